"""One execution of a recording: its memory, its passes, and the time of each stage."""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .ahead import Ahead, popped
from .arrays import Array, Resident
from .commands import Clear, Command, Copy, Dispatch, Download, Proxy, Upload
from .compiling import Compiled, tell_compiling
from .device import MAX_TICKS, Device, texel_rows
from .pool import Use

if TYPE_CHECKING:
    import wgpu

    from .pool import Memory

LONG_S = 0.3  # to compile a kernel: Mesa's driver takes a third of it for one whose code it has


class Run:
    """One execution of a recording: its buffers, encoders and clocks."""

    def __init__(self, device: Device) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        self.times_s: defaultdict[str, float] = defaultdict(float)
        self.clock = "gpu" if device.timestamps else "wall"
        self._device = device
        self._held: list[Memory] = []
        self._memory: dict[str, Memory] = {}
        self._groups: dict[tuple[int, ...], wgpu.GPUBindGroup] = {}
        self._encoder: wgpu.GPUCommandEncoder | None = None
        self._pass: wgpu.GPUComputePassEncoder | None = None
        self._stages: list[str] = []  # of the passes in the open encoder, in order
        self._timed: list[tuple[list[str], wgpu.GPUBuffer]] = []  # ticks of this segment

    def allocate(self, proxies: Mapping[str, Proxy], params: bytes) -> None:
        """Take memory for the transient arrays and the params from the pool."""
        for label, proxy in proxies.items():
            if proxy.nbytes:
                self._memory[label] = self._acquire(label, proxy.nbytes, proxy.use)
        if params:
            self._uniform = self._acquire("params", len(params))
            self._device.gpu.queue.write_buffer(self._uniform, 0, params)

    def _acquire(self, label: str, nbytes: int, use: Use = Use.DATA) -> Memory:
        buffer = self._device.pool.acquire(label, nbytes, use)
        self._held.append(buffer)
        return buffer

    def release(self, first: int = 0) -> None:
        """Give the buffers back that were acquired, from the ``first`` on."""
        for buffer in self._held[first:]:
            self._device.pool.release(buffer)
        del self._held[first:]

    def compile(self, first_uses: Sequence[Dispatch]) -> None:
        """Compile the kernels of these dispatches, and tell of each.

        One after another; once one takes long, further cores take part where that helps.
        """
        left, total = deque(first_uses), len(first_uses)
        ahead = None
        try:
            for number, command in enumerate(popped(left.popleft)):
                tell_compiling(number, total)
                spent_s = compile_one(self._device, command)
                if spent_s > LONG_S and ahead is None and self._device.shares_code:
                    ahead = Ahead(self._device, compile_one, left)
            if ahead is not None:
                self._take_over(*ahead.taken(), total)
        finally:
            if ahead is not None:
                ahead.stop()
        if first_uses:
            tell_compiling(total, total)

    def _take_over(
        self, others: Sequence[Dispatch], compiled: Mapping[object, Compiled], total: int
    ) -> None:
        """Compile what further devices have compiled: the driver has the code of it."""
        own_s, spent_s = 0.0, sum(one.wall_s for one in compiled.values())
        for number, command in enumerate(others, start=total - len(others)):
            tell_compiling(number, total)
            own_s += compile_one(self._device, command)
        self._device.shares_code = own_s < max(spent_s / 2, LONG_S)
        self._device.compiled |= compiled

    def dispatch_nothing(self, command: Dispatch) -> None:
        """Dispatch a kernel with no workgroups, untimed, and wait for it."""
        encoder = self._device.gpu.create_command_encoder(label="compile")
        compute = encoder.begin_compute_pass(label=command.kernel.path)
        self._bind(compute, command)
        compute.dispatch_workgroups(0, 0, 0)
        compute.end()
        self._device.gpu.queue.submit([encoder.finish()])
        self._device.wait()

    def segment(self, commands: Sequence[Command]) -> None:
        """Submit the commands of one segment, wait, and fetch its downloads."""
        held = len(self._held)
        started = time.perf_counter()
        fetches = []
        for command in commands:
            match command:
                case Dispatch():
                    self._dispatch(command)
                case Download(source, dtype):
                    self.arrays[source.label] = np.empty(source.shape, dtype)
                    if source.nbytes:
                        staging = self._acquire("download", source.nbytes, Use.READBACK)
                        self._copying().copy_buffer_to_buffer(
                            self._buffer(source), 0, staging, 0, source.nbytes
                        )
                        fetches.append((staging, self.arrays[source.label], source.dtype))
                case Copy(source, target):
                    buffer, texture = self._buffer(source), self._buffer(target).texture
                    for origin, in_buffer, size in texel_rows(source.nbytes):
                        self._copying().copy_buffer_to_texture(
                            {"buffer": buffer, **in_buffer},
                            {"texture": texture, "origin": origin},
                            size,
                        )
                case Clear(target) if target.nbytes:
                    self._copying().clear_buffer(self._buffer(target), 0, target.nbytes)
                case Upload(target, array) if target.nbytes:
                    self._submit()  # a queue write comes before whatever is submitted after it
                    self._device.fill(self._buffer(target), array)
        self._submit()
        self._device.wait()
        self._account(time.perf_counter() - started)
        for fetched in fetches:
            self._device.fetch(*fetched)
        self.release(held)

    def _buffer(self, array: Array) -> Memory:
        return array.buffer if isinstance(array, Resident) else self._memory[array.label]

    def _open(self) -> wgpu.GPUCommandEncoder:
        if self._encoder is None:
            self._encoder = self._device.gpu.create_command_encoder(label="recording")
        return self._encoder

    def _copying(self) -> wgpu.GPUCommandEncoder:
        """Return the encoder with no pass open."""
        self._end_pass()
        return self._open()

    def _dispatch(self, command: Dispatch) -> None:
        kernel = command.kernel
        if self._pass is None or self._stages[-1] != kernel.path:
            self._begin_pass(kernel.path)
        self._bind(self._pass, command)
        self._pass.dispatch_workgroups(*command.groups)

    def _bind(self, compute: wgpu.GPUComputePassEncoder, command: Dispatch) -> None:
        """Set pipeline, buffers and params of a dispatch."""
        kernel = command.kernel
        compiled = kernel.compile(self._device)
        memory = [self._buffer(command.buffers[name]) for name in kernel.buffers]
        key = (id(compiled), *map(id, memory))
        if key not in self._groups:
            sizes = [command.buffers[name].nbytes for name in kernel.buffers]
            indices = [one.index for one in kernel.buffers.values()]
            bound = [(0, self._uniform, kernel.params.size)]
            bound += zip(indices, memory, sizes, strict=True)
            self._groups[key] = self._device.gpu.create_bind_group(
                label=kernel.path,
                layout=compiled.layout,
                entries=[
                    {"binding": index, "resource": _bound(one, size)} for index, one, size in bound
                ],
            )
        compute.set_pipeline(compiled.pipeline)
        compute.set_bind_group(0, self._groups[key], [command.offset])

    def _begin_pass(self, stage: str) -> None:
        self._end_pass()
        timing = {}
        if self.clock == "gpu":
            if 2 * len(self._stages) == MAX_TICKS:
                self._submit()
            tick = 2 * len(self._stages)
            timing = {
                "query_set": self._device.ticks,
                "beginning_of_pass_write_index": tick,
                "end_of_pass_write_index": tick + 1,
            }
        else:
            self._submit()
        self._pass = self._open().begin_compute_pass(label=stage, timestamp_writes=timing or None)
        self._stages.append(stage)

    def _end_pass(self) -> None:
        if self._pass is not None:
            self._pass.end()
            self._pass = None
            if self.clock == "wall":  # no better clock: each pass is submitted alone and awaited
                started = time.perf_counter()
                stage = self._stages[-1]
                self._submit()
                self._device.wait()
                self.times_s[stage] += time.perf_counter() - started

    def _submit(self) -> None:
        """Submit the open encoder, if any, and the copy of its ticks."""
        self._end_pass()
        if self._encoder is None:
            return
        commands = [self._encoder]
        if self._stages and self.clock == "gpu":
            nbytes = 16 * len(self._stages)
            ticks = self._acquire("ticks", nbytes, Use.TICKS)
            staging = self._acquire("ticks", nbytes, Use.READBACK)
            self._encoder.resolve_query_set(self._device.ticks, 0, nbytes // 8, ticks, 0)
            # Copied by a command buffer of its own: some adapters else copy zeros (wgpu #6406).
            commands.append(self._device.gpu.create_command_encoder(label="ticks"))
            commands[-1].copy_buffer_to_buffer(ticks, 0, staging, 0, nbytes)
            self._timed.append((self._stages, staging))
        self._device.gpu.queue.submit([one.finish() for one in commands])
        self._encoder = None
        self._stages = []

    def _account(self, elapsed_s: float) -> None:
        """Add this segment's times by stage from its ticks.

        Where one tick is nonsense (wgpu #5660, #9414) the device's ticks are not used any more,
        and the passes of this segment get equal shares of the time that passed.
        """
        spans = []
        for stages, staging in self._timed:
            ticks = np.empty((len(stages), 2), np.uint64)
            self._device.fetch(staging, ticks, ticks.dtype)
            spans += zip(stages, spans_s(ticks, self._device.tick_s), strict=True)
        self._timed.clear()
        if not all(0 <= span <= elapsed_s for _, span in spans):
            self._device.timestamps = False
            self.clock = "wall"
            spans = [(stage, elapsed_s / len(spans)) for stage, _ in spans]
        for stage, span in spans:
            self.times_s[stage] += span


def compile_one(device: Device, command: Dispatch) -> float:
    """Compile the kernel of a dispatch, and return the seconds that it took.

    Software drivers compile at a pipeline's first dispatch: one of no workgroups, over buffers as
    small as the kernel takes, makes them do so now and not amid the work.
    """
    kernel = command.kernel
    buffers = {
        name: Proxy(name, kernel.least_bytes(name) // 4, np.float32, array.use)
        for name, array in command.buffers.items()
    }
    run = Run(device)
    try:
        run.allocate(buffers, bytes(kernel.params.size))
        started = time.perf_counter()
        run.dispatch_nothing(Dispatch(kernel, command.groups, 0, buffers))
        wall_s = time.perf_counter() - started
    finally:
        run.release()
    device.compiled[kernel.key] = Compiled(kernel.path, kernel.overrides, wall_s)
    return wall_s


def _bound(memory: Memory, nbytes: int) -> Memory | dict[str, object]:
    """Return a bind group's resource: the first bytes of a buffer, or a whole texture."""
    if hasattr(memory, "texture"):
        return memory
    return {"buffer": memory, "offset": 0, "size": nbytes}


def spans_s(ticks: np.ndarray, tick_s: float) -> list[float]:
    """Return the seconds between the two ticks of each pass.

    Negative where they are disordered, and where one is 0, as it is while nobody has written it. A
    pass may begin and end within one tick: those of NVIDIA's driver are 32 ns and longer.
    """
    return [(int(end) - int(begin)) * tick_s if begin and end else -tick_s for begin, end in ticks]

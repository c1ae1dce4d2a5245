"""A recording: a flat list of commands over proxies, run at once, timed by stage."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import wgpu

from .compiling import Compiled, tell_compiling
from .device import MAX_TICKS, Array, Device, Resident, texel_rows
from .layout import ShaderError
from .pool import Memory, Use

if TYPE_CHECKING:
    from .kernel import Kernel

_UNIFORM_STEP = 256  # WebGPU's portable alignment of uniform offsets


class Proxy(Array):
    """A transient array of one recording: memory only while the recording runs."""


@dataclass(frozen=True)
class Upload:
    """Write a host array into a buffer."""

    target: Array
    array: np.ndarray


@dataclass(frozen=True)
class Copy:
    """Copy a buffer into a texture of as many bytes."""

    source: Array
    target: Array


@dataclass(frozen=True)
class Clear:
    """Fill a buffer with zeros."""

    target: Array


@dataclass(frozen=True)
class Download:
    """Copy a buffer to the host, under its label."""

    source: Array


@dataclass(frozen=True)
class Dispatch:
    """Run a kernel over a grid of workgroups; ``offset`` is where its params lie."""

    kernel: Kernel
    groups: tuple[int, int, int]
    offset: int
    buffers: Mapping[str, Array]


Command = Upload | Copy | Clear | Download | Dispatch


@dataclass
class Result(Mapping):
    """The downloaded arrays by label, and what the run cost.

    Attributes
    ----------
    times_s : dict of str to float
        Seconds for each stage.
    clock : str
        ``gpu`` (timestamps) or ``wall``.
    """

    arrays: dict[str, np.ndarray]
    times_s: dict[str, float]
    clock: str

    def __getitem__(self, label: str) -> np.ndarray:
        return self.arrays[label]

    def __iter__(self) -> Iterator[str]:
        return iter(self.arrays)

    def __len__(self) -> int:
        return len(self.arrays)


class Recording:
    """Commands for one device; :meth:`run` submits them.

    A recording may be run again: it then uploads and computes everything anew.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self._segments: list[list[Command]] = [[]]
        self._proxies: dict[str, Proxy] = {}
        self._written: set[str] = set()
        self._params = bytearray()
        self._offsets: dict[bytes, int] = {}
        self._downloads: set[str] = set()
        self._prefix = ""

    @property
    def commands(self) -> Iterator[Command]:
        """All commands, in order."""
        return chain.from_iterable(self._segments)

    @property
    def params(self) -> bytes:
        """The uniforms of all dispatches, each at its ``offset``."""
        return bytes(self._params)

    @contextmanager
    def labelled(self, prefix: str) -> Iterator[None]:
        """Begin the labels of all buffers that are declared meanwhile with a text.

        So that one recording holds the same work several times.
        """
        before, self._prefix = self._prefix, self._prefix + prefix
        try:
            yield
        finally:
            self._prefix = before

    def buffer(
        self,
        label: str,
        shape: tuple[int, ...] | int,
        dtype: np.dtype | type,
        use: Use = Use.DATA,
    ) -> Proxy:
        """Declare a transient array; its content is undefined until something writes it.

        Raises
        ------
        ShaderError
            The label is taken, or the dtype is none that shaders have.
        """
        label = self._prefix + label
        if label in self._proxies:
            raise ShaderError(f"this recording already has a buffer {label!r}")
        proxy = self._proxies[label] = Proxy(label, shape, dtype, use)
        return proxy

    def upload(self, target: Array, array: np.ndarray) -> None:
        """Write a host array into a buffer; the array is read when the recording runs."""
        command = Upload(target, target.checked(array))
        self._check((), (target,))
        self._segments[-1].append(command)

    def copy(self, source: Array, target: Array) -> None:
        """Copy a buffer into texels of as many bytes.

        Raises
        ------
        ShaderError
            The arrays have other uses, or their sizes differ.
        """
        uses = (source.use, target.use)
        if uses != (Use.DATA, Use.TEXELS) or source.nbytes != target.nbytes:
            raise ShaderError(f"{source} cannot be copied into {target}")
        self._check((source,), (target,))
        self._segments[-1].append(Copy(source, target))

    def clear(self, target: Array) -> None:
        """Fill a buffer with zeros; texels are not cleared."""
        if target.use is Use.TEXELS:
            raise ShaderError(f"{target} is filled by upload and copy alone")
        self._check((), (target,))
        self._segments[-1].append(Clear(target))

    def download(self, source: Array) -> str:
        """Copy a buffer to the host; return its label, the key in the result.

        Texels are not downloaded.
        """
        if source.use is Use.TEXELS:
            raise ShaderError(f"{source} is what a buffer was copied into: download that")
        if source.label in self._downloads:
            raise ShaderError(f"buffer {source.label!r} is downloaded twice")
        self._check((source,), ())
        self._segments[-1].append(Download(source))
        self._downloads.add(source.label)
        return source.label

    def mark(self) -> None:
        """End a segment: :meth:`run` submits and waits here, and reports progress."""
        self._segments.append([])

    def dispatch(
        self,
        kernel: Kernel,
        groups: tuple[int, int, int],
        params: bytes,
        buffers: Mapping[str, Array],
    ) -> None:
        """Append a checked dispatch; :meth:`Kernel.record` is the way to call it."""
        writes = [array for name, array in buffers.items() if kernel.writes(name)]
        reads = [array for name, array in buffers.items() if not kernel.writes(name)]
        empty = [array.label for array in buffers.values() if array.nbytes == 0]
        if 0 in groups:  # nothing to compute: what it would have written counts as written
            self._check(reads, writes, f"{kernel.path}: ")
            return
        if empty:
            raise ShaderError(f"{kernel.path}: {empty} have no elements")
        if params not in self._offsets:
            self._offsets[params] = len(self._params)
            self._params += params + bytes(-len(params) % _UNIFORM_STEP)
        self._check(reads, writes, f"{kernel.path}: ")
        command = Dispatch(kernel, groups, self._offsets[params], dict(buffers))
        self._segments[-1].append(command)

    def _check(self, reads: Sequence[Array], writes: Sequence[Array], where: str = "") -> None:
        """Refuse foreign proxies and proxies read before anything wrote them; note the writes."""
        for array in (*reads, *writes):
            if isinstance(array, Proxy) and self._proxies.get(array.label) is not array:
                raise ShaderError(f"{where}buffer {array.label!r} is of another recording")
        for array in reads:
            if isinstance(array, Proxy) and array.label not in self._written:
                raise ShaderError(f"{where}buffer {array.label!r} is read before it is written")
        self._written.update(array.label for array in writes)

    def run(self, progress: Callable[[int, int], None] | None = None) -> Result:
        """Submit everything, wait, and return the downloads.

        Parameters
        ----------
        progress : callable, optional
            Called with (segments done, segments in all) after each segment.

        Raises
        ------
        OutOfMemoryError
            The buffers do not fit the GPU memory budget.
        DeviceLostError
            The device went away.
        ShaderError
            A shader does not compile.
        """
        segments = [segment for segment in self._segments if segment]
        run = _Run(self.device)
        with self.device.telling_of_loss():
            first_uses = {
                command.kernel.key: command
                for command in self.commands
                if isinstance(command, Dispatch) and command.kernel.key not in self.device.compiled
            }
            try:
                run.allocate(self._proxies, bytes(self._params))
                run.compile(list(first_uses.values()))
                for number, segment in enumerate(segments, start=1):
                    run.segment(segment)
                    if progress is not None:
                        progress(number, len(segments))
            finally:
                run.release()
        return Result(run.arrays, dict(run.times_s), run.clock)


class _Run:
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
        """Compile the kernels of these dispatches, one after another, and tell of each.

        Software drivers compile at a pipeline's first dispatch: one of no workgroups, over the
        buffers that the kernel will have, makes them do so here and not amid the work.
        """
        device = self._device
        for number, command in enumerate(first_uses):
            tell_compiling(number, len(first_uses))
            wall, cpu = time.perf_counter(), time.process_time()
            encoder = device.gpu.create_command_encoder(label="compile")
            compute = encoder.begin_compute_pass(label=command.kernel.path)
            self._bind(compute, command)
            compute.dispatch_workgroups(0, 0, 0)
            compute.end()
            device.gpu.queue.submit([encoder.finish()])
            device.wait()
            spent = time.perf_counter() - wall, time.process_time() - cpu
            kernel = command.kernel
            device.compiled[kernel.key] = Compiled(kernel.path, kernel.overrides, *spent)
        if first_uses:
            tell_compiling(len(first_uses), len(first_uses))

    def segment(self, commands: Sequence[Command]) -> None:
        """Submit the commands of one segment, wait, and fetch its downloads."""
        held = len(self._held)
        started = time.perf_counter()
        fetches = []
        for command in commands:
            match command:
                case Dispatch():
                    self._dispatch(command)
                case Download(source):
                    self.arrays[source.label] = np.empty(source.shape, source.dtype)
                    if source.nbytes:
                        staging = self._acquire("download", source.nbytes, Use.READBACK)
                        self._copying().copy_buffer_to_buffer(
                            self._buffer(source), 0, staging, 0, source.nbytes
                        )
                        fetches.append((staging, self.arrays[source.label]))
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
        for staging, array in fetches:
            self._device.fetch(staging, array)
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
            self._device.fetch(staging, ticks)
            spans += zip(stages, spans_s(ticks, self._device.tick_s), strict=True)
        self._timed.clear()
        if not all(0 <= span <= elapsed_s for _, span in spans):
            self._device.timestamps = False
            self.clock = "wall"
            spans = [(stage, elapsed_s / len(spans)) for stage, _ in spans]
        for stage, span in spans:
            self.times_s[stage] += span


def _bound(memory: Memory, nbytes: int) -> Memory | dict[str, object]:
    """Return a bind group's resource: the first bytes of a buffer, or a whole texture."""
    if isinstance(memory, wgpu.GPUTextureView):
        return memory
    return {"buffer": memory, "offset": 0, "size": nbytes}


def spans_s(ticks: np.ndarray, tick_s: float) -> list[float]:
    """Return the seconds between the two ticks of each pass.

    Negative where they are disordered, and where one is 0, as it is while nobody has written it. A
    pass may begin and end within one tick: those of NVIDIA's driver are 32 ns and longer.
    """
    return [(int(end) - int(begin)) * tick_s if begin and end else -tick_s for begin, end in ticks]

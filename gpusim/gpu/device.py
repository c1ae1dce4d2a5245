"""The device: explicit limits, report, what goes there and comes back."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from typing import TYPE_CHECKING

import numpy as np

from gpusim.errors import UserError

from .adapters import choose, described, native
from .arrays import Resident
from .compiling import Compiled
from .packing import ShaderError
from .pool import (
    MAX_BINDING_BYTES,
    MAX_BUFFER_BYTES,
    TEXEL_BYTES,
    TEXEL_ROW_BYTES,
    Pool,
    Use,
)

if TYPE_CHECKING:
    import wgpu

    from .pool import Memory

# Limits that are not named are filled from the adapter by wgpu-py, and then code that runs here may
# not run elsewhere; so the defaults of the WebGPU specification (section "Limits") are named.
PORTABLE_LIMITS = {
    "max-bind-groups": 4,
    "max-storage-buffers-per-shader-stage": 8,
    "max-sampled-textures-per-shader-stage": 16,
    "max-texture-dimension-2d": 8192,
    "max-uniform-buffers-per-shader-stage": 12,
    "max-uniform-buffer-binding-size": 65536,
    "max-storage-buffer-binding-size": MAX_BINDING_BYTES,
    "max-buffer-size": MAX_BUFFER_BYTES,
    "max-compute-workgroup-storage-size": 16384,
    "max-compute-invocations-per-workgroup": 256,
    "max-compute-workgroup-size-x": 256,
    "max-compute-workgroup-size-y": 256,
    "max-compute-workgroup-size-z": 64,
    "max-compute-workgroups-per-dimension": 65535,
}
DEFAULT_BUDGET_BYTES = 1 << 30  # leaves room for a desktop on an adapter with 2 GiB
# Uploads that may wait for the device. Each has memory of its own until it is done, and new memory
# is dear: 100 uploads of 2.3 MB took 0.2 to 0.8 s together, 0.03 s where each found the memory of
# those before it (lavapipe, 2 cores).
ON_THE_WAY_BYTES = 16 << 20
MAX_TICKS = 4096  # WebGPU's limit of one query set; two ticks a pass


class DeviceLostError(UserError):
    """The device is gone, and everything on it: driver reset, unplugged, put to sleep."""


class Device:
    """One GPU device under portable limits; open it with :meth:`open`.

    Attributes
    ----------
    pool : Pool
    timestamps : bool
        Passes are timed by the GPU; switched off when its ticks turn out to be nonsense.
    lost : bool
        Nothing works on it any more.
    compiled : dict of object to Compiled
        What each kernel that has run took to compile, by the kernel's key.
    shares_code : bool
        Whether the driver has the code of kernels that another device has compiled: taken for
        granted until it turns out not to be so.
    """

    def __init__(self, adapter: wgpu.GPUAdapter, budget: int) -> None:
        features = ["timestamp-query"] if "timestamp-query" in adapter.features else []
        self._adapter = adapter
        self.gpu = adapter.request_device_sync(
            label="gpusim", required_features=features, required_limits=PORTABLE_LIMITS
        )
        self.pool = Pool(self.gpu, budget)
        self.timestamps = bool(features)
        self.lost = False
        self.tick_s = native().wgpuQueueGetTimestampPeriod(self.gpu.queue._internal) * 1e-9
        self.pipelines: dict[object, object] = {}  # filled and read by kernel.py
        self.double_float: dict[str, bool] | None = None  # not tested yet: see exact.py
        self.compiled: dict[object, Compiled] = {}  # by run.py, in order of time
        self.shares_code = True
        self._on_the_way = 0  # bytes of uploads
        self._fence = self.gpu.create_buffer(label="fence", size=16, usage=Use.READBACK.value)
        self._ticks: wgpu.GPUQuerySet | None = None

    @classmethod
    def open(cls, adapter: str | None = None, budget: int = DEFAULT_BUDGET_BYTES) -> Device:
        """Open a device.

        Parameters
        ----------
        adapter : str, optional
            Part of the adapter's or driver's name, upper or lower case. Without it: a discrete
            GPU before an integrated one before a CPU.
        budget : int
            GPU memory budget in bytes.

        Raises
        ------
        UserError
            No usable adapter, or none of that name.
        """
        return cls(choose(adapter), budget)

    @contextmanager
    def another(self) -> Iterator[Device]:
        """Open a further device of the same adapter, for as long as the body runs."""
        device = Device(self._adapter, self.pool.budget)
        try:
            yield device
        finally:
            device.gpu.destroy()

    def report(self) -> dict[str, object]:
        """Return what runs here: adapter, driver, backend, versions, clock, limits, budget."""
        return {
            **described(self._adapter),
            "wgpu": metadata.version("wgpu"),
            "timestamps": self.timestamps,
            "budget_bytes": self.pool.budget,
            "limits": {name: self.gpu.limits[name] for name in PORTABLE_LIMITS},
        }

    def resident(self, label: str, array: np.ndarray, use: Use = Use.DATA) -> Resident:
        """Upload an array that stays on the device until ``.destroy()``."""
        with self.telling_of_loss():
            result = Resident(self, label, array.shape, array.dtype, use)
            self.write(result, array)
        return result

    def empty(self, label: str, shape: tuple[int, ...] | int, dtype: np.dtype | type) -> Resident:
        """Make a resident array whose content is undefined."""
        with self.telling_of_loss():
            return Resident(self, label, shape, dtype)

    @contextmanager
    def telling_of_loss(self) -> Iterator[None]:
        """Turn the errors of a lost device into one that says so.

        Raises
        ------
        DeviceLostError
            For whatever wgpu raises in the body when the device is lost.
        """
        import wgpu

        try:
            yield
        except (wgpu.GPUError, RuntimeError, ShaderError) as error:
            if not re.search("device (is )?lost", str(error), re.IGNORECASE):
                raise
            self.lost = True
            raise DeviceLostError(
                "The graphics device was lost in the middle of the work: its driver was reset (a "
                "pass took too long, or the memory ran out), or the device went away",
                field="adapter",
                value=self._adapter.info["device"],
                allowed="the same command again, with smaller tiles (--memory 256MiB), or on "
                "another adapter (--adapter NAME; gpusim devices lists them)",
            ) from error

    def write(self, resident: Resident, array: np.ndarray) -> None:
        """Replace the content of a resident array."""
        data = resident.checked(array)
        if data.nbytes:
            self.fill(resident.buffer, data)
            self._on_the_way += data.nbytes
        if self._on_the_way > ON_THE_WAY_BYTES:
            self.wait()
            self._on_the_way = 0

    def fill(self, memory: Memory, data: np.ndarray) -> None:
        """Write a contiguous array into a buffer or texture, from its beginning."""
        if not hasattr(memory, "texture"):
            self.gpu.queue.write_buffer(memory, 0, data)
            return
        data = data.reshape(-1).view(np.uint8)
        for origin, in_data, size in texel_rows(data.nbytes):
            target = {"texture": memory.texture, "origin": origin}
            self.gpu.queue.write_texture(target, data, in_data, size)

    def read(self, resident: Resident) -> np.ndarray:
        """Return a copy of a resident array."""
        result = np.empty(resident.shape, resident.dtype)
        if not result.nbytes:
            return result
        with self.telling_of_loss():
            staging = self.pool.acquire("read", result.nbytes, Use.READBACK)
            encoder = self.gpu.create_command_encoder(label="read")
            if resident.use is Use.TEXELS:
                for origin, in_buffer, size in texel_rows(result.nbytes):
                    source = {"texture": resident.buffer.texture, "origin": origin}
                    encoder.copy_texture_to_buffer(source, {"buffer": staging, **in_buffer}, size)
            else:
                encoder.copy_buffer_to_buffer(resident.buffer, 0, staging, 0, result.nbytes)
            self.gpu.queue.submit([encoder.finish()])
            self.fetch(staging, result, result.dtype)
            self.pool.release(staging)
        return result

    def fetch(self, staging: wgpu.GPUBuffer, into: np.ndarray, dtype: np.dtype) -> None:
        """Wait for ``staging`` and copy its first numbers, of a dtype, into a contiguous array."""
        nbytes = into.size * dtype.itemsize
        staging.map_async("READ", 0, nbytes).sync_wait()
        view = staging.read_mapped(0, nbytes, copy=False)
        into.reshape(-1)[:] = np.frombuffer(view, dtype)
        del view  # a view past unmap() may point nowhere
        staging.unmap()

    def wait(self) -> None:
        """Wait until everything submitted so far is done.

        ``queue.on_submitted_work_done`` fails in wgpu 0.32.0. A buffer is mapped once the last
        submission that uses it is done, and submissions end in their order: so one is made here.
        Without it SwiftShader and NVIDIA's driver return at once, and lavapipe alone, which works
        while it takes a submission, has nothing left to wait for.
        """
        encoder = self.gpu.create_command_encoder(label="fence")
        encoder.clear_buffer(self._fence)
        self.gpu.queue.submit([encoder.finish()])
        self._fence.map_async("READ").sync_wait()
        self._fence.unmap()

    @property
    def ticks(self) -> wgpu.GPUQuerySet:
        """The query set for the timestamps of one submit."""
        if self._ticks is None:
            self._ticks = self.gpu.create_query_set(
                label="ticks", type="timestamp", count=MAX_TICKS
            )
        return self._ticks


Triple = tuple[int, int, int]


def texel_rows(nbytes: int) -> list[tuple[Triple, dict[str, int], Triple]]:
    """Return the rectangles of a texture that so many bytes fill: whole rows, part of a last one.

    Each one is its origin, where its bytes lie, and its size in texels.
    """
    rows, rest = divmod(nbytes, TEXEL_ROW_BYTES)
    parts = (0, TEXEL_ROW_BYTES // TEXEL_BYTES, rows), (rows, rest // TEXEL_BYTES, 1)
    return [
        (
            (0, first, 0),
            {"offset": first * TEXEL_ROW_BYTES, "bytes_per_row": TEXEL_ROW_BYTES},
            (width, height, 1),
        )
        for first, width, height in parts
        if width and height
    ]


_default: Device | None = None


def default_device() -> Device:
    """Return the one device of this process; the first call opens it, and the first after a loss.

    The environment variable GPUSIM_ADAPTER names the adapter; without it the best one is taken.

    Raises
    ------
    UserError
        No such adapter.
    """
    global _default
    if _default is None or _default.lost:
        _default = Device.open(os.environ.get("GPUSIM_ADAPTER") or None)
    return _default

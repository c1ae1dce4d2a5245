"""A pool of GPU buffers and textures in size classes, with a budget and counters."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from typing import TYPE_CHECKING

from gpusim.errors import UserError

if TYPE_CHECKING:
    import wgpu

    # A texture is held as its view, which a shader is given. Copies go to the view's `texture`.
    Memory = wgpu.GPUBuffer | wgpu.GPUTextureView

# The portable caps of WebGPU's default limits: what runs here then runs on any adapter.
MAX_BUFFER_BYTES = 256 << 20
MAX_BINDING_BYTES = 128 << 20
MIN_CLASS_BYTES = 256  # WebGPU's alignment of uniform offsets: the smallest useful buffer
TEXEL_BYTES = 16  # rgba32float
# As shaders/common/texels has it: 128 MiB are 4096 rows, of 8192 that every adapter has.
TEXEL_ROW_BYTES = 2048 * TEXEL_BYTES


class OutOfMemoryError(UserError):
    """The device's memory, or the budget of it, does not suffice: less work at a time may."""


class Use(Enum):
    """What memory is for; that of different uses is never exchanged.

    TEXELS is a texture, of which shaders only read: see shaders/common/texels. The values are
    WebGPU's flags as wgpu reads them.
    """

    DATA = "STORAGE | UNIFORM | COPY_SRC | COPY_DST"
    READBACK = "MAP_READ | COPY_DST"
    TICKS = "QUERY_RESOLVE | COPY_SRC"
    TEXELS = "TEXTURE_BINDING | COPY_SRC | COPY_DST"


def size_class(nbytes: int, use: Use = Use.DATA) -> int:
    """Return the smallest 2^n or 1.5 * 2^n bytes that holds ``nbytes``; whole rows of a texture.

    At most a third of a buffer is unused, a sixth on average, and a few classes serve all tiles.
    Textures have no classes: wgpu fills one with zeros that is not written as a whole at once, and
    new memory is dear. Their rows are no power of two: lavapipe compiles a shader anew for each
    set of textures of which others have a power of two, two seconds for the demonstration.
    """
    if use is Use.TEXELS:
        rows = max(-(-nbytes // TEXEL_ROW_BYTES), 3)
        return (rows + (rows & (rows - 1) == 0)) * TEXEL_ROW_BYTES
    power = MIN_CLASS_BYTES
    while power < nbytes:
        if power * 3 // 2 >= nbytes:
            return power * 3 // 2
        power *= 2
    return power


def mebibytes(nbytes: float) -> str:
    """Return ``nbytes`` as a text in MiB."""
    return f"{nbytes / 2**20:.1f} MiB"


class Pool:
    """Hands out GPU buffers and textures, and keeps the returned ones for reuse.

    Parameters
    ----------
    device : wgpu.GPUDevice
    budget : int
        Bytes that buffers in use and buffers kept for reuse may hold together.

    Attributes
    ----------
    in_use, idle, peak : int
        Bytes handed out now; bytes kept for reuse; largest sum of both so far.
    hits, misses : int
        Requests served from the kept buffers; requests that made a new one.
    """

    def __init__(self, device: wgpu.GPUDevice, budget: int) -> None:
        self._device = device
        self._free: defaultdict[tuple[int, Use], list[Memory]] = defaultdict(list)
        self._lent: dict[Memory, tuple[int, Use]] = {}
        self.budget = budget
        self.in_use = self.idle = self.peak = self.hits = self.misses = 0

    def acquire(self, label: str, nbytes: int, use: Use = Use.DATA) -> Memory:
        """Return a buffer, or the view of a texture, of at least ``nbytes``.

        What it holds is undefined.

        Raises
        ------
        OutOfMemoryError
            The buffer is larger than a portable binding, the budget does not allow it, or the
            adapter has no more.
        """
        if nbytes > MAX_BINDING_BYTES:
            raise OutOfMemoryError(
                f"The GPU buffer {label!r} would be larger than one binding may be",
                field=label,
                value=mebibytes(nbytes),
                allowed=f"at most {mebibytes(MAX_BINDING_BYTES)} on any adapter: work in tiles",
            )
        size = size_class(nbytes, use)
        kept = self._free[size, use]
        if kept:
            self.hits += 1
            self.idle -= size
            buffer = kept.pop()
        else:
            self._make_room(label, size)
            self.misses += 1
            buffer = self._create(label, size, use)
        self._lent[buffer] = size, use
        self.in_use += size
        self.peak = max(self.peak, self.in_use + self.idle)
        return buffer

    @contextmanager
    def within(self, budget: int) -> Iterator[None]:
        """Hold to another budget for a while, and count the peak anew."""
        before = self.budget
        self.budget = budget
        self._drop(self.in_use + self.idle - budget)
        self.peak = self.in_use + self.idle
        try:
            yield
        finally:
            self.budget = before

    def release(self, buffer: Memory) -> None:
        """Take back what was lent; the GPU must have finished with it."""
        size, use = self._lent.pop(buffer)
        self._free[size, use].append(buffer)
        self.in_use -= size
        self.idle += size

    def clear(self) -> None:
        """Destroy the buffers kept for reuse."""
        for buffers in self._free.values():
            for buffer in buffers:
                _destroy(buffer)
        self._free.clear()
        self.idle = 0

    def _drop(self, nbytes: int) -> None:
        """Destroy so many bytes of the buffers kept for reuse, the largest first, and no more.

        New memory is dear: lavapipe takes 3 to 5 s for a GiB that it has not touched before.
        """
        for (size, _), buffers in sorted(self._free.items(), key=lambda kept: -kept[0][0]):
            while buffers and nbytes > 0:
                _destroy(buffers.pop())
                self.idle -= size
                nbytes -= size

    def _create(self, label: str, size: int, use: Use) -> Memory:
        import wgpu

        try:
            return self._made(label, size, use)
        except wgpu.GPUOutOfMemoryError:
            self.clear()  # what is kept for reuse may be what is lacking
        try:
            return self._made(label, size, use)
        except wgpu.GPUOutOfMemoryError as error:
            raise OutOfMemoryError(
                f"The adapter has no memory left for the buffer {label!r}",
                value=f"{mebibytes(size)} beside {mebibytes(self.in_use)} in use",
                allowed="a smaller tile or a smaller frame",
            ) from error

    def _made(self, label: str, size: int, use: Use) -> Memory:
        if use is not Use.TEXELS:
            return self._device.create_buffer(label=label, size=size, usage=use.value)
        texture = self._device.create_texture(
            label=label,
            size=(TEXEL_ROW_BYTES // TEXEL_BYTES, size // TEXEL_ROW_BYTES, 1),
            format="rgba32float",
            usage=use.value,
        )
        return texture.create_view(label=label)

    def _make_room(self, label: str, size: int) -> None:
        self._drop(self.in_use + self.idle + size - self.budget)
        if self.in_use + size > self.budget:
            raise OutOfMemoryError(
                f"The GPU memory budget does not hold the buffer {label!r}",
                field="GPU memory budget",
                value=f"{mebibytes(self.budget)}, {mebibytes(self.in_use)} of it in use",
                allowed=f"at least {mebibytes(self.in_use + size)}",
            )


def _destroy(memory: Memory) -> None:
    getattr(memory, "texture", memory).destroy()  # a view's texture, or a buffer

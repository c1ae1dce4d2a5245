"""Arrays on the device: what a kernel binds, and those that stay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .packing import ShaderError
from .pool import TEXEL_BYTES, Use

if TYPE_CHECKING:
    from .device import Device
    from .pool import Memory

# NumPy dtypes that a buffer may have, and the WGSL scalar that they are.
DTYPES = {
    np.dtype(np.float32): "f32",
    np.dtype(np.complex64): "f32",
    np.dtype(np.uint32): "u32",
    np.dtype(np.int32): "i32",
}


class Array:
    """A GPU buffer, or texture, seen as an array: what a kernel binds.

    Attributes
    ----------
    label : str
    shape : tuple of int
    dtype : numpy.dtype
        float32, complex64 (as vec2f), uint32 or int32.
    nbytes : int
    use : Use
        DATA; or TEXELS, which has whole texels of float32.
    """

    def __init__(
        self,
        label: str,
        shape: tuple[int, ...] | int,
        dtype: np.dtype | type,
        use: Use = Use.DATA,
    ) -> None:
        self.label, self.use = label, use
        self.shape = (shape,) if isinstance(shape, int) else tuple(int(n) for n in shape)
        self.dtype = np.dtype(dtype)
        if self.dtype not in DTYPES:
            allowed = ", ".join(str(known) for known in DTYPES)
            raise ShaderError(f"buffer {label!r}: dtype {self.dtype}, allowed are {allowed}")
        if min(self.shape, default=1) < 0:
            raise ShaderError(f"buffer {label!r}: shape {self.shape}")
        self.nbytes = int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize
        if use is Use.TEXELS and (DTYPES[self.dtype] != "f32" or self.nbytes % TEXEL_BYTES):
            raise ShaderError(f"{self}: texels are four float32 each")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.label!r}, {self.shape}, {self.dtype})"

    def checked(self, array: np.ndarray) -> np.ndarray:
        """Return ``array``, contiguous, if it has this shape and dtype.

        Raises
        ------
        ShaderError
            Another shape or dtype: nothing is converted in silence.
        """
        if array.shape != self.shape or array.dtype != self.dtype:
            raise ShaderError(
                f"buffer {self.label!r} is {self.dtype} {self.shape}, "
                f"got an array {array.dtype} {array.shape}"
            )
        return np.ascontiguousarray(array)


class Resident(Array):
    """An array that stays on the device until :meth:`destroy`; it counts against the budget."""

    def __init__(
        self,
        device: Device,
        label: str,
        shape: tuple[int, ...] | int,
        dtype: np.dtype | type,
        use: Use = Use.DATA,
    ) -> None:
        super().__init__(label, shape, dtype, use)
        self._pool = device.pool
        self._buffer: Memory | None = device.pool.acquire(label, self.nbytes, use)

    @property
    def buffer(self) -> Memory:
        """The GPU buffer, or the view of the texture.

        Raises
        ------
        ShaderError
            After :meth:`destroy`.
        """
        if self._buffer is None:
            raise ShaderError(f"resident {self.label!r} is used after destroy()")
        return self._buffer

    def destroy(self) -> None:
        """Give the memory back to the pool; a second call does nothing."""
        if self._buffer is not None:
            self._pool.release(self._buffer)
            self._buffer = None

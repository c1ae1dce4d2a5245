"""One shader over arrays."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gpusim.gpu import Kernel, Recording, Use, default_device

# What outputs hold before a shader runs: "not written" then differs from zero. The payload of the
# NaN is ours, so that a NaN that a shader computes is not taken for it.
NAN_PATTERN = 0x7FC0BEEF
ALL_ONES = 0xFFFFFFFF
# Elements of pattern behind every buffer: what reads past the end sees NaN, not the last element
# again, and what writes there is found. Adapters either drop such accesses or clamp them, and
# both hide a wrong guard. Whole elements of every struct: grids have 10 words.
MARGIN = 5120


def filled(shape: tuple[int, ...] | int, dtype: np.dtype | type) -> np.ndarray:
    """Return an array of the pattern for its dtype (float32, complex64, uint32 or int32)."""
    dtype = np.dtype(dtype)
    words = dtype.itemsize // 4
    pattern = NAN_PATTERN if dtype.kind in "fc" else ALL_ONES
    shape = (shape,) if isinstance(shape, int) else tuple(shape)
    return np.full((*shape, words), pattern, np.uint32).view(dtype)[..., 0]


def unwritten(array: np.ndarray) -> np.ndarray:
    """Return where an output still holds the pattern (any word of it, for complex numbers)."""
    array = np.ascontiguousarray(array)
    pattern = NAN_PATTERN if array.dtype.kind in "fc" else ALL_ONES
    words = array.view(np.uint32).reshape(*array.shape, array.dtype.itemsize // 4)
    return (words == pattern).any(axis=-1)


def run_stage(
    kernel: str | Kernel,
    groups: tuple[int, int, int],
    params: Mapping[str, object],
    inputs: Mapping[str, np.ndarray],
    outputs: Mapping[str, tuple[tuple[int, ...] | int, np.dtype | type]],
    **overrides: bool | int | float,
) -> dict[str, np.ndarray]:
    """Run one shader on the device.

    Parameters
    ----------
    kernel : str or Kernel
        Path below shaders/, or a kernel made of a text.
    groups : (int, int, int)
        Workgroups.
    params : dict
        A value for each member of ``struct Params``.
    inputs : dict of str to array
        float32, complex64 (as vec2f), uint32 or int32; by the name in the shader.
    outputs : dict of str to (shape, dtype)
        Filled with a pattern before, see :func:`unwritten`. A buffer that is also an input is
        read and written, and starts with the input's values.
    **overrides
        Values for the shader's overrides; only with a path.

    Raises
    ------
    AssertionError
        The shader writes past the end of an output.
    """
    device = default_device()
    if isinstance(kernel, str):
        kernel = Kernel(kernel, **overrides)
    elif overrides:
        raise ValueError("a Kernel has its overrides already")
    rec = Recording(device)
    start = {name: filled(shape, dtype) for name, (shape, dtype) in outputs.items()}
    start |= {name: np.asarray(array) for name, array in inputs.items()}
    buffers = {}
    for name, array in start.items():
        data = np.concatenate([array.reshape(-1), filled(MARGIN, array.dtype)])
        use = Use.TEXELS if kernel.buffers[name].kind == "texels" else Use.DATA
        buffers[name] = rec.buffer(name, data.shape, data.dtype, use)
        rec.upload(buffers[name], data)
    kernel.record(rec, groups, params, **buffers)
    for name in outputs:
        rec.download(buffers[name])
    results = {}
    for name, data in rec.run().items():
        assert unwritten(data[-MARGIN:]).all(), f"{kernel.path} writes past the end of {name}"
        results[name] = data[:-MARGIN].reshape(start[name].shape)
    return results

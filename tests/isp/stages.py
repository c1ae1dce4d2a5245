"""What the tests of the ISP's stages share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.gpu import Array, Device, Recording

F32 = np.float32
ULP = 2.0**-24  # largest relative error of rounding to f32


def through(
    device: Device, given: np.ndarray, record: Callable[[Recording, Array], Array | None]
) -> np.ndarray:
    """Return what a stage makes of an array, in place where it returns no other."""
    rec = Recording(device)
    buffer = rec.buffer("given", given.shape, F32)
    rec.upload(buffer, given)
    label = rec.download(record(rec, buffer) or buffer)
    return rec.run()[label]


def scene(rows: int, cols: int, seed: int) -> np.ndarray:
    """Return random light, some of it below black and some above saturation."""
    return np.random.default_rng(seed).uniform(-0.1, 1.2, (rows, cols)).astype(F32)

"""Float64 twin of packing."""

from __future__ import annotations

import numpy as np


def pack(values: np.ndarray, bits: int) -> np.ndarray:
    """Return whole numbers (pixels, 3) of values (3, pixels), halves rounded up."""
    most = 2**bits - 1
    return np.floor(np.clip(np.asarray(values, np.float64), 0, 1) * most + 0.5).astype(int).T

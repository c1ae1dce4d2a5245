"""Float64 twin of the colour matrix."""

from __future__ import annotations

import numpy as np


def matrix(planes: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return (3, ...) of planes (colours, ...) and a matrix of as many columns."""
    return np.einsum("ij,j...->i...", np.asarray(rows, np.float64), planes)

"""Float64 twin of the defects stage."""

from __future__ import annotations

import numpy as np


def defects(
    plane: np.ndarray,
    places: list[tuple[int, int]],
    keep: np.ndarray,
    add: np.ndarray,
    limit_e: float = np.inf,
) -> np.ndarray:
    """Return a plane (rows, cols) in which the pixels of a list (row, col) are changed."""
    changed = np.array(plane, np.float64)
    for (row, col), kept, added in zip(places, keep, add, strict=True):
        changed[row, col] = min(kept * changed[row, col] + added, limit_e)
    return changed

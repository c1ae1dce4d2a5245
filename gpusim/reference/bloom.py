"""Float64 twin of the bloom stage: each photosite's excess sent on its way by itself."""

from __future__ import annotations

import numpy as np


def bloom(
    charge: np.ndarray, full_well_e: float, photosites: slice = slice(None)
) -> tuple[np.ndarray, np.ndarray]:
    """Return the charge (rows, cols) after blooming, and what left (2, cols) at row 0 and the end.

    Parameters
    ----------
    charge : ndarray (rows, cols)
        Electrons.
    full_well_e : float
    photosites : slice
        The rows that hold photosites.
    """
    held = np.array(charge, np.float64)
    inner = held[photosites]
    excess = np.maximum(inner - full_well_e, 0)
    inner -= excess
    left = np.zeros((2, held.shape[1]))
    halves = np.floor(excess / 2)
    for end, step, parts in ((1, 1, excess - halves), (0, -1, halves)):
        # Flows of one direction may go in any order: what they fill together is the same.
        for row, col in zip(*np.nonzero(parts), strict=True):
            flow, at = parts[row, col], row + step
            while flow > 0 and 0 <= at < len(inner):
                filled = min(flow, full_well_e - inner[at, col])
                inner[at, col] += filled
                flow -= filled
                at += step
            left[end, col] += flow
    return held, left

"""Float64 twin of the smear stage: each packet followed on its way, row by row."""

from __future__ import annotations

import numpy as np


def passed(rate: np.ndarray, kind: str) -> np.ndarray:
    """Return the sum of the rates (rows, cols) of the rows that each packet passes.

    Parameters
    ----------
    rate : ndarray (rows, cols)
    kind : str
        "interline", "frame_transfer", or "cleared": the latter with the columns cleared by
        shifting before the exposure. Charge moves towards row 0.
    """
    rate = np.asarray(rate, np.float64)
    rows = len(rate)
    found = np.zeros_like(rate)
    for row in range(rows):
        after = range(row)
        before = range(row + 1, rows)
        ways = {
            "interline": [*before, row, *after],
            "frame_transfer": [*after],
            "cleared": [*before, *after],
        }
        found[row] = rate[ways[kind]].sum(axis=0)
    return found


def smear(
    rate: np.ndarray, mean: np.ndarray, kind: str, weight: float, limit_e: float = np.inf
) -> np.ndarray:
    """Return mean electrons with those that the light made during the transfer."""
    return np.minimum(mean + weight * passed(rate, kind), limit_e)

"""Float64 twin of the smear stage: the rows that each packet passes on its way."""

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
    after = np.zeros_like(rate)  # the rows between a packet and the read-out, which it passes last
    after[1:] = np.cumsum(rate[:-1], axis=0)
    before = np.zeros_like(rate)  # those above it, which its empty well came through
    before[:-1] = np.cumsum(rate[:0:-1], axis=0)[::-1]
    ways = {
        "interline": before + rate + after,
        "frame_transfer": after,
        "cleared": before + after,
    }
    return ways[kind]


def smear(
    rate: np.ndarray, mean: np.ndarray, kind: str, weight: float, limit_e: float = np.inf
) -> np.ndarray:
    """Return mean electrons with those that the light made during the transfer."""
    return np.minimum(mean + weight * passed(rate, kind), limit_e)

"""Float64 twin of the analogue-to-digital converter."""

from __future__ import annotations

import numpy as np


def response(electrons: np.ndarray, points_e: np.ndarray, read_e: np.ndarray) -> np.ndarray:
    """Return what a non-linear converter reads: straight between points, and on beyond them."""
    inside = np.interp(electrons, points_e, read_e)
    for end, inner in ((0, 1), (-1, -2)):
        slope = (read_e[end] - read_e[inner]) / (points_e[end] - points_e[inner])
        beyond = electrons < points_e[0] if end == 0 else electrons > points_e[-1]
        inside = np.where(beyond, read_e[end] + slope * (electrons - points_e[end]), inside)
    return inside


def adc(
    electrons: np.ndarray,
    system_gain_dn_per_e: float,
    black_level_dn: float | np.ndarray,
    bit_depth: int,
) -> np.ndarray:
    """Return the DN of each pixel: rounded halves up, clipped to the codes of the converter.

    ``black_level_dn`` may be an array that broadcasts with the pixels, column offsets included.
    """
    level = system_gain_dn_per_e * np.asarray(electrons, np.float64) + black_level_dn
    return np.clip(np.floor(level + 0.5), 0, 2**bit_depth - 1).astype(np.uint32)

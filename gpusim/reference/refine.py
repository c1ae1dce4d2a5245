"""Float64 twin of directional demosaicing's third stage."""

from __future__ import annotations

import numpy as np


def refine(chosen: np.ndarray, along_row: np.ndarray) -> np.ndarray:
    """Return the differences smoothed along their direction (rows, cols), which wrap around.

    The mean of three: the site's own, and those at the two greens beside it, each the mean of the
    sites on both sides of it (Menon, Andriani and Calvagno 2007, section II-D).
    """
    smooth = []
    for axis in (0, 1):
        before, behind = np.roll(chosen, 2, axis), np.roll(chosen, -2, axis)
        smooth.append(np.mean([chosen, (before + chosen) / 2, (chosen + behind) / 2], axis=0))
    return np.where(along_row, smooth[1], smooth[0])

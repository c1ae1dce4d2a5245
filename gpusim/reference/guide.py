"""Float64 twin of guided demosaicing's second stage."""

from __future__ import annotations

import numpy as np

SHARE, REACH = 0.7, 3


def guide(
    light: np.ndarray, means: np.ndarray, pattern: tuple[str, ...], own: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return the guiding colour (rows, cols), and what light differs by from it, pixel by pixel.

    ``means`` is that colour, ``own``, by a tent. What light of another colour differs by from it is
    drawn by SHARE to the mean of that around, at sites of that colour less than REACH rows and
    columns away.
    """
    rows, cols = light.shape
    sites = np.array([list(line) for line in pattern])
    y, x = np.mgrid[:rows, :cols]
    colours = sites[y % sites.shape[0], x % sites.shape[1]]
    away = np.subtract(light, means, dtype=float)
    found = away.copy()
    for row, col in np.ndindex(rows, cols):
        tent = np.maximum(REACH - abs(y - row), 0) * np.maximum(REACH - abs(x - col), 0)
        tent = tent * (colours == colours[row, col])
        tent[row, col] = 0
        if tent.sum() > 0 and colours[row, col] != own:
            around = (tent * away).sum() / tent.sum()
            found[row, col] += SHARE * (around - away[row, col])
    return light - found, found

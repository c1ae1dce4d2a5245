"""Float64 twin of demosaicing by weighted means."""

from __future__ import annotations

import numpy as np


def bilinear(
    light: np.ndarray, pattern: tuple[str, ...], colours: str, reach: int, far: int
) -> np.ndarray:
    """Return all colours at each pixel (colours, rows, cols), pixel by pixel.

    Each is the mean of its sites less than ``reach`` rows and columns away, weighted by a tent; a
    site keeps its own value. At the rim, where a colour has no site as near, it is that of the
    tent of ``far``.
    """
    rows, cols = light.shape
    sites = np.array([list(line) for line in pattern])
    found = np.zeros((len(colours), rows, cols))
    for row, col in np.ndindex(rows, cols):
        for number, colour in enumerate(colours):
            mean = 0.0
            for wide in (far, reach):
                y, x = np.ogrid[:rows, :cols]
                tent = np.maximum(wide - abs(y - row), 0) * np.maximum(wide - abs(x - col), 0)
                own = sites[y % sites.shape[0], x % sites.shape[1]] == colour
                if (tent * own).sum() > 0:
                    mean = (tent * own * light).sum(dtype=float) / (tent * own).sum()
            found[number, row, col] = mean
        own = pattern[row % len(pattern)][col % len(pattern[0])]
        found[colours.index(own), row, col] = light[row, col]
    return found

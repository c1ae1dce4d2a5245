"""Float64 twin of demosaicing by weighted means."""

from __future__ import annotations

import numpy as np


def bilinear(light: np.ndarray, pattern: tuple[str, ...], colours: str, reach: int) -> np.ndarray:
    """Return all colours at each pixel (colours, rows, cols), pixel by pixel.

    Each is the mean of its sites less than ``reach`` rows and columns away, weighted by a tent; a
    site keeps its own value.
    """
    rows, cols = light.shape
    found = np.zeros((len(colours), rows, cols))
    for row in range(rows):
        for col in range(cols):
            sums = dict.fromkeys(colours, 0.0)
            weights = dict.fromkeys(colours, 0.0)
            for y in range(max(0, row - reach + 1), min(rows, row + reach)):
                for x in range(max(0, col - reach + 1), min(cols, col + reach)):
                    letter = pattern[y % len(pattern)][x % len(pattern[0])]
                    weight = (reach - abs(y - row)) * (reach - abs(x - col))
                    sums[letter] += weight * float(light[y, x])
                    weights[letter] += weight
            for number, colour in enumerate(colours):
                found[number, row, col] = sums[colour] / max(weights[colour], 1e-300)
            own = pattern[row % len(pattern)][col % len(pattern[0])]
            found[colours.index(own), row, col] = light[row, col]
    return found

"""Float64 twin of the correction of distortion and lateral colour."""

from __future__ import annotations

import numpy as np


def keys(t: float) -> float:
    """Return Keys' kernel of cubic convolution (1981, equation 15), a = -1/2."""
    t = abs(t)
    if t <= 1:
        return 1.5 * t**3 - 2.5 * t**2 + 1
    return -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2 if t < 2 else 0.0


def rectify(
    planes: np.ndarray, maps: tuple[tuple[float, ...], ...], axis: tuple[float, float]
) -> np.ndarray:
    """Return the picture (colours, rows, cols) of which `planes` are the distorted one.

    By the DNG specification 1.4, WarpRectilinear: ``maps`` are its radial and tangential
    coefficients, one set for all planes or one for each; ``axis`` is x, y over the picture, 0 to 1.
    """
    _, rows, cols = planes.shape
    x0, y0 = axis[0] * cols, axis[1] * rows
    farthest = max(np.hypot(cx - x0, cy - y0) for cx in (0, cols) for cy in (0, rows))
    found = np.zeros(planes.shape)
    for colour, row, col in np.ndindex(found.shape):
        kr0, kr1, kr2, kr3, kt0, kt1 = maps[colour % len(maps)]
        dx, dy = (col + 0.5 - x0) / farthest, (row + 0.5 - y0) / farthest
        r = np.hypot(dx, dy)
        f = kr0 + kr1 * r**2 + kr2 * r**4 + kr3 * r**6
        x = x0 + farthest * (f * dx + kt0 * 2 * dx * dy + kt1 * (r**2 + 2 * dx**2)) - 0.5
        y = y0 + farthest * (f * dy + kt1 * 2 * dx * dy + kt0 * (r**2 + 2 * dy**2)) - 0.5
        if not (-0.5 <= x <= cols - 0.5 and -0.5 <= y <= rows - 0.5):
            continue
        for line in range(int(np.floor(y)) - 1, int(np.floor(y)) + 3):
            for place in range(int(np.floor(x)) - 1, int(np.floor(x)) + 3):
                value = planes[colour, min(max(line, 0), rows - 1), min(max(place, 0), cols - 1)]
                found[colour, row, col] += keys(y - line) * keys(x - place) * float(value)
    return found

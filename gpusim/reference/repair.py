"""Float64 twin of the correction of defective pixels."""

from __future__ import annotations

import numpy as np

PAIRS = ((0, 1), (1, 0), (1, 1), (1, -1))


def repair(
    light: np.ndarray, step: int, noise: tuple[float, float], sigmas: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the inner pixels, mended, and by how much each stands out of its neighbours' range.

    Without the ``step`` rows and columns at each rim. A pixel stands out, and is the mean of the
    two opposite neighbours that differ least, where the second is more than 0.
    """
    light = np.asarray(light, np.float64)
    rows, cols = light.shape

    def moved(down: int, right: int) -> np.ndarray:
        top, left = step * (1 + down), step * (1 + right)
        return light[top : top + rows - 2 * step, left : left + cols - 2 * step]

    sides = np.array([[moved(y, x), moved(-y, -x)] for y, x in PAIRS])
    mean = sides.mean(axis=(0, 1))
    margin = sigmas * np.sqrt(np.maximum(noise[0] * mean + noise[1], 0))
    value = moved(0, 0)
    beyond = np.maximum(value - sides.max(axis=(0, 1)), sides.min(axis=(0, 1)) - value) - margin
    best = np.argmin(np.abs(sides[:, 0] - sides[:, 1]), axis=0)
    instead = np.take_along_axis(sides.mean(axis=1), best[None], axis=0)[0]
    return np.where(beyond > 0, instead, value), beyond

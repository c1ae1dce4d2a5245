"""Float64 twin of lens-shading correction."""

from __future__ import annotations

import numpy as np


def shading(
    shape: tuple[int, int],
    k: tuple[float, ...],
    axis: tuple[float, float],
    frame: tuple[int, int],
    first: tuple[int, int],
) -> np.ndarray:
    """Return the gain at each pixel (rows, cols): DNG specification 1.4, FixVignetteRadial.

    ``axis`` is x, y over the frame, 0 to 1; ``first`` the row and column of the first pixel in it.
    """
    rows, cols = frame
    y = np.arange(first[0], first[0] + shape[0])[:, None] + 0.5 - axis[1] * rows
    x = np.arange(first[1], first[1] + shape[1])[None] + 0.5 - axis[0] * cols
    corners = [(cx - axis[0] * cols, cy - axis[1] * rows) for cx in (0, cols) for cy in (0, rows)]
    farthest = max(np.hypot(*corner) for corner in corners)
    r = np.hypot(x, y) / farthest
    return 1 + sum(value * r ** (2 * n) for n, value in enumerate(k, start=1))

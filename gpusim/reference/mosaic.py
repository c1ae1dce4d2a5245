"""Float64 twin of the mosaic stage."""

from __future__ import annotations

import numpy as np


def mosaic(
    planes: np.ndarray, glare: np.ndarray, sites: np.ndarray, period: int, shape: tuple[int, int]
) -> np.ndarray:
    """Take each pixel from its plane.

    Parameters
    ----------
    planes : ndarray (planes, rows / period, cols / period)
        Electrons/s.
    glare : ndarray (S,)
        Electrons/s.
    sites : ndarray (py, px, 2) of int
        Plane and glare of each pixel of the pattern.
    period : int
        Pixels from a sample of a plane to the next.
    shape : (int, int)
        Rows and columns.

    Returns
    -------
    ndarray (rows, cols), float64
        Electrons/s.
    """
    rate = np.empty(shape)
    py, px, _ = sites.shape
    for row, col in np.ndindex(shape):
        plane, light = sites[row % py, col % px]
        own = float(planes[plane, row // period, col // period])
        rate[row, col] = max(own, 0.0) + float(glare[light])
    return rate

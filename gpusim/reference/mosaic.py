"""Float64 twin of the mosaic stage."""

from __future__ import annotations

import numpy as np


def mosaic(planes: np.ndarray, glare: np.ndarray, period: tuple[int, int]) -> np.ndarray:
    """Interleave the planes of the filter sites.

    Parameters
    ----------
    planes : ndarray (S, rows / py, cols / px)
        Electrons/s.
    glare : ndarray (S,)
        Electrons/s.
    period : (int, int)
        Rows py and columns px of the filter pattern.

    Returns
    -------
    ndarray (rows, cols), float64
        Electrons/s.
    """
    py, px = period
    rate = np.empty((planes.shape[1] * py, planes.shape[2] * px))
    for site, (plane, light) in enumerate(zip(planes, glare, strict=True)):
        rate[site // px :: py, site % px :: px] = np.maximum(plane.astype(np.float64), 0.0) + light
    return rate

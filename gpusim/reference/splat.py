"""The light of highlights on pixels, from tables of spline coefficients."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates


def splat(
    pixels: np.ndarray,
    channels: np.ndarray,
    centres: np.ndarray,
    axes: np.ndarray,
    radiance: np.ndarray,
    mixed: list[np.ndarray],
) -> np.ndarray:
    """Sum the highlights on some pixels.

    Parameters
    ----------
    pixels : ndarray (P, 2)
        x, y of their centres.
    channels : ndarray (P,) of int
    centres : ndarray (N, 2)
        Centres of the highlights, in the same units.
    axes : ndarray (N, 2)
        Radial direction, as long as there are table samples in a unit.
    radiance : ndarray (N, M)
    mixed : list of ndarray (C, M, n, n)
        Cubic-spline coefficients of each highlight's kernels, row tangential, column radial; the
        highlight's centre at n / 2, zero beyond.

    Returns
    -------
    ndarray (P,), float64
    """
    total = np.zeros(len(pixels))
    for centre, (cos, sin), colour, table in zip(centres, axes, radiance, mixed, strict=True):
        dx, dy = (pixels - centre).T
        middle = table.shape[-1] // 2
        where = np.stack([cos * dy - sin * dx, cos * dx + sin * dy]) + middle
        for channel in np.unique(channels):
            own = channels == channel
            kernel = np.tensordot(colour, np.asarray(table[channel], np.float64), axes=1)
            light = map_coordinates(
                kernel, where[:, own], order=3, prefilter=False, mode="constant"
            )
            total[own] += np.maximum(light, 0.0)  # no highlight takes light away
    return total

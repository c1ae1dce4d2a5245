"""The light of highlights on pixels, from tables of spline coefficients."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates


def point_sources(
    pixels: np.ndarray,
    channels: np.ndarray,
    *,
    centres: np.ndarray,
    axes: np.ndarray,
    radiance: np.ndarray,
    near: list[np.ndarray],
    far: list[np.ndarray],
    radius: float,
    step: float,
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
        Radial direction, as long as there are near samples in a unit.
    radiance : ndarray (N, M)
    near, far : lists of ndarray (C, M, n, n)
        Cubic-spline coefficients of each highlight's kernels, row sagittal, column tangential; the
        highlight's centre at n / 2, zero beyond.
    radius : float
        Distance up to which near ones count, and beyond which far ones do; near samples.
    step : float
        Near samples from one far sample to the next.

    Returns
    -------
    ndarray (P,), float64
    """
    total = np.zeros(len(pixels))
    for number, (centre, (cos, sin)) in enumerate(zip(centres, axes, strict=True)):
        dx, dy = (pixels - centre).T
        off = np.stack([cos * dy - sin * dx, cos * dx + sin * dy])
        within = np.hypot(*off) <= radius
        for table, apart, chosen in ((near[number], 1.0, within), (far[number], step, ~within)):
            where = off / apart + table.shape[-1] // 2
            for channel in np.unique(channels):
                own = chosen & (channels == channel)
                kernel = np.tensordot(radiance[number], table[channel].astype(np.float64), axes=1)
                light = map_coordinates(
                    kernel, where[:, own], order=3, prefilter=False, mode="constant"
                )
                total[own] += np.maximum(light, 0.0)  # no highlight takes light away
    return total

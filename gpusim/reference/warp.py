"""A raster scene sampled on the sim grid through the chief-ray map."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from gpusim.reference.chief_ray import chief_ray


def warp(
    raster: np.ndarray,
    origin_xy: tuple[float, float],
    shape: tuple[int, int],
    centre_xy: tuple[float, float],
    scale: float,
    *,
    distortion: np.ndarray,
    radius: float,
    circle: tuple[float, float] = (0.0, 0.0),
    weights: np.ndarray | None = None,
    step: float = 1.0,
) -> np.ndarray:
    """Sample the cubic spline through a raster on the real image plane.

    Parameters
    ----------
    raster : ndarray (rows, cols)
        Radiance samples; beyond the raster its border value goes on.
    origin_xy : (float, float)
        Position of sim sample (0, 0) on the real plane, sim samples from the axis.
    shape : (int, int)
        Rows and columns of the block.
    centre_xy : (float, float)
        The optical axis in raster samples, sample 0 at 0.
    scale : float
        Raster samples per sim sample.
    distortion, radius, circle
        As of `gpusim.reference.chief_ray`, in sim samples; beyond the image circle the result is
        black.
    weights, step : ndarray (2 K + 1,), float
        Each sample is the weighted sum of points `step` apart, in x and in y; one point where left
        out.

    Returns
    -------
    ndarray (rows, cols), float64
    """
    if weights is not None:
        reach = len(weights) // 2
        return sum(
            weights[j + reach]
            * weights[i + reach]
            * warp(
                raster,
                (origin_xy[0] + i * step, origin_xy[1] + j * step),
                shape,
                centre_xy,
                scale,
                distortion=distortion,
                radius=radius,
                circle=circle,
            )
            for j in range(-reach, reach + 1)
            for i in range(-reach, reach + 1)
        )
    x = np.stack(
        np.meshgrid(origin_xy[0] + np.arange(shape[1]), origin_xy[1] + np.arange(shape[0])), axis=-1
    )
    u, _ = chief_ray(x, distortion, radius, circle)
    columns = np.clip(centre_xy[0] + scale * u[..., 0], 0, raster.shape[1] - 1)
    rows = np.clip(centre_xy[1] + scale * u[..., 1], 0, raster.shape[0] - 1)
    radiance = map_coordinates(
        np.asarray(raster, np.float64), [rows, columns], order=3, mode="mirror"
    )
    inside = np.sum((x - np.array(circle)) ** 2, axis=-1) <= radius**2
    return np.where(inside, radiance, 0.0)

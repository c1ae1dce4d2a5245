"""A raster scene sampled on the sim grid through the chief-ray map."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates


def warp(
    raster: np.ndarray,
    origin_xy: tuple[float, float],
    shape: tuple[int, int],
    centre_xy: tuple[float, float],
    scale: float,
    distortion: np.ndarray,
    radius: float,
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
    distortion, radius
        Chief-ray map: u = x g(|x|^2 / radius^2), coefficients of g low to high; radius of the image
        circle in sim samples; beyond it the result is black.

    Returns
    -------
    ndarray (rows, cols), float64
    """
    x = np.stack(
        np.meshgrid(origin_xy[0] + np.arange(shape[1]), origin_xy[1] + np.arange(shape[0])), axis=-1
    )
    g = np.polynomial.Polynomial(distortion)
    rho2 = np.sum(x**2, axis=-1) / radius**2
    u = x * g(rho2)[..., None]
    columns = np.clip(centre_xy[0] + scale * u[..., 0], 0, raster.shape[1] - 1)
    rows = np.clip(centre_xy[1] + scale * u[..., 1], 0, raster.shape[0] - 1)
    radiance = map_coordinates(
        np.asarray(raster, np.float64), [rows, columns], order=3, mode="mirror"
    )
    return np.where(rho2 <= 1, radiance, 0.0)

"""A chart low-passed by a Gaussian and sampled on the sim grid, by numerical integration."""

from __future__ import annotations

import numpy as np
from scipy.special import i0e, ndtr

from gpusim.reference.chief_ray import chief_ray

NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)


def rectangle_coverage(
    d: np.ndarray, half_size: tuple[float, float], angle: float, covariance: np.ndarray
) -> np.ndarray:
    """Return the indicator of a rectangle convolved with a Gaussian.

    Parameters
    ----------
    d : ndarray (..., 2)
        Position from the rectangle's centre.
    half_size : (float, float)
        Half width and half height, same unit.
    angle : float
        Direction of the width, radians from x towards y.
    covariance : ndarray (2, 2)
        Of the Gaussian. Taken as diagonal in the rectangle's own axes.
    """
    result = 1.0
    for half, direction in zip(half_size, (angle, angle + np.pi / 2), strict=True):
        e = np.array([np.cos(direction), np.sin(direction)])
        width = np.sqrt(e @ covariance @ e)
        t = d @ e
        result = result * (ndtr((half - t) / width) - ndtr((-half - t) / width))
    return result


def disc_coverage(r: np.ndarray, radius: float, sigma: float) -> np.ndarray:
    """Return the indicator of a disc convolved with an isotropic Gaussian, at distance `r`.

    The Rice integral: int_0^R (q/s^2) exp(-(q^2 + r^2)/(2 s^2)) I_0(q r/s^2) dq, by Gauss-Legendre
    quadrature over 200 nodes (Rice 1945, eq. 3.10-11).
    """
    r = np.asarray(r, np.float64)[..., None]
    low = np.clip(r - 12 * sigma, 0.0, radius)
    q = low + (radius - low) * (NODES + 1) / 2
    density = q / sigma**2 * np.exp(-((q - r) ** 2) / (2 * sigma**2)) * i0e(q * r / sigma**2)
    return np.sum(density * WEIGHTS, axis=-1) * (radius - low[..., 0]) / 2


def paint(
    primitives: list[dict],
    materials: np.ndarray,
    background: int,
    origin_xy: tuple[float, float],
    shape: tuple[int, int],
    sigma: float,
    distortion: np.ndarray,
    radius: float,
    circle: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Paint primitives over a background on the real image plane.

    Parameters
    ----------
    primitives : list of dict
        ``kind`` ("rectangle" or "disc"), ``centre`` (x, y), ``half_size`` (a disc's radius first),
        ``angle``,
        ``material``; in samples from the optical axis on the ideal plane, in painter's order.
    materials : ndarray (materials, J)
        Coefficients.
    background : int
        Material under all primitives.
    origin_xy : (float, float)
        Position of sample (0, 0) on the real plane, in samples from the axis.
    shape : (int, int)
        Rows and columns of the block.
    sigma : float
        Standard deviation of the Gaussian on the real plane, samples.
    distortion, radius, circle
        As of `gpusim.reference.chief_ray`; beyond the image circle the result is black.

    Returns
    -------
    ndarray (J, rows, cols), float64
    """
    x = np.stack(
        np.meshgrid(origin_xy[0] + np.arange(shape[1]), origin_xy[1] + np.arange(shape[0])), axis=-1
    )
    u, jacobian = chief_ray(x, distortion, radius, circle)
    result = np.broadcast_to(materials[background], (*shape, materials.shape[1])).copy()
    for primitive in primitives:
        d = u - np.asarray(primitive["centre"])
        cover = np.empty(shape)
        for index in np.ndindex(shape):
            covariance = sigma**2 * jacobian[index] @ jacobian[index].T
            if primitive["kind"] == "disc":
                r = np.hypot(*d[index])
                e = d[index] / r if r > 0 else np.array([1.0, 0.0])
                cover[index] = disc_coverage(
                    r, primitive["half_size"][0], np.sqrt(e @ covariance @ e)
                )
            else:
                cover[index] = rectangle_coverage(
                    d[index], primitive["half_size"], primitive["angle"], covariance
                )
        result += cover[..., None] * (materials[primitive["material"]] - result)
    lit = ndtr((radius - np.hypot(x[..., 0] - circle[0], x[..., 1] - circle[1])) / sigma)
    return np.moveaxis(result * lit[..., None], -1, 0)

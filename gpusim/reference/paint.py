"""A chart low-passed by a Gaussian and sampled on the sim grid, by numerical integration."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.special import ndtr

from gpusim.reference.chief_ray import chief_ray

NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)


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
        Covariance of the Gaussian. It is taken as diagonal in the rectangle's own axes.
    """
    result = 1.0
    for half, direction in zip(half_size, (angle, angle + np.pi / 2), strict=True):
        e = np.array([np.cos(direction), np.sin(direction)])
        width = np.sqrt(e @ covariance @ e)
        t = d @ e
        result = result * (ndtr((half - t) / width) - ndtr((-half - t) / width))
    return result


def disc_coverage(d: np.ndarray, radius: float, covariance: np.ndarray) -> float:
    """Return the indicator of a disc convolved with a Gaussian, at one place.

    The Gaussian's density integrated over the disc in polar coordinates about its centre:
    Gauss-Legendre over the radius, the periodic sum over the angle.

    Parameters
    ----------
    d : ndarray (2,)
        Position from the disc's centre.
    radius : float
        Same unit.
    covariance : ndarray (2, 2)
        Covariance of the Gaussian.
    """
    inverse = np.linalg.inv(covariance)
    narrowest = np.sqrt(np.linalg.eigvalsh(covariance)[0])
    # What is farther than 12 widths from here counts for nothing.
    low = max(np.hypot(*d) - 12 * np.sqrt(np.trace(covariance)), 0.0)
    if low >= radius:
        return 0.0
    q = low + (radius - low) * (NODES + 1) / 2
    count = int(48 + 20 * radius / narrowest)
    angle = 2 * np.pi * np.arange(count) / count
    turn = np.stack([np.cos(angle), np.sin(angle)])
    off = q[:, None, None] * turn - d[:, None]
    density = np.exp(-0.5 * np.einsum("qik,ij,qjk->qk", off, inverse, off))
    rings = density.mean(axis=1) * q / np.sqrt(np.linalg.det(covariance))
    return float(np.sum(rings * WEIGHTS) * (radius - low) / 2)


def polygon_coverage(corners: np.ndarray, covariance: np.ndarray) -> float:
    """Return the indicator of a polygon convolved with a Gaussian, at one place.

    Green's theorem in coordinates in which the Gaussian is round: the sum over sides of
    int Phi(x) phi(y) dy, by Gauss-Legendre over pieces of at most 20 widths.

    Parameters
    ----------
    corners : ndarray (N, 2)
        From the place, in turn.
    covariance : ndarray (2, 2)
        Covariance of the Gaussian.
    """
    round_corners = np.linalg.solve(np.linalg.cholesky(covariance), corners.T).T
    total = 0.0
    for start, end in zip(round_corners, np.roll(round_corners, -1, axis=0), strict=True):
        way = end - start
        # Beyond 12 widths up or down there is nothing; that far to the left Phi is 0, right 1.
        ends = [0.0, 1.0]
        for axis in (0, 1):
            if way[axis]:
                ends += [(side - start[axis]) / way[axis] for side in (-12.0, 12.0)]
        ends = np.unique(np.clip(ends, 0.0, 1.0))
        for low, high in pairwise(ends):
            x, y = start + way * (low + high) / 2
            if abs(y) > 12 or x < -12:
                continue
            if x > 12:
                total += ndtr(start[1] + high * way[1]) - ndtr(start[1] + low * way[1])
                continue
            for a, b in pairwise(
                np.linspace(low, high, 2 + int(np.hypot(*way) * (high - low) / 20))
            ):
                t = a + (b - a) * (NODES + 1) / 2
                px, py = start[0] + t * way[0], start[1] + t * way[1]
                density = np.exp(-(py**2) / 2) / np.sqrt(2 * np.pi)
                total += np.sum(ndtr(px) * density * WEIGHTS) * (b - a) / 2 * way[1]
    return float(total)


def paint(
    primitives: list[dict],
    materials: np.ndarray,
    background: int,
    *,
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
        ``kind`` ("rectangle", "disc" or "polygon"), ``centre`` (x, y), ``half_size`` (a disc's
        radius first), ``angle``, a polygon's ``points`` in their place (from x towards y),
        ``material`` and ``under``, the material all around; in samples from the optical axis on the
        ideal plane.
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
        polygon = primitive["kind"] == "polygon"
        d = u - np.asarray((0.0, 0.0) if polygon else primitive["centre"])
        cover = np.empty(shape)
        for index in np.ndindex(shape):
            covariance = sigma**2 * jacobian[index] @ jacobian[index].T
            if polygon:
                corners = np.asarray(primitive["points"]) - d[index]
                cover[index] = polygon_coverage(corners, covariance)
            elif primitive["kind"] == "disc":
                cover[index] = disc_coverage(d[index], primitive["half_size"][0], covariance)
            else:
                cover[index] = rectangle_coverage(
                    d[index], primitive["half_size"], primitive["angle"], covariance
                )
        step = materials[primitive["material"]] - materials[primitive["under"]]
        result += cover[..., None] * step
    lit = ndtr((radius - np.hypot(x[..., 0] - circle[0], x[..., 1] - circle[1])) / sigma)
    return np.moveaxis(result * lit[..., None], -1, 0)

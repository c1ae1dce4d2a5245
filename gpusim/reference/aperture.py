"""What one image point's light fills of a plane across it, and its transform: F of the judge.

The rays of `gpusim.reference.bundle` are fitted by polynomials, which are read on a uniform grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from scipy.fft import fft2, next_fast_len
from scipy.spatial import ConvexHull

from gpusim.reference.bundle import Rays

MARGIN = 1.02  # the grid is so much wider than the pupil
DEGREES = (14, 18)  # of the polynomials in p; above 18 the normal equations are singular in float64
GOOD_FIT_WAVES = 1e-4


@dataclass(frozen=True)
class Aperture:
    """What one image point's light fills of the frame's plane, on a uniform grid.

    Attributes
    ----------
    p1, p2 : ndarray (A,), (B,)
        Over the focal length.
    field : ndarray of complex (A, B)
        A exp(i k V).
    solid_angle_sr : float
        Solid angle of the light that arrives, in direction cosines at the image.
    residual_waves : float
        RMS misfit of the polynomial to the rays' paths.
    """

    p1: np.ndarray
    p2: np.ndarray
    field: np.ndarray
    solid_angle_sr: float
    residual_waves: float


def _design(u, v, degree):
    i, j = (part.ravel() for part in np.indices((degree + 1, degree + 1)))
    used = i + j <= degree
    return chebyshev.chebvander(u, degree)[:, i[used]] * chebyshev.chebvander(v, degree)[:, j[used]]


def aperture_of(
    rays: Rays, wavelength_nm: float, half_um: float, gaussian: float = 0.0
) -> Aperture:
    """Fit what the rays sample, on a grid so fine that its image repeats every 2 `half_um`."""
    low, high = rays.p.min(axis=1), rays.p.max(axis=1)
    middle, half = (low + high) / 2, MARGIN * (high - low) / 2
    spacing = wavelength_nm * 1e-3 / (2 * half_um)
    grids = []
    for centre, extent in zip(middle, half, strict=True):
        count = int(np.ceil(extent / spacing))
        grids.append(centre + spacing * (np.arange(2 * count) + 0.5 - count))
    active = [m for m in range(len(rays.margin)) if rays.margin[m].max() > 0]
    last = len(rays.margin) - 1
    if gaussian and last not in active:
        active.append(last)
    mean = rays.path_mm[rays.inside].mean()
    targets = np.column_stack([rays.path_mm - mean, *rays.cosines, *rays.margin[active]])
    u, v = (rays.p - middle[:, None]) / half[:, None]
    for degree in DEGREES:
        design = _design(u, v, degree)
        terms = np.linalg.lstsq(design, targets, rcond=None)[0]
        misfit = float(np.std((design @ terms[:, 0] - targets[:, 0])[rays.inside]))
        residual = misfit / (wavelength_nm * 1e-6)
        if residual < GOOD_FIT_WAVES:
            break
    i, j = (part.ravel() for part in np.indices((degree + 1, degree + 1)))
    used = i + j <= degree
    left, right = (
        chebyshev.chebvander((grid - centre) / extent, degree)
        for grid, centre, extent in zip(grids, middle, half, strict=True)
    )

    def on_grid(column):
        square = np.zeros((degree + 1, degree + 1))
        square[i[used], j[used]] = column
        return left @ square @ right.T

    path, alpha, beta, *margins = (on_grid(column) for column in terms.T)
    cover = _within_hull(rays.p, *grids).astype(float)
    for number, margin in zip(active, margins, strict=True):
        if rays.margin[number].max() > 0:
            cover = np.minimum(cover, _share_below(margin))
    (a1, a2), (b1, b2) = np.gradient(alpha), np.gradient(beta)
    density = np.abs(a1 * b2 - a2 * b1) / spacing**2  # d alpha d beta per cell of p / f
    passed = 1.0
    if gaussian:
        passed = np.exp(-gaussian * np.maximum(1 + margins[active.index(last)], 0))
    light = cover * density * passed**2
    wave = np.exp(2j * np.pi / (wavelength_nm * 1e-6) * path)
    return Aperture(
        *grids, np.sqrt(density) * passed * cover * wave, float(light.sum()) * spacing**2, residual
    )


def _within_hull(points, grid_1, grid_2):
    """Return which nodes lie within the convex hull of the rays."""
    within = np.ones((len(grid_1), len(grid_2)), bool)
    for a, b, offset in ConvexHull(points.T).equations:
        within &= (a * grid_1)[:, None] + (b * grid_2)[None] + offset <= 1e-12
    return within


def _share_below(margin):
    """Return the share of each cell where a smooth function is negative, by its tangent plane."""
    slope_1, slope_2 = np.gradient(margin)
    # 4 x 4 points of the tangent plane, each with a ramp of a quarter of a cell.
    at = (np.arange(4) - 1.5) / 4
    size = np.maximum(np.hypot(slope_1, slope_2), 1e-300)
    share = np.zeros_like(margin)
    near = np.abs(margin) < size
    m, s1, s2, size = margin[near], slope_1[near], slope_2[near], size[near]
    total = sum(np.clip(0.5 - 4 * (m + a * s1 + b * s2) / size, 0, 1) for a in at for b in at)
    share[near] = total / 16
    share[margin <= -np.maximum(np.hypot(slope_1, slope_2), 0)] = 1.0
    return share


def core_of(
    aperture: Aperture, wavelength_nm: float, at_1: np.ndarray, at_2: np.ndarray
) -> np.ndarray:
    """Return |F|^2 per unit of X = f w at places (um), as share of the light per um^2."""
    k = 2 * np.pi / (wavelength_nm * 1e-3)
    rows = np.exp(1j * k * np.outer(at_1, aperture.p1))
    columns = np.exp(1j * k * np.outer(aperture.p2, at_2))
    amplitude = rows @ aperture.field @ columns
    cell = (aperture.p1[1] - aperture.p1[0]) * (aperture.p2[1] - aperture.p2[0])
    # Parseval: the integral over X is lambda^2 times that of |A|^2, which is the solid angle.
    scale = cell**2 / ((wavelength_nm * 1e-3) ** 2 * aperture.solid_angle_sr)
    return scale * np.square(np.abs(amplitude))


def wide_of(aperture: Aperture, edges: np.ndarray) -> np.ndarray:
    """Return the share of the light in cells between `edges` (um, one period of the grid).

    The image of the sampled pupil repeats every lambda / spacing, which is the period.
    """
    # Twice as many samples as nodes: |F|^2 has twice the field's bandwidth.
    count = next_fast_len(2 * max(aperture.field.shape))
    image = np.square(np.abs(fft2(np.conj(aperture.field), (count, count))))
    # The transform has exp(-i k ...): of the conjugate it is the conjugate of what is wanted.
    image = np.fft.fftshift(image)
    period = edges[-1] - edges[0]
    pitch = period / count
    places = (np.arange(count) - count // 2) * pitch
    low, high = places[:, None] - pitch / 2, places[:, None] + pitch / 2
    inside = np.clip(np.minimum(high, edges[1:]) - np.maximum(low, edges[:-1]), 0, None) / pitch
    # Half a sample sticks out on the left: it is the period's right end.
    inside[0, -1] += 1 - inside[0].sum()
    cell = (aperture.p1[1] - aperture.p1[0]) * (aperture.p2[1] - aperture.p2[0])
    total = aperture.solid_angle_sr / cell * count**2
    return inside.T @ image @ inside / total

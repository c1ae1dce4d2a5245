"""Wavefront and vignetted pupil in image-space direction cosines.

A ray that leaves the lens with direction cosines (alpha, beta, gamma) carries a plane wave. Its
optical path is taken to the foot of the perpendicular from the reference point, the chief ray's
image point; W(alpha, beta) is that path less the chief ray's: the OPD on a reference sphere centred
on the image point (of infinite radius: Debye's form, so that no exit pupil enters). Then

    U(x, y) = integral A exp(i k (W + alpha x + beta y)) d alpha d beta

(Debye 1909; Stamnes, Waves in Focal Regions, 1986, ch. 15), and a ray lands at (x, y) =
-(dW/d alpha, dW/d beta): the PSF and the spot diagram share one sign convention. A^2 d alpha d beta
is the light that a point of the scene sends there: see `gpusim.lens.entering`.

A centred lens is symmetric about the meridional plane, so only alpha >= 0 is kept of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev
from scipy.spatial import ConvexHull

from gpusim.lens.samples import RAY_OVERSIZE, Samples, sample_field

if TYPE_CHECKING:
    from gpusim.lens.system import System

# Degrees of the polynomial in (alpha, beta): the second is tried where the first leaves too much.
# Residuals of the double Gauss at f/2, 22 deg, in waves at 400 nm: f = 8 mm 9e-6 with 14;
# f = 100 mm 6e-5 with 14, 2e-6 with 18. Above 18 the normal equations are singular in float64.
DEGREES = (14, 18)
GOOD_FIT_WAVES = 1e-4
# The grid is so much wider than the pupil.
OVERSIZE = 1.12
BEYOND = 2.0  # reach of nodes that no ray reaches


@dataclass(frozen=True)
class Pupil:
    """The pupil of one field and wavelength on a uniform grid.

    Attributes
    ----------
    alpha : ndarray, shape (A,)
        (i + 1/2) d_alpha of the half pupil alpha > 0, or all of it.
    beta : ndarray, shape (B,)
    coverage : ndarray, shape (A, B)
        Share of each cell that lies inside every aperture.
    opd_mm : ndarray, shape (A, B)
        W; without meaning where the coverage is 0.
    fit_residual_mm : float
        RMS difference between W and the traced rays inside the pupil.
    half : bool
        Whether the other half, alpha < 0, is the mirror image of this one.
    apodised : ndarray, shape (A, B), or 1
        Amplitude that the stop, and glass where losses go with the ray, pass: over that of the
        axis.
    entering : ndarray, shape (A, B)
        Amplitude of the light that enters, sqrt(E), over the chief ray's: see
        `gpusim.lens.entering`. The field's A is coverage times apodised times this.
    entering_at_chief : float
        E of the chief ray.
    reach : ndarray, shape (A, B), or None
        (height / clear semi-diameter)^2 at the aperture that is nearest to clipping: 1 at the rim.
    """

    alpha: np.ndarray
    beta: np.ndarray
    coverage: np.ndarray
    opd_mm: np.ndarray
    fit_residual_mm: float
    entering: np.ndarray
    entering_at_chief: float
    half: bool = True
    apodised: np.ndarray | float = 1.0
    reach: np.ndarray | None = None

    @property
    def amplitude(self) -> np.ndarray:
        """A of each cell, shape (A, B)."""
        return self.coverage * self.apodised * self.entering

    @property
    def light(self) -> np.ndarray:
        """What each cell passes of a point's light, over that about the chief ray, shape (A, B).

        Not the square of A: of a cell on a rim, a share passes whole.
        """
        return self.coverage * (self.apodised * self.entering) ** 2

    @property
    def arriving(self) -> np.ndarray:
        """What each cell passes of light that comes evenly from all points, shape (A, B)."""
        return self.coverage * self.apodised**2

    @property
    def cell(self) -> float:
        """Area of a cell in direction cosines."""
        return float((self.alpha[1] - self.alpha[0]) * (self.beta[1] - self.beta[0]))

    @property
    def light_sr(self) -> float:
        """Integral of `light`, d alpha d beta, over the whole pupil (both halves)."""
        return (2.0 if self.half else 1.0) * float(self.light.sum()) * self.cell

    @property
    def entered(self) -> float:
        """What a point of the scene sends through: mm^2, or sr where it is near."""
        return self.light_sr * self.entering_at_chief

    @property
    def projected_solid_angle_sr(self) -> float:
        """Integral of `arriving`, d alpha d beta, over the whole pupil (both halves)."""
        return (2.0 if self.half else 1.0) * float(self.arriving.sum()) * self.cell


def half_plane_share(h: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Share of the unit square centred on the origin where a u + b v < h.

    Two boxes as wide as the slopes, convolved and integrated: piecewise quadratic, exact for a
    straight edge.
    """
    a, b = np.abs(a), np.abs(b)
    # A width of 1e-6 of the other's stands for 0: the quotient below stays accurate to 1e-9.
    least = 1e-6 * np.maximum(a, b) + 1e-300
    a, b = np.maximum(a, least), np.maximum(b, least)

    def ramp(t):
        return np.square(np.maximum(t, 0))

    plus, minus = (a + b) / 2, (a - b) / 2
    area = ramp(h + plus) - ramp(h + minus) - ramp(h - minus) + ramp(h - plus)
    return np.clip(area / (2 * a * b), 0, 1)


def pupils(
    samples: Samples, wavelengths_nm: np.ndarray, window_um: float, nodes: int
) -> list[Pupil]:
    """Put the wavefront and the pupil's edge of one field on uniform grids, one per wavelength.

    W and each aperture's margin are fitted by least squares with Chebyshev products of total
    degree, even in alpha for a half pupil; a cell on a rim counts with the share of it that lies
    inside.

    Parameters
    ----------
    samples : Samples
    wavelengths_nm : ndarray, shape (L,)
    window_um : float
        Width of the PSF window: the grid is fine enough that the PSF repeats at more than twice
        this width.
    nodes : int
        Least number of nodes across the pupil, even.
    """
    return [
        line_pupil(samples, line, wavelength, window_um, nodes)
        for line, wavelength in enumerate(wavelengths_nm)
    ]


def line_pupil(
    samples: Samples, line: int, wavelength_nm: float, window_um: float, nodes: int
) -> Pupil:
    """Return the pupil of one wavelength of a field, the `line`-th of the samples: see `pupils`."""
    margin = samples.margin[:, line]
    inside = samples.inside[line]
    # Far outside a rim the rays only spoil the fit: keep what is within RAY_OVERSIZE of every
    # rim.
    keep = samples.ok[line] & (margin <= RAY_OVERSIZE**2 - 1 + 1e-12).all(axis=0)
    density, entering_at_chief = samples.entering.density(line, keep)
    keep[keep] = np.isfinite(density)
    alpha, beta = samples.alpha[line][keep], samples.beta[line][keep]
    opd, margin, inside = samples.opd_mm[line][keep], margin[:, keep], inside[keep]
    # d_alpha <= lambda / (2 window): the next copy of the PSF is two windows away.
    finest = wavelength_nm * 1e-3 / (2 * window_um)
    centre_a, half_a, grid_a = _axis(alpha, samples.half, nodes, finest)
    centre_b, half_b, grid_b = _axis(beta, False, nodes, finest)

    active = [m for m in range(len(margin)) if margin[m].max() > 0]
    if samples.apodisation and active[-1:] != [len(margin) - 1]:
        active.append(len(margin) - 1)  # the diaphragm, though it clips nothing
    exponents = [-0.5 * np.log(density[np.isfinite(density)])]
    if samples.losses is not None:
        exponents.append(samples.losses.exponent(line, wavelength_nm)[keep])
    targets = np.column_stack([opd, *margin[active], *exponents])
    for degree in DEGREES:
        fitted, smooth = _fit(
            (alpha - centre_a) / half_a,
            (beta - centre_b) / half_b,
            targets,
            (grid_a - centre_a) / half_a,
            (grid_b - centre_b) / half_b,
            degree=degree,
            stride=2 if samples.half else 1,
        )
        residual = float(np.std((fitted[:, 0] - opd)[inside]))
        if residual < GOOD_FIT_WAVES * wavelength_nm * 1e-6:
            break

    within = within_hull(alpha, beta, grid_a, grid_b, samples.half)
    smooth, exponents = smooth[: -len(exponents)], smooth[-len(exponents) :]
    entering, *lost = (np.exp(-np.where(within, one, 0.0)) for one in exponents)
    apodised = lost[0] if lost else 1.0
    if samples.apodisation:
        apodised = apodised * np.exp(-samples.apodisation * np.maximum(1 + smooth[-1], 0.0))
    return Pupil(
        alpha=grid_a,
        beta=grid_b,
        coverage=_coverage(within, smooth[1:]),
        opd_mm=smooth[0],
        fit_residual_mm=residual,
        entering=entering,
        entering_at_chief=entering_at_chief,
        half=samples.half,
        apodised=apodised,
        reach=np.where(within, 1 + np.max(smooth[1:], axis=0), BEYOND) if active else None,
    )


def _coverage(within: np.ndarray, margins: list[np.ndarray]) -> np.ndarray:
    """Return the share of each cell that lies inside all rims, by margins below 0 there."""
    coverage = within.astype(float)
    for g in margins:
        slope_a, slope_b = np.gradient(g, edge_order=2)
        # Rims that coincide must not count twice, so the least share, not the product.
        coverage = np.minimum(coverage, half_plane_share(-g, slope_a, slope_b))
    return coverage


def _axis(
    cosines: np.ndarray, half: bool, nodes: int, finest: float
) -> tuple[float, float, np.ndarray]:
    """Return centre and half-width of the grid along one direction cosine, and its nodes.

    It is wider than the rays by OVERSIZE / RAY_OVERSIZE. For a half pupil it is centred on 0, and
    only the nodes above are returned.
    """
    high = float(cosines.max())
    low = -high if half else float(cosines.min())
    centre, half_width = (low + high) / 2, OVERSIZE / RAY_OVERSIZE * (high - low) / 2
    count = max(nodes, 2 * int(np.ceil(half_width / finest)))
    grid = centre + half_width * (2 * np.arange(count) + 1 - count) / count
    return centre, half_width, grid[count // 2 :] if half else grid


def _fit(
    a: np.ndarray,
    b: np.ndarray,
    targets: np.ndarray,
    grid_a: np.ndarray,
    grid_b: np.ndarray,
    *,
    degree: int,
    stride: int,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Fit Chebyshev products of one total degree to the columns of ``targets``.

    A ``stride`` of 2 takes the even ones in a only, of a half pupil; 1 takes all.

    Returns the fit at the samples, shape like ``targets``, and each column on the grid.
    """
    i, j = np.meshgrid(np.arange(0, degree + 1, stride), np.arange(degree + 1), indexing="ij")
    used = i + j <= degree
    in_a, in_b = chebyshev.chebvander(a, degree), chebyshev.chebvander(b, degree)
    design = in_a[:, i[used]] * in_b[:, j[used]]
    # Normal equations: the design's condition number is 2e5 with degree 14 and 8e6 with 18, so the
    # fit keeps 1e-9 of W at the rays; a singular value decomposition takes ten times as long.
    solution = np.linalg.solve(design.T @ design, design.T @ targets)
    on_a = chebyshev.chebvander(grid_a, degree)[:, ::stride]
    on_b = chebyshev.chebvander(grid_b, degree)
    on_grid = []
    for column in solution.T:
        coefficients = np.zeros(i.shape)
        coefficients[used] = column
        on_grid.append(on_a @ coefficients @ on_b.T)
    return design @ solution, on_grid


def within_hull(
    alpha: np.ndarray,
    beta: np.ndarray,
    grid_a: np.ndarray,
    grid_b: np.ndarray,
    half: bool = True,
) -> np.ndarray:
    """Return the nodes within the convex hull of the rays, of a half with their mirror images.

    Beyond it a fit means nothing, and a margin could seem negative again.

    The rays reach RAY_OVERSIZE beyond every rim, so the hull never cuts the pupil.
    """
    if half:
        alpha, beta = np.append(alpha, -alpha), np.append(beta, beta)
    within = np.ones((len(grid_a), len(grid_b)), dtype=bool)
    for a, b, offset in ConvexHull(np.column_stack([alpha, beta])).equations:
        within &= (a * grid_a)[:, None] + (b * grid_b)[None, :] + offset <= 1e-12
    return within


def best_focus_shift(system: System, wavelengths_nm: np.ndarray) -> float:
    """Return the shift of the image plane (mm) that is best on axis over all wavelengths.

    Best: the least sum over wavelengths of the variance of W / lambda over the pupil, weighted by
    the amplitude, as it darkens the peak. A shift dz adds dz (gamma - 1) to W exactly, so the
    least-squares answer is closed.
    """
    samples = sample_field(system, system.index(wavelengths_nm), 0.0)
    above = below = 0.0
    # Only the pupil matters here, so any narrow window does; 256 nodes settle dz to 1e-5 of itself.
    for pupil, wavelength in zip(
        pupils(samples, wavelengths_nm, 1.0, 256), wavelengths_nm, strict=True
    ):
        weight = pupil.amplitude / pupil.amplitude.sum()
        sine2 = np.minimum(pupil.alpha[:, None] ** 2 + pupil.beta[None] ** 2, 1)
        gamma = np.sqrt(1 - sine2)
        opd = pupil.opd_mm - (weight * pupil.opd_mm).sum()
        gamma = gamma - (weight * gamma).sum()
        above += float((weight * opd * gamma).sum() / wavelength**2)
        below += float((weight * gamma * gamma).sum() / wavelength**2)
    return -above / below

"""Spatial frequency response of a slanted edge, the quantity of ISO 12233, with its uncertainty.

The edge spread function E(d), over the distance d from the edge, is a cubic spline that is fitted
to the region's pixels, each at its own distance: no bins, and so none of their bias at angles where
distances repeat (those with a tangent of 1/2, 1/3 ...). The line spread function is its derivative,
and

    SFR(f) = |F(f)| / |F(0)|,   F(f) = integral of w(d) E'(d) exp(-2 pi i f d) dd,

with f along the edge's normal and a window w that is one over three quarters of the region and
falls to zero at its ends. E's coefficients are linear in the pixels, so is F, and the uncertainty
follows from the pixels' own residuals, whatever law their noise has (White 1980).

ISO 12233:2023 (annex D) bins by a quarter of a pixel along rows and corrects for the derivative;
where it is exact, this is the same quantity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from gpusim.errors import UserError
from gpusim.metrics.edge import Line, Samples, find_line, followed, samples_of
from gpusim.metrics.figure import Figure

# Knots of the spline, px of the sampled lattice's finest way. A cubic spline passes 0.5 cycles/px,
# an eighth of a cycle a knot, but for some (1/8)^4 * 0.6 = 1.5e-4 (de Boor 1978, XII).
# At 2 cycles/px, half a cycle a knot, 4 % of what little response is there.
KNOT_PX = 0.25
DEGREE = 3
STEP_PX = 1 / 16  # of the sum over d: the integrand holds less than 4 cycles/px
# The knots are close within so many widths of the rise from 10 to 90 % and as many px; farther out
# their distance is that share of the way from there.
CORE_RISES, CORE_PX, GROWTH, WIDEST_PX = 1.0, 1.5, 0.25, 4.0
FLAT_SHARE = 0.75  # of the window
# Weight of the penalty on the third derivative, against the data's own weight. It decides where no
# pixel lies, and changes SFR at 0.5 cycles/px by less than 1e-5.
PENALTY = 1e-7
NYQUIST_CY_PX = 0.5
MEASURED_CY_PX = np.linspace(0.0, 2.0, 401)
FREQUENCIES_CY_PX = MEASURED_CY_PX[:201]  # to 1 cycle/px: those of comparisons
CLIPPED_SHARE = 2e-3  # of the pixels at the largest or smallest code
LEAST_STEP = 5.0  # of the edge, in standard deviations of the noise of a pixel
LEAST_REACH_PX = 4.0  # beside the edge
LEAST_PIXELS = 8  # for each px of distance, on either side: two for each knot
# A line is bettered by the edge spread function along it as long as the pixels then lie so much
# closer to it. Below that noise hides it; and an edge as sharp as its pixels, which a spline misses
# between them, would be turned by 4e-3 degrees.
CLOSER = 0.9
ROTATIONS = 1.0  # pixels that the edge must move over the region, for distances to be spread


@dataclass(frozen=True, eq=False)
class Sfr:
    """What a slanted edge says.

    Attributes
    ----------
    line : Line
        Where it lies.
    frequency_cy_px : ndarray (F,)
        Along the edge's normal, cycles per pixel: 0 to 2. Where distances from the edge repeat
        every D px, at slants with a tangent of 1/2 (D = 0.45) or 1 (0.71), what lies beyond
        1 / (2 D) is the spline's.
    sfr, u_sfr : ndarray (F,)
        Spatial frequency response, and its standard uncertainty.
    distance_px, esf, lsf : ndarray (D,)
        Edge spread function, from 0 to 1, and its derivative per pixel, over the distance.
    noise : float
        Standard deviation of a pixel about the edge spread function, over the edge's height.
    rise_px : float
        From 10 to 90 %.
    pixels : int
    """

    line: Line
    frequency_cy_px: np.ndarray
    sfr: np.ndarray
    u_sfr: np.ndarray
    distance_px: np.ndarray
    esf: np.ndarray
    lsf: np.ndarray
    noise: float
    rise_px: float
    pixels: int

    def at(self, frequency_cy_px: float) -> Figure:
        """Return the response at a frequency."""
        value, u = (
            float(np.interp(frequency_cy_px, self.frequency_cy_px, of))
            for of in (self.sfr, self.u_sfr)
        )
        return Figure(value, u)

    def falls_to(self, level: float, *, of_peak: bool = False) -> Figure | None:
        """Return the first frequency where the response falls to a level: 0.5 gives MTF50.

        Parameters
        ----------
        level : float
        of_peak : bool
            Whether the level is a share of the largest response up to Nyquist, not of that at 0.
            This gives MTF50P, which sharpening does not move. Beyond, noise has peaks of its own.

        Returns
        -------
        Figure or None
            Cycles per pixel; None where it does not fall so far.
        """
        first = int(np.argmax(self.sfr[self.frequency_cy_px <= NYQUIST_CY_PX])) if of_peak else 0
        level = level * self.sfr[first]
        below = np.flatnonzero(self.sfr[first:] < level)
        if below.size == 0:
            return None
        right = first + below[0]
        f, sfr = self.frequency_cy_px, self.sfr
        # Through four points: between two the response bends by up to 1e-4 of the frequency.
        own = np.clip(np.arange(right - 2, right + 2), 0, len(f) - 1)
        own = np.unique(own)
        curve = np.polynomial.Polynomial.fit(f[own], sfr[own] - level, len(own) - 1)
        roots = curve.roots()
        real = roots[np.abs(roots.imag) < 1e-9].real
        at = float(real[np.argmin(np.abs(real - (f[right - 1] + f[right]) / 2))])
        return Figure(at, self.at(at).u / abs(float(curve.deriv()(at))))

    def quality(self, cutoff_cy_px: float, upto_cy_px: float = NYQUIST_CY_PX) -> float:
        """Return the area under the response over that of a diffraction-limited lens.

        Parameters
        ----------
        cutoff_cy_px : float
            pitch / (wavelength * f-number), cycles per pixel (Goodman 2005, eq. 6-32).
        upto_cy_px : float
            End of both areas.
        """
        f = self.frequency_cy_px
        own = f <= upto_cy_px + 1e-12
        at = np.clip(f / cutoff_cy_px, 0, 1)
        limit = 2 / np.pi * (np.arccos(at) - at * np.sqrt(1 - at**2))
        return float(np.trapezoid(self.sfr[own], f[own]) / np.trapezoid(limit[own], f[own]))


@dataclass(frozen=True, eq=False)
class Edge:
    """An edge of a picture in one channel: its number, region (x, y, width, height), and SFR."""

    number: int
    region: tuple[int, int, int, int]
    channel: str
    sfr: Sfr


def measure_sfr(
    image: np.ndarray,
    region: tuple[int, int, int, int],
    *,
    sites: np.ndarray | None = None,
    clip: tuple[float, float] | None = None,
) -> Sfr:
    """Measure the edge in a region of a picture.

    Parameters
    ----------
    image : ndarray (rows, cols)
        Linear signal.
    region : (x, y, width, height)
        Pixels, from the upper left corner.
    sites : ndarray (R, C) of bool, optional
        Which photosites of a repeated pattern count, as of one channel of a filter array.
    clip : (float, float), optional
        Values at which the signal is black and saturated; by default none is taken as clipped.

    Raises
    ------
    UserError
        The region is too small, clipped or flat, has no edge, or one along the rows or columns.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.special import erf
    >>> y, x = np.mgrid[:64, :64] + 0.5
    >>> edge = 0.5 + 0.4 * erf((x - 32 - 0.1 * (y - 32)) / 2)
    >>> found = measure_sfr(edge, (0, 0, 64, 64))
    >>> print(f"{found.falls_to(0.5).value:.3f} cycles/px, {found.line.angle_deg:.2f} deg")
    0.133 cycles/px, 5.71 deg
    """
    samples = samples_of(image, region, sites)
    if clip is not None:
        share = float(np.mean((samples.value <= clip[0]) | (samples.value >= clip[1])))
        if share > CLIPPED_SHARE:
            raise UserError(
                "The region is clipped: its edge is another.",
                field="roi",
                value=f"{share:.1%} of the pixels at the ends of the scale",
                allowed=f"{CLIPPED_SHARE:.1%} or less",
            )
    line = find_line(samples)
    moved = abs(np.diff(line.x_of_y(samples.y[[0, -1]]))[0])
    if moved < ROTATIONS:
        raise UserError(
            "The edge runs along the pixels: all of them see it at the same few distances.",
            field="roi",
            value=f"{line.angle_deg:.2f} deg, {moved:.2f} px over the region",
            allowed=f"{ROTATIONS:g} px or more: a taller region, or a steeper edge",
        )
    return _measured(*_followed(samples, line))


def _followed(samples: Samples, line: Line) -> tuple[Line, _Spline]:
    """Return the line, bettered by the edge spread function along it, and that function."""
    spline = _along(samples, line)
    if spline is None:
        raise UserError(
            "The edge leaves the region.",
            field="roi",
            value=f"{_reach(line.distance(samples.x, samples.y)):.1f} px beside it",
            allowed=f"{LEAST_REACH_PX:g} px or more on both sides",
        )
    while True:
        other = followed(samples, line, spline.at, spline.slope, spline.reach)
        along = _along(samples, other)
        if along is None or along.noise > CLOSER * spline.noise:
            return line, spline
        line, spline = other, along


def _along(samples: Samples, line: Line) -> _Spline | None:
    """Return the edge spread function along a line, if the region holds enough of it."""
    distance = line.distance(samples.x, samples.y)
    reach = _reach(distance)
    own = np.abs(distance) <= reach
    return None if reach < LEAST_REACH_PX else _Spline(distance[own], samples.value[own], reach)


def _measured(line: Line, rough: _Spline) -> Sfr:
    distance, value, reach = rough.distance, rough.value, rough.reach
    at = np.arange(-reach, reach + STEP_PX / 2, STEP_PX)
    spline = _Spline(distance, value, reach, _rise(at, rough.normal(at)))
    low, high = spline.levels()
    step = high - low
    noise = spline.noise
    if not abs(step) > LEAST_STEP * noise:
        raise UserError(
            "The edge is fainter than its noise allows.",
            field="roi",
            value=f"a step of {abs(step) / noise:.1f} standard deviations of a pixel",
            allowed=f"{LEAST_STEP:g} or more",
        )
    window = _window(at / reach)
    f = MEASURED_CY_PX
    waves = np.exp(-2j * np.pi * np.outer(f, at)) * (window * STEP_PX)
    transfer = waves @ spline.slopes(at)  # (F, J)
    response = transfer @ spline.coefficients
    size = np.abs(response)
    sfr = size / size[0]
    # d sfr / d c, real: of |F| the part along F, and of |F(0)| that of the whole.
    ways = (np.conj(response)[:, None] * transfer).real / np.maximum(size, 1e-300)[:, None]
    ways = (ways - sfr[:, None] * ways[0]) / size[0]
    u_sfr = np.sqrt(np.maximum(np.einsum("fj,fj->f", ways @ spline.covariance(), ways), 0.0))
    esf = spline.normal(at)
    lsf = spline.slopes(at) @ spline.coefficients / step
    return Sfr(
        line,
        f,
        sfr,
        u_sfr,
        at,
        esf,
        lsf,
        noise / abs(step),
        _rise(at, esf),
        len(value),
    )


def _reach(distance: np.ndarray) -> float:
    """Return how far on both sides of the edge there are pixels enough: corners have few."""
    bins = np.arange(0.0, max(np.abs(distance).max(), 1.0), 1.0)
    seen = [np.histogram(side * distance, bins)[0] for side in (1, -1)]
    scarce = np.flatnonzero(np.minimum(*seen) < LEAST_PIXELS) if len(bins) > 1 else [0]
    return float(scarce[0]) if len(scarce) else float(bins[-1])


def _knots(reach: float, rise_px: float | None) -> np.ndarray:
    """Return knots from -reach to reach: close ones about the edge, then each way farther apart."""
    if rise_px is None:
        return np.linspace(-reach, reach, 2 * int(np.ceil(reach)) + 1)
    at = [0.0]
    while at[-1] < reach:
        away = at[-1] - CORE_RISES * rise_px - CORE_PX
        at.append(at[-1] + max(KNOT_PX, min(GROWTH * away, WIDEST_PX)))
    side = np.array(at) * (reach / at[-1])
    return np.concatenate([-side[:0:-1], side])


def _window(share: np.ndarray) -> np.ndarray:
    """Return one within FLAT_SHARE, and a cosine from there to 0 at 1 (Tukey 1967)."""
    over = np.clip((np.abs(share) - FLAT_SHARE) / (1 - FLAT_SHARE), 0, 1)
    return 0.5 + 0.5 * np.cos(np.pi * over)


def _rise(at: np.ndarray, esf: np.ndarray) -> float:
    """Return the way from 10 to 90 %, px: from the last place below to the first above."""
    first = np.flatnonzero(esf > 0.9)
    last = np.flatnonzero(esf[: first[0]] < 0.1) if first.size else first
    if not last.size:
        return float("nan")
    high = np.interp(0.9, esf[first[0] - 1 : first[0] + 1], at[first[0] - 1 : first[0] + 1])
    low = np.interp(0.1, esf[last[-1] : last[-1] + 2], at[last[-1] : last[-1] + 2])
    return float(high - low)


class _Spline:
    """A cubic spline through pixels at their distances, by least squares.

    Beside the edge the knots lie farther and farther apart: what is there is smooth, and knots that
    only follow the noise would carry it into the response.
    """

    def __init__(
        self, distance: np.ndarray, value: np.ndarray, reach: float, rise_px: float | None = None
    ) -> None:
        inner = _knots(reach, rise_px)
        outer = np.diff(inner)[-1] * np.arange(1, DEGREE + 1)
        self.knots = np.concatenate([-reach - outer[::-1], inner, reach + outer])
        self.distance, self.value = distance, value
        self.design = BSpline.design_matrix(
            np.clip(distance, -reach, reach), self.knots, DEGREE
        ).tocsr()
        count = self.design.shape[1]
        gram = (self.design.T @ self.design).toarray()
        third = np.diff(np.eye(count), 3, axis=0)
        weight = PENALTY * np.trace(gram) / count
        self.factor = cho_factor(gram + weight * third.T @ third)
        self.coefficients = cho_solve(self.factor, self.design.T @ value)
        self.rest = value - self.design @ self.coefficients
        self.count, self.reach = count, reach
        self.noise = float(np.sqrt(self.rest @ self.rest / max(len(value) - count, 1)))

    def at(self, places: np.ndarray) -> np.ndarray:
        return BSpline(self.knots, self.coefficients, DEGREE)(places)

    def normal(self, places: np.ndarray) -> np.ndarray:
        """Return the edge spread function from 0 to 1."""
        low, high = self.levels()
        return (self.at(places) - low) / (high - low)

    def slopes(self, places: np.ndarray) -> np.ndarray:
        """Return the derivative of each of the basis' functions (D, J)."""
        inside = np.clip(places, -self.reach, self.reach)
        return BSpline(self.knots, np.eye(self.count), DEGREE).derivative()(inside)

    def slope(self, places: np.ndarray) -> np.ndarray:
        """Return the derivative of the edge spread function as fitted."""
        return BSpline(self.knots, self.coefficients, DEGREE).derivative()(places)

    def levels(self) -> tuple[float, float]:
        """Return the levels of both sides: means over the outer quarter of each."""
        outer = np.linspace(FLAT_SHARE, 1, 33) * self.reach
        return float(self.at(-outer).mean()), float(self.at(outer).mean())

    def covariance(self) -> np.ndarray:
        """Return that of the coefficients (J, J), whatever law the pixels' noise has.

        Each residual stands for its pixel's noise, widened by how far the pixel draws the spline to
        itself (MacKinnon and White 1985, HC3).
        """
        solved = cho_solve(self.factor, self.design.T.toarray())
        leverage = np.asarray(self.design.multiply(solved.T).sum(axis=1)).ravel()
        weight = (self.rest / np.maximum(1 - leverage, 1e-6)) ** 2
        return (solved * weight) @ solved.T

"""Where a slanted edge lies: a polynomial through the edge of each row, to small parts of a pixel.

An edge nearer to the vertical is x = p(y); one nearer to the horizontal is turned first. All of a
channel's photosites are used at their own places, so that raw frames need no demosaicing: a lattice
of one colour is a picture with a step of two pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial, legendre

from gpusim.errors import UserError

SMALLEST_PX = 16  # sides of a region: below it fewer than 16 rows place the line
# A mean step over the noise of a pixel. Below it the noise's own gradient turns the line: at 5 a
# region of 32 rows still finds it to half a degree.
LEAST_CONTRAST = 5.0
# Of placing the window on the line anew. Each one takes the rest down to the share that `_drawn`
# returns: 0.04 at MTF50 of 0.25 cycles/px, 0.55 at 0.05.
ROUNDS = 12
LEAST_FREE = 0.05  # of a round's step: edges so much wider than their window are found by nobody
WINDOW_PX = (
    9.0  # least half width in which a row's edge is sought, about the line of the last round
)
# Cost of one more coefficient, in units of Schwarz's penalty: at 1 noise bends every tenth straight
# edge.
DEAR = 2.0
DEGREES = (1, 2, 3, 5)  # of the polynomial: ISO 12233:2023 fits the fifth, a straight edge wants 1


@dataclass(frozen=True, eq=False)
class Samples:
    """Pixels of a region, each at its place.

    Attributes
    ----------
    x, y : ndarray (N,)
        Pixels from the upper left corner of the picture; the middle of its first pixel is at 0.5.
    value : ndarray (N,)
        Linear signal.
    rows : tuple of (float, ndarray, ndarray)
        The same row by row: y, x (C,) and values (C,).
    turned : bool
        x and y are exchanged: the edge is nearer to the horizontal.
    """

    x: np.ndarray
    y: np.ndarray
    value: np.ndarray
    rows: tuple[tuple[float, np.ndarray, np.ndarray], ...]
    turned: bool


@dataclass(frozen=True, eq=False)
class Line:
    """An edge in a region.

    Attributes
    ----------
    x_of_y : numpy.polynomial.Polynomial
        Where it lies, px; of a turned region y of x.
    turned : bool
    middle_px : float
        y of the region's middle, of a turned one x.
    u_px : float
        Standard uncertainty of the place at the middle, px along x.
    u_slope : float
        Standard uncertainty of the slope there.
    """

    x_of_y: Polynomial
    turned: bool
    middle_px: float
    u_px: float
    u_slope: float

    @property
    def slope(self) -> float:
        """Slope of the edge at its middle: px along x for each px along y."""
        return float(self.x_of_y.deriv()(self.middle_px))

    @property
    def angle_deg(self) -> float:
        """Between the edge and the nearer axis of the pixels, 0 to 45 and a little more."""
        return float(np.degrees(np.arctan(self.slope)))

    @property
    def u_angle_deg(self) -> float:
        """Standard uncertainty of the angle."""
        return float(np.degrees(self.u_slope / (1 + self.slope**2)))

    @property
    def place_px(self) -> tuple[float, float]:
        """Point (x, y) of the picture on the edge, in the region's middle."""
        at = float(self.x_of_y(self.middle_px)), self.middle_px
        return at[::-1] if self.turned else at

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return how far points (N,) lie from the edge along its normal, px; brighter side or not.

        A curved edge is taken as its circle of curvature, to second order of the distance.
        """
        slope, bend = self.x_of_y.deriv()(y), self.x_of_y.deriv(2)(y)
        across = x - self.x_of_y(y)
        root = np.sqrt(1 + slope**2)
        near = across / root
        # The foot of the normal lies near * slope / root higher up, where the curve has bent away.
        return near - bend * (near * slope / root) ** 2 / (2 * root)


def samples_of(
    image: np.ndarray, region: tuple[int, int, int, int], sites: np.ndarray | None = None
) -> Samples:
    """Return the pixels of a region, turned so that its edge is nearer to the vertical.

    Parameters
    ----------
    image : ndarray (rows, cols)
        Linear signal.
    region : (x, y, width, height)
        Pixels.
    sites : ndarray (R, C) of bool, optional
        Which photosites of a repeated pattern count, from the first pixel of the picture.

    Raises
    ------
    UserError
        The region leaves the picture, or is too small.
    """
    left, top, width, height = region
    if not (
        0 <= left < left + width <= image.shape[1] and 0 <= top < top + height <= image.shape[0]
    ):
        allowed = f"x,y,width,height within {image.shape[1]} x {image.shape[0]}"
        raise UserError(
            "The region leaves the picture.", field="roi", value=region, allowed=allowed
        )
    if min(width, height) < SMALLEST_PX:
        allowed = f"{SMALLEST_PX} x {SMALLEST_PX} pixels or more"
        raise UserError("The region is too small.", field="roi", value=region, allowed=allowed)
    own = np.s_[top : top + height, left : left + width]
    mask = np.ones((height, width), bool)
    if sites is not None:
        row, col = (
            np.arange(at, at + n) % p
            for at, n, p in zip((top, left), (height, width), sites.shape, strict=True)
        )
        mask = sites[np.ix_(row, col)]
    value = image[own].astype(np.float64)
    across, down = (_variation(value, mask, axis) for axis in (1, 0))
    turned = bool(down > across)
    if turned:
        value, mask, left, top = value.T, mask.T, top, left
    line = np.arange(value.shape[1]) + left + 0.5
    rows = tuple(
        (top + number + 0.5, line[mask[number]], value[number, mask[number]])
        for number in range(len(value))
        if mask[number].any()
    )
    row, col = np.nonzero(mask)
    return Samples(line[col], top + row + 0.5, value[row, col], rows, turned)


def _variation(value: np.ndarray, mask: np.ndarray, axis: int) -> float:
    """Return how much the mean profile along an axis varies: most where the edge crosses it."""
    count = np.maximum(mask.sum(axis=1 - axis), 1)
    profile = (value * mask).sum(axis=1 - axis) / count
    return float(profile[mask.any(axis=1 - axis)].std())


def find_line(samples: Samples) -> Line:
    """Return the edge through a region.

    In each row the edge is the centroid of the derivative under a Hann window about the line that
    the last round found (ISO 12233:2017, annex D, centres its window on the row). The polynomial's
    degree is the least whose residuals no higher one explains clearly better (Schwarz 1978).

    Rounds end where windows and line agree, at a line L = P(c(L)) through centroids c that a shift
    of the windows shifts by a share s of itself. What noise does to the centroids is therefore
    1 / (1 - s) as large in the line (JCGM 102:2011, 6.3: measurement models that are implicit).

    Raises
    ------
    UserError
        There is no edge in the region, or it is fainter than its noise.
    """
    line, bound = _first_line(samples)
    y = np.array([row[0] for row in samples.rows])
    half = WINDOW_PX
    widest = max(np.ptp(row[1]) for row in samples.rows) / 2
    place = np.zeros(len(y))
    for number in range(ROUNDS):
        # The first windows are as wide as the region, for the first line may be far off.
        half = max(WINDOW_PX, bound, widest / 2**number)
        place = np.array([_centroid(x, value, line(at), half) for at, x, value in samples.rows])
        seen = np.isfinite(place)
        if seen.sum() < SMALLEST_PX / 4:
            raise _no_edge(samples)
        line = Polynomial.fit(y[seen], place[seen], 1)
    found = _fitted(samples, y[seen], place[seen])
    wider = 1 / max(1 - _drawn(samples, found.x_of_y, half), LEAST_FREE)
    return replace(found, u_px=wider * found.u_px, u_slope=wider * found.u_slope)


def followed(
    samples: Samples,
    line: Line,
    esf: Callable[[np.ndarray], np.ndarray],
    slope: Callable[[np.ndarray], np.ndarray],
    reach: float,
) -> Line:
    """Return the edge, its slope and bends by how far rows are shifted against all together.

    A row's shift is that of least squares against the edge spread function. It hears all pixels of
    the edge, where a centroid has a window, which cuts a wide edge otherwise in each row. Where the
    edge lies as a whole, the centroids have said.

    Parameters
    ----------
    samples : Samples
    line : Line
    esf, slope : callable
        Edge spread function over the distance from the line, and its derivative.
    reach : float
        Distance to which it is known, px.
    """
    y, place = [], []
    for at, x, value in samples.rows:
        distance = line.distance(x, np.full_like(x, at))
        own = np.abs(distance) <= reach
        steep, rest = slope(distance[own]), value[own] - esf(distance[own])
        weight = float(steep @ steep)
        if weight > 0:
            y.append(at)
            # The distance falls by the shift along x times the cosine of the edge's angle.
            shift = -float(rest @ steep) / weight
            place.append(float(line.x_of_y(at)) + shift * np.hypot(1, line.x_of_y.deriv()(at)))
    y, place = np.array(y), np.array(place)
    found = _fitted(samples, y, place)
    whole = float(np.mean(line.x_of_y(y) - found.x_of_y(y)))
    return replace(found, x_of_y=found.x_of_y + whole, u_px=line.u_px)


def _first_line(samples: Samples) -> tuple[Polynomial, float]:
    """Return a first line, and how far its ends may be off."""
    steps = [_step(x, value) for _, x, value in samples.rows]
    y = np.array([row[0] for row in samples.rows])
    x = np.array([step[0] for step in steps])
    # The median of slopes between rows far apart outlives rows that noise has misled (Theil 1950).
    half = len(y) // 2
    slope = float(np.median((x[half:] - x[: len(x) - half]) / (y[half:] - y[: len(y) - half])))
    offset = float(np.median(x - slope * y))
    rest = float(np.median(np.abs(x - slope * y - offset)))
    levels = np.array([step[1:] for step in steps])
    step_up, noise = np.median(levels[:, 0]), np.sqrt(np.median(levels[:, 1] ** 2))
    if not abs(step_up) > LEAST_CONTRAST * noise / np.sqrt(len(samples.rows)):
        raise _no_edge(samples)
    return Polynomial([offset, slope]), 3 * rest


def _step(x: np.ndarray, value: np.ndarray) -> tuple[float, float, float]:
    """Return where a row is best cut in two levels, the step upwards, and the noise about them."""
    count = np.arange(1, len(value))
    total = np.cumsum(value)
    left, right = total[:-1] / count, (total[-1] - total[:-1]) / (len(value) - count)
    between = count * (len(value) - count) * (right - left) ** 2
    cut = int(np.argmax(between[1:-1])) + 1 if len(between) > 2 else int(np.argmax(between))
    noise = np.abs(np.diff(value))
    return (x[cut] + x[cut + 1]) / 2, right[cut] - left[cut], float(np.median(noise)) / 0.954


def _centroid(x: np.ndarray, value: np.ndarray, about: float, half: float) -> float:
    """Return the centroid of a row's derivative under a Hann window; not a number where none is."""
    middle, change = (x[1:] + x[:-1]) / 2, np.diff(value)
    away = middle - about
    weight = np.where(np.abs(away) < half, np.cos(np.pi * away / (2 * half)) ** 2, 0.0)
    total = np.sum(weight * change)
    # A derivative that the region's side cuts off leans away from it.
    margin = min(half, (x[-1] - x[0]) / 4)
    inside = x[0] + margin < about < x[-1] - margin
    if not inside or total == 0:
        return np.nan
    shift = np.sum(weight * change * away) / total
    return about + shift if abs(shift) < half else np.nan


def _drawn(samples: Samples, line: Polynomial, half: float) -> float:
    """Return by which share of their own shift windows about a line shift the rows' centroids.

    The derivative of the quotient in `_centroid`, of all rows together: -sum(w' a E') / sum(w E').
    """
    with_slopes, total = 0.0, 0.0
    for at, x, value in samples.rows:
        change, away = np.diff(value), (x[1:] + x[:-1]) / 2 - line(at)
        phase = np.where(np.abs(away) < half, np.pi * away / (2 * half), np.pi / 2)
        with_slopes += np.sum(np.sin(2 * phase) * np.pi / (2 * half) * away * change)
        total += np.sum(np.cos(phase) ** 2 * change)
    return float(with_slopes / total)


def _fitted(samples: Samples, y: np.ndarray, place: np.ndarray) -> Line:
    """Return the polynomial of the degree that the rows bear, with its uncertainty."""
    middle = (samples.rows[0][0] + samples.rows[-1][0]) / 2
    reach = (samples.rows[-1][0] - samples.rows[0][0]) / 2
    at = (y - middle) / reach
    best = None
    for degree in DEGREES:
        if best is not None and len(y) < 6 * (degree + 1):  # a line wants no more than it has
            break
        design = legendre.legvander(at, degree)
        found, *_ = np.linalg.lstsq(design, place, rcond=None)
        rest = place - design @ found
        square = max(float(rest @ rest), 1e-18 * len(y))
        score = len(y) * np.log(square / len(y)) + DEAR * (degree + 1) * np.log(len(y))
        if best is None or score < best[0]:
            best = score, degree, found, square
    _, degree, found, square = best
    design = legendre.legvander(at, degree)
    covariance = np.linalg.inv(design.T @ design) * square / (len(y) - degree - 1)
    at_middle = legendre.legvander(np.zeros(1), degree)[0]
    slopes = np.array([legendre.Legendre.basis(n).deriv()(0.0) for n in range(degree + 1)]) / reach
    curve = legendre.Legendre(found, domain=[middle - reach, middle + reach])
    return Line(
        curve.convert(kind=Polynomial),
        samples.turned,
        middle,
        float(np.sqrt(at_middle @ covariance @ at_middle)),
        float(np.sqrt(slopes @ covariance @ slopes)),
    )


def _no_edge(samples: Samples) -> UserError:
    seen = np.ptp(samples.value)
    return UserError(
        "There is no edge in the region, or it is fainter than its noise.",
        field="roi",
        value=f"values over {seen:.4g}",
        allowed="one edge that crosses the region from side to side",
    )

"""Distortion of a lens from a chart's lattice of marks, and lateral colour between channels.

Local geometric distortion (ISO 17850:2015) is

    LGD = (r_d - r_u) / r_u,

with r_d the distance of a mark from the picture's middle and r_u the one it would have at the
magnification of the middle. Both are given in shares of the way from the middle to the corner. The
chart may be tilted: undistorted, its lattice is a plane seen by a pinhole (a homography), whose
eight parameters are fitted together with those of the model,

    r_u = r_d (1 + k_1 r_d^2 + k_2 r_d^4 + ...)          3rd order: k_1; 5th: k_1 and k_2
    r_u = tan(a r_d) / a, or of pincushion atan(a r_d) / a          tangent, written as s = +-a^2.

The polynomial that the marks bear gives LGD; the others are there to be compared. Misses are
distances in the picture as it is, distorted.

Lateral colour (ISO 19084:2015) is how far the marks of a channel lie from those of the reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gpusim.errors import UserError
from gpusim.metrics.lattice import count_marks
from gpusim.metrics.marks import Marks, again, find_marks
from gpusim.metrics.picture import Plane

MOST_TERMS = 5  # of the polynomial: r^11
OUTLYING = 8.0  # robust standard deviations from the lattice, beyond which a mark is left out
LEAST_OUTLYING_PX = 0.1  # no mark that lies closer is
RADII = np.linspace(0.02, 1.0, 50)  # of the curves, shares of the way to the corner


@dataclass(frozen=True, eq=False)
class Fit:
    """One model of distortion.

    Attributes
    ----------
    name : str
    coefficients : ndarray (K,)
        k_1, k_2 ... of a polynomial, s of the tangent; of radii in shares of the way to the corner.
    covariance : ndarray (K, K)
        Covariance of the coefficients, by the misses' own spread.
    rms_px : float
        Root mean square of the misses, of x and y together.
    worst_px : float
    ideal : ndarray (N, 2)
        Where the marks would lie undistorted, from the middle, shares of the way to the corner.
    miss_px : ndarray (N, 2)
        x and y, of each mark.
    """

    name: str
    coefficients: np.ndarray
    covariance: np.ndarray
    rms_px: float
    worst_px: float
    ideal: np.ndarray
    miss_px: np.ndarray

    def undistorted(self, r: np.ndarray) -> np.ndarray:
        """Return r_u of r_d, both in shares of the way to the corner."""
        return r * _ratio(self.name, self.coefficients, np.asarray(r, np.float64))[0]

    def lgd(self, r: np.ndarray) -> np.ndarray:
        """Return LGD as a share at distances r_d."""
        r = np.asarray(r, np.float64)
        return 1 / _ratio(self.name, self.coefficients, r)[0] - 1

    def u_lgd(self, r: np.ndarray) -> np.ndarray:
        """Return the standard uncertainty of `lgd`."""
        step = 1e-6
        slopes = []
        for at in range(len(self.coefficients)):
            moved = self.coefficients.copy()
            moved[at] += step
            slopes.append((1 / _ratio(self.name, moved, r)[0] - 1 - self.lgd(r)) / step)
        slopes = np.array(slopes)
        return np.sqrt(np.einsum("kr,kl,lr->r", slopes, self.covariance, slopes))


@dataclass(frozen=True, eq=False)
class Shift:
    """Lateral colour of one channel.

    Attributes
    ----------
    channel : str
    away_px : ndarray (N, 2)
        Where each mark lies from the same one of the reference, x and y; NaN where it was not
        found.
    radial_px : ndarray (N,)
        Outwards.
    slope_px, cubic_px : float
        Coefficients of the fit radial = slope r + cubic r^3, r in shares of the way to the corner.
    """

    channel: str
    away_px: np.ndarray
    radial_px: np.ndarray
    slope_px: float
    cubic_px: float

    @property
    def rms_px(self) -> float:
        """Root mean square of the distances."""
        return float(np.sqrt(np.nanmean(np.sum(self.away_px**2, axis=1))))

    @property
    def largest_px(self) -> float:
        """Largest radial shift, with its sign."""
        return float(self.radial_px[np.nanargmax(np.abs(self.radial_px))])


@dataclass(frozen=True, eq=False)
class Distortion:
    """What the marks of a chart say.

    Attributes
    ----------
    marks : Marks
        Those of the lattice, of the reference channel.
    cell : ndarray (N, 2) of int
        Column and row of each.
    reference : str
        Channel.
    centre : (float, float)
        x, y, px.
    corner_px : float
        Half the picture's diagonal: the unit of radii.
    size : (int, int)
        Columns and rows of the picture.
    fits : dict of str to Fit
        ``chosen``, ``3rd order``, ``5th order`` and ``tangent``.
    left_out : int
        Marks that lie far from the lattice.
    shifts : tuple of Shift
        Shifts of the other channels.
    """

    marks: Marks
    cell: np.ndarray
    reference: str
    centre: tuple[float, float]
    corner_px: float
    size: tuple[int, int]
    fits: dict[str, Fit]
    left_out: int
    shifts: tuple[Shift, ...]

    @property
    def radius(self) -> np.ndarray:
        """Return r_d of each mark (N,), shares of the way to the corner."""
        away = np.stack([self.marks.x, self.marks.y], 1) - self.centre
        return np.hypot(*away.T) / self.corner_px

    @property
    def lgd(self) -> np.ndarray:
        """Return LGD of each mark (N,), a share: r_u is that of the chosen fit's lattice."""
        ideal = np.hypot(*self.fits["chosen"].ideal.T)
        return self.radius / np.maximum(ideal, 1e-12) - 1


def measure_distortion(
    planes: dict[str, Plane],
    centre: tuple[float, float] | None = None,
    channels: Sequence[str] | None = None,
) -> Distortion:
    """Measure the distortion of a picture of a checkerboard or of dots.

    Parameters
    ----------
    planes : dict of str to Plane
        Channels of the picture. The reference is green, or else the first.
    centre : (float, float), optional
        Where the lens's axis meets the picture, x and y, px; its middle by default.
    channels : sequence of str, optional
        Between which lateral colour is measured; all colours by default.

    Raises
    ------
    UserError
        There is no lattice of marks, or it cannot be a distorted plane.
    """
    names = list(channels or (name for name in planes if name != "Y" or len(planes) == 1))
    reference = "G" if "G" in names else names[0]
    plane = planes[reference]
    found = find_marks(plane)
    which, cell = count_marks(found.x, found.y)
    rows, cols = plane.values.shape
    at = (cols / 2, rows / 2) if centre is None else centre
    corner = float(np.hypot(rows, cols) / 2)

    def place(which: np.ndarray) -> np.ndarray:
        return (np.stack([found.x[which], found.y[which]], 1) - at) / corner

    chosen = _chosen(place(which), cell, corner)
    # A mark of something else: the lattice is straight to hundredths of a pixel without it.
    far = np.hypot(*chosen.miss_px.T)
    limit = max(OUTLYING * 1.48 * float(np.median(far)), LEAST_OUTLYING_PX)
    good = far <= limit
    left_out = int(np.count_nonzero(~good))
    which, cell = which[good], cell[good]
    if left_out:
        chosen = _chosen(place(which), cell, corner)
    places = place(which)
    fits = {
        "chosen": chosen,
        "3rd order": _fit("3rd order", places, cell, corner, 1),
        "5th order": _fit("5th order", places, cell, corner, 2),
        "tangent": _fit("tangent", places, cell, corner, 1),
    }
    marks = Marks(found.x[which], found.y[which], found.width_px[which], found.kind)
    shifts = tuple(
        _shift(name, marks, again(marks, planes[name]), places)
        for name in names
        if name != reference
    )
    return Distortion(marks, cell, reference, at, corner, (cols, rows), fits, left_out, shifts)


def _ratio(name: str, k: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return r_u / r_d and the derivative of r_u at distances r_d."""
    if name == "tangent":
        a = np.sqrt(abs(k[0]))
        x = a * r
        if a < 1e-6:
            return np.ones_like(r), np.ones_like(r)
        near = np.maximum(x, 1e-12)
        if k[0] > 0:
            bent = np.minimum(near, 1.5)  # of a tangent's quarter turn
            return np.tan(bent) / bent, 1 / np.cos(bent) ** 2
        return np.arctan(near) / near, 1 / (1 + near**2)
    powers = r[..., None] ** (2 * np.arange(1, len(k) + 1))
    odd = 2 * np.arange(1, len(k) + 1) + 1
    return 1 + powers @ k, 1 + powers @ (odd * k)


def _homography(h: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Return where cells (N, 2) lie, seen by a pinhole (N, 2)."""
    full = np.append(h, 1.0).reshape(3, 3)
    x, y, w = full @ np.stack([*cell.T, np.ones(len(cell))])
    return np.stack([x / w, y / w], 1)


def _fit(name: str, place: np.ndarray, cell: np.ndarray, corner_px: float, terms: int) -> Fit:
    """Fit a homography and a model to the marks."""
    scale = float(np.abs(cell).max())
    cells = cell / scale
    r = np.hypot(*place.T)
    outward = place / np.maximum(r, 1e-12)[:, None]

    def miss(values: np.ndarray) -> np.ndarray:
        ratio, slope = _ratio(name, values[8:], r)
        apart = place * ratio[:, None] - _homography(values[:8], cells)
        radial = np.sum(apart * outward, axis=1)
        # Back to the picture as it is: what lies across r shrinks by r_u / r_d, along it by dr_u.
        along = radial / np.where(np.abs(slope) > 0.05, slope, 0.05)
        around = (apart - radial[:, None] * outward) / np.maximum(ratio, 0.05)[:, None]
        return corner_px * (around + along[:, None] * outward)

    start = np.concatenate([_first(place, cells), np.zeros(terms)])
    start[8:] = 1e-3  # off zero, where the tangent has no slope
    found = least_squares(lambda v: miss(v).ravel(), start, x_scale="jac", xtol=1e-14, ftol=1e-14)
    rest = miss(found.x)
    freedom = max(rest.size - len(start), 1)
    square = float(np.sum(rest**2))
    try:
        covariance = np.linalg.inv(found.jac.T @ found.jac) * square / freedom
    except np.linalg.LinAlgError:
        raise UserError(
            "The marks do not determine the distortion.",
            field="PICTURE",
            value=f"{len(place)} marks",
            allowed="a chart that fills most of the picture",
        ) from None
    return Fit(
        name,
        found.x[8:],
        covariance[8:, 8:],
        float(np.sqrt(square / freedom)),
        float(np.hypot(*rest.T).max()),
        _homography(found.x[:8], cells),
        rest,
    )


def _first(place: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return a homography's first guess: the affine map of the third of the marks amid them."""
    away = np.hypot(*place.T)
    near = away <= np.sort(away)[max(len(away) // 3, 8) - 1]
    design = np.stack([*cells[near].T, np.ones(np.count_nonzero(near))], 1)
    affine, *_ = np.linalg.lstsq(design, place[near], rcond=None)
    return np.concatenate([affine.T.ravel(), [0.0, 0.0]])


def _chosen(place: np.ndarray, cell: np.ndarray, corner_px: float) -> Fit:
    """Return the polynomial that the marks bear: the least of Schwarz's criterion (1978)."""
    best: tuple[float, Fit] | None = None
    for terms in range(1, MOST_TERMS + 1):
        one = _fit("polynomial", place, cell, corner_px, terms)
        values = 2 * len(place)
        square = max(float(np.mean(one.miss_px**2)), 1e-14)
        score = values * np.log(square) + (8 + terms) * np.log(values)
        if best is None or score < best[0]:
            best = score, one
    return best[1]


def _shift(name: str, reference: Marks, own: Marks, place: np.ndarray) -> Shift:
    """Return how far a channel's marks lie from the reference's."""
    away = np.stack([own.x - reference.x, own.y - reference.y], 1)
    r = np.hypot(*place.T)
    radial = np.sum(away * place, axis=1) / np.maximum(r, 1e-12)
    seen = np.isfinite(radial)
    if np.count_nonzero(seen) < 3:
        raise UserError(
            "The channel does not show the marks.",
            field="--channel",
            value=name,
            allowed="a channel in which the chart has contrast",
        )
    slope, cubic = np.linalg.lstsq(np.stack([r, r**3], 1)[seen], radial[seen], rcond=None)[0]
    return Shift(name, away, radial, float(slope), float(cubic))

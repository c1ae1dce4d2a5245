"""Fields of a bank: where its PSFs stand, which of them a source point needs, and its place.

Of a lens with an axis they are image heights (`Heights`), of one without a grid (`Grid`). Both have
the image circle: its centre on the sensor, um, and its radius. Between fields everything is the
polynomial of Newton through the nearest four, two on either side, or the outer four.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import CubicSpline

MAP_ERROR_UM = 1e-5


def _cubic(axis: np.ndarray, at: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Return the nodes (N,) of an axis that points (P,) within it need, with the share of each.

    From divided differences: the share of a node is the value of the polynomial that is 1 there.
    """
    count = min(4, len(axis))
    above = np.searchsorted(axis, at, side="right")
    first = np.minimum(np.maximum(above - count // 2, 0), len(axis) - count)
    found = []
    for start in np.unique(first):
        here = first == start
        x = axis[start : start + count]
        for node in range(count):
            table = np.eye(count)[node]
            for order in range(1, count):
                table[order:] = (table[order:] - table[order - 1 : -1]) / (x[order:] - x[:-order])
            value = np.zeros(np.count_nonzero(here))
            for difference, one in zip(table[::-1], x[::-1], strict=True):
                value = value * (at[here] - one) + difference
            share = np.zeros(len(at))
            share[here] = value
            found.append((int(start) + node, share))
    return found


class Heights:
    """Fields at image heights, between which PSFs are cubic in height and turned.

    At negative heights are the same fields seen from the other side: the points and their PSFs are
    turned by half a turn about the axis.
    """

    def __init__(self, bank: Any) -> None:
        self.bank = bank
        reference = list(bank.wavelengths_nm).index(bank.reference_nm)
        self.radius_um = np.asarray(bank.real_height_um[:, reference], np.float64)
        self.centre, self.circle = np.zeros(2), self.radius_um[-1]
        # The map is asked millions of times: a spline of it, and beyond the circle a straight line.
        # Between 4096 knots it is off by 1e-9 um at most.
        heights = np.linspace(0, bank.rectilinear_circle_um, 4097)
        self.map = CubicSpline(heights, bank.ideal_from_real(heights)[0])
        self.beyond = float(self.map(heights[-1], 1))

    def light(self, field: int, place: int) -> tuple[np.ndarray, float, tuple[float, float]]:
        """Return PSF, illumination and lateral colour (x, y, um) of a field and wavelength."""
        shift = self.bank.real_height_um[field, place] - self.radius_um[field]
        illumination = self.bank.relative_illumination[field, place]
        return self.bank.psf[field, place], illumination, (shift, 0.0)

    def axes(self, source: np.ndarray) -> np.ndarray:
        """Return the direction of the PSFs' x axis (P, 2) at source points (P, 2)."""
        radius = np.hypot(*source.T)[:, None]
        return np.where(radius > 0, source / np.maximum(radius, 1e-9), [1.0, 0.0])

    def shares(self, source: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
        """Yield the fields that source points (P, 2) need, on which side, with the share (P,)."""
        radius = np.minimum(np.hypot(*source.T), self.radius_um[-1])
        both = np.concatenate([-self.radius_um[:0:-1], self.radius_um])
        middle = len(self.radius_um) - 1
        for place, share in _cubic(both, radius):
            yield abs(place - middle), 1 if place >= middle else -1, share

    def ideal(self, real: np.ndarray) -> np.ndarray:
        """Return the ideal-plane positions (..., 2) of real ones, um."""
        radius = np.hypot(real[..., 0], real[..., 1])
        at = np.minimum(radius, self.map.x[-1])
        ideal = self.map(at) + (radius - at) * self.beyond
        return real * np.where(radius > 0, ideal / np.maximum(radius, 1e-9), 1.0)[..., None]


class OneHeight(Heights):
    """What a bank makes of one height, taken for every source point: turned, and not changed."""

    def __init__(self, bank: Any, radius_um: float) -> None:
        super().__init__(bank)
        at = np.array([[radius_um, 0.0]])
        self.mixed = [(field, side, share[0]) for field, side, share in super().shares(at)]

    def shares(self, source: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
        """Yield the same fields for all source points (P, 2)."""
        for field, side, share in self.mixed:
            yield field, side, np.full(len(source), share)


class TracedHeight(OneHeight):
    """A field that was traced anew, taken for every source point before the map of a bank.

    Parameters
    ----------
    bank : gpusim.lens.bank.Bank
        Whose map from the ideal to the real plane holds.
    traced : gpusim.lens.bank.Bank
        Holds the field.
    field : int
    radius_um : float
        Where the bank has the field: lateral colour counts from there.
    """

    def __init__(self, bank: Any, traced: Any, field: int, radius_um: float) -> None:
        super().__init__(bank, radius_um)
        self.mixed = [(field, 1, 1.0)]
        self.bank, self.own_um = traced, radius_um

    def light(self, field: int, place: int) -> tuple[np.ndarray, float, tuple[float, float]]:
        """Return PSF, illumination and lateral colour (x, y, um) of a wavelength."""
        traced = self.bank
        shift = traced.real_height_um[field, place] - self.own_um
        illumination = traced.relative_illumination[field, place]
        return traced.psf[field, place], illumination, (shift, 0.0)


class Grid:
    """Fields on a grid of field angles, between which PSFs are bicubic.

    The map from the image to the field is a fit of its own to the bank's chief rays: Chebyshev
    products, of total degrees until the largest error is ``MAP_ERROR_UM``.
    """

    def __init__(self, bank: Any) -> None:
        self.bank = bank
        self.centre = np.array([bank.ray_x_um[0], bank.ray_y_um[0]])
        field = np.stack([bank.ray_x_deg, bank.ray_y_deg], axis=1)
        landed = np.stack([bank.ray_x_um, bank.ray_y_um], axis=1) - self.centre
        off = np.hypot(*field.T)
        self.circle = np.hypot(*landed[off > 0.999999 * off.max()].T).min()
        self.span = 1.2 * np.abs(landed).max()
        self.flat = bank.projection.name == "rectilinear"
        height = np.tan(np.radians(off)) if self.flat else np.radians(off)
        wanted = 1e3 * bank.efl_mm * (height / np.where(off > 0, off, 1.0))[:, None] * field
        for degree in range(3, 15, 2):
            basis = self._basis(landed, degree)
            terms = np.linalg.lstsq(basis, wanted, rcond=None)[0]
            if np.abs(basis @ terms - wanted).max() < MAP_ERROR_UM:
                break
        self.terms = np.zeros((degree + 1, degree + 1, 2))
        places = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
        for place, term in zip(places, terms, strict=True):
            self.terms[place] = term

    def _basis(self, off_centre: np.ndarray, degree: int) -> np.ndarray:
        x, y = (chebyshev.chebvander(one / self.span, degree) for one in off_centre.T)
        return np.stack(
            [x[:, i] * y[:, j] for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1
        )

    def ideal(self, real: np.ndarray) -> np.ndarray:
        """Return the ideal-plane positions (..., 2) of real ones, um."""
        flat = np.reshape(real, (-1, 2)) - self.centre
        x, y = flat.T / self.span
        return np.moveaxis(chebyshev.chebval2d(x, y, self.terms), 0, -1).reshape(np.shape(real))

    def light(self, field: int, place: int) -> tuple[np.ndarray, float, tuple[float, float]]:
        """Return PSF, illumination and lateral colour (x, y, um) of a field and wavelength."""
        bank = self.bank
        row, col = divmod(field, len(bank.field_x_deg))
        reference = list(bank.wavelengths_nm).index(bank.reference_nm)
        x, y = bank.chief_x_um[row, col], bank.chief_y_um[row, col]
        shift = (x[place] - x[reference], y[place] - y[reference])
        return bank.psf[row, col, place], bank.relative_illumination[row, col, place], shift

    def axes(self, source: np.ndarray) -> np.ndarray:
        """Return the direction of the PSFs' x axis (P, 2) at source points (P, 2)."""
        return np.broadcast_to([1.0, 0.0], source.shape)

    def shares(self, source: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
        """Yield the fields that source points (P, 2) need, on which side, with the share (P,)."""
        bank = self.bank
        ideal = self.ideal(source)
        height = np.hypot(*ideal.T)
        angle = height / (1e3 * bank.efl_mm)
        angle = np.degrees(np.arctan(angle) if self.flat else angle)
        x_deg, y_deg = ideal.T * (angle / np.maximum(height, 1e-9))
        across, down = (
            _cubic(axis, np.clip(at, axis[0], axis[-1]))
            for at, axis in ((x_deg, bank.field_x_deg), (y_deg, bank.field_y_deg))
        )
        for col, of_col in across:
            for row, of_row in down:
                yield row * len(bank.field_x_deg) + col, 1, of_col * of_row

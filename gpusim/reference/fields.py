"""Fields of a bank: where its PSFs stand, which of them a source point needs, and its place.

The fields of a lens with an axis are image heights (`Heights`), those of a lens without one a grid
(`Grid`). Both have the image circle: its centre on the sensor, um, and its radius. Between fields
everything is the polynomial of Newton through the nearest four, two on either side, or the outer
four.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import CubicSpline

MAP_ERROR_UM = 1e-5


class Cubics:
    """Which nodes of an axis points (P,) within it need, and the shares of each.

    From divided differences: the share of a node is the value of the polynomial that is 1 there.

    Attributes
    ----------
    nodes : range
        All that some point needs.
    shares : ndarray (K, P)
        Share of each of them, zero where it is not among a point's nearest.
    nearest : ndarray (N, P) of int
        The four nodes of each point, or as many as there are.
    """

    def __init__(self, axis: np.ndarray, at: np.ndarray) -> None:
        count = min(4, len(axis))
        above = np.searchsorted(axis, at, side="right")
        first = np.minimum(np.maximum(above - count // 2, 0), len(axis) - count)
        low = int(first.min(initial=len(axis)))
        starts = np.flatnonzero(np.bincount(first))
        self.nodes = range(low, int(first.max(initial=low)) + count)
        self.shares = np.zeros((len(self.nodes), len(at)))
        for start in starts:
            here = first == start if len(starts) > 1 else slice(None)
            x, place = axis[start : start + count], at[here]
            for node in range(count):
                table = np.eye(count)[node]
                for order in range(1, count):
                    table[order:] = (table[order:] - table[order - 1 : -1]) / (
                        x[order:] - x[:-order]
                    )
                value = np.full(len(place), table[-1])
                for difference, one in zip(table[-2::-1], x[-2::-1], strict=True):
                    value *= place - one
                    value += difference
                self.shares[start - low + node, here] = value
        self.nearest = first + np.arange(count)[:, None]

    def of_nearest(self) -> np.ndarray:
        """Return the shares (N, P) of the nearest nodes."""
        return np.take_along_axis(self.shares, self.nearest - self.nodes.start, axis=0)


class Heights:
    """Fields at image heights, between which PSFs are cubic in height and turned.

    At negative heights are the same fields seen from the other side: the points and their PSFs are
    turned by half a turn about the axis.
    """

    def __init__(self, bank: Any) -> None:
        self.bank = bank
        reference = list(bank.wavelengths_nm).index(bank.reference_nm)
        self.radius_um = np.asarray(bank.real_height_um[:, reference], np.float64)
        self.used = range(len(self.radius_um))  # those that some source point needs
        self.centre, self.circle = np.zeros(2), self.radius_um[-1]
        # The map is asked millions of times: a spline of how much it stretches heights, and beyond
        # the circle a straight line. Between 4096 knots it is off by 1e-9 um at most.
        heights = np.linspace(0, bank.rectilinear_circle_um, 4097)
        ideal = CubicSpline(heights, bank.ideal_from_real(heights)[0])
        stretch = np.append(ideal(0.0, 1), ideal(heights[1:]) / heights[1:])
        self.stretch = CubicSpline(heights, stretch)
        self.rim, self.beyond = (float(ideal(heights[-1], order)) for order in (0, 1))

    def light(self, field: int, place: int) -> tuple[np.ndarray, float, tuple[float, float]]:
        """Return PSF, illumination and lateral colour (x, y, um) of a field and wavelength."""
        shift = self.bank.real_height_um[field, place] - self.radius_um[field]
        illumination = self.bank.relative_illumination[field, place]
        return self.bank.psf[field, place], illumination, (shift, 0.0)

    def axes(self, source: np.ndarray) -> np.ndarray:
        """Return the direction of the PSFs' x axis (P, 2) at source points (P, 2)."""
        radius = np.hypot(*source.T)[:, None]
        return np.where(radius > 0, source / np.maximum(radius, 1e-9), [1.0, 0.0])

    def _cubics(self, source: np.ndarray) -> tuple[Cubics, int]:
        """Return the cubics at source points (P, 2) over both sides, and the number of the axis."""
        radius = np.minimum(np.hypot(*source.T), self.radius_um[-1])
        both = np.concatenate([-self.radius_um[:0:-1], self.radius_um])
        return Cubics(both, radius), len(self.radius_um) - 1

    def near(self, source: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the fields (N, P) that source points (P, 2) need, their sides and shares."""
        cubics, middle = self._cubics(source)
        places = cubics.nearest - middle
        return np.abs(places), np.where(places < 0, -1, 1), cubics.of_nearest()

    def shares(self, source: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
        """Yield the fields that source points (P, 2) need, on which side, with the share (P,)."""
        cubics, middle = self._cubics(source)
        for place, share in zip(cubics.nodes, cubics.shares, strict=True):
            yield abs(place - middle), 1 if place >= middle else -1, share

    def ideal(self, real: np.ndarray) -> np.ndarray:
        """Return the ideal-plane positions (..., 2) of real ones, um."""
        radius = np.hypot(real[..., 0], real[..., 1])
        end = self.stretch.x[-1]
        stretch = self.stretch(np.minimum(radius, end))
        out = radius > end
        stretch[out] = (self.rim + (radius[out] - end) * self.beyond) / radius[out]
        return real * stretch[..., None]


def lateral_um(fields: Heights | Grid) -> float:
    """Return how far PSFs of any wavelength lie from the reference's chief ray, at most."""
    lines = range(len(fields.bank.wavelengths_nm))
    shifts = [fields.light(field, line)[2] for field in fields.used for line in lines]
    return float(np.hypot(*np.transpose(shifts)).max())


class Everywhere:
    """Fields of one place, taken for every source point.

    Attributes
    ----------
    mixed : tuple of ndarray (N, 1)
        As `near` returns it for that place.
    """

    mixed: tuple[np.ndarray, np.ndarray, np.ndarray]

    def near(self, source: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the same fields (N, P) for all source points (P, 2), their sides and shares."""
        return tuple(np.repeat(one, len(source), axis=1) for one in self.mixed)

    def shares(self, source: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
        """Yield the same fields for all source points (P, 2)."""
        for field, side, share in zip(*(one[:, 0] for one in self.mixed), strict=True):
            yield int(field), int(side), np.full(len(source), share)


class OneHeight(Everywhere, Heights):
    """What a bank makes of one height, taken for every source point: turned, and not changed."""

    def __init__(self, bank: Any, radius_um: float) -> None:
        super().__init__(bank)
        self.mixed = Heights.near(self, np.array([[radius_um, 0.0]]))
        self.used = sorted(set(self.mixed[0].ravel().tolist()))


class TracedHeight(OneHeight):
    """A field that was traced anew, taken for every source point before the map of a bank.

    Parameters
    ----------
    bank : gpusim.psf.bank.Bank
        Whose map from the ideal to the real plane holds.
    traced : gpusim.psf.bank.Bank
        Holds the field.
    field : int
    radius_um : float
        Where the bank has the field: lateral colour counts from there.
    """

    def __init__(self, bank: Any, traced: Any, field: int, radius_um: float) -> None:
        super().__init__(bank, radius_um)
        self.mixed = np.array([[field]]), np.array([[1]]), np.array([[1.0]])
        self.used = [field]
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
        self.used = range(len(bank.field_x_deg) * len(bank.field_y_deg))
        self.centre = np.array([bank.ray_x_um[0], bank.ray_y_um[0]])
        field = np.stack([bank.ray_x_deg, bank.ray_y_deg], axis=1)
        landed = np.stack([bank.ray_x_um, bank.ray_y_um], axis=1) - self.centre
        off = np.hypot(*field.T)
        self.circle = np.hypot(*landed[off > 0.999999 * off.max()].T).min()
        self.span = 1.2 * np.abs(landed).max()
        self.flat = bank.projection.name == "rectilinear"
        height = np.tan(np.radians(off)) if self.flat else np.radians(off)
        wanted = (
            1e3
            * bank.principal_distance_mm
            * (height / np.where(off > 0, off, 1.0))[:, None]
            * field
        )
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

    def _cubics(self, source: np.ndarray) -> tuple[Cubics, Cubics]:
        """Return the cubics at source points (P, 2) across and down."""
        bank = self.bank
        ideal = self.ideal(source)
        height = np.hypot(*ideal.T)
        angle = height / (1e3 * bank.principal_distance_mm)
        angle = np.degrees(np.arctan(angle) if self.flat else angle)
        x_deg, y_deg = ideal.T * (angle / np.maximum(height, 1e-9))
        return tuple(
            Cubics(axis, np.clip(at, axis[0], axis[-1]))
            for at, axis in ((x_deg, bank.field_x_deg), (y_deg, bank.field_y_deg))
        )

    def near(self, source: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the fields (N, P) that source points (P, 2) need, their sides and shares."""
        across, down = self._cubics(source)
        fields = down.nearest * len(self.bank.field_x_deg) + across.nearest[:, None]
        shares = down.of_nearest() * across.of_nearest()[:, None]
        fields, shares = (one.reshape(-1, len(source)) for one in (fields, shares))
        return fields, np.ones_like(fields), shares

    def shares(self, source: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
        """Yield the fields that source points (P, 2) need, on which side, with the share (P,)."""
        across, down = self._cubics(source)
        for col, of_col in zip(across.nodes, across.shares, strict=True):
            for row, of_row in zip(down.nodes, down.shares, strict=True):
                yield row * len(self.bank.field_x_deg) + col, 1, of_col * of_row


class OnePoint(Everywhere, Grid):
    """What a bank makes of one image point, taken for every source point."""

    def __init__(self, bank: Any, point_um: np.ndarray) -> None:
        super().__init__(bank)
        self.mixed = Grid.near(self, np.reshape(point_um, (1, 2)))
        self.used = sorted(set(self.mixed[0].ravel().tolist()))


class TracedPoint(OnePoint):
    """A field that was traced anew, taken for every source point before the map of a bank.

    Parameters
    ----------
    bank : gpusim.psf.plane_bank.PlaneBank
        Whose map from the ideal to the real plane holds.
    traced : gpusim.psf.plane_bank.PlaneBank
        Holds the field.
    field : int
    point_um : ndarray (2,)
        Where the bank has the field: lateral colour counts from there.
    """

    def __init__(self, bank: Any, traced: Any, field: int, point_um: np.ndarray) -> None:
        super().__init__(bank, point_um)
        self.mixed = np.array([[field]]), np.array([[1]]), np.array([[1.0]])
        self.used = [field]
        self.bank, self.own_um = traced, point_um

    def light(self, field: int, place: int) -> tuple[np.ndarray, float, tuple[float, float]]:
        """Return PSF, illumination and lateral colour (x, y, um) of a wavelength."""
        traced = self.bank
        at = (*divmod(field, len(traced.field_x_deg)), place)
        shift = (traced.chief_x_um[at] - self.own_um[0], traced.chief_y_um[at] - self.own_um[1])
        return traced.psf[at], traced.relative_illumination[at], shift

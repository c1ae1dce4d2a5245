"""Where light lands that a lens without symmetry sends: from the real image to the ideal one.

The ideal plane is that of a distortion-free camera whose axis is the lens's: a height that goes
with the field angle, in the direction of the field. Chief rays are traced on rings of field angle.
Around a ring they are a Fourier series, and across the rings, through the middle, its coefficients
are splines; so the map from field to image is known everywhere. The one back is a bicubic spline
over the square around the image circle, fitted to many points of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.sparse import coo_array, vstack
from scipy.sparse.linalg import splu

from gpusim.errors import UserError

# What the rays may leave open.
MAP_ERROR_UM = 0.01
# What the spline may miss of what they tell: a thousandth of a pixel of 1 um.
FIT_ERROR_UM = 1e-3
FEWEST_CELLS, MOST_CELLS = 8, 128
SAMPLES = 3  # of what a spline is to follow, each way in a cell at the rim
# Weight of the control points' third differences against the samples. It makes the map go on evenly
# beyond the circle, where no sample lies.
EVENNESS = 1e-7
STEPS = 33  # rings where the map must not fold, and points across the circle that stand for all
DEGREE = 7  # of the splines across the rings: see `gpusim.psf.field_map`
# Twice as many rings are so much better, at least: 2^-8 in the end.
HALVED = 1 / 16


class PlaneMap:
    """The chief rays of one wavelength: u = x + the spline with the control points `net`.

    Parameters
    ----------
    field_deg : ndarray (M, 2)
        Fields x, y of traced chief rays: (0, 0), then rings of rising angle with the same even
        directions, one after the other.
    real_um : ndarray (M, 2)
        Where they land.
    ideal_height_um : callable
        Returns heights on the ideal plane of field angles, rad.
    centre_um : (float, float)
        Centre of the image circle.
    radius_um : float

    Attributes
    ----------
    net : ndarray (n + 3, n + 3, 2)
        Control points, um, by x and then y, over n x n cells of the square around the circle.
    error_um : float
        What the rays leave open, and the spline misses.

    Raises
    ------
    UserError
        Where there is no circle, the rays are no rings or leave the map open by more than
        ``MAP_ERROR_UM``, or it folds over.
    """

    def __init__(
        self,
        field_deg: np.ndarray,
        real_um: np.ndarray,
        ideal_height_um: Callable[[np.ndarray], np.ndarray],
        centre_um: tuple[float, float],
        radius_um: float,
    ) -> None:
        if radius_um == 0:
            raise UserError(
                "the fields of the bank make no image: they must lie on both sides of the axis",
                field="field_x_deg, field_y_deg",
                allowed="from below 0 to above 0",
            )
        self.centre_um, self.radius_um = centre_um, radius_um
        rays = Rings(field_deg, real_um)
        if rays.error_um > MAP_ERROR_UM:
            raise UserError(
                "The chief rays of this lens are too few, or not smooth enough, to tell where "
                "light lands between them.",
                field="max_field_deg",
                value=f"{rays.error_um:.3g} um are open",
                allowed=f"at most {MAP_ERROR_UM} um: more rays, or a smaller field",
            )
        if rays.folds():
            raise UserError(
                "distortion folds the image over: two field angles meet in one image point",
                field="max_field_deg",
                allowed="a smaller field",
            )
        cells = FEWEST_CELLS
        while True:
            z, shift_um = self._told(rays, ideal_height_um, cells, 0.0)
            self.net = _net(z, shift_um, cells)
            # Held against what lies between: half a step on, each way.
            z, shift_um = self._told(rays, ideal_height_um, cells, 0.5)
            seen = np.hypot(*z.T) <= 1
            miss_um = np.hypot(*(self._shift_um(*z[seen].T, 0, 0) - shift_um[seen]).T).max()
            if miss_um <= FIT_ERROR_UM or cells == MOST_CELLS:
                break
            cells *= 2
        self.error_um = rays.error_um + float(miss_um)

    def _told(
        self,
        rays: Rings,
        ideal_height_um: Callable[[np.ndarray], np.ndarray],
        cells: int,
        offset: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return points z (P, 2) all over the field, and u - x there, um.

        Rings and directions begin `offset` of a step on.
        """
        count = SAMPLES * cells // 2
        theta = rays.edge * (np.arange(1, count + 1) - offset) / count
        around = int(np.ceil(2 * np.pi * count))
        azimuth = 2 * np.pi * (np.arange(around) + offset) / around
        real = np.concatenate([rays(theta, azimuth).reshape(-1, 2), rays.middle_um[None]])
        way = np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
        ideal = ideal_height_um(theta)[:, None, None] * way
        ideal = np.concatenate([ideal.reshape(-1, 2), np.zeros((1, 2))])
        return (real - self.centre_um) / self.radius_um, ideal - real

    def ideal_points(
        self, x_um: np.ndarray, y_um: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x and y on the ideal plane of real image points, and which are in the circle.

        Beyond it they are those of the nearest point of its rim.
        """
        z_x = (x_um - self.centre_um[0]) / self.radius_um
        z_y = (y_um - self.centre_um[1]) / self.radius_um
        radius = np.hypot(z_x, z_y)
        inside = radius <= 1
        shrink = 1 / np.maximum(radius, 1.0)
        z_x, z_y = z_x * shrink, z_y * shrink
        shift = self._shift_um(z_x, z_y, 0, 0)
        u = self.centre_um[0] + z_x * self.radius_um + shift[..., 0]
        v = self.centre_um[1] + z_y * self.radius_um + shift[..., 1]
        return u, v, inside

    def jacobian(self) -> np.ndarray:
        """Return du/dx (P, 2, 2) at points all over the circle."""
        line = np.linspace(-1, 1, STEPS)
        z = np.stack(np.meshgrid(line, line), axis=0).reshape(2, -1)
        z = z[:, np.hypot(*z) <= 1]
        columns = [self._shift_um(*z, *way) / self.radius_um for way in ((1, 0), (0, 1))]
        return np.eye(2) + np.stack(columns, axis=-1)

    def _shift_um(self, z_x: np.ndarray, z_y: np.ndarray, nu_x: int, nu_y: int) -> np.ndarray:
        """Return u - x (..., 2), or a derivative of it, at points of the circle."""
        cells = len(self.net) - 3
        shape, net = np.shape(z_x), self.net.reshape(-1, 2)
        (col, across), (row, down) = (
            _weights(np.ravel(z), cells, nu) for z, nu in ((z_x, nu_x), (z_y, nu_y))
        )
        found = np.zeros((col.size, 2))
        for a, b in np.ndindex(4, 4):
            place = (col + a) * (cells + 3) + row + b
            found += (across[:, a] * down[:, b])[:, None] * net[place]
        return found.reshape(*shape, 2)


class Rings:
    """Where chief rays land: a Fourier series around each ring, splines across the rings.

    Attributes
    ----------
    edge : float
        Largest field angle, rad.
    middle_um : ndarray (2,)
        Where the ray of field (0, 0) lands.
    error_um : float
        What they leave open: the highest terms of the series, and what the splines miss, told by
        those through every other ring.
    """

    def __init__(self, field_deg: np.ndarray, real_um: np.ndarray) -> None:
        theta = np.radians(np.hypot(*field_deg.T))
        self.edge, self.middle_um = float(theta[-1]), real_um[0]
        spokes = int(np.isclose(theta, theta[-1], rtol=1e-9, atol=0).sum())
        rings = (len(theta) - 1) // max(spokes, 1)
        grid = field_deg[1:].reshape(rings, spokes, 2) if rings * spokes + 1 == len(theta) else None
        if grid is None or rings < 4 or spokes < 4 or not _even(grid):
            raise UserError(
                "the chief rays of the map are no rings",
                field="ray_x_deg, ray_y_deg",
                value=f"{len(theta)} rays, {spokes} of them at the rim",
                allowed="(0, 0), then 4 rings or more in the same even directions, 4 or more",
            )
        # The azimuth of spoke k, from y towards x, is that of the first and k steps.
        self.first = float(np.arctan2(*grid[-1, 0]))
        self.turn = 1 if _turns(grid[-1]) > 0 else -1
        series = np.fft.fft((real_um[1:] - real_um[0]).reshape(rings, spokes, 2), axis=1) / spokes
        self.orders = np.fft.fftfreq(spokes, 1 / spokes).astype(int)
        self.angles = theta[1:].reshape(rings, spokes)[:, 0]
        self.series = series
        self.spline = self._across(np.arange(rings))
        half = np.arange(rings)[(rings - 1) % 2 :: 2]
        other = np.setdiff1d(np.arange(rings), half)
        miss = self._across(half)(self.angles[other]) - series[other]
        highest = np.abs(series[:, np.abs(self.orders) >= spokes // 2 - 1]).sum(axis=1)
        # Sums over the orders: at the worst azimuth they add up.
        self.error_um = float(np.linalg.norm(np.abs(miss).sum(axis=1), axis=-1).max()) * HALVED
        self.error_um += float(np.linalg.norm(highest, axis=-1).max())

    def _across(self, numbers: np.ndarray):
        """Return the splines through some rings: order m is odd in the angle where m is."""
        angles, series = self.angles[numbers], self.series[numbers]
        sign = np.where(self.orders % 2, -1, 1)[:, None]
        both = np.concatenate([sign * series[::-1], 0 * series[:1], series])
        at = np.concatenate([-angles[::-1], [0.0], angles])
        return make_interp_spline(at, both, k=min(DEGREE, 2 * len(angles) - 1))

    def folds(self) -> bool:
        """Return whether fields that lie around a point anywhere land around it the other way."""
        azimuth = 2 * np.pi * np.arange(2 * STEPS) / (2 * STEPS)
        grid = self(self.edge * np.arange(1, STEPS + 1) / STEPS, azimuth)
        middle = np.broadcast_to(self.middle_um, (1, *grid.shape[1:]))
        outwards = np.diff(np.concatenate([middle, grid]), axis=0)
        around = np.roll(grid, -1, axis=1) - grid
        turns = outwards[..., 0] * around[..., 1] - outwards[..., 1] * around[..., 0]
        return bool(turns.min() < 0 < turns.max())

    def __call__(self, theta: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
        """Return where the rays of fields land, um: (T, A, 2)."""
        turned = self.turn * (azimuth - self.first)
        waves = np.exp(1j * np.outer(self.orders, turned))
        found = np.einsum("tmc,ma->tac", self.spline(theta), waves, optimize=True)
        return found.real + self.middle_um


def _even(grid: np.ndarray) -> bool:
    """Whether fields (R, S, 2) lie on rings of rising angle, in the same even directions each."""
    azimuth = np.arctan2(grid[..., 0], grid[..., 1])
    step = 2 * np.pi / grid.shape[1] * (1 if _turns(grid[-1]) > 0 else -1)
    wanted = azimuth[-1, 0] + step * np.arange(grid.shape[1])
    off = np.abs(np.exp(1j * azimuth) - np.exp(1j * wanted))
    theta = np.hypot(grid[..., 0], grid[..., 1])
    rises = (np.diff(theta[:, 0]) > 0).all() and theta[0, 0] > 0
    return bool(off.max() < 1e-9 and np.ptp(theta, axis=1).max() < 1e-9 and rises)


def _turns(ring: np.ndarray) -> float:
    """Return the sine of the step between the first two directions (S, 2), from y towards x."""
    (x0, y0), (x1, y1) = ring[0], ring[1]
    return float(x1 * y0 - x0 * y1)


def _weights(z: np.ndarray, cells: int, nu: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the cell (P,) of z, from -1 to 1, and its four weights (P, 4): B-splines' values.

    Or slopes over z, for ``nu`` 1. Uniform cubic B-splines (Unser 1999, eq. 6).
    """
    s = (z + 1) / 2 * cells
    cell = np.clip(s.astype(int), 0, cells - 1)
    f = s - cell
    e = 1 - f
    if nu:
        slopes = [-e * e, f * (3 * f - 4), -e * (3 * e - 4), f * f]
        return cell, np.stack(slopes, axis=1) * (cells / 4)
    values = [e**3, 4 + 3 * f * f * (f - 2), 4 + 3 * e * e * (e - 2), f**3]
    return cell, np.stack(values, axis=1) / 6


def _net(z: np.ndarray, shift_um: np.ndarray, cells: int) -> np.ndarray:
    """Return the control points of the spline that is nearest to values (P, 2) at z (P, 2)."""
    side = cells + 3
    within = np.abs(z).max(axis=1) <= 1
    z, shift_um = z[within], shift_um[within]
    (col, across), (row, down) = (_weights(one, cells, 0) for one in z.T)
    a, b = (one.ravel() for one in np.indices((4, 4)))
    where = (col[:, None] + a) * side + row[:, None] + b
    values = across[:, a] * down[:, b]
    numbers = np.broadcast_to(np.arange(len(z))[:, None], where.shape)
    seen = coo_array(
        (values.ravel(), (numbers.ravel(), where.ravel())), shape=(len(z), side * side)
    )
    rough = EVENNESS * vstack([_differences(side, axis) for axis in (0, 1)])
    normal = (seen.T @ seen + rough.T @ rough).tocsc()
    return splu(normal).solve(seen.T @ shift_um).reshape(side, side, 2)


def _differences(side: int, axis: int) -> coo_array:
    """Return the operator of third differences along an axis of a net."""
    number = np.arange(side * side).reshape(side, side)
    lines = np.moveaxis(number, axis, 0)
    places = np.stack([lines[k : side - 3 + k].ravel() for k in range(4)], axis=1)
    rows = np.repeat(np.arange(len(places)), 4)
    values = np.tile([-1.0, 3.0, -3.0, 1.0], len(places))
    return coo_array((values, (rows, places.ravel())), shape=(len(places), side * side))

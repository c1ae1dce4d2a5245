"""The chief-ray map as the shaders use it: splines from the real to the ideal image plane."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from gpusim.optics.grid import SimGrid
from gpusim.psf.bank import Bank
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.plane_map import PlaneMap
from gpusim.sensor.sensor import Sensor

# What a spline may miss of the map, on the real plane: a ten-thousandth of a pixel of 1 um.
FIT_ERROR_UM = 1e-4
# Pieces of a radial spline: doubled until it follows. 4096 take 64 KiB.
FEWEST_PIECES, MOST_PIECES = 16, 4096
LANDINGS = 1025  # heights between which it is interpolated where ideal points land
# Relaxation leaves exp(-RELAXED) of the way, where the map stretches evenly.
RELAXED, MOST_STEPS = 7, 200
BETWEEN = 4  # places in a piece at which a spline is held against the map
# On the axis the map is 0 / 0: its value is taken at this share of the image circle's radius.
NEAR_AXIS = 1e-4
# Below that an image is not distorted: far less than the shaders' own rounding, 2^-24 of 5 mm.
UNDISTORTED_UM = 1e-4


@dataclass(frozen=True)
class RadialMap:
    """u = x (1 + d(|x|^2 / R^2)) with R the image circle, as far as the scene has a place for it.

    Attributes
    ----------
    pieces : ndarray (n, 4)
        Cubic spline d of n even pieces: coefficients, low to high, of how far into a piece.
    radius_um : float
        R, um.
    distortion : bool
        Whether the shaders are to evaluate the spline; else u = x.
    error_um : float
        Largest miss on the real plane.
    """

    pieces: np.ndarray
    radius_um: float
    distortion: bool = True
    error_um: float = 0.0
    centre_um = (0.0, 0.0)
    has_axis = True

    def params(self, sim_pitch_um: float) -> dict:
        """Return the fields of the shaders' `Params` that describe the map, in sim samples."""
        return {
            "circle": self.centre_um,
            "inverse_radius2": (sim_pitch_um / self.radius_um) ** 2,
            "pieces": len(self.pieces),
        }

    def terms(self, sim_pitch_um: float) -> np.ndarray:
        """Return the shaders' `terms`: the pieces one after the other, of any pitch."""
        return self.pieces.astype(np.float32)

    def ideal_um(self, real_um: np.ndarray) -> np.ndarray:
        """Return ideal points (..., 2) of real ones; beyond the image circle d is that of the rim.

        Nothing of it is seen there.
        """
        rho2 = (real_um[..., 0] ** 2 + real_um[..., 1] ** 2) / self.radius_um**2
        return real_um * (1 + self._values(np.minimum(rho2, 1.0))[0])[..., None]

    def real_um(self, ideal_um: np.ndarray) -> np.ndarray:
        """Return about where ideal points (N, 2) land, for plans: within 1e-3 of the circle."""
        real = np.linspace(0, self.radius_um, LANDINGS)
        ideal = real * (1 + self._values((real / self.radius_um) ** 2)[0])
        height = np.hypot(*ideal_um.T)
        beyond = np.maximum(height / ideal[-1], 1.0)
        landed = np.interp(height, ideal, real) * beyond
        return ideal_um * (landed / np.maximum(height, NEAR_AXIS))[:, None]

    def _values(self, rho2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return d and its derivative at rho^2 up to 1."""
        count = len(self.pieces)
        piece = np.minimum((rho2 * count).astype(int), count - 1)
        t = rho2 * count - piece
        one, two, three, four = np.moveaxis(self.pieces[piece], -1, 0)
        d = one + t * (two + t * (three + t * four))
        return d, (two + t * (2 * three + 3 * t * four)) * count

    @cached_property
    def stretch(self) -> float:
        """Largest factor by which the map stretches: along the radius, or across it."""
        return float(self._factors.max())

    @property
    def least_stretch(self) -> float:
        """Smallest factor by which the map stretches."""
        return float(self._factors.min())

    def stretch_within(self, low_um: np.ndarray, high_um: np.ndarray) -> np.ndarray:
        """Return the largest stretch (P,) between two heights, each (P,)."""
        most = self._factors.max(axis=0)
        last = len(most) - 1
        places = (
            np.clip(height / self.radius_um, 0, 1) ** 2 * last for height in (low_um, high_um)
        )
        first, end = (np.floor(next(places)).astype(int), np.ceil(next(places)).astype(int) + 1)
        # What lies between two is taken up by reduceat, which wants rising pairs.
        pairs = np.stack([first, end], axis=1).ravel()
        return np.maximum.reduceat(np.append(most, 0.0), pairs)[::2]

    @cached_property
    def _factors(self) -> np.ndarray:
        """Factors (2, P) across and along the radius, even in rho^2 from the axis to the rim."""
        rho2 = np.linspace(0, 1, BETWEEN * len(self.pieces) + 1)
        d, slope = self._values(rho2)
        return np.abs([1 + d, 1 + d + 2 * rho2 * slope])


@dataclass(frozen=True)
class GeneralMap:
    """A map without symmetry, see `PlaneMap`."""

    plane: PlaneMap
    distortion = True
    has_axis = False

    @property
    def radius_um(self) -> float:
        """Radius of the image circle."""
        return self.plane.radius_um

    @property
    def centre_um(self) -> tuple[float, float]:
        """x, y of the image circle's centre."""
        return self.plane.centre_um

    @property
    def error_um(self) -> float:
        """Largest miss between the chief rays, as far as they tell."""
        return self.plane.error_um

    def params(self, sim_pitch_um: float) -> dict:
        """Return the fields of the shaders' `Params` that describe the map, in sim samples."""
        return {
            "circle": np.array(self.centre_um) / sim_pitch_um,
            "inverse_radius2": (sim_pitch_um / self.radius_um) ** 2,
            "pieces": len(self.plane.net) - 3,
        }

    def terms(self, sim_pitch_um: float) -> np.ndarray:
        """Return the shaders' `terms` in sim samples: see shaders/common/chief_ray."""
        net = (self.plane.net / sim_pitch_um).reshape(-1, 2)
        return np.pad(net, ((0, 0), (0, 2))).astype(np.float32)

    def ideal_um(self, real_um: np.ndarray) -> np.ndarray:
        """Return ideal points (..., 2) of real ones; beyond the image circle those of the rim."""
        return np.stack(self.plane.ideal_points(real_um[..., 0], real_um[..., 1])[:2], axis=-1)

    def real_um(self, ideal_um: np.ndarray) -> np.ndarray:
        """Return about where ideal points (N, 2) land, for plans; beyond the circle, beyond it.

        Steps that are too short for the largest stretch lead there from the same side.
        """
        real = ideal_um / self.stretch
        steps = math.ceil(RELAXED * self.stretch / max(self.least_stretch, 1 / MOST_STEPS))
        for _ in range(min(steps, MOST_STEPS)):
            real = real + (ideal_um - self.ideal_um(real)) / self.stretch
        return real

    @cached_property
    def stretch(self) -> float:
        """Largest factor by which the map stretches."""
        return float(np.linalg.norm(self.plane.jacobian(), ord=2, axis=(1, 2)).max())

    @property
    def least_stretch(self) -> float:
        """Smallest factor by which the map stretches."""
        return float(np.linalg.norm(self.plane.jacobian(), ord=-2, axis=(1, 2)).min())

    def stretch_within(self, low_um: np.ndarray, high_um: np.ndarray) -> np.ndarray:
        """Return the largest stretch (P,) between two heights, each (P,): that of all."""
        return np.full(np.shape(low_um), self.stretch)


ChiefRayMap = RadialMap | GeneralMap


def outline(
    chief_ray: ChiefRayMap, corner: np.ndarray, size: tuple[float, float], sim_pitch_um: float
) -> np.ndarray:
    """Return where the outline of a rectangle of the sim grid lies on the ideal plane.

    What lies in the rectangle lies within the outline: on the way from one of its points to the
    next the map is monotone, nearly.

    Parameters
    ----------
    chief_ray : ChiefRayMap
    corner : ndarray (..., 2)
        x, y from the axis, sim samples.
    size : (float, float)
        Width and height, sim samples.
    sim_pitch_um : float

    Returns
    -------
    ndarray (36, ..., 2)
        x, y, sim samples.
    """
    side = np.linspace(0, 1, 9)
    ends = [np.full(9, end) for end in (0, 1)]
    around = [np.stack(pair, axis=1) for end in ends for pair in ((side, end), (end, side))]
    offsets = np.concatenate(around) * size
    real = corner + offsets.reshape(-1, *(1,) * (np.ndim(corner) - 1), 2)
    return chief_ray.ideal_um(real * sim_pitch_um) / sim_pitch_um


def chief_ray_map(bank: FieldBank, force: bool = False) -> ChiefRayMap:
    """Return the bank's chief-ray map at the reference wavelength, as splines.

    Parameters
    ----------
    bank : FieldBank
    force : bool
        Evaluate them though the lens does not distort: for tests.
    """
    if not isinstance(bank, Bank):
        return GeneralMap(bank.plane_map)
    radius_um = bank.rectilinear_circle_um
    found = radial_map(lambda real_um: bank.ideal_from_real(real_um)[0], radius_um)
    real = np.linspace(0, radius_um, 401)
    moved_um = float(np.abs(bank.ideal_from_real(real)[0] - real).max())
    return replace(found, distortion=force or moved_um > UNDISTORTED_UM)


def radial_map(ideal_um: Callable[[np.ndarray], np.ndarray], radius_um: float) -> RadialMap:
    """Return the map of a lens with an axis.

    The spline goes through the map where its pieces meet. It has as many pieces as it takes to be
    ``FIT_ERROR_UM`` off at most, looked at ``BETWEEN`` times in each; or ``MOST_PIECES``.

    Parameters
    ----------
    ideal_um : callable
        Returns the ideal heights of real ones, um, from the axis to the rim, where they rise.
    radius_um : float
        Radius of the image circle.
    """
    count = FEWEST_PIECES
    while True:
        found = _splined(ideal_um, radius_um, count)
        if found.error_um <= FIT_ERROR_UM or count == MOST_PIECES:
            return found
        count *= 2


def _splined(
    ideal_um: Callable[[np.ndarray], np.ndarray], radius_um: float, count: int
) -> RadialMap:
    """Return the map as a spline of so many pieces, and what that misses."""
    rho2 = np.linspace(0, 1, BETWEEN * count + 1)
    real = radius_um * np.maximum(np.sqrt(rho2), NEAR_AXIS)
    ideal = ideal_um(real)
    spline = CubicSpline(rho2[::BETWEEN], (ideal / real)[::BETWEEN] - 1)
    pieces = spline.c[::-1].T / float(count) ** np.arange(4)
    found = RadialMap(np.ascontiguousarray(pieces), radius_um)
    miss = np.abs(real * (1 + spline(rho2)) - ideal)
    # Back on the real plane: over the slope of the map along the radius.
    return replace(found, error_um=float((miss / found._factors[1]).max()))


def black_share(sensor: Sensor, centre_um: tuple[float, float], radius_um: float) -> float:
    """Return the share of a sensor's pixels whose middles lie beyond an image circle."""
    row, col = (
        (np.arange(count) + 0.5 - count / 2) * sensor.pixel_pitch_um
        for count in (sensor.rows, sensor.cols)
    )
    half_um = np.sqrt(np.maximum(radius_um**2 - (row - centre_um[1]) ** 2, 0.0))
    ends = (np.searchsorted(col, centre_um[0] + way * half_um) for way in (-1, 1))
    first, last = next(ends), next(ends)
    return 1.0 - float((last - first).sum()) / (sensor.rows * sensor.cols)


def block_bounds_um(
    grid: SimGrid, pitch_um: float, chief_ray: ChiefRayMap, margin: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where the blocks of a sim grid lie on the ideal plane, and which of them see light.

    Parameters
    ----------
    grid : SimGrid
    pitch_um : float
        Pitch of the sim grid.
    chief_ray : ChiefRayMap
    margin : float
        How much larger each block is taken to be on every side, samples.

    Returns
    -------
    low, high : ndarray (blocks, 2)
        Corners of the boxes that hold them, um; the index of x runs fastest.
    lit : ndarray (blocks,) of bool
        Whether a part of the block lies within the image circle.
    """
    columns, rows = (np.arange(count) for count in grid.blocks)
    index = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    corner = index * grid.block + np.array(grid.start) - np.array(grid.centre) - margin
    size = np.array(grid.block) + 2 * margin
    ideal = outline(chief_ray, corner, size, pitch_um) * pitch_um
    circle = np.array(chief_ray.centre_um) / pitch_um
    nearest = np.maximum(np.maximum(corner - circle, circle - corner - size), 0.0) * pitch_um
    lit = np.hypot(*nearest.T) < chief_ray.radius_um
    return ideal.min(axis=0) - pitch_um, ideal.max(axis=0) + pitch_um, lit

"""The chief-ray map as the shaders use it: polynomials from the real to the ideal image plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.bank import Bank
from gpusim.lens.field_bank import FieldBank
from gpusim.lens.plane_map import PlaneMap
from gpusim.optics.grid import SimGrid

# Error of the fit that the design allows at any image height (a thousandth of a pixel of 1 um).
FIT_ERROR_UM = 1e-3
# Below that an image is not distorted: far less than the shaders' own rounding, 2^-24 of 5 mm.
UNDISTORTED_UM = 1e-4


@dataclass(frozen=True)
class RadialMap:
    """u = x g(|x|^2 / R^2) with R the image circle, as far as the ideal plane has a place for it.

    Attributes
    ----------
    coefficients : ndarray (8,)
        Of g, low to high.
    radius_um : float
        R, um.
    distortion : bool
        Whether the shaders are to evaluate the polynomial; else u = x.
    """

    coefficients: np.ndarray
    radius_um: float
    distortion: bool = True
    centre_um = (0.0, 0.0)
    degree = 0

    def params(self, sim_pitch_um: float) -> dict:
        """Return the fields of the shaders' `Params` that describe the map, in sim samples."""
        return {
            "g_low": self.coefficients[:4],
            "g_high": self.coefficients[4:],
            "circle": self.centre_um,
            "inverse_radius2": (sim_pitch_um / self.radius_um) ** 2,
        }

    def terms(self, sim_pitch_um: float) -> np.ndarray:
        """Return the shaders' `terms`: one that is not read, for a buffer cannot be empty."""
        return np.zeros((1, 2), np.float32)

    def ideal_um(self, real_um: np.ndarray) -> np.ndarray:
        """Return ideal points (..., 2) of real ones; beyond the image circle g is that of the rim.

        The shaders go on with the polynomial there, and nothing of it is seen.
        """
        rho2 = (real_um[..., 0] ** 2 + real_um[..., 1] ** 2) / self.radius_um**2
        rho2 = np.minimum(rho2, 1.0)
        return real_um * np.polynomial.Polynomial(self.coefficients)(rho2)[..., None]

    @cached_property
    def stretch(self) -> float:
        """Largest factor by which the map stretches: along the radius, or across it."""
        return float(np.max(self._factors()))

    @property
    def least_stretch(self) -> float:
        """Smallest factor by which the map stretches."""
        return float(np.min(self._factors()))

    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the factors across and along the radius, from the axis to the rim."""
        g = np.polynomial.Polynomial(self.coefficients)
        rho2 = np.linspace(0, 1, 257)
        return np.abs(g(rho2)), np.abs(g(rho2) + 2 * rho2 * g.deriv()(rho2))


@dataclass(frozen=True)
class GeneralMap:
    """A map without symmetry, see `PlaneMap`."""

    plane: PlaneMap
    distortion = True

    @property
    def radius_um(self) -> float:
        """Radius of the image circle."""
        return self.plane.radius_um

    @property
    def centre_um(self) -> tuple[float, float]:
        """x, y of the image circle's centre."""
        return self.plane.centre_um

    @property
    def degree(self) -> int:
        """Of the polynomial."""
        return self.plane.degree

    def params(self, sim_pitch_um: float) -> dict:
        """Return the fields of the shaders' `Params` that describe the map, in sim samples."""
        return {
            "g_low": np.zeros(4),
            "g_high": np.zeros(4),
            "circle": np.array(self.centre_um) / sim_pitch_um,
            "inverse_radius2": (sim_pitch_um / self.radius_um) ** 2,
        }

    def terms(self, sim_pitch_um: float) -> np.ndarray:
        """Return the shaders' `terms` in sim samples: see shaders/common/chief_ray."""
        degree = self.degree
        order = [(i, degree - row) for row in range(degree + 1) for i in range(row, -1, -1)]
        return (self.plane.ideal[tuple(np.transpose(order))] / sim_pitch_um).astype(np.float32)

    def ideal_um(self, real_um: np.ndarray) -> np.ndarray:
        """Return ideal points (..., 2) of real ones; beyond the image circle those of the rim."""
        return np.stack(self.plane.ideal_points(real_um[..., 0], real_um[..., 1])[:2], axis=-1)

    @cached_property
    def stretch(self) -> float:
        """Largest factor by which the map stretches."""
        return float(np.linalg.norm(self.plane.jacobian(), ord=2, axis=(1, 2)).max())

    @property
    def least_stretch(self) -> float:
        """Smallest factor by which the map stretches."""
        return float(np.linalg.norm(self.plane.jacobian(), ord=-2, axis=(1, 2)).min())


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
    """Return the bank's chief-ray map at the reference wavelength, as polynomials.

    Parameters
    ----------
    bank : FieldBank
    force : bool
        Evaluate them though the lens does not distort: for tests.

    Raises
    ------
    UserError
        When polynomials do not follow the map to a thousandth of a micrometre: of degree 15 in
        image height where the lens has an axis, or see `PlaneMap`.
    """
    return _radial(bank, force) if isinstance(bank, Bank) else GeneralMap(bank.plane_map)


def _radial(bank: Bank, force: bool) -> RadialMap:
    radius = np.linspace(0, bank.rectilinear_circle_um, 401)[1:]
    ratio = bank.ideal_from_real(radius)[0] / radius
    fit = np.polynomial.Polynomial.fit(
        (radius / radius[-1]) ** 2, ratio, 7, domain=[0, 1], w=radius
    ).convert()
    coefficients = np.zeros(8)
    coefficients[: len(fit.coef)] = fit.coef
    error_um = (
        np.abs(np.polynomial.Polynomial(coefficients)((radius / radius[-1]) ** 2) - ratio) * radius
    )
    if error_um.max() > FIT_ERROR_UM:
        raise UserError(
            "The chief-ray map is not smooth enough for the engine's polynomial.",
            field="distortion",
            value=f"{error_um.max():.3g} um off at {radius[error_um.argmax()]:.0f} um height",
            allowed=f"at most {FIT_ERROR_UM} um",
        )
    distorted = bool((np.abs(ratio - 1) * radius).max() > UNDISTORTED_UM)
    return RadialMap(coefficients, float(radius[-1]), distorted or force)


def block_bounds_um(
    grid: SimGrid, pitch_um: float, chief_ray: ChiefRayMap, margin: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where the blocks of a sim grid lie on the ideal plane, and which of them see light.

    Parameters
    ----------
    grid : SimGrid
    pitch_um : float
        Of the sim grid.
    chief_ray : ChiefRayMap
    margin : float
        By which each block is taken to be larger on every side, samples.

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

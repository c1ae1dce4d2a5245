"""The bank of a lens with an axis: its fields are heights, and its PSFs turn with the azimuth."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gpusim.errors import UserError
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.field_map import FieldMap
from gpusim.psf.halo import split
from gpusim.psf.lines import CHIEF_RAYS, STRAIGHT, line_shares
from gpusim.psf.places import Heights
from gpusim.psf.scatter import spread_by
from gpusim.psf.store import Table
from gpusim.psf.variables import RADIAL


@dataclass(frozen=True, eq=False, kw_only=True)
class Bank(FieldBank):
    """PSFs and maps of a lens with an axis: F fields, L wavelengths, n x n samples.

    Attributes
    ----------
    field_deg, ideal_height_um : ndarray, shape (F,)
        Field angle theta and c tan(theta), both rising from 0, c the principal distance; infinite
        from 90 deg. With an object plane theta is the angle at the entrance pupil.
    real_height_um : ndarray, shape (F, L)
        Where the chief ray of each wavelength lands.
    psf : ndarray of float32, shape (F, L, n, n)
        Row eta: sagittal. Column xi: tangential, along the radius and away from the axis.
    relative_illumination : ndarray, shape (F, L)
        What an even scene shows, over that on axis.
    projected_solid_angle_sr, transmission : ndarray, shape (L,)
        On axis.
    chief : ndarray, shape (F, L, 2), or None
        Along xi and along eta: tangential and sagittal.
    field_light : ndarray, shape (F, L), or None
        What an even scene sends through the lens about a field, per area of its image, over
        `projected_solid_angle_sr`: see ``gpusim.lens.entering``.
    ray_deg, ray_um : ndarray, shape (M,), and ndarray, shape (M, L), or None
        Chief rays between the fields, and theirs: see ``gpusim.psf.chief_rays``.

    The others are those of every bank: see ``gpusim.psf.field_bank.FieldBank``.
    """

    field_deg: np.ndarray
    ideal_height_um: np.ndarray
    real_height_um: np.ndarray
    field_light: np.ndarray | None = None
    ray_deg: np.ndarray | None = None
    ray_um: np.ndarray | None = None

    table: ClassVar[Table] = RADIAL

    @functools.cached_property
    def scatter(self) -> np.ndarray:
        """Light (F, L) that a point of each field spreads, K, over that which is shown on axis.

        PSFs lie beside their chief rays and change with the field, so what they spread of a light K
        adds up to K - div(K c) + div div(K S) / 2 where the scene is even: c and S are their first
        and second moments about the chief ray of the reference wavelength. A ready-made
        bank tells only what such a scene shows, and this is the K that makes it so.
        """
        if self.field_light is not None:
            return self.field_light
        return spread_by(self)

    @functools.cached_property
    def levels(self) -> tuple[Bank, ...]:
        """The bank as banks that add up, from the core outwards; without halo one.

        Their light is `scatter`. The core's PSFs fall to 0 towards the window's rim, where the
        first level takes over.
        """
        return split(replace(self, relative_illumination=self.scatter))

    @property
    def image_circle_um(self) -> float:
        """Largest real height at the reference wavelength."""
        return float(self.real_height_um[-1, self.reference])

    @property
    def rectilinear_circle_um(self) -> float:
        """Largest real height at the reference wavelength that has a place on the ideal plane."""
        return self._ideal_edge[1]

    centre_um = (0.0, 0.0)

    @property
    def landing_um(self) -> np.ndarray:
        """Where chief rays land (F, L, 2); x points away from the axis."""
        return np.stack([self.real_height_um, np.zeros_like(self.real_height_um)], axis=-1)

    def at(self, number: int) -> tuple[int, ...]:
        """Return where the field of a number lies along the axis of the field."""
        return (number,)

    @property
    def probes(self) -> tuple[int, ...]:
        """Fields that stand for all: the axis, half and full field."""
        return (0, len(self.field_deg) // 2, len(self.field_deg) - 1)

    def places(self, reach_um: float) -> tuple[tuple[int, ...], Heights]:
        """Return the fields as far as image points up to `reach_um` off the axis need them."""
        radius_um = self.real_height_um[:, self.reference]
        # Two beyond a point are of the nearest four.
        count = min(int(np.searchsorted(radius_um, reach_um)) + 2, len(radius_um))
        return (*range(count), 1), Heights(radius_um[:count])

    def ideal_points(
        self, x_um: np.ndarray, y_um: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x and y on the ideal plane of real image points, and which are in the circle."""
        radius = np.hypot(x_um, y_um)
        ideal, inside = self.ideal_from_real(radius)
        scale = ideal / np.maximum(radius, 1e-9)
        return x_um * scale, y_um * scale, inside

    def illumination_at(self, x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
        """Return the relative illumination at real image points, by wavelength first."""
        radius = np.hypot(x_um, y_um)
        heights = Heights(self.real_height_um[:, self.reference])
        light = heights.even(self.relative_illumination, radius.ravel())
        return light.T.reshape(len(self.wavelengths_nm), *radius.shape)

    @property
    def distortion(self) -> np.ndarray:
        """Real over ideal height at the reference wavelength, less 1; shape (F,), 0 on axis."""
        real = self.real_height_um[1:, self.reference]
        return np.concatenate([[0.0], real / self.ideal_height_um[1:] - 1])

    @functools.cached_property
    def _maps(self) -> dict[float, FieldMap]:
        return {}

    def _ray_shares(self, wavelengths_nm: np.ndarray | float) -> np.ndarray:
        """Return how much each line counts for the chief rays at wavelengths."""
        degree = STRAIGHT if self.spectral_degree == STRAIGHT else CHIEF_RAYS
        return line_shares(self.wavelengths_nm, degree, wavelengths_nm)

    def _map(self, wavelength_nm: float | None) -> FieldMap:
        """Return the map of a wavelength."""
        wavelength = self.reference_nm if wavelength_nm is None else float(wavelength_nm)
        lines = self.wavelengths_nm
        if not lines[0] <= wavelength <= lines[-1]:
            raise UserError(
                "the bank has no chief rays at this wavelength",
                field="wavelength_nm",
                value=wavelength,
                allowed=f"{lines[0]:g} to {lines[-1]:g}",
            )
        if wavelength not in self._maps:
            share = self._ray_shares(wavelength)
            angles, heights = self.field_deg, self.real_height_um
            if self.ray_deg is not None:
                angles, heights = self.ray_deg, self.ray_um
            self._maps[wavelength] = FieldMap(
                np.radians(angles), heights @ share, 1e3 * self.principal_distance_mm
            )
        return self._maps[wavelength]

    def height_from_angle(
        self, theta_deg: np.ndarray, wavelength_nm: float | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Map field angle to real image height.

        Parameters
        ----------
        theta_deg : array_like
            Field angles, >= 0.
        wavelength_nm : float, optional
            From the bank's first to its last (its reference wavelength).

        Returns
        -------
        height_um : ndarray
            Beyond the largest field: the straight line that continues the map.
        inside : ndarray of bool
            False beyond the largest field.

        Raises
        ------
        UserError
            Where the wavelength lies beyond the bank's.
        """
        chief, theta = self._map(wavelength_nm), np.radians(theta_deg)
        at = np.minimum(theta, chief.edge)
        height = chief.height_um(at) + chief.slope_um(chief.edge) * (theta - at)
        return height, theta <= chief.edge

    def angle_from_height(
        self, r_um: np.ndarray, wavelength_nm: float | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Map real image height to field angle in deg: the inverse of ``height_from_angle``."""
        chief, wanted = self._map(wavelength_nm), np.asarray(r_um, dtype=float)
        at = np.minimum(wanted, chief.edge_um)
        theta = chief.angle(at) + (wanted - at) / chief.slope_um(chief.edge)
        return np.degrees(theta), wanted <= chief.edge_um

    @functools.cached_property
    def _ideal_edge(self) -> tuple[float, float, float]:
        """The ideal and the real height where the ideal plane ends, and the map's slope there."""
        chief, scale_um = self._map(None), 1e3 * self.principal_distance_mm
        edge = min(chief.edge, float(np.radians(self.projection.end_deg)))
        slope = float(chief.slope_um(edge)) / (scale_um * self.projection.slope(edge))
        real_um = self.image_circle_um if edge == chief.edge else float(chief.height_um(edge))
        return scale_um * float(self.projection.height(edge)), real_um, slope

    def real_from_ideal(self, r_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Map ideal to real image height at the reference wavelength.

        Parameters
        ----------
        r_um : array_like
            Ideal heights, >= 0: the principal distance times tan(theta), or of another projection.

        Returns
        -------
        real_um : ndarray
            Beyond the image circle: the straight line that continues the map.
        inside : ndarray of bool
            False beyond the image circle, and beyond the projection's end.
        """
        r = np.asarray(r_um, dtype=float)
        edge, _, slope = self._ideal_edge
        at = np.minimum(r, edge)
        scale_um = 1e3 * self.principal_distance_mm
        real = self._map(None).height_um(self.projection.angle(at / scale_um))
        return real + slope * (r - at), r <= edge

    def ideal_from_real(self, r_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Map real to ideal image height: the inverse of ``real_from_ideal``, to 1e-9 um."""
        wanted = np.asarray(r_um, dtype=float)
        _, edge, slope = self._ideal_edge
        at = np.minimum(wanted, edge)
        scale_um = 1e3 * self.principal_distance_mm
        ideal = scale_um * self.projection.height(self._map(None).angle(at))
        return ideal + (wanted - at) / slope, wanted <= edge

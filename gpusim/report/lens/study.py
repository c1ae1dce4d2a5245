"""The numbers of a lens's figures, each computed when it is first asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gpusim.lens.analysis import energy, focus, rays, zernike
from gpusim.lens.analysis.fields import (
    WHITE_NM,
    WHITE_REFERENCE,
    Field,
    angles_across,
    design_lines,
    main_fields,
    rays_at,
    white_light,
)
from gpusim.lens.system import System
from gpusim.parallel import each
from gpusim.psf import contrast, otf
from gpusim.report.lens_page import round_above, round_near

CHIEF_FIELDS = 41
CONTRAST_FIELDS, BOTH_SIDES = 11, 15  # each takes a second or two
ZONES = np.linspace(0.02, 1.0, 50)
FOCUS_STEPS = 61
FREQUENCIES = 101
RADII = 160
GRID = 11  # lines of the distortion grid each way
# Beyond this angle off the axis a grid that is even in tan(theta) says little of the picture.
WIDE_DEG = 60.0


@dataclass(eq=False)
class Study:
    """A lens whose figures are drawn.

    Attributes
    ----------
    label : str
        What figures call it.
    system : System
    asked_frequency : float, optional
        Cycles/mm of the curves at one frequency; without it where the axis keeps about half.
    """

    label: str
    system: System
    asked_frequency: float | None = None

    @property
    def centred(self) -> bool:
        """Whether the lens has an axis."""
        return not self.system.geometry.moved.any()

    @property
    def ways(self) -> tuple[str, str]:
        """Names of the directions y and x of the image."""
        return otf.DIRECTIONS if self.centred else ("along y", "along x")

    @cached_property
    def fields(self) -> list[Field]:
        """The fields that have a fan, a spot and a curve of their own."""
        return main_fields(self.system)

    @cached_property
    def lines(self) -> tuple[np.ndarray, int]:
        """The design wavelengths and the number of the primary one."""
        return design_lines(self.system)

    @property
    def primary_nm(self) -> float:
        """The primary wavelength."""
        lines, primary = self.lines
        return float(lines[primary])

    @cached_property
    def airy_um(self) -> float:
        """Radius of the Airy disc on the axis, at the primary wavelength."""
        return rays.airy_radius_um(self.system, self.primary_nm)

    # rays

    @cached_property
    def fans(self) -> list[tuple[rays.Fan, rays.Fan]]:
        """Fans along y and along x of each field."""
        return [
            tuple(rays.ray_fan(self.system, *self.lines, field, way) for way in ("y", "x"))
            for field in self.fields
        ]

    @cached_property
    def spots(self) -> list[rays.Spot]:
        """The spot of each field."""
        return [rays.spot_diagram(self.system, *self.lines, field) for field in self.fields]

    @cached_property
    def waves(self) -> list[tuple[rays.Wavefront, np.ndarray]]:
        """The wavefront of each field at the primary wavelength, and its Zernike terms."""
        found = []
        for field in self.fields:
            wave = rays.wavefront_map(self.system, self.primary_nm, field)
            lit = np.isfinite(wave.opd_waves)
            x, y = np.meshgrid(wave.stop, wave.stop)
            found.append((wave, zernike.fit(wave.opd_waves[lit], x[lit], y[lit])))
        return found

    @cached_property
    def theta(self) -> np.ndarray:
        """Field angles of chief rays, rad."""
        return angles_across(self.system, CHIEF_FIELDS)

    @cached_property
    def focus_mm(self) -> np.ndarray:
        """Tangential and sagittal focus over the field, shape (F, L, 2)."""
        return focus.field_focus(self.system, self.lines[0], self.theta)

    @cached_property
    def chief_um(self) -> np.ndarray:
        """Where the chief rays land along y, shape (F, L)."""
        middle = np.zeros(1)
        return np.array(
            [
                1e3 * rays_at(self.system, self.lines[0], Field("", a), middle, middle).chief_y_mm
                for a in self.theta
            ]
        )

    @cached_property
    def zones_mm(self) -> np.ndarray:
        """Where rays of the axial beam cross the axis, shape (L, Z)."""
        return focus.longitudinal_aberration(self.system, self.lines[0], ZONES)

    @cached_property
    def colour_nm(self) -> np.ndarray:
        """Wavelengths of the chromatic focal shift."""
        lines = self.lines[0]
        return np.linspace(min(400.0, lines[0]), max(700.0, lines[-1]), 61)

    @cached_property
    def colour_mm(self) -> np.ndarray:
        """Focus of close rays on the axis against wavelength, from the image plane, (W, 2)."""
        return focus.field_focus(self.system, self.colour_nm, np.zeros(1))[0]

    @property
    def arrival_theta(self) -> np.ndarray:
        """Field angles of the angles at the image, rad: every other one."""
        return self.theta[::2]

    @cached_property
    def arrivals(self) -> list[rays.Arrival]:
        """How light arrives over the field at the primary wavelength."""
        return [
            rays.arrival(self.system, self.primary_nm, Field("", angle))
            for angle in self.arrival_theta
        ]

    @cached_property
    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Places of a square grid of the object: ideal and real, mm, each (GRID, GRID, 2).

        Even in tan(theta), of wide lenses in theta; the ideal has the scale of the image's middle.
        """
        edge = np.radians(self.system.prescription.max_field_deg)
        wide = self.system.prescription.max_field_deg > WIDE_DEG
        reach = edge if wide else np.tan(edge)
        at = np.linspace(-1, 1, GRID) * reach / np.sqrt(2)
        x, y = np.meshgrid(at, at)
        distance = np.hypot(x, y)
        theta = distance if wide else np.arctan(distance)
        azimuth = np.arctan2(x, y)
        if self.centred:
            known, which = np.unique(theta.round(12), return_inverse=True)
            radius = np.array([self._lands(one, 0.0)[1] for one in known])[which.reshape(x.shape)]
            real = radius[..., None] * np.stack([np.sin(azimuth), np.cos(azimuth)], -1)
        else:
            real = np.array(
                [self._lands(*one) for one in zip(theta.ravel(), azimuth.ravel(), strict=True)]
            ).reshape(*x.shape, 2)
        small = max(1e-3 * reach, 1e-6)
        middle, beside = (
            self._lands(0.0, 0.0),
            self._lands(small if wide else np.arctan(small), 0.0),
        )
        scale = np.linalg.norm(beside - middle) / small
        return middle + scale * np.stack([x, y], -1), real

    def _lands(self, theta: float, azimuth: float) -> np.ndarray:
        """Return x and y of the primary wavelength's chief ray, mm."""
        middle = np.zeros(1)
        field, line = Field("", float(theta), float(azimuth)), np.array([self.primary_nm])
        found = rays_at(self.system, line, field, middle, middle)
        return np.array([found.chief_x_mm[0], found.chief_y_mm[0]])

    # white light

    @cached_property
    def pupils(self) -> list[otf.FieldPupils]:
        """The polychromatic pupils of each field."""
        light = white_light(self.system)

        def traced(field: Field) -> otf.FieldPupils:
            return otf.field_pupils(
                self.system,
                field.theta,
                WHITE_NM,
                light,
                reference=WHITE_REFERENCE,
                azimuth=field.azimuth,
            )

        return each(traced, self.fields)

    @cached_property
    def frequency(self) -> float:
        """Cycles/mm of the curves at one frequency."""
        if self.asked_frequency is not None:
            return self.asked_frequency
        tried = self._tried
        half = np.flatnonzero(self._axis < 0.5)
        return float(round_near(tried[half[0]] if half.size else tried[-1] / 2))

    @cached_property
    def frequencies(self) -> np.ndarray:
        """Cycles/mm of the MTF, to where the axis keeps a tenth."""
        lost = np.flatnonzero(self._axis < 0.1)
        top = round_above(self._tried[lost[0]] if lost.size else self._tried[-1])
        return np.linspace(0, max(top, 1.2 * self.frequency), FREQUENCIES)

    @cached_property
    def _tried(self) -> np.ndarray:
        cut_off = 1.22e3 / self.airy_um * self.primary_nm / WHITE_NM[0]
        return np.geomspace(cut_off / 500, cut_off, 120)

    @cached_property
    def _axis(self) -> np.ndarray:
        return np.abs(self.pupils[0].otf(self._tried, "tangential"))

    @cached_property
    def mtf(self) -> np.ndarray:
        """MTF against frequency, shape (fields, 2, K)."""

        def both(pupils: otf.FieldPupils) -> np.ndarray:
            return np.abs([pupils.otf(self.frequencies, way) for way in otf.DIRECTIONS])

        return np.array(each(both, self.pupils))

    @cached_property
    def limit(self) -> np.ndarray:
        """MTF of a perfect lens as bright on axis, with the same light, shape (K,)."""
        number = self.airy_um / (1.22e-3 * self.primary_nm)
        mtf = [otf.diffraction_mtf(self.frequencies, w, number) for w in WHITE_NM]
        weight = self.pupils[0].weight
        return weight @ np.array(mtf) / weight.sum()

    @cached_property
    def depth_mm(self) -> np.ndarray:
        """Shifts of the image plane: to twice where a perfect lens first loses the frequency."""
        number = self.airy_um / (1.22e-3 * self.primary_nm)
        unit = 1.22 * number / self.frequency
        tried = np.linspace(-4, 4, 65) * unit
        best = [
            abs(tried[np.abs(one.through_focus(self.frequency, way, tried)).argmax()])
            for one in self.pupils
            for way in otf.DIRECTIONS
        ]
        depth = round_above(max(2 * unit, max(best) + unit))
        return np.linspace(-depth, depth, FOCUS_STEPS)

    @cached_property
    def through_focus(self) -> np.ndarray:
        """MTF at one frequency through focus, shape (fields, 2, Z)."""

        def both(pupils: otf.FieldPupils) -> np.ndarray:
            ways = otf.DIRECTIONS
            found = [pupils.through_focus(self.frequency, way, self.depth_mm) for way in ways]
            return np.abs(found)

        return np.array(each(both, self.pupils))

    @cached_property
    def contrast_theta(self) -> np.ndarray:
        """Field angles of the MTF over the field, rad."""
        return angles_across(self.system, CONTRAST_FIELDS if self.centred else BOTH_SIDES)

    @property
    def contrast_frequencies(self) -> np.ndarray:
        """Half of the chosen frequency, itself, and twice."""
        return self.frequency * np.array([0.5, 1.0, 2.0])

    @cached_property
    def across(self) -> list[contrast.FieldContrast]:
        """MTF and light over the field."""
        light, wanted = white_light(self.system), self.contrast_frequencies

        def at(theta: float) -> contrast.FieldContrast:
            return contrast.field_contrast(self.system, theta, WHITE_NM, light, wanted)

        return each(at, self.contrast_theta)

    @cached_property
    def illumination(self) -> np.ndarray:
        """Light over the field at 550 nm, of the middle's."""
        sr = np.array([one.light_sr[WHITE_REFERENCE] for one in self.across])
        return sr / sr[np.abs(self.contrast_theta).argmin()]

    @cached_property
    def radius_um(self) -> np.ndarray:
        """Radii of the encircled energy."""
        largest = min(energy.largest_radius_um(one.fine, WHITE_NM) for one in self.pupils)
        return np.append(0.0, np.geomspace(0.05 * self.airy_um, largest, RADII - 1))

    @cached_property
    def encircled(self) -> np.ndarray:
        """Encircled energy of each field, shape (fields, R)."""

        def of(one: otf.FieldPupils) -> np.ndarray:
            chief = one.shift_um[::-1]
            return energy.encircled_energy(one.fine, WHITE_NM, one.weight, chief, self.radius_um)

        return np.array(each(of, self.pupils))

    @cached_property
    def encircled_limit(self) -> np.ndarray:
        """Encircled energy of perfect lenses with a round pupil, shape (R,)."""
        weight = self.pupils[0].weight
        scale = self.airy_um * WHITE_NM / self.primary_nm
        return weight @ energy.airy_energy(self.radius_um, scale[:, None]) / weight.sum()


def aligned(studies: Sequence[Study]) -> list[Study]:
    """Return lenses that share a figure with the same frequencies and shifts of the image plane.

    The first says at which frequency the curves are that have one.
    """
    for study in studies[1:]:
        study.frequency = studies[0].frequency
    top = max(study.frequencies[-1] for study in studies)
    depth = max(study.depth_mm[-1] for study in studies)
    for study in studies:
        study.frequencies = np.linspace(0, top, FREQUENCIES)
        study.depth_mm = np.linspace(-depth, depth, FOCUS_STEPS)
    return list(studies)

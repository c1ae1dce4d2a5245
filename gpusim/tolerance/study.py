"""A tolerance study: a camera and a budget, and the differentials and samples of both."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from gpusim.camera import Camera
from gpusim.config.text import read_record
from gpusim.disk import whole
from gpusim.errors import UserError
from gpusim.lens.perturb import perturbed
from gpusim.lens.prescription import Prescription
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build
from gpusim.plan.accuracy import Accuracy
from gpusim.plan.band import band_of
from gpusim.scene import make_scene
from gpusim.tolerance.budget import Budget, Mounted, step_of
from gpusim.tolerance.sfr import (
    FREQUENCY_CY_PX,
    ILLUMINANT,
    Channel,
    channel_of,
    mtf50,
    otfs,
    through_focus,
)
from gpusim.tolerance.wave import Wave, wave_of

PARTS = "parts"
STUDY = "study.json"
# Focus is sought about the least variance of the wavefront: so many steps of a quarter of the depth
# of focus either way, by the mean SFR where the design's is one half.
FOCUS_STEPS = 6
BAND_TOLERANCE = 1e-3  # light beyond the eye's counts as far as a render to it would take it

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Place:
    """Where edges are measured: pixels from the sensor's middle, and the field in rad.

    x points right and y down, as the lens's own axes do in a bank (`gpusim.psf.plane_bank`).
    """

    x_px: float
    y_px: float
    theta: float
    azimuth: float


@dataclass
class Study:
    """A camera, a budget, and what is computed of them.

    Attributes
    ----------
    camera : Camera
    budget : Budget
    out : Path
        Finished parts lie in its folder ``parts``.
    progress : callable
    """

    camera: Camera
    budget: Budget
    out: Path
    progress: Progress = field(default=lambda *_: None)

    @cached_property
    def lens(self) -> Prescription:
        """The design, its stop and image plane fixed."""
        return Mounted.of(self.camera).lens

    @cached_property
    def channel(self) -> Channel:
        """The photosites that are measured, and the light that a render would have."""
        camera = self.camera
        grey = make_scene("grey", illuminant=ILLUMINANT, frame=camera.frame)
        band = band_of(self.lens, camera.sensor, grey, Accuracy(BAND_TOLERANCE))
        return channel_of(camera.sensor, *band.wavelengths_nm[[0, -1]])

    @cached_property
    def draws(self) -> list[dict[str, float]]:
        """Changes of each sample."""
        return self.budget.draws(self.lens)

    @cached_property
    def names(self) -> list[str]:
        """Numbers that vary."""
        return list(self.budget.axes(self.lens))

    @cached_property
    def places(self) -> list[Place]:
        """Nine places: 3 x 3 over the sensor, from its upper left corner, row by row."""
        sensor, share = self.camera.sensor, self.budget.field
        return [
            self.place(right * share * sensor.cols / 2, down * share * sensor.rows / 2)
            for down in (-1, 0, 1)
            for right in (-1, 0, 1)
        ]

    def place(self, x_px: float, y_px: float) -> Place:
        """Return a place of the sensor: pixels from its middle, x right and y down.

        Raises
        ------
        UserError
            The lens does not see so far.
        """
        height = 1e-3 * self.camera.sensor.pixel_pitch_um * math.hypot(x_px, y_px)
        angles, heights = self._radii
        if height > heights[-1]:
            raise UserError(
                "the lens's field does not reach the places",
                field="field",
                value=self.budget.field,
                allowed=f"up to {self.budget.field * heights[-1] / height:.2g}",
            )
        theta = float(np.interp(height, heights, angles))
        return Place(x_px, y_px, theta, math.atan2(x_px, y_px) if height else 0.0)

    @cached_property
    def _radii(self) -> tuple[np.ndarray, np.ndarray]:
        """Field angles, rad, and the image heights of their chief rays, mm."""
        system = build(self.lens)
        index = system.index(np.array([self.lens.reference_nm]))
        angles = np.radians(np.linspace(0, self.lens.max_field_deg, 33))
        zero = np.zeros(1)
        heights = [
            float(sample_rays(system, index, one, zero, zero).chief_y_mm[0]) for one in angles
        ]
        return angles, np.array(heights)

    @cached_property
    def waves(self) -> list[Wave]:
        """Wavefronts of the design."""
        found = []
        for k, place in enumerate(self.places):
            self.progress("design", k, len(self.places))
            found.append(
                wave_of(self.lens, place.theta, place.azimuth, self.channel.wavelengths_nm)
            )
        self.progress("design", len(self.places), len(self.places))
        return found

    @property
    def digest(self) -> str:
        """What the parts depend on."""
        about = [self.lens.model_dump_json(), self.camera.sensor.model_dump_json()]
        text = "".join([*about, self.budget.model_dump_json(exclude={"raws"})])
        return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()

    def prepare(self, resume: bool) -> None:
        """Make the folder, or go on with what is there.

        Raises
        ------
        UserError
            A folder with files without ``resume``, or one of another study.
        """
        mark = self.out / STUDY
        if resume and mark.exists():
            instead = "what gpusim tolerance wrote; or an empty folder without --resume"
            known = read_record(mark, "the mark of a study", "digest", allowed=instead)
            if known["digest"] != self.digest:
                raise UserError(
                    "another study is there: camera or budget differ",
                    field="--resume",
                    value=self.out,
                    allowed="the folder of this study, or another folder without --resume",
                )
        elif self.out.exists() and any(self.out.iterdir()):
            raise UserError(
                "the folder is not empty",
                field="--out",
                value=self.out,
                allowed="an empty folder; --resume goes on with a study",
            )
        (self.out / PARTS).mkdir(parents=True, exist_ok=True)
        with whole(mark) as part:
            part.write_text(json.dumps({"digest": self.digest}))

    def change(self, name: str, moves: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Return coefficients (9, L, K) and residuals (9,), mm, of a lens with changes.

        They are read from the study's folder where they are there.
        """
        path = self.out / PARTS / f"{name}.npz"
        if not path.exists():
            lens = self.moved(moves)
            found = [wave.change(lens) for wave in self.waves]
            with whole(path) as part, part.open("wb") as file:
                np.savez(
                    file,
                    coefficients=np.array([one for one, _ in found]),
                    residual=np.array([one for _, one in found]),
                )
        with np.load(path) as kept:
            return kept["coefficients"], kept["residual"]

    def moved(self, moves: dict[str, float]) -> Prescription:
        """Return the lens with changes."""
        lens = self.lens
        for name, value in moves.items():
            lens = perturbed(lens, name, value, f"tolerances.{name}")
        return lens

    @cached_property
    def differentials(self) -> np.ndarray:
        """First and second differentials of the wavefront, (P, 2, 9, L, K), mm per change."""
        axes = self.budget.axes(self.lens)
        rows = []
        for k, (name, axis) in enumerate(axes.items()):
            self.progress("differentials", k, len(axes))
            step = step_of(axis)
            more, _ = self.change(f"{name}-more", {name: step})
            less, _ = self.change(f"{name}-less", {name: -step})
            rows.append([(more - less) / (2 * step), (more + less) / (2 * step**2)])
        self.progress("differentials", len(axes), len(axes))
        return np.array(rows)

    def modelled(self, draws: list[dict[str, float]]) -> np.ndarray:
        """Return the coefficients (S, 9, L, K) of lenses, by the differentials."""
        values = np.array([[row.get(name, 0.0) for name in self.names] for row in draws])
        first, second = self.differentials[:, 0], self.differentials[:, 1]
        return np.tensordot(values, first, 1) + np.tensordot(values**2, second, 1)

    def sfrs(self, coefficients: np.ndarray, focus_mm: np.ndarray) -> np.ndarray:
        """Return the camera's SFR, (S, 9, 2, F): across upright edges, then level ones."""
        frequency = FREQUENCY_CY_PX / self.channel.pitch_mm
        found = [
            otfs(wave, self.channel.weight, coefficients[:, k], focus_mm, frequency)
            for k, wave in enumerate(self.waves)
        ]
        return np.abs(np.stack(found, axis=1)) * self.channel.transfer

    def focus(self, coefficients: np.ndarray, phase: str = "focus") -> np.ndarray:
        """Return where the image plane is best, (S,) mm, away from the lens; 0 if it is fixed."""
        start = np.zeros(len(coefficients))
        if self.budget.compensator is None:
            return start
        above, below = start.copy(), 0.0
        for k, wave in enumerate(self.waves):
            for number, line in enumerate(wave.lines):
                weight = line.amplitude / line.amplitude.sum()
                gamma = line.gamma - (weight * line.gamma).sum()
                opd = line.opd_mm + np.tensordot(coefficients[:, k, number], line.basis, 1)
                # Tilt of gamma moves the image and blurs nothing: it is taken out.
                gamma = _without_tilt(gamma, weight)
                above -= (weight * gamma * opd).sum(axis=(1, 2))
                below += float((weight * gamma**2).sum())
        middle = above / below
        depth = _depth_mm(self.waves[len(self.waves) // 2]) / 4
        steps = np.arange(-FOCUS_STEPS, FOCUS_STEPS + 1)
        merit = 0.0
        for k, wave in enumerate(self.waves):
            self.progress(phase, k, len(self.waves))
            at = self._criterion_cy_mm
            own = coefficients[:, k]
            merit = merit + through_focus(
                wave,
                self.channel.weight,
                own,
                middle,
                steps=FOCUS_STEPS,
                step_mm=depth,
                frequency_cy_mm=at,
            )
        self.progress(phase, len(self.waves), len(self.waves))
        best = np.clip(merit.argmax(axis=0), 1, len(steps) - 2)
        column = np.arange(len(middle))
        left, here, right = (merit[best + d, column] for d in (-1, 0, 1))
        bend = left - 2 * here + right
        off = np.where(bend < 0, (left - right) / np.where(bend < 0, 2 * bend, 1.0), 0.0)
        return middle + depth * (steps[best] + np.clip(off, -1, 1))

    @cached_property
    def _criterion_cy_mm(self) -> float:
        """Where the design's SFR is one half, over all places; cycles/mm."""
        zero = np.zeros((1, len(self.waves), *self.shape))
        return float(mtf50(self.sfrs(zero, np.zeros(1))).mean()) / self.channel.pitch_mm

    @property
    def shape(self) -> tuple[int, int]:
        """Lines, and coefficients of each."""
        lines = self.waves[0].lines
        return len(lines), len(lines[0].basis)

    def evaluated(self, coefficients: np.ndarray, phase: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the focus (S,), mm, and MTF50 (S, 9, 2), cycles/px, of lenses."""
        focus = self.focus(coefficients, phase)
        return focus, mtf50(self.sfrs(coefficients, focus))


def _without_tilt(gamma: np.ndarray, weight: np.ndarray) -> np.ndarray:
    rows, cols = np.indices(gamma.shape)
    for one in (rows, cols):
        way = one - (weight * one).sum()
        gamma = gamma - way * (weight * gamma * way).sum() / (weight * way**2).sum()
    return gamma


def _depth_mm(wave: Wave) -> float:
    """Return the depth of focus 2 lambda N^2 of a field's pupil: N of its larger half width."""
    line = wave.lines[wave.reference]
    lit = np.argwhere(line.amplitude > 0.5)
    half = max(np.ptp(lit, axis=0) * np.array(line.step)) / 2
    return 2 * line.wavelength_mm * (0.5 / half) ** 2

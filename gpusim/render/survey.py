"""Line spreads of a lens as a sensor sees them: what tells how densely a bank must be sampled.

What is compared is what the certificate compares: a pixel beside an edge, and an even scene,
relative to the local signal.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.prescription import Prescription
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan.accuracy import BEST_EFFORT, SMALLEST, Accuracy, rounded_up
from gpusim.plan.density import MOST_SHARE, AnyDensity
from gpusim.plan.fringes import cycles, lone_points
from gpusim.plan.signal import brightest_e
from gpusim.psf.lines import CUBIC, line_shares
from gpusim.psf.plane_spreads import PlaneSpreads
from gpusim.psf.spreads import ELEVENTHS, Spreads, added_intervals
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.aperture import transfer_along
from gpusim.sensor.sensor import Sensor

Progress = Callable[[int, int], None]
# Banks are made for these tolerances and contrasts, so that few of them serve many renders.
TOLERANCES = (3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, SMALLEST)
# White over black of a chart's edges, 1 where it has none: ISO 12233 has 4, charts of wide contrast
# 16. Photographs count as the former.
CONTRASTS = (1.0, 5.0, 20.0)
PHOTOGRAPH = 5.0
# Lines at which fields are compared, of the twelve: 550 nm and both ends are among them. Below and
# beyond them every second one, and the last.
FEW = (0, 2, 4, 7, 9, 11)
# Cells of the pupil each way for what is compared with itself alone: half of what a bank takes, a
# quarter of the time. What PSFs fold into the window from beyond 512 samples changes as evenly over
# the field as they do, and adds 7e-4 of a line spread's peak at most (the lens of `kodak`).
COARSE = 512
# Pixels are judged within this distance from an edge, and within twice, four times it and so on:
# the worst RMS counts. The Tessar at f/2.8 between 19.6 and 20.4 deg errs by 1.2e-4 within a pixel,
# by 3e-3 within 32.
NEAR_PX = 1.0
TINY = 1e-6  # of a line spread's peak: less is rounding


class Axis(NamedTuple):
    """What the planner's bound of the signal asks of a bank."""

    wavelengths_nm: np.ndarray
    projected_solid_angle_sr: np.ndarray
    transmission: np.ndarray
    relative_illumination: np.ndarray
    spectral_degree: int = CUBIC


class Survey:
    """Line spreads of a lens, seen by a sensor.

    Attributes
    ----------
    axis : Axis
        What is known of the field on the axis.
    pitch_um, size : float, int
        Pitch and number of a line spread's samples.
    unit_sr : float
        Projected solid angle of the light on the axis, the mean of the lines.
    """

    axis: Axis
    pitch_um: float
    size: int
    unit_sr: float

    def __init__(
        self,
        lens: Prescription,
        sensor: Sensor,
        scene: Scene,
        contrast: float,
        progress: Progress | None,
    ) -> None:
        self.lens, self.sensor, self.contrast, self.progress = lens, sensor, contrast, progress
        self.spectrum = scene.spectra[scene.spectra.sum(axis=1).argmax()]
        self.points = lone_points(scene)
        self.corner_um = math.hypot(sensor.rows, sensor.cols) / 2 * sensor.pixel_pitch_um
        self.wavelengths_nm = scene.wavelengths_nm
        self.ends_nm = tuple(scene.wavelengths_nm[[0, -1]].tolist())

    def transfer(
        self,
        found: Spreads | PlaneSpreads,
        unit_sr: float,
        lateral_um: tuple[np.ndarray | None, np.ndarray | None],
    ) -> np.ndarray:
        """Return the transfer functions (F, C, 2, n / 2 + 1) of the channels, along both ways.

        Light included; lateral colour (F, L), None where there is none, is as the engine has it, a
        streak (`gpusim.optics.images`).
        """
        n, lines = found.spread.shape[-1], found.wavelengths_nm
        frequency = np.fft.rfftfreq(n, found.pitch_um)
        ones = np.ones(len(lines))
        axis = Axis(lines, ones, found.transmission, found.light_sr / unit_sr)
        weights = spectral_weights(axis, self.sensor, self._efficiency, self.wavelengths_nm)
        weights = weights * self.spectrum
        weights /= weights.sum(axis=(-2, -1), keepdims=True)
        shares = line_shares(lines, CUBIC, self.wavelengths_nm)
        lateral = [None if one is None else one @ shares for one in lateral_um]
        out = np.empty((len(found.spread), len(weights), 2, len(frequency)), complex)
        # Sample n / 2 is the origin.
        middle = (-1.0) ** np.arange(len(frequency))
        pixel = [transfer_along(self.sensor.response_um, frequency, axis) for axis in (0, 1)]
        for place in range(len(out)):
            spectra = np.fft.rfft(found.spread[place], axis=-1) * middle
            # What lands beyond the core lies wide and even: the sum is that of all light.
            spectra[..., 0] = 1.0
            spectra *= axis.relative_illumination[place, :, None, None]
            for way, at in enumerate(lateral):
                if at is None:
                    own = weights.sum(axis=-1)
                    out[place, :, way] = np.einsum("cl,lf->cf", own, spectra[:, way])
                else:
                    turn = np.exp(-2j * np.pi * np.outer(at[place], frequency))
                    out[place, :, way] = np.einsum("clf,lf->cf", weights @ turn, spectra[:, way])
            out[place] *= pixel
        return out

    @property
    def _efficiency(self) -> np.ndarray:
        """Quantum efficiency (C, 1, K) on the axis."""
        return np.stack(list(self.sensor.qe_at(self.wavelengths_nm).values()))[:, None]

    @cached_property
    def told(self) -> int:
        """Samples from a point of light as far as the few lines tell its fringes apart."""
        lines = self.axis.wavelengths_nm
        first = int(np.argmin(np.diff(1 / lines)))  # of those that are farthest apart
        a_um = cycles(1.0, self.unit_sr, *lines[first : first + 2].tolist())
        return min(max(int(1 / a_um / self.pitch_um), 1), self.size // 2)

    def error(self, off: np.ndarray, own: np.ndarray) -> float:
        """Return what an error of transfer functions (C, 2, n / 2 + 1) does to pixels: the RMS."""
        even = off[..., :1].real / own[..., :1].real
        if self.contrast == 1:
            return float(np.sqrt(np.mean(even**2)))
        pitch_um, dark = self.pitch_um, 1 / self.contrast
        near = int(np.ceil(NEAR_PX * self.sensor.pixel_pitch_um / pitch_um))
        middle = (-1.0) ** np.arange(off.shape[-1])
        squares = []
        steps = [np.cumsum(np.fft.irfft(one * middle), axis=-1) for one in (off, own)]
        whole = [one[..., :1].real for one in (off, own)]
        for step in (steps, [a - b for a, b in zip(whole, steps, strict=True)]):
            change, signal = (dark * a + (1 - dark) * b for a, b in zip(whole, step, strict=True))
            squares.append(np.square(change / signal))
        found = [np.mean(even**2)]
        if self.points:
            beside = slice(self.size // 2 - self.told, self.size // 2 + self.told)
            change, signal = (
                np.fft.irfft(one * middle, axis=-1)[..., beside] for one in (off, own)
            )
            found.append(np.mean(np.square(change / np.maximum(signal, TINY * signal.max()))))
        # The more of the neighbourhood counts the less is one edge in it; but wide PSFs may err
        # most far out, where black is lit by them alone.
        while True:
            beside = slice(max(self.size // 2 - near, 0), self.size // 2 + near)
            found.append(np.mean([one[..., beside] for one in squares]))
            if near >= self.size // 2:
                return math.sqrt(max(found))
            near *= 2


def refuse_above(found: AnyDensity, asked: float, accuracy: Accuracy) -> None:
    """Refuse a bank that errs by more than a tolerance leaves to it, with the nearest one."""
    if found.worst > MOST_SHARE * asked and not accuracy.best_effort:
        nearest = rounded_up(found.worst / MOST_SHARE * accuracy.tolerance / asked)
        raise UserError(
            f"The tolerance cannot be met: {found.why}.",
            field="tolerance",
            value=accuracy.text,
            allowed=f"{accuracy.in_words(nearest)} or more{BEST_EFFORT}",
        )


def class_of(tolerance: float) -> float:
    """Return the tolerance that a bank is made for."""
    return next((one for one in TOLERANCES if one <= tolerance), TOLERANCES[-1])


def relative(
    survey: Survey, sensor: Sensor, scene: Scene, accuracy: Accuracy, exposure_s: float
) -> float:
    """Return the tolerance relative to the brightest signal."""
    if accuracy.unit == "relative":
        return accuracy.tolerance
    brightest = sensor.full_well_e
    if sensor.eqe_map is None:
        brightest = min(brightest, brightest_e(survey.axis, sensor, scene, exposure_s))
    signal = brightest, sensor.temporal_dark_noise_e, sensor.full_well_e
    return replace(accuracy, best_effort=True).relative(*signal).tolerance


def contrasts(scene: Scene) -> tuple[float, float]:
    """Return the contrast of a scene's edges, and that for which a bank is made."""
    ratio = _contrast(scene)
    return ratio, next((one for one in CONTRASTS if ratio <= one), CONTRASTS[-1])


def _contrast(scene: Scene) -> float:
    """Return the contrast of a scene's edges, at most the last of CONTRASTS."""
    if not isinstance(scene.source, Chart):
        return PHOTOGRAPH
    if not scene.source.primitives:
        return CONTRASTS[0]
    used = {scene.source.background, *(one.material for one in scene.source.primitives)}
    light = scene.spectra[sorted(used)].sum(axis=1)
    return float(light.max() / max(light.min(), light.max() / CONTRASTS[-1]))


def few_lines(first_nm: float, last_nm: float) -> list[int]:
    """Return which of the fewest lines fields are compared at: see `FEW`."""
    below, beyond = added_intervals(first_nm, last_nm)
    last = below + ELEVENTHS + beyond
    inner = {below + place for place in FEW}
    return sorted({*range(0, below, 2), *inner, *range(last, below + ELEVENTHS, -2)})

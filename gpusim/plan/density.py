"""How densely a lens's bank must be sampled for a tolerance, and what that leaves of error.

Between a bank's fields and lines everything is interpolated, and how well depends on the lens: PSFs
of fast lenses change quickly towards the rim, vignetting sets in all at once (the light behind the
first sliver of a stop that is cut off goes as a power of 3/2: no cubic follows it), colours differ
in focus. So the lens is asked: line spreads half-way between fields, and at lines between lines,
are compared with what a bank makes of those around. Fields are halved where they miss, one interval
for itself; lines are evenly spaced in 1 / lambda and made two or three times as many.

What is compared is what the certificate compares: a pixel beside an edge, and an even scene,
relative to the local signal.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.prescription import Prescription
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan.accuracy import BEST_EFFORT, SMALLEST, Accuracy, rounded_up
from gpusim.plan.fringes import cycles, lone_points, steps_for_fringes
from gpusim.plan.signal import brightest_e
from gpusim.plan.stage import PlanStage
from gpusim.psf.beyond import landing_share
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.lines import CUBIC, line_shares
from gpusim.psf.places import lagrange
from gpusim.psf.sampling import default_fields_deg
from gpusim.psf.spreads import (
    ELEVENTHS,
    Spreads,
    added_intervals,
    cached_spreads,
    cached_traced_spreads,
    even_lines_nm,
    middles_deg,
)
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
# What the fields and what the lines may each leave: shares of the tolerance. Fields are added where
# they are missed; lines are doubled for all fields at once, so that most have more than they need.
FIELDS_SHARE, LINES_SHARE = 0.25, 0.4
# The engine errs by at most this share of what it is planned for: measured over five scenes and
# three lenses at three tolerances.
ENGINE = 0.78
MOST_SHARE = 0.85  # of the tolerance: a bank that leaves more is refused
# Lines at which fields are compared, of the twelve: 550 nm and both ends are among them. Below and
# beyond them every second one, and the last.
FEW = (0, 2, 4, 7, 9, 11)
TRACED = 16  # field, of the twenty-nine, at which the pupil's sampling is judged in float64
LINES_AT = (0, 4, 8, 12, 14)  # fields, of fifteen, at which lines are compared
STEPS = (1, 2, 3)  # lines in each eleventh of the range; cubic splines err by their fourth power
ROUNDS = 8  # of halving
# Cells of the pupil each way for what is compared with itself alone: half of what a bank takes, a
# quarter of the time. What PSFs fold into the window from beyond 512 samples changes as evenly over
# the field as they do, and adds 7e-4 of a line spread's peak at most (the lens of `kodak`).
COARSE = 512
ALONE = {"transform": COARSE, "rim": False}
MOST_SAMPLES = 2**29  # of all PSFs: 2 GiB
# Mean square of (1 - 4 t^2) (9 - 4 t^2) / 9, the error of a cubic between its middle nodes at
# t = -1/2 and 1/2 over that half-way.
MEAN = 0.5167
# Pixels are judged within this distance from an edge, and within twice, four times it and so on:
# the worst RMS counts. The Tessar at f/2.8 between 19.6 and 20.4 deg errs by 1.2e-4 within a pixel,
# by 3e-3 within 32.
NEAR_PX = 1.0
TINY = 1e-6  # of a line spread's peak: less is rounding
LOOKED_AT = 17  # distances from the middle to the corner at which light from far off may land


@dataclass(frozen=True, eq=False)
class Density:
    """Where a bank is sampled, and what it is expected to err by, relative to the local signal.

    Attributes
    ----------
    field_deg, wavelengths_nm : ndarray (F,), (L,)
    height_um : ndarray (F,)
        Heights of the fields.
    fields_error : ndarray (F - 1,)
        Half-way between the fields; 0 beyond the sensor's corners.
    lines_um, lines_error : ndarray (A,)
        Heights, and what the lines leave there.
    pupil_error : float
        What the generator errs by at the nodes themselves: it samples the pupil's rim in cells.
    contrast : float
        Contrast of the edges that the bank was made for, 1 where the scene has none.
    ratio : float
        Contrast of the scene's own edges.
    """

    field_deg: np.ndarray
    wavelengths_nm: np.ndarray
    height_um: np.ndarray
    fields_error: np.ndarray
    lines_um: np.ndarray
    lines_error: np.ndarray
    pupil_error: float
    contrast: float
    ratio: float

    def at(self, radius_um: float) -> float:
        """Return the error at an image height."""
        place = int(np.searchsorted(self.height_um, radius_um, "right")) - 1
        of_fields = self.fields_error[min(max(place, 0), len(self.fields_error) - 1)]
        of_lines = np.interp(radius_um, self.lines_um, self.lines_error)
        return math.hypot(of_fields, of_lines, self.pupil_error)

    @property
    def worst(self) -> float:
        """The largest error on the sensor."""
        middles = (self.height_um[1:] + self.height_um[:-1]) / 2
        used = [r for r, error in zip(middles, self.fields_error, strict=True) if error > 0]
        return max(map(self.at, used), default=0.0)

    @property
    def rms(self) -> float:
        """What is expected of the whole sensor: the root of the mean square over its area.

        Each interval between fields counts by its ring. Towards the fields the error falls.
        """
        ends = self.height_um
        middles = (ends[1:] + ends[:-1]) / 2
        used = self.fields_error > 0
        if not used.any():
            return 0.0
        area = (ends[1:] ** 2 - ends[:-1] ** 2)[used]
        of_lines = np.interp(middles[used], self.lines_um, self.lines_error)
        squares = MEAN * self.fields_error[used] ** 2 + of_lines**2 + self.pupil_error**2
        return float(np.sqrt(np.average(squares, weights=area)))

    @property
    def sampling(self) -> dict[str, np.ndarray]:
        """What `gpusim.camera.Camera.bank` takes."""
        return {"wavelengths_nm": self.wavelengths_nm, "field_deg": self.field_deg}

    @property
    def why(self) -> str:
        """Why it cannot be less."""
        if self.pupil_error > self.worst / math.sqrt(2):
            return f"PSFs err by {self.pupil_error:.1e}, for the pupil's rim is sampled in cells"
        fields, lines = len(self.field_deg), len(self.wavelengths_nm)
        return (
            f"between {fields} fields and {lines} wavelengths the lens's PSFs are interpolated, "
            f"which errs by {self.worst:.1e}, and a bank takes no more than 2 GiB"
        )

    @property
    def text(self) -> str:
        """What was chosen, in words."""
        fields, lines = len(self.field_deg), len(self.wavelengths_nm)
        return f"PSFs of {fields} fields x {lines} wavelengths, what lies between interpolated"


@dataclass(frozen=True, eq=False)
class LensShare:
    """What a tolerance leaves to the engine: the rest is the bank's, and of light beyond it.

    Attributes
    ----------
    density : Density
    bank : FieldBank
        Bank that was made so.
    corner_um : float
        From the middle of the sensor to its corner.
    """

    density: Density
    bank: FieldBank
    corner_um: float

    @cached_property
    def window(self) -> float:
        """What the light beyond the last level costs: it is spread evenly, and dark pixels lack it.

        In a scene half black and half white, a black pixel lacks half of it times the contrast, as
        far as it lands on the sensor.
        """
        beyond = getattr(self.bank, "beyond_energy", None)
        if beyond is None:
            return 0.0
        farthest = min(self.corner_um, self.bank.rectilinear_circle_um)
        landing = landing_share(self.bank, np.linspace(0.0, farthest, LOOKED_AT))
        share = float(beyond.max() * landing.max())
        contrast = self.density.ratio
        return share * (1 + 1 / contrast) / 2 * math.sqrt((contrast**2 + 1) / 2)

    def excess(self, tolerance: float) -> float:
        """Return what is not the engine's over what it may be of a tolerance, at most."""
        return (self.density.worst + self.window) / (MOST_SHARE * tolerance)

    def left_of(self, tolerance: float) -> float:
        """Return the engine's part of a tolerance: squares add, but for light that is lost."""
        most = MOST_SHARE * tolerance
        window = min(self.window, most)
        of_bank = min(self.density.worst, most - window)
        left = math.sqrt((tolerance - window) ** 2 - of_bank**2) / ENGINE
        return min(max(left, SMALLEST), tolerance)

    @property
    def stages(self) -> tuple[PlanStage, ...]:
        """Describe them."""
        return (
            PlanStage("bank", True, self.density.text, self.density.rms),
            PlanStage("window", True, "light beyond the bank's widest level", self.window),
        )


class _Axis(NamedTuple):
    """What the planner's bound of the signal asks of a bank."""

    wavelengths_nm: np.ndarray
    projected_solid_angle_sr: np.ndarray
    transmission: np.ndarray
    relative_illumination: np.ndarray
    spectral_degree: int = CUBIC


def bank_density(
    lens: object,
    sensor: Sensor,
    scene: Scene,
    accuracy: Accuracy,
    exposure_s: float = math.inf,
    progress: Progress | None = None,
) -> Density | None:
    """Return how densely to sample the bank of a lens; None where it cannot be traced.

    Parameters
    ----------
    lens : Prescription, or anything else
        Traced where it is a prescription of a lens with an axis.
    sensor, scene, accuracy
    exposure_s : float
        Longest that will be captured: see `gpusim.plan.plan_optics`.
    progress : callable, optional
        Called with (fields done, fields in all).

    Raises
    ------
    UserError
        Where a field does not pass the lens; where the densest bank errs by more than the tolerance
        leaves to it and no best effort is asked for: with the nearest that can be met.
    """
    if not isinstance(lens, Prescription) or not lens.is_centred:
        return None
    ratio = _contrast(scene)
    contrast = next((one for one in CONTRASTS if ratio <= one), CONTRASTS[-1])
    survey = _Survey(lens, sensor, scene, contrast, progress)
    asked = _relative(survey, sensor, scene, accuracy, exposure_s)
    tolerance = _class_of(asked)
    at_um, between = survey.lines_error()
    steps = next((n for n in STEPS if between.max() / n**4 <= LINES_SHARE * tolerance), STEPS[-1])
    steps = max(steps, survey.fringe_steps)
    lines = even_lines_nm(steps, *survey.ends_nm)
    most_fields = MOST_SAMPLES // (len(lines) * survey.size**2)
    fields, errors = survey.refined(FIELDS_SHARE * tolerance, most_fields)
    between = between / steps**4
    found = Density(
        field_deg=fields,
        wavelengths_nm=lines,
        height_um=np.array([survey.height_um(one) for one in fields]),
        fields_error=errors,
        lines_um=at_um,
        lines_error=between,
        pupil_error=survey.pupil_error(),
        contrast=survey.contrast,
        ratio=ratio,
    )
    if found.worst > MOST_SHARE * asked and not accuracy.best_effort:
        nearest = rounded_up(found.worst / MOST_SHARE * accuracy.tolerance / asked)
        raise UserError(
            f"The tolerance cannot be met: {found.why}.",
            field="tolerance",
            value=accuracy.text,
            allowed=f"{accuracy.in_words(nearest)} or more{BEST_EFFORT}",
        )
    return found


def _class_of(tolerance: float) -> float:
    """Return the tolerance that a bank is made for."""
    return next((one for one in TOLERANCES if one <= tolerance), TOLERANCES[-1])


def _relative(
    survey: _Survey, sensor: Sensor, scene: Scene, accuracy: Accuracy, exposure_s: float
) -> float:
    """Return the tolerance relative to the brightest signal."""
    if accuracy.unit == "relative":
        return accuracy.tolerance
    brightest = sensor.full_well_e
    if sensor.eqe_map is None:
        brightest = min(brightest, brightest_e(survey.axis, sensor, scene, exposure_s))
    signal = brightest, sensor.temporal_dark_noise_e, sensor.full_well_e
    return replace(accuracy, best_effort=True).relative(*signal).tolerance


def _contrast(scene: Scene) -> float:
    """Return the contrast of a scene's edges, at most the last of CONTRASTS."""
    if not isinstance(scene.source, Chart):
        return PHOTOGRAPH
    if not scene.source.primitives:
        return CONTRASTS[0]
    used = {scene.source.background, *(one.material for one in scene.source.primitives)}
    light = scene.spectra[sorted(used)].sum(axis=1)
    return float(light.max() / max(light.min(), light.max() / CONTRASTS[-1]))


def _few(first_nm: float, last_nm: float) -> list[int]:
    """Return which of the fewest lines fields are compared at: see `FEW`."""
    below, beyond = added_intervals(first_nm, last_nm)
    last = below + ELEVENTHS + beyond
    inner = {below + place for place in FEW}
    return sorted({*range(0, below, 2), *inner, *range(last, below + ELEVENTHS, -2)})


class _Survey:
    """Line spreads of a lens, seen by a sensor."""

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
        self.corner_um = math.hypot(sensor.rows, sensor.cols) / 2 * sensor.pixel_pitch_um
        self.first_deg = default_fields_deg(lens)
        self.wavelengths_nm = scene.wavelengths_nm
        self.ends_nm = tuple(scene.wavelengths_nm[[0, -1]].tolist())
        lines = even_lines_nm(STEPS[0], *self.ends_nm)[_few(*self.ends_nm)]
        both = np.sort(np.concatenate([self.first_deg, middles_deg(lens, self.first_deg)]))
        self.few = cached_spreads(lens, lines, both, progress, **ALONE)
        self.axis = _Axis(
            lines,
            self.few.light_sr[0],
            self.few.transmission,
            self.few.light_sr / self.few.light_sr[0],
        )
        self.size = self.few.spread.shape[-1]
        self.unit_sr = float(self.few.light_sr[0].mean())
        self.points = lone_points(scene)
        self.seen: dict[float, np.ndarray] = {}
        self.heights: dict[float, float] = {}
        self._take(self.few)

    def height_um(self, field_deg: float) -> float:
        """Return the image height of a field that was traced."""
        return self.heights[float(field_deg)]

    @property
    def fringe_steps(self) -> int:
        """Lines in each eleventh that points of light ask for."""
        if not self.points:
            return STEPS[0]
        reach_um = self.size / 2 * self.few.pitch_um
        return steps_for_fringes(even_lines_nm(1, *self.ends_nm), reach_um, self.unit_sr)

    @cached_property
    def told(self) -> int:
        """Samples from a point of light as far as the few lines tell its fringes apart."""
        lines = self.few.wavelengths_nm
        first = int(np.argmin(np.diff(1 / lines)))  # of those that are farthest apart
        a_um = cycles(1.0, self.unit_sr, *lines[first : first + 2].tolist())
        return min(max(int(1 / a_um / self.few.pitch_um), 1), self.size // 2)

    def lines_error(self) -> tuple[np.ndarray, np.ndarray]:
        """Return heights (A,) and what the fewest lines err by there, of what twice as many see."""
        fields = self.first_deg[list(LINES_AT)]
        lines = even_lines_nm(2, *self.ends_nm)
        many = cached_spreads(self.lens, lines, fields, self.progress, **ALONE)
        few = replace(
            many,
            wavelengths_nm=many.wavelengths_nm[::2],
            **{name: getattr(many, name)[:, ::2] for name in ("height_um", "light_sr")},
            transmission=many.transmission[::2],
            spread=many.spread[:, ::2],
        )
        true, made = (self._transfer(one, self.unit_sr) for one in (many, few))
        errors = [self._error(a - b, b) for a, b in zip(made, true, strict=True)]
        return many.height_um[:, many.reference], np.array(errors)

    def pupil_error(self) -> float:
        """Return by how much the generator is off where nothing is interpolated."""
        found = self.few
        theta = found.field_deg[TRACED : TRACED + 1]
        surveys = cached_spreads, cached_traced_spreads
        made, true = (
            self._transfer(of(self.lens, found.wavelengths_nm, theta), self.unit_sr)[0]
            for of in surveys
        )
        return self._error(made - true, true)

    def refined(self, allowed: float, most: int) -> tuple[np.ndarray, np.ndarray]:
        """Halve intervals until none errs by more than is allowed, or there are too many fields.

        Returns
        -------
        field_deg : ndarray (F,)
        errors : ndarray (F - 1,)
        """
        fields = self.first_deg
        for left in reversed(range(ROUNDS + 1)):
            middles = middles_deg(self.lens, fields)
            errors = self._between(fields, middles)
            worst = np.argsort(-errors)
            bad = [n for n in worst if errors[n] > allowed]
            taken = bad[: max(most - len(fields), 0)]
            if not taken or not left:
                break
            fields = np.sort(np.concatenate([fields, middles[taken]]))
        return fields, errors

    def _between(self, fields: np.ndarray, middles: np.ndarray) -> np.ndarray:
        """Return what fields make of those half-way between them, as far as the sensor reaches."""
        height = np.array([self.height_um(one) for one in fields])
        used = np.flatnonzero(height[:-1] < self.corner_um)
        missing = [one for one in middles[used] if float(one) not in self.seen]
        if missing:
            lines = self.few.wavelengths_nm
            given = np.array(missing), self.progress
            self._take(cached_spreads(self.lens, lines, *given, **ALONE))
        seen = np.stack([self.seen[float(one)] for one in fields])
        # Beyond the axis lies the second field, turned by half a turn.
        both = np.concatenate([seen[1:2].conj(), seen])
        nodes = np.concatenate([-height[1:2], height])
        errors = np.zeros(len(middles))
        for number in used:
            own = self.seen[float(middles[number])]
            numbers, weights = lagrange(nodes, self.height_um(middles[number]))
            errors[number] = self._error(np.tensordot(weights, both[numbers], axes=1) - own, own)
        return errors

    def _take(self, found: Spreads) -> None:
        """Keep what a camera sees of fields that were traced."""
        for one, height, seen in zip(
            found.field_deg,
            found.height_um[:, found.reference],
            self._transfer(found, self.unit_sr),
            strict=True,
        ):
            self.heights[float(one)], self.seen[float(one)] = float(height), seen

    def _transfer(self, found: Spreads, unit_sr: float) -> np.ndarray:
        """Return the transfer functions (F, C, 2, n / 2 + 1) of the channels, along xi and eta.

        Light included; lateral colour is as the engine has it, a streak (`gpusim.optics.images`).
        """
        n, lines = found.spread.shape[-1], found.wavelengths_nm
        frequency = np.fft.rfftfreq(n, found.pitch_um)
        ones = np.ones(len(lines))
        axis = _Axis(lines, ones, found.transmission, found.light_sr / unit_sr)
        weights = spectral_weights(axis, self.sensor, self._efficiency, self.wavelengths_nm)
        weights = weights * self.spectrum
        weights /= weights.sum(axis=(-2, -1), keepdims=True)
        shares = line_shares(lines, CUBIC, self.wavelengths_nm)
        lateral = (found.height_um - found.height_um[:, found.reference, None]) @ shares
        out = np.empty((len(found.field_deg), len(weights), 2, len(frequency)), complex)
        # Sample n / 2 is the origin.
        middle = (-1.0) ** np.arange(len(frequency))
        pixel = [transfer_along(self.sensor.response_um, frequency, axis) for axis in (0, 1)]
        for place in range(len(out)):
            spectra = np.fft.rfft(found.spread[place], axis=-1) * middle
            # What lands beyond the core lies wide and even: the sum is that of all light.
            spectra[..., 0] = 1.0
            spectra *= axis.relative_illumination[place, :, None, None]
            turn = np.exp(-2j * np.pi * np.outer(lateral[place], frequency))
            out[place, :, 0] = np.einsum("clf,lf->cf", weights @ turn, spectra[:, 0])
            out[place, :, 1] = np.einsum("cl,lf->cf", weights.sum(axis=-1), spectra[:, 1])
            out[place] *= pixel
        return out

    @property
    def _efficiency(self) -> np.ndarray:
        """Quantum efficiency (C, 1, K) on the axis."""
        return np.stack(list(self.sensor.qe_at(self.wavelengths_nm).values()))[:, None]

    def _error(self, off: np.ndarray, own: np.ndarray) -> float:
        """Return what an error of transfer functions (C, 2, n / 2 + 1) does to pixels: the RMS."""
        even = off[..., :1].real / own[..., :1].real
        if self.contrast == 1:
            return float(np.sqrt(np.mean(even**2)))
        pitch_um, dark = self.few.pitch_um, 1 / self.contrast
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

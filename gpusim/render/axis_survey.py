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
from dataclasses import replace

import numpy as np

from gpusim.lens.prescription import Prescription
from gpusim.plan.accuracy import Accuracy
from gpusim.plan.density import Density
from gpusim.plan.fringes import steps_for_fringes
from gpusim.psf.places import lagrange
from gpusim.psf.sampling import default_fields_deg
from gpusim.psf.spreads import (
    Spreads,
    cached_spreads,
    cached_traced_spreads,
    even_lines_nm,
    middles_deg,
)
from gpusim.render.survey import (
    COARSE,
    Axis,
    Progress,
    Survey,
    class_of,
    contrasts,
    few_lines,
    refuse_above,
    relative,
)
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor

# What the fields and what the lines may each leave: shares of the tolerance. Fields are added where
# they are missed; lines are doubled for all fields at once, so that most have more than they need.
FIELDS_SHARE, LINES_SHARE = 0.25, 0.4
TRACED = 16  # field, of the twenty-nine, at which the pupil's sampling is judged in float64
LINES_AT = (0, 4, 8, 12, 14)  # fields, of fifteen, at which lines are compared
STEPS = (1, 2, 3)  # lines in each eleventh of the range; cubic splines err by their fourth power
ROUNDS = 8  # of halving
ALONE = {"transform": COARSE, "rim": False}  # of spreads that are compared with one another
MOST_SAMPLES = 2**29  # of all PSFs: 2 GiB


def bank_density(
    lens: object,
    sensor: Sensor,
    scene: Scene,
    accuracy: Accuracy,
    *,
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
    if not isinstance(lens, Prescription):
        return None
    ratio, contrast = contrasts(scene)
    survey = _Survey(lens, sensor, scene, contrast, progress)
    asked = relative(survey, sensor, scene, accuracy, exposure_s)
    tolerance = class_of(asked)
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
    refuse_above(found, asked, accuracy)
    return found


class _Survey(Survey):
    """That of a lens with an axis."""

    def __init__(self, lens: Prescription, *given: object) -> None:
        super().__init__(lens, *given)
        self.first_deg = default_fields_deg(lens)
        lines = even_lines_nm(STEPS[0], *self.ends_nm)[few_lines(*self.ends_nm)]
        both = np.sort(np.concatenate([self.first_deg, middles_deg(lens, self.first_deg)]))
        self.few = cached_spreads(lens, lines, both, self.progress, **ALONE)
        self.axis = Axis(
            lines,
            self.few.light_sr[0],
            self.few.transmission,
            self.few.light_sr / self.few.light_sr[0],
        )
        self.size, self.pitch_um = self.few.spread.shape[-1], self.few.pitch_um
        self.unit_sr = float(self.few.light_sr[0].mean())
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
        errors = [self.error(a - b, b) for a, b in zip(made, true, strict=True)]
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
        return self.error(made - true, true)

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
            errors[number] = self.error(np.tensordot(weights, both[numbers], axes=1) - own, own)
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
        """Return the transfer functions (F, C, 2, n / 2 + 1) of the channels, along xi and eta."""
        lateral_um = found.height_um - found.height_um[:, found.reference, None]
        return self.transfer(found, unit_sr, (lateral_um, None))

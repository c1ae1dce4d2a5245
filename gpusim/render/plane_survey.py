"""How densely the bank of a lens without an axis must be sampled for a tolerance.

Fields lie on an even grid, and between them PSFs are bicubic. So the lens is asked, as one with an
axis is (`gpusim.render.axis_survey`): line spreads in the middles of some cells are compared with
what the sixteen fields around make of them. The middles lie where the field changes most, towards
the corners of the sensor, and one half-way. Errors of cubics go with the fourth power of the
spacing: that says which grid to try next.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np

from gpusim.lens.prescription import Prescription
from gpusim.plan.accuracy import Accuracy
from gpusim.plan.density import PlaneDensity
from gpusim.psf.places import lagrange
from gpusim.psf.plane_spreads import PlaneSpreads, cached_plane_spreads
from gpusim.psf.sampling import SIDE, default_sides_deg
from gpusim.psf.spreads import even_lines_nm
from gpusim.psf.transform import TRANSFORM
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

# Fields each way, at least and at most: the most, with twelve lines, take 2.1 GiB with their halo.
# The decentred triplet of tools/matrix.py, at 0.9 of its field beside edges of 16:1 on pixels of
# 4 um, errs by 7.8e-2 with 9, 2.8e-2 with 17, 8e-3 with 27 and 3e-4 with 41.
FEWEST, MOST = SIDE, 27
STEPS = (1, 2)  # lines in each eleventh of the range: see `gpusim.render.axis_survey`
# What the fields and what the lines may each leave: shares of the tolerance.
FIELDS_SHARE, LINES_SHARE = 0.4, 0.4
# The cells that are asked: how far out, of the sensor's corner or the largest field, towards each
# corner; and half-way, aside of the axes.
FAR, HALF_WAY = 0.9, (0.5, 0.2)


def plane_bank_density(
    lens: Prescription,
    sensor: Sensor,
    scene: Scene,
    accuracy: Accuracy,
    *,
    exposure_s: float = math.inf,
    progress: Progress | None = None,
) -> PlaneDensity:
    """Return how densely to sample the bank of a lens without an axis.

    Parameters
    ----------
    lens : Prescription
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
    ratio, contrast = contrasts(scene)
    survey = _PlaneSurvey(lens, sensor, scene, contrast, progress)
    asked = relative(survey, sensor, scene, accuracy, exposure_s)
    tolerance = class_of(asked)
    between = survey.lines_error()
    steps = next((n for n in STEPS if between / n**4 <= LINES_SHARE * tolerance), STEPS[-1])
    sides, errors = survey.refined(FIELDS_SHARE * tolerance)
    found = PlaneDensity(
        side_deg=sides,
        wavelengths_nm=even_lines_nm(steps, *survey.ends_nm),
        fields_error=errors,
        lines_error=between / steps**4,
        pupil_error=survey.pupil_error(),
        ratio=ratio,
    )
    refuse_above(found, asked, accuracy)
    return found


class _PlaneSurvey(Survey):
    """Line spreads of a lens without an axis, seen by a sensor."""

    def __init__(self, lens: Prescription, *given: object) -> None:
        super().__init__(lens, *given)
        self.lines_nm = even_lines_nm(STEPS[0], *self.ends_nm)[few_lines(*self.ends_nm)]
        self.probes_deg = self._probes()
        first = self._spreads(self.lines_nm, self.probes_deg)
        self.size, self.pitch_um = first.spread.shape[-1], first.pitch_um
        relative_light = first.light_sr / first.light_sr[0]
        self.axis = Axis(self.lines_nm, first.light_sr[0], first.transmission, relative_light)
        self.unit_sr = float(first.light_sr[0].mean())

    def _spreads(
        self, lines_nm: np.ndarray, fields_deg: np.ndarray, **more: bool | int
    ) -> PlaneSpreads:
        """Return line spreads at fields (F, 2): to be compared with one another alone."""
        x, y = np.transpose(fields_deg)
        given = {"field_x_deg": x, "field_y_deg": y, "transform": COARSE} | more
        given |= {"wavelengths_nm": lines_nm, "progress": self.progress}
        return cached_plane_spreads(self.lens, **given)

    def _probes(self) -> np.ndarray:
        """Return the axis, and the fields whose cells are asked, (1 + C, 2)."""
        sensor, largest_deg = self.sensor, self.lens.max_field_deg
        corner = np.array([sensor.cols, sensor.rows]) / math.hypot(sensor.cols, sensor.rows)
        edges = [np.zeros(2), np.array([0.0, largest_deg])]
        landed = self._spreads(np.array([550.0]), np.array(edges)).chief_um[:, 0]
        # Nearly even in image height, which is enough to choose places by.
        share = min(1.0, self.corner_um / float(np.hypot(*(landed[1] - landed[0]))))
        reach_deg = share * largest_deg
        ways = [corner * signs for signs in product((1, -1), repeat=2)]
        probes = [FAR * reach_deg * way for way in ways]
        return np.array([np.zeros(2), *probes, reach_deg * np.array(HALF_WAY)])

    def _seen(self, found: PlaneSpreads) -> np.ndarray:
        """Return the transfer functions (F, C, 2, n / 2 + 1) of the channels, along x and y."""
        lateral_um = found.chief_um - found.chief_um[:, [found.reference]]
        return self.transfer(found, self.unit_sr, (lateral_um[..., 0], lateral_um[..., 1]))

    def lines_error(self) -> float:
        """Return what the fewest lines err by at most, of what twice as many see."""
        many = self._spreads(even_lines_nm(2, *self.ends_nm), self.probes_deg)
        few = replace(
            many,
            wavelengths_nm=many.wavelengths_nm[::2],
            chief_um=many.chief_um[:, ::2],
            light_sr=many.light_sr[:, ::2],
            transmission=many.transmission[::2],
            spread=many.spread[:, ::2],
        )
        true, made = self._seen(many), self._seen(few)
        return max(self.error(a - b, b) for a, b in zip(made, true, strict=True))

    def pupil_error(self) -> float:
        """Return by how much the generator is off where nothing is interpolated."""
        probe = self.probes_deg[1:2]
        given = {"transform": TRANSFORM}
        made = self._seen(self._spreads(self.lines_nm, probe, **given))[0]
        true = self._seen(self._spreads(self.lines_nm, probe, **given, traced=True))[0]
        return self.error(made - true, true)

    def refined(self, allowed: float) -> tuple[np.ndarray, np.ndarray]:
        """Take more fields until no cell errs by more than is allowed, or there are the most.

        Returns
        -------
        side_deg : ndarray (N,)
        errors : ndarray (C,)
        """
        count = FEWEST
        while True:
            sides = default_sides_deg(self.lens, count)
            errors = self._in_cells(sides)
            if errors.max() <= allowed or count >= MOST:
                return sides, errors
            cells = math.ceil((count - 1) * (errors.max() / allowed) ** 0.25)
            count = min(cells + cells % 2 + 1, MOST)

    def _in_cells(self, sides: np.ndarray) -> np.ndarray:
        """Return what sixteen fields make of the middles of the cells around the probes, (C,)."""
        low = np.clip(np.searchsorted(sides, self.probes_deg[1:], "right") - 1, 0, len(sides) - 2)
        # Cells whose middles lie within the largest field.
        inwards = np.where(self.probes_deg[1:] > 0, -1, 1)
        middles = (sides[low] + sides[low + 1]) / 2
        over = np.hypot(*middles.T) > self.lens.max_field_deg
        low[over] += inwards[over]
        middles = (sides[low] + sides[low + 1]) / 2
        errors = []
        for middle in middles:
            (cols, across), (rows, down) = (lagrange(sides, at) for at in middle)
            around = [(sides[col], sides[row]) for row in rows for col in cols]
            seen = self._seen(self._spreads(self.lines_nm, np.array([middle, *around])))
            weights = (down[:, None] * across).ravel()
            made = np.tensordot(weights, seen[1:], axes=1)
            errors.append(self.error(made - seen[0], seen[0]))
        return np.array(errors)

"""All that the Kodak report measures: most of it at once, and then what is timed, alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from gpusim.validate.at_once import Progress, at_once
from gpusim.validate.bars import Bar
from gpusim.validate.certified import certificate_bar
from gpusim.validate.kodak import (
    REFERENCE,
    SHEETS,
    Edges,
    measure_edges,
    mono_sensor,
    predictor_of,
    stand_in,
    targets,
)
from gpusim.validate.kodak_cost import Costs, measure_costs
from gpusim.validate.kodak_effects import Effects, measure_effects
from gpusim.validate.kodak_noise import Hues, Noises, measure_hues, measure_noises
from gpusim.validate.kodak_psf import PointSpreads, measure_psfs


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured, by part of the report."""

    edges: Edges
    psfs: PointSpreads
    effects: Effects
    hues: Hues
    noises: Noises
    costs: Costs

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        parts = self.edges, self.psfs, self.costs, self.effects, self.hues, self.noises
        bars = [bar for part in parts for bar in part.bars()]
        return [*bars, certificate_bar(self.effects.certificates)]


def measured(
    progress: Progress = lambda what, done, total: None,
    *,
    own: bool = False,
) -> Measured:
    """Measure all of it.

    Parameters
    ----------
    progress : callable
        Called with (what, done, total).
    own : bool
        Whether our tracer predicts, which is not independent.
    """
    parts = [_squares, *(partial(_edges, own, where) for where in SHEETS)]
    (effects, hues, noises), *edges = at_once(parts, progress)
    lens = stand_in()
    progress("predictions", 0, 2)
    predictor = predictor_of(lens, own=own)
    progress("predictions", 1, 2)
    psfs = measure_psfs(lens, predictor)
    progress("predictions", 2, 2)
    vertical = targets(predictor, mono_sensor(REFERENCE))[0]
    costs = measure_costs(lens, vertical, predictor, progress)
    return Measured(Edges.of(edges), psfs, effects, hues, noises, costs)


def _edges(own: bool, where: str, progress: Progress) -> Edges:
    lens = stand_in()
    return measure_edges(lens, predictor_of(lens, own=own), progress, sheets=(where,))


def _squares(progress: Progress) -> tuple[Effects, Hues, Noises]:
    effects, light = measure_effects(stand_in(), progress)
    progress("read-out", 0, 2)
    hues = measure_hues(light)
    progress("read-out", 1, 2)
    noises = measure_noises(light)
    progress("read-out", 2, 2)
    light.release()
    return effects, hues, noises

"""All that the Kodak report measures: most of it at once, and then what is timed, alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from threadpoolctl import threadpool_limits

from gpusim.validate.at_once import Progress, crew
from gpusim.validate.bars import Bar
from gpusim.validate.certified import certificate_bar
from gpusim.validate.edges import AXES
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
from gpusim.validate.kodak_cost import Costs, measure_grids, prepared, timed
from gpusim.validate.kodak_effects import Effects, measure_effects
from gpusim.validate.kodak_noise import Hues, Noises, measure_hues, measure_noises
from gpusim.validate.kodak_psf import PointSpreads, measure_psfs
from gpusim.validate.predict import Predictor


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
    lens = stand_in()
    # OpenBLAS's own threads wait by spinning.
    with crew(progress) as workers, threadpool_limits(1):
        squares = workers.begin(_squares)
        progress("predictions", 0, 1)
        predictor = predictor_of(lens, own=own)
        progress("predictions", 1, 1)
        # The first chart makes the edges' bank; sim grids' frames are prepared here meanwhile.
        first, *others = [
            partial(_edges, predictor, where, axis) for where in SHEETS for axis in AXES
        ]
        begun = [workers.begin(first)]
        sim_grids = workers.begin(partial(measure_grids, lens, predictor))
        begun += [workers.begin(one) for one in others]
        psfs = measure_psfs(lens, predictor)
        vertical = targets(predictor, mono_sensor(REFERENCE))[0]
        (grids,) = workers.results([sim_grids])
        with prepared(lens, vertical, grids) as takers:
            (effects, hues, noises), *edges = workers.results([squares, *begun])
            costs = timed(takers, grids, progress)
    return Measured(Edges.of(edges), psfs, effects, hues, noises, costs)


def _edges(predictor: Predictor, where: str, axis: str, progress: Progress) -> Edges:
    return measure_edges(stand_in(), predictor, progress, sheets=(where,), axes=(axis,))


def _squares(progress: Progress) -> tuple[Effects, Hues, Noises]:
    effects, light = measure_effects(stand_in(), progress)
    progress("read-out", 0, 2)
    hues = measure_hues(light)
    progress("read-out", 1, 2)
    noises = measure_noises(light)
    progress("read-out", 2, 2)
    light.release()
    return effects, hues, noises

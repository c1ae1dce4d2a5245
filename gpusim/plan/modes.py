"""How many modes the kernels of a lens take, guessed from a few of them."""

from __future__ import annotations

from gpusim.errors import UserError
from gpusim.optics.grid import SimGrid
from gpusim.optics.modes import Decomposition, mode_decomposition
from gpusim.plan.blocks import TRANSFORMS
from gpusim.plan.problem import Problem, Sampled

# What is looked at to guess how many modes there are: the PSFs as far, sim samples, and at so many
# nodes.
MODES_REACH = 32
MODES_CELLS = (6, 4)
MODES_MOST = 16  # fewer than half of those nodes, or the guess is none


def guessed_rank(problem: Problem, sampled: Sampled, allowed: float) -> tuple[int, float]:
    """Return how many modes leave an allowed error, and the error they leave.

    Raises
    ------
    UserError
        Where they are too many.
    """
    rank, error = _decomposed(problem, sampled).rank_within(allowed)
    if rank > MODES_MOST:
        raise UserError(
            "The PSFs change too much over the field to be sums of few modes.",
            field="method",
            value=f"more than {MODES_MOST} modes",
            allowed=f"{MODES_MOST} modes",
        )
    return rank, error


def _decomposed(problem: Problem, sampled: Sampled) -> Decomposition:
    """Decompose the first plane's kernels, to guess how many modes all planes take.

    Cores are guessed alike, however they are cut: what is looked at lies within the cuts.
    """
    reach = sampled.reach_um / sampled.pitch_um
    half_size = int(min(reach + 8, MODES_REACH)) // 8 * 8
    grid = SimGrid(
        problem.sensor.rows,
        problem.sensor.cols,
        sampled.stride,
        problem.planes.period,
        TRANSFORMS[-1],
        half_size,
        (1, 1),
        problem.planes.layers,
    )
    few = tuple(min(count, most) for count, most in zip(sampled.cells, MODES_CELLS, strict=True))
    key = sampled.pitch_um, few
    if sampled.name == "tail":
        key = *key, float(sampled.weight.sum())
    if key not in problem.guesses:
        kernels = problem.channels(sampled.weight, sampled.pitch_um)
        problem.guesses[key] = mode_decomposition(kernels, grid, sampled.pitch_um, few, 1)
    return problem.guesses[key]

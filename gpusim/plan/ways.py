"""The ways to convolve that a tolerance allows, worked out as far as they may be chosen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gpusim.errors import UserError
from gpusim.optics.kernels import RINGING, FieldKernels, field_kernels
from gpusim.optics.nodes import Scale
from gpusim.plan.candidates import Candidate, Part
from gpusim.plan.parts import part_of
from gpusim.plan.predict import GUARD, cells_within
from gpusim.plan.problem import CUTS_TRIED, Problem, Sampled
from gpusim.plan.shares import ALIAS_SHARE, NODE_SHARE, TONE_SHARE
from gpusim.psf.sampling import PITCH_UM

# On one sample a pixel kernels are sharp-edged in frequency and ring beyond their support: an even
# scene lost up to 2.5 % of its light.
OVERSAMPLINGS = (2, 4, 8, 16)
# Samples from a photosite to the next of its site: see shaders/optics/fft_columns.
LARGEST_STRIDE = 16
WHOLE = "whole"  # forced: PSFs are not cut


def candidates(problem: Problem, methods: Sequence[str], cut: bool) -> list[Candidate]:
    """Return the ways to convolve, worked out as far as they may be chosen.

    `cut`: of those that the tolerance allows, only those that cut the PSFs.
    """
    limit = ALIAS_SHARE * problem.accuracy.tolerance
    allowed = [n for n in OVERSAMPLINGS if n * problem.planes.period <= LARGEST_STRIDE]
    found: list[Candidate] = []
    alias, tried = 0.0, 0
    for oversampling in allowed:
        # A finer grid than is needed only costs more, and errs less. Where something else
        # exceeds its limit, the next finer one is tried where it costs least.
        enough = tried == 2 or any(one.parts and one.excess <= 1 for one in found)
        alias = alias if tried else problem.grid_error(oversampling)
        if enough or (alias > limit and oversampling != allowed[-1]):
            name = f"{_samples(oversampling)} a pixel"
            errors, limits = {"alias": alias}, {"alias": limit}
            found.append(Candidate(name, oversampling, None, problem.sigma, errors, limits))
            continue
        first, tried = tried == 0, tried + 1
        whole_alone = WHOLE in problem.force
        cuts = [] if whole_alone else list(problem.tails)[: CUTS_TRIED if first else 1]
        whole = [] if cut and cuts else [None]
        for radius in (*whole, *cuts):
            taken = methods if first else methods[:1]
            found += _on_grid(problem, taken, oversampling, alias, radius)
    return found


def scales_of(problem: Problem, chosen: Candidate) -> tuple[Scale, ...]:
    """Return the parts of a candidate with their kernels, of all planes and channels."""
    of_bank = problem.images, problem.places, problem.bank.pitch_um
    return tuple(
        Scale(
            part.name,
            part.layout.grid,
            part.pitch_um,
            problem.sigma,
            field_kernels(*of_bank, part.pitch_um, weight),
            part.method,
            **part.options,
        )
        for part, weight in zip(chosen.parts, problem.weights(chosen.cut_um), strict=True)
    )


def _on_grid(
    problem: Problem, methods: Sequence[str], oversampling: int, alias: float, cut_um: float | None
) -> list[Candidate]:
    """Work out each method on one sim grid; with a cut, the tails by whatever is cheapest."""
    tolerance = problem.accuracy.tolerance
    finest, nodes = _finest(problem, oversampling, cut_um)
    errors = {"alias": alias, "nodes": nodes}
    limits = {knob: tolerance for knob in ("nodes", "modes")}
    limits["alias"] = ALIAS_SHARE * tolerance
    if cut_um is not None or "direct" in methods:
        limits |= {knob: tolerance / problem.contrast for knob in ("cut", "support")}
    tail, how = None, "whole PSFs"
    if cut_um is not None:
        lag, few = problem.tails[cut_um]
        errors |= {"nodes": float(np.hypot(nodes, lag)), "cut": problem.lost[cut_um]}
        tail = _tail(problem, methods, problem.weights(cut_um)[1], few)
        how = f"PSFs cut at {cut_um:g} um"
    found = []
    for method in methods:
        name = f"{method}, {_samples(oversampling)} a pixel, {how}"
        own, parts, obstacle = {}, (), None
        try:
            core, own = part_of(problem, finest, method)
            name += f", {core.text}"
            parts = (core,)
            if isinstance(tail, UserError):
                raise tail
            if tail is not None:
                name += f"; tail by {tail.method}, {tail.text}"
                parts = (core, tail)
        except UserError as error:
            # Its frames would keep the problem, with all kernels, as long as the candidate.
            parts, obstacle = (), error.with_traceback(None)
        given = cut_um, problem.sigma, errors | own, limits, parts, obstacle
        found.append(Candidate(name, oversampling, *given))
    return found


def _finest(problem: Problem, oversampling: int, cut_um: float | None) -> tuple[Sampled, float]:
    """Return the PSFs, or their cores, on the finest grid, and the error that their nodes leave."""
    pitch_um = problem.sensor.pixel_pitch_um / oversampling
    weight = problem.weights(cut_um)[0]
    # Within 20 um a core holds 98 % of its energy at f/2.8. A halo's levels are as much wider
    # as their samples.
    first = problem.first(weight, pitch_um)
    reach_um = held_um(first, pitch_um, cut_um or problem.reach_um)
    wider = max(problem.bank.pitch_um / PITCH_UM, 1.0)
    most_um = max(20.0 * wider, (RINGING - GUARD) * pitch_um)
    cells, nodes = cells_within(
        first,
        pitch_um,
        most_um,
        problem.half_um,
        (NODE_SHARE if problem.has_edges else TONE_SHARE) * problem.accuracy.tolerance,
        beyond_um=reach_um,
        edge=problem.edge(pitch_um) if problem.has_edges else False,
    )
    name, stride = "whole" if cut_um is None else "core", oversampling * problem.planes.period
    return Sampled(name, stride, pitch_um, reach_um, weight, cells), nodes


def _tail(
    problem: Problem, methods: Sequence[str], weight: np.ndarray, cells: tuple[int, int]
) -> Part | UserError:
    """Return the cheapest way to convolve the tails, or why there is none."""
    found = []
    pitch_um = problem.coarse_pitch_um
    reach_um = held_um(problem.first(weight, pitch_um), pitch_um, problem.reach_um)
    tail = Sampled("tail", problem.coarse_stride, pitch_um, reach_um, weight, cells)
    for method in methods:
        try:
            part, _ = part_of(problem, tail, method)
        except UserError as error:
            obstacle = error.with_traceback(None)
        else:
            found.append(part)
    return min(found, key=lambda part: part.layout.cost_s) if found else obstacle


def held_um(kernels: FieldKernels, pitch_um: float, reach_um: float) -> float:
    """Return how far kernels of PSFs that reach so far are sampled: as they ring."""
    return max(reach_um, (RINGING - GUARD) * pitch_um) if kernels.ringing else reach_um


def _samples(oversampling: int) -> str:
    return f"{oversampling} sample{'s' * (oversampling > 1)}"

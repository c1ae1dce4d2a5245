"""What a method takes for PSFs on a sim grid: the cheapest layout, and the errors that it adds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gpusim.errors import UserError
from gpusim.optics import paint
from gpusim.optics.convolve import Scratch
from gpusim.optics.direct import MARGIN, direct_work, support_within
from gpusim.optics.grid import SimGrid
from gpusim.optics.nodes import folds_of, own_kernels
from gpusim.plan.blocks import (
    Memory,
    Needed,
    cheapest_grid,
    planes_at_nodes,
    planes_at_points,
)
from gpusim.plan.candidates import Part
from gpusim.plan.modes import guessed_rank
from gpusim.plan.problem import Problem, Sampled
from gpusim.plan.shares import MODES_SHARE, TONE_SHARE
from gpusim.sensor.aperture import Response

DIRECT_STRIDE = 8  # sim samples from a site to the next, at most: shaders/optics/direct
DIRECT_REACH = 64  # sim samples beyond which transforms are cheaper at any rate


def part_of(problem: Problem, sampled: Sampled, method: str) -> tuple[Part, dict[str, float]]:
    """Return a scale by one method, and the errors that this adds.

    Raises
    ------
    UserError
        Where the method cannot do it.
    """
    # Beside the pixel: the image moves while it is exposed.
    beside_um = 0.0
    if isinstance(response := problem.sensor.response_um, Response):
        beside_um = max(response.reach - problem.sensor.pixel_pitch_um / 2, 0.0)
    sampled = replace(sampled, reach_um=sampled.reach_um + beside_um)
    reach, cells = sampled.reach_um / sampled.pitch_um, sampled.cells
    options: dict[str, object] = {}
    errors: dict[str, float] = {}
    rank = support = 0
    if method == "modes":
        share = MODES_SHARE if problem.has_edges else TONE_SHARE
        allowed = share * problem.accuracy.tolerance
        rank, errors["modes"] = guessed_rank(problem, sampled, allowed)
        options = {"map_cells": cells, "rank_error": allowed}
        cells = (1, 1)
    elif method == "direct":
        support, errors["support"] = _support(problem, sampled)
        options = {"support": support}
        reach = max(support - 4, 0)
    work = _Work(problem, sampled, method, rank, support)
    layout = cheapest_grid(
        problem.sensor,
        work,
        reach,
        cells,
        stride=sampled.stride,
        period=problem.planes.period,
        layers=problem.planes.layers,
    )
    nodes = 0
    if method != "modes":
        nodes = np.count_nonzero(work.at_nodes(layout.grid, layout.needed))
    return Part(sampled.name, sampled.pitch_um, layout, method, options, rank, nodes), errors


def _support(problem: Problem, sampled: Sampled) -> tuple[int, float]:
    """Return the smallest support of the direct sum, and the error it leaves.

    Raises
    ------
    UserError
        Where it is too large for the shader.
    """
    sensor, pitch_um, reach_um = problem.sensor, sampled.pitch_um, sampled.reach_um
    reach, stride = reach_um / pitch_um, sampled.stride
    if reach > DIRECT_REACH or stride > DIRECT_STRIDE:
        raise UserError(
            "The direct sum is for small supports.",
            field="method",
            value=f"PSFs of {2 * reach:.0f} sim samples, sites {stride} apart",
            allowed=f"{2 * DIRECT_REACH} samples, {DIRECT_STRIDE}",
        )
    return support_within(
        problem.channels(sampled.weight, pitch_um),
        pitch_um,
        reach_um,
        problem.half_um,
        problem.accuracy.tolerance / problem.contrast,
        oversampling=sensor.pixel_pitch_um / pitch_um,
        aperture_um=sensor.response_um,
        sigma=problem.sigma,
    )


@dataclass(frozen=True, eq=False)
class _Work:
    """The work of a method on the grids that PSFs may be cut into: its seconds and its memory."""

    problem: Problem
    sampled: Sampled
    method: str
    rank: int
    support: int

    @cached_property
    def _own(self) -> bool:
        """Whether the sites of a channel have kernels of their own."""
        planes, channels = self.problem.planes, len(self.problem.sensor.channels)
        return own_kernels(self.sampled.stride, planes.period, planes.layers, channels)

    @property
    def _outputs(self) -> int:
        problem = self.problem
        return len(problem.planes.channels if self._own else problem.sensor.channels)

    def needed(self, grid: SimGrid) -> Needed:
        """Return the planes that each block needs."""
        return self.problem.needed(grid, self.sampled.pitch_um)

    def seconds(self, grid: SimGrid, needed: Needed) -> dict[str, float]:
        """Return the seconds of a frame, by stage."""
        costs = self.problem.costs
        lit = np.array([count for count in needed.values() if count], int)
        if self.method == "direct":
            madds = direct_work(grid, self.support, needed, self.problem.sites)
            seconds = {"direct": costs.seconds("direct", madds)}
        else:
            of_modes = self.rank if self.method == "modes" else None
            seconds = costs.transforms(grid, self._outputs, lit, of_modes)
        seconds |= self._source_s(grid, needed)
        # The source's two, and those of the method.
        dispatches = (2 + (1 if self.method == "direct" else 3)) * len(lit)
        return seconds | {"dispatch": costs.seconds("dispatch", dispatches)}

    def at_nodes(self, grid: SimGrid, needed: Needed) -> np.ndarray:
        """Return the planes of each node's kernels."""
        folds = (False, False)
        if self.method == "fft":
            problem = self.problem
            # See Outputs.
            step = 0 if self._own else self.sampled.stride // problem.planes.period
            folds = folds_of(grid, problem.mirrored, problem.sensor.response_um, step)
        return planes_at_nodes(grid, needed, folds)

    def kernels_s(self, grid: SimGrid, needed: Needed) -> float:
        """Return the seconds that the kernels take, which are made once."""
        problem, support = self.problem, self.support
        size, spectra = (2 * grid.half_size) ** 2, grid.length**2
        if self.method == "modes":
            nodes = np.prod(np.add(self.sampled.cells, 3))
            made = nodes * max(needed.values(), default=0)
            transformed = self.rank * made / nodes
        else:
            planes = self.at_nodes(grid, needed)
            transformed = planes.sum()
            symmetric = tuple(problem.mirrored and grid.mirrored(axis) for axis in (0, 1))
            made = planes_at_points(planes, symmetric)
        if self.method == "direct":
            size, spectra = (2 * (support + MARGIN)) ** 2, (2 * (support + 2 * MARGIN)) ** 2
        channels = len(problem.sensor.channels)
        return problem.costs.seconds("kernels", channels * size * made) + (
            problem.costs.seconds("spectra", self._outputs * spectra * transformed)
        )

    def memory(self, grid: SimGrid, needed: Needed) -> Memory:
        """Return what kernels and scratch take on the device."""
        half = grid.length // 2 * grid.length * 8 * self._outputs
        most = max(needed.values(), default=0)
        if self.method == "modes":
            pairs = -(-most * self.rank // 2)
            scratch = Scratch.shapes(grid, most, pairs).values()
            largest = max(4 * math.prod(shape) for shape in scratch)
            return Memory(2 * pairs * half, max(pairs * half, largest))
        if self.method == "direct":
            half = len(self.problem.planes.channels) * (2 * self.support + 12) ** 2 * 8
        return Memory(4 * most * half, most * half)

    def _source_s(self, grid: SimGrid, needed: Needed) -> dict[str, float]:
        """Return the seconds of laying the scene on the grid."""
        costs, block = self.problem.costs, grid.block[0] * grid.block[1]
        if not self.problem.is_chart:
            return {"warp": costs.seconds("warp", block * sum(needed.values()))}
        # The shader paints so many planes at once, each time all of the outlines.
        groups = [-(-count // paint.PLANES) for count in needed.values()]
        painted = costs.seconds("paint", block * sum(groups))
        return {"paint": painted + self._edges_s * max(groups, default=0)}

    @cached_property
    def _edges_s(self) -> float:
        """Seconds of a chart's outlines, each time it is painted."""
        problem = self.problem
        edges = paint.samples_at_edges(problem.placed, problem.half_um, self.sampled.pitch_um)
        return problem.costs.seconds("edges", edges)

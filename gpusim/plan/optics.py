"""The choice of planes, oversampling, cut, PSF nodes and blocks for a tolerance."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gpusim.errors import UserError
from gpusim.optics import paint, warp
from gpusim.optics.chief_ray import ChiefRayMap, black_share, chief_ray_map
from gpusim.optics.convolve import Scratch
from gpusim.optics.direct import MARGIN, direct_work, support_within
from gpusim.optics.fold import MAX_PLANES, Basis, camera_basis
from gpusim.optics.grid import SimGrid
from gpusim.optics.images import field_images, mirrored
from gpusim.optics.kernels import RINGING, FieldKernels, core_window, distances_um, field_kernels
from gpusim.optics.methods import METHODS, check_method
from gpusim.optics.modes import Decomposition, mode_decomposition
from gpusim.optics.nodes import Scale, folds_of, own_kernels
from gpusim.plan.accuracy import Accuracy
from gpusim.plan.alias import Alias
from gpusim.plan.candidates import Candidate, Part, RunnerUp, choose
from gpusim.plan.contrast import contrast_of, edge_contrast
from gpusim.plan.costs import LAVAPIPE, Costs
from gpusim.plan.density import Density, LensShare
from gpusim.plan.halo import describe_halo, halo_levels, seen_shares
from gpusim.plan.layout import (
    TRANSFORMS,
    Memory,
    Needed,
    cheapest_grid,
    planes_at_nodes,
    planes_at_points,
)
from gpusim.plan.predict import GUARD, Edge, cells_within, cut_error
from gpusim.plan.reach import within_reach
from gpusim.plan.signal import brightest_e
from gpusim.plan.splat import describe_splat
from gpusim.plan.stages import RIM, Plan, PlanStage, describe
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.places import Places
from gpusim.psf.sampling import PITCH_UM
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.sensor.aperture import Response
from gpusim.sensor.effects import EFFECTS
from gpusim.sensor.planes import Planes, planes_of
from gpusim.sensor.sensor import Sensor

# The planes' error is that of the worst spectrum in its weakest channel; the rest is well below it.
WORST_TO_RMS = 5.0
# Share of the tolerance that is left to the nodes; a photograph's contrast is larger than a
# chart's.
NODE_SHARE = 0.5
# The same of a scene of one tone, for nodes and for modes: the kernels' sums alone count, and
# neighbouring pixels err alike. It is the mean over the sensor: within 40 pixels of the rim of the
# phone lens's image circle four times as much was found.
TONE_SHARE = 0.1
# By how much the terms of a quantum efficiency that goes with the azimuth may err: share of a
# plane's light.
ANGLE_SHARE = 0.05
TAIL_SHARE = 0.4  # for the nodes of the tails, which add in the squares
ALIAS_SHARE = 0.7  # of the tolerance; with that of the nodes in the squares, all of it
# Radii at which the core of the PSFs may be cut from their tail, um.
CUTS_UM = (6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0)
CUTS_TRIED = 3  # the smallest that meet the tolerance: a larger core only costs more
# On one sample a pixel kernels are sharp-edged in frequency and ring beyond their support: an even
# scene lost up to 2.5 % of its light.
OVERSAMPLINGS = (2, 4, 8, 16)
LARGEST_STRIDE = 16  # samples from a photosite to the next of its site: shaders/optics/columns
MODES_SHARE = 0.5  # of the tolerance; with that of the nodes in the squares, 0.94 of it
# What is looked at to guess how many modes there are: the PSFs as far, sim samples, and at so many
# nodes.
MODES_REACH = 32
MODES_CELLS = (6, 4)
MODES_MOST = 16  # fewer than half of those nodes, or the guess is none
FEW_SPECTRA = 3  # of a photograph in colour, whose planes are for each by itself
SHOWN = 500  # samples of a spectral photograph that its planes are made for
LATERAL = "lateral"  # the stage of lateral colour
WHOLE = "whole"  # forced: PSFs are not cut
DIRECT_STRIDE = 8  # sim samples from a site to the next, at most: shaders/optics/direct
DIRECT_REACH = 64  # sim samples beyond which transforms are cheaper at any rate


def plan_optics(
    bank: FieldBank,
    sensor: Sensor,
    scene: Scene,
    accuracy: Accuracy,
    costs: Costs = LAVAPIPE,
    noise: bool = True,
    method: str | None = None,
    force: Collection[str] = (),
    exposure_s: float = math.inf,
    density: Density | None = None,
) -> Plan:
    """Choose planes, oversampling, the cut of the PSFs, nodes and blocks for a tolerance.

    Where a tolerance cannot be met, it is refused, with the nearest that can be; or, for best
    effort, the plan is that for the nearest.

    Parameters
    ----------
    bank : FieldBank
    sensor : Sensor
    scene : Scene
    accuracy : Accuracy
    costs : Costs
        Rates of the adapter that is to render.
    noise : bool
        Whether the sensor's noise and fixed patterns are asked for.
    method : str, optional
        One of METHODS, instead of the cheapest.
    force : collection of str
        Stages of the plan that are to run though nothing needs them: for tests. With `WHOLE` no
        PSF is cut, so that other ones of the lens may take its place: for drafts.
    exposure_s : float
        Longest that will be captured: to a tolerance in sigmas, the noise of the brightest signal
        that the scene makes in it counts.
    density : Density, optional
        How well the bank stands for its lens: the engine gets what that leaves of the tolerance.

    Raises
    ------
    UserError
        When a PSF is wider than the longest transform allows, or a part of the error cannot be as
        small as the tolerance asks: which, and the nearest tolerance that can be met.
    """
    given = bank, sensor, scene, accuracy, costs, noise, method, force, exposure_s
    return plans_optics(*given, count=1, density=density)[0]


def plans_optics(
    bank: FieldBank,
    sensor: Sensor,
    scene: Scene,
    accuracy: Accuracy,
    costs: Costs = LAVAPIPE,
    noise: bool = True,
    method: str | None = None,
    force: Collection[str] = (),
    exposure_s: float = math.inf,
    *,
    count: int,
    density: Density | None = None,
) -> list[Plan]:
    """Return the plan of `plan_optics`, and then those that it takes for the next cheapest.

    At most `count` in all; all meet the tolerance that the first one is made for.
    """
    lens = None if density is None else LensShare(density, bank)
    levels, bank = bank.levels, bank.levels[0]
    check_method(method)
    methods = METHODS if method is None else (method,)
    signal = (
        brightest_e(bank, sensor, scene, exposure_s),
        sensor.temporal_dark_noise_e,
        sensor.full_well_e,
    )
    relative = accuracy.relative(*signal)

    aliases: dict[tuple[int, int], float] = {}

    shown = shown_mixtures(scene)

    last: _Problem | None = None

    def attempt(tolerance: float) -> _Attempt:
        nonlocal last
        basis = camera_basis(
            bank,
            sensor,
            scene.spectra,
            0.0 if "spectra" in force else WORST_TO_RMS * tolerance,
            _commonest_first(scene),
            ANGLE_SHARE * tolerance,
            scene.wavelengths_nm,
            shown,
        )
        asked = replace(relative, tolerance=tolerance)
        if lens is not None:
            asked = replace(asked, tolerance=lens.left_of(tolerance))
        if last is not None and last.has_basis(basis):
            problem = last.to(asked)
        else:
            problem = _Problem(bank, sensor, scene, asked, costs, basis, force, levels, aliases)
        last = problem
        candidates = problem.candidates(methods, "tail" in force)
        return _Attempt(problem, candidates, choose(candidates)[0], lens, tolerance)

    floor = None if lens is None else lens.excess
    found, shortfall = within_reach(attempt, accuracy, accuracy.share(*signal), floor)
    problem, rest = found.problem, [one for one in found.candidates if one is not found.chosen]
    others = [one for one in rest if one.parts and one.excess <= 1]
    taken = [found.chosen, *sorted(others, key=lambda one: one.cost_s)][:count]
    runners_up = choose(found.candidates)[1]
    return [
        _plan(problem, one, runners_up if one is found.chosen else (), noise, shortfall, lens)
        for one in taken
    ]


def alias_of(bank: FieldBank, sensor: Sensor, scene: Scene, accuracy: Accuracy) -> Alias:
    """Return what predicts the errors of sim grids, as the planner makes it for a tolerance."""
    core, allowed = bank.levels[0], WORST_TO_RMS * accuracy.tolerance
    given = allowed, _commonest_first(scene), ANGLE_SHARE * allowed, scene.wavelengths_nm
    basis = camera_basis(core, sensor, scene.spectra, *given, shown_mixtures(scene))
    return _Problem(core, sensor, scene, accuracy, LAVAPIPE, basis, (), bank.levels).alias


def _plan(
    problem: _Problem,
    chosen: Candidate,
    runners_up: tuple[RunnerUp, ...],
    noise: bool,
    shortfall: str,
    lens: LensShare | None,
) -> Plan:
    """Return a candidate as a plan."""
    basis, sensor, scene, costs = problem.basis, problem.sensor, problem.scene, problem.costs
    scales, force = problem.scales(chosen), problem.force
    halo = halo_levels(problem.levels, problem.accuracy, problem.seen_shares)
    identity = problem.identity(scales[0])
    tolerance = problem.accuracy.tolerance
    splat = describe_splat(problem.bank, sensor, scene, problem._placed, tolerance, costs)
    stages = describe(
        chosen,
        basis,
        sensor,
        scene,
        costs,
        identity,
        noise,
        force,
        (
            *problem.left_out(),
            *(() if lens is None else lens.stages),
            describe_halo(problem.levels, halo),
        ),
        splat,
    )
    of_sensor = {effect.name for effect in EFFECTS}
    return Plan(
        basis=basis,
        scales=scales,
        stages=stages,
        name=chosen.name,
        predicted_s=sum(part.layout.frame_s for part in chosen.parts)
        + sum(stage.predicted_cost_s or 0.0 for stage in stages if stage.name in of_sensor),
        kernels_s=sum(part.layout.kernels_s for part in chosen.parts)
        + (splat.predicted_cost_s or 0.0),
        rates=costs.source,
        runners_up=runners_up,
        halo=halo,
        tolerance=problem.accuracy.tolerance,
        shortfall=shortfall,
    )


@dataclass(frozen=True, eq=False)
class _Attempt:
    """What came of planning for one tolerance: see `gpusim.plan.reach.Attempt`."""

    problem: _Problem
    candidates: list[Candidate]
    chosen: Candidate
    lens: LensShare | None
    tolerance: float

    @property
    def excess(self) -> float:
        return max(self._planes, self.chosen.excess, self._lens)

    @property
    def why(self) -> str:
        chosen = self.chosen
        if self._lens >= max(self._planes, chosen.excess):
            return self.lens.density.why
        if self._planes >= chosen.excess:
            return (
                f"the planes of the scene's spectra cannot err by less: there are {MAX_PLANES} at "
                f"most, and this camera tells more spectra of this scene apart"
            )
        if chosen.worst == "alias":
            return (
                f"the alias of edges on the sim grid cannot be less: {chosen.oversampling} samples "
                "a pixel are the most, and scene and PSFs hold finer detail than these carry"
            )
        error, limit = chosen.errors[chosen.worst], chosen.limits[chosen.worst]
        return f"the error of its {chosen.worst} is {error:.1e} at least, above {limit:.1e}"

    @property
    def _lens(self) -> float:
        """The bank's error over its limit."""
        return 0.0 if self.lens is None else self.lens.excess(self.tolerance)

    @property
    def _planes(self) -> float:
        """The planes' error over its limit."""
        problem = self.problem
        return problem.basis.residual / (WORST_TO_RMS * problem.accuracy.tolerance)


@dataclass(frozen=True, eq=False)
class _Problem:
    """What is to be convolved, and how well.

    `accuracy` is what the bank leaves of the tolerance to the engine.
    """

    bank: FieldBank
    sensor: Sensor
    scene: Scene
    accuracy: Accuracy
    costs: Costs
    basis: Basis
    force: Collection[str]
    levels: tuple[FieldBank, ...]
    # What sim grids cost, by samples a pixel and planes: the same at every tolerance.
    aliases: dict[tuple[int, int], float] = field(default_factory=dict)

    def has_basis(self, basis: Basis) -> bool:
        """Return whether the planes are those of a basis, wherever they are seen."""
        return basis.elsewhere is self.basis.elsewhere is None and np.array_equal(
            basis.spectra, self.basis.spectra
        )

    def to(self, accuracy: Accuracy) -> _Problem:
        """Return the same for another accuracy, with all that was worked out and holds there.

        Kernels of the fields take most of a plan's time: a search for the nearest tolerance that
        can be met makes them once.
        """
        other = replace(self, accuracy=accuracy)
        found = {name: value for name, value in vars(self).items() if name not in vars(other)}
        found.pop("_tails", None)  # how many nodes they need
        vars(other).update(found)
        return other

    def candidates(self, methods: Sequence[str], cut: bool) -> list[Candidate]:
        """Return the ways to convolve, worked out as far as they may be chosen.

        `cut`: of those that the tolerance allows, only those that cut the PSFs.
        """
        limit = ALIAS_SHARE * self.accuracy.tolerance
        allowed = self._oversamplings
        found: list[Candidate] = []
        alias, tried = 0.0, 0
        for oversampling in allowed:
            # A finer grid than is needed only costs more, and errs less. Where something else
            # exceeds its limit, the next finer one is tried where it costs least.
            enough = tried == 2 or any(one.parts and one.excess <= 1 for one in found)
            alias = alias if tried else self._alias(oversampling)
            if enough or (alias > limit and oversampling != allowed[-1]):
                name = f"{_samples(oversampling)} a pixel"
                errors, limits = {"alias": alias}, {"alias": limit}
                found.append(Candidate(name, oversampling, None, self.sigma, errors, limits))
                continue
            first, tried = tried == 0, tried + 1
            whole_alone = WHOLE in self.force
            cuts = [] if whole_alone else list(self._tails)[: CUTS_TRIED if first else 1]
            whole = [] if cut and cuts else [None]
            for radius in (*whole, *cuts):
                found += self._candidates(
                    methods if first else methods[:1], oversampling, alias, radius
                )
        return found

    def _alias(self, oversampling: int) -> float:
        """Return what the sim grid costs; where all is of one tone, nothing."""
        if not self.has_edges:
            return 0.0
        key = oversampling, self.basis.coefficients.shape[1]
        if key not in self.aliases:
            self.aliases[key] = self.alias.error(oversampling)
        return self.aliases[key]

    @property
    def _oversamplings(self) -> list[int]:
        """Samples a pixel that may be chosen."""
        return [n for n in OVERSAMPLINGS if n * self.planes.period <= LARGEST_STRIDE]

    def left_out(self) -> tuple[PlanStage, ...]:
        """Describe what this lens may not need: distortion and lateral colour."""
        distorts, moves = self._chief_ray.distortion, self.bank.lateral_um > 0
        forced = {name: ", forced" * (name in self.force) for name in ("distortion", LATERAL)}
        return (
            self._rim(),
            PlanStage(
                "distortion",
                distorts,
                "where each sample lies on the ideal plane, by splines to "
                f"{self._chief_ray.error_um:.0e} um" + forced["distortion"]
                if distorts
                else "the lens has none: the ideal and the real image are one",
            ),
            PlanStage(
                LATERAL,
                moves or LATERAL in self.force,
                f"colours lie up to {self.bank.lateral_um:.3g} um apart, folded into the kernels"
                if moves
                else "the lens has none: no colour is moved" + forced[LATERAL],
            ),
        )

    def _rim(self) -> PlanStage:
        """Describe where the image ends, and what of the sensor lies beyond."""
        bank, sensor = self.bank, self.sensor
        whole, flat = (
            black_share(sensor, bank.centre_um, radius)
            for radius in (bank.image_circle_um, bank.rectilinear_circle_um)
        )
        if whole == flat == 0:
            return PlanStage(RIM, False, "the image circle covers the sensor")
        words = []
        if whole > 0:
            words.append(
                f"the sensor reaches beyond the image circle: {whole:.2%} of its pixels are black"
            )
        if flat > whole:
            words.append(
                f"the scene is flat and ends {bank.projection.end_deg:g} deg off the axis, before "
                f"the image circle: {flat:.2%} of the pixels are black (--projection angular)"
            )
        return PlanStage(RIM, True, "; ".join(words))

    def scales(self, chosen: Candidate) -> tuple[Scale, ...]:
        """Return the parts of a candidate with their kernels, of all planes and channels."""
        return tuple(
            Scale(
                part.name,
                part.layout.grid,
                part.pitch_um,
                self.sigma,
                field_kernels(self.images, self.places, self.bank.pitch_um, part.pitch_um, weight),
                part.method,
                **part.options,
            )
            for part, weight in zip(chosen.parts, self._parts(chosen.cut_um), strict=True)
        )

    def _candidates(
        self, methods: Sequence[str], oversampling: int, alias: float, cut_um: float | None
    ) -> list[Candidate]:
        """Work out each method on one sim grid; with a cut, the tails by whatever is cheapest."""
        tolerance, period = self.accuracy.tolerance, self.planes.period
        pitch_um = self.sensor.pixel_pitch_um / oversampling
        weights = self._parts(cut_um)
        # Within 20 um a core holds 98 % of its energy at f/2.8. A halo's levels are as much wider
        # as their samples.
        first = self._first(weights[0], pitch_um)
        reach_um = held_um(first, pitch_um, cut_um or self.reach_um)
        most_um = max(20.0 * max(self.bank.pitch_um / PITCH_UM, 1.0), (RINGING - GUARD) * pitch_um)
        cells, nodes = cells_within(
            first,
            pitch_um,
            most_um,
            self.half_um,
            (NODE_SHARE if self.has_edges else TONE_SHARE) * tolerance,
            reach_um,
            self._edge(pitch_um) if self.has_edges else False,
        )
        errors = {"alias": alias, "nodes": nodes}
        limits = {knob: tolerance for knob in ("nodes", "modes")}
        limits["alias"] = ALIAS_SHARE * tolerance
        if cut_um is not None or "direct" in methods:
            limits |= {knob: tolerance / self.contrast for knob in ("cut", "support")}
        tail = None
        if cut_um is not None:
            lag, few = self._tails[cut_um]
            errors |= {"nodes": float(np.hypot(nodes, lag)), "cut": self._lost[cut_um]}
            tail = self._tail(methods, weights[1], few)
        kind, how = (
            ("whole", "whole PSFs") if cut_um is None else ("core", f"PSFs cut at {cut_um:g} um")
        )
        found = []
        for method in methods:
            name = f"{method}, {_samples(oversampling)} a pixel, {how}"
            own, parts, obstacle = {}, (), None
            try:
                core, own = self._part(
                    kind,
                    method,
                    oversampling * period,
                    pitch_um,
                    reach_um,
                    weights[0],
                    cells,
                )
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
            found.append(
                Candidate(
                    name, oversampling, cut_um, self.sigma, errors | own, limits, parts, obstacle
                )
            )
        return found

    def _tail(
        self, methods: Sequence[str], weight: np.ndarray, cells: tuple[int, int]
    ) -> Part | UserError:
        """Return the cheapest way to convolve the tails, or why there is none."""
        found = []
        pitch_um = self.coarse_pitch_um
        reach_um = held_um(self._first(weight, pitch_um), pitch_um, self.reach_um)
        where = (self.coarse_stride, pitch_um, reach_um, weight, cells)
        for method in methods:
            try:
                part, _ = self._part("tail", method, *where)
            except UserError as error:
                obstacle = error.with_traceback(None)
            else:
                found.append(part)
        return min(found, key=lambda part: part.layout.cost_s) if found else obstacle

    def _part(
        self,
        name: str,
        method: str,
        stride: int,
        pitch_um: float,
        reach_um: float,
        weight: np.ndarray,
        cells: tuple[int, int],
    ) -> tuple[Part, dict[str, float]]:
        """Return a scale by one method, and the errors that this adds.

        Raises
        ------
        UserError
            Where the method cannot do it.
        """
        period = self.planes.period
        layers, outputs = self.planes.layers, len(self.sensor.channels)
        step = stride // period  # see Outputs
        if own_kernels(stride, period, layers, outputs):
            outputs, step = len(self.planes.channels), 0
        options: dict[str, object] = {}
        errors: dict[str, float] = {}
        rank = 0
        # Beside the pixel: the image moves while it is exposed.
        beside_um = 0.0
        if isinstance(response := self.sensor.response_um, Response):
            beside_um = max(response.reach - self.sensor.pixel_pitch_um / 2, 0.0)
        reach_um += beside_um
        reach = reach_um / pitch_um
        if method == "modes":
            found = self._decomposed(stride, pitch_um, reach, name, weight, cells)
            allowed = (MODES_SHARE if self.has_edges else TONE_SHARE) * self.accuracy.tolerance
            rank, errors["modes"] = found.rank_within(allowed)
            if rank > MODES_MOST:
                raise UserError(
                    "The PSFs change too much over the field to be sums of few modes.",
                    field="method",
                    value=f"more than {MODES_MOST} modes",
                    allowed=f"{MODES_MOST} modes",
                )
            options = {"map_cells": cells, "rank_error": allowed}
            cells = (1, 1)
        elif method == "direct":
            if reach > DIRECT_REACH or stride > DIRECT_STRIDE:
                raise UserError(
                    "The direct sum is for small supports.",
                    field="method",
                    value=f"PSFs of {2 * reach:.0f} sim samples, sites {stride} apart",
                    allowed=f"{2 * DIRECT_REACH} samples, {DIRECT_STRIDE}",
                )
            limit = self.accuracy.tolerance / self.contrast
            support, errors["support"] = self._support(pitch_um, reach_um, weight, limit)
            options = {"support": support}
            reach = max(support - 4, 0)

        def work(grid: SimGrid, needed: Needed) -> dict[str, float]:
            lit = np.array([count for count in needed.values() if count], int)
            if method == "direct":
                madds = direct_work(grid, support, needed, self.sites)
                seconds = {"direct": self.costs.seconds("direct", madds)}
            else:
                of_modes = rank if method == "modes" else None
                seconds = self.costs.transforms(grid, outputs, lit, of_modes)
            seconds |= self._source_s(grid, needed, edges_s)
            # The source's two, and those of the method.
            dispatches = (2 + (1 if method == "direct" else 3)) * len(lit)
            return seconds | {"dispatch": self.costs.seconds("dispatch", dispatches)}

        channels = len(self.sensor.channels)

        def at_nodes(grid: SimGrid, needed: Needed) -> np.ndarray:
            folds = (False, False)
            if method == "fft":
                folds = folds_of(grid, self._mirrored, self.sensor.response_um, step)
            return planes_at_nodes(grid, needed, folds)

        def preparation(grid: SimGrid, needed: Needed) -> float:
            size, spectra = (2 * grid.half_size) ** 2, grid.length**2
            if method == "modes":
                nodes = np.prod(np.add(options["map_cells"], 3))
                made = nodes * max(needed.values(), default=0)
                transformed = rank * made / nodes
            else:
                planes = at_nodes(grid, needed)
                transformed = planes.sum()
                symmetric = tuple(self._mirrored and grid.mirrored(axis) for axis in (0, 1))
                made = planes_at_points(planes, symmetric)
            if method == "direct":
                size, spectra = (2 * (support + MARGIN)) ** 2, (2 * (support + 2 * MARGIN)) ** 2
            return self.costs.seconds("kernels", channels * size * made) + (
                self.costs.seconds("spectra", outputs * spectra * transformed)
            )

        def memory(grid: SimGrid, needed: Needed) -> Memory:
            half = grid.length // 2 * grid.length * 8 * outputs
            most = max(needed.values(), default=0)
            if method == "modes":
                pairs = -(-most * rank // 2)
                scratch = Scratch.shapes(grid, most, pairs).values()
                largest = max(4 * math.prod(shape) for shape in scratch)
                return Memory(2 * pairs * half, max(pairs * half, largest))
            if method == "direct":
                half = len(self.planes.channels) * (2 * support + 12) ** 2 * 8
            return Memory(4 * most * half, most * half)

        edges_s = 0.0
        if self.is_chart:
            edges = paint.samples_at_edges(self._placed, self.half_um, pitch_um)
            edges_s = self.costs.seconds("edges", edges)
        layout = cheapest_grid(
            self.sensor,
            stride,
            period,
            reach,
            cells,
            lambda grid: self._needed(grid, pitch_um),
            work,
            memory,
            preparation,
            layers,
        )
        nodes = 0 if method == "modes" else np.count_nonzero(at_nodes(layout.grid, layout.needed))
        return Part(name, pitch_um, layout, method, options, rank, nodes), errors

    def _decomposed(
        self,
        stride: int,
        pitch_um: float,
        reach: float,
        name: str,
        weight: np.ndarray,
        cells: tuple[int, int],
    ) -> Decomposition:
        """Decompose the first plane's kernels, to guess how many modes all planes take.

        Cores are guessed alike, however they are cut: what is looked at lies within the cuts.
        """
        half_size = int(min(reach + 8, MODES_REACH)) // 8 * 8
        grid = SimGrid(
            self.sensor.rows,
            self.sensor.cols,
            stride,
            self.planes.period,
            TRANSFORMS[-1],
            half_size,
            (1, 1),
            self.planes.layers,
        )
        few = tuple(min(count, most) for count, most in zip(cells, MODES_CELLS, strict=True))
        key = (pitch_um, few) if name != "tail" else (pitch_um, few, float(weight.sum()))
        if key not in self._guesses:
            kernels = self._channels(weight, pitch_um)
            self._guesses[key] = mode_decomposition(kernels, grid, pitch_um, few, 1)
        return self._guesses[key]

    @cached_property
    def _guesses(self) -> dict[tuple, Decomposition]:
        return {}

    def _support(
        self, pitch_um: float, reach_um: float, weight: np.ndarray, limit: float
    ) -> tuple[int, float]:
        """Return the smallest support of the direct sum, and the error it leaves."""
        sensor = self.sensor
        return support_within(
            self._channels(weight, pitch_um),
            pitch_um,
            reach_um,
            self.half_um,
            limit,
            oversampling=sensor.pixel_pitch_um / pitch_um,
            aperture_um=sensor.response_um,
            sigma=self.sigma,
        )

    @cached_property
    def planes(self) -> Planes:
        return planes_of(self.sensor)

    @property
    def sites(self) -> list[int]:
        """Channel of each plane."""
        return list(self.planes.channels)

    # The scene

    @cached_property
    def is_chart(self) -> bool:
        return isinstance(self.scene.source, Chart)

    @cached_property
    def has_edges(self) -> bool:
        """Whether anything changes over the scene: not in a chart that is all background."""
        return not self.is_chart or len(self.scene.source.primitives) > 0

    @property
    def sigma(self) -> float:
        return paint.SIGMA if self.is_chart else 0.0

    @cached_property
    def half_um(self) -> tuple[float, float]:
        sensor = self.sensor
        return tuple(n * sensor.pixel_pitch_um / 2 for n in (sensor.cols, sensor.rows))

    @cached_property
    def _chief_ray(self) -> ChiefRayMap:
        return chief_ray_map(self.bank, "distortion" in self.force)

    @cached_property
    def _placed(self) -> Chart | PlacedRaster:
        if self.is_chart:
            return self.scene.source.placed(self.half_um[1])
        return self.scene.source.placed(*self.half_um, 0.0)

    @cached_property
    def seen_shares(self) -> np.ndarray:
        return seen_shares(self.levels, self.scene, self.half_um)

    def identity(self, scale: Scale) -> bool:
        """Return whether the raster's samples are those of the sim grid.

        One of another pitch is never identical, and placing a finer one takes a while.
        """
        return (
            not self.is_chart
            and bool(np.isclose(self._placed.pitch_um, scale.pitch_um, rtol=1e-9))
            and warp.is_identity(
                self.scene.source.placed(*self.half_um, scale.pitch_um), scale, self._chief_ray
            )
        )

    def _needed(self, grid: SimGrid, pitch_um: float) -> Needed:
        """Return the planes that each block needs; worked out once for all methods."""
        if (grid, pitch_um) not in self._found_needed:
            where = (self._placed, self.basis.coefficients, grid, pitch_um, self._chief_ray)
            found = (paint if self.is_chart else warp).planes_by_block(*where)
            self._found_needed[grid, pitch_um] = found
        return self._found_needed[grid, pitch_um]

    @cached_property
    def _found_needed(self) -> dict[tuple[SimGrid, float], Needed]:
        return {}

    def _source_s(self, grid: SimGrid, needed: Needed, edges_s: float) -> dict[str, float]:
        block = grid.block[0] * grid.block[1]
        if not self.is_chart:
            return {"warp": self.costs.seconds("warp", block * sum(needed.values()))}
        # The shader paints so many planes at once, each time all of the outlines.
        groups = [-(-count // paint.PLANES) for count in needed.values()]
        painted = self.costs.seconds("paint", block * sum(groups))
        return {"paint": painted + edges_s * max(groups, default=0)}

    # The PSFs

    @cached_property
    def _images(self) -> tuple[np.ndarray, Places]:
        # Sources around the sensor count too, and so do the nodes beyond them.
        farthest_um = float(np.hypot(*self.half_um) + np.sqrt(2) * self.reach_um)
        basis, lateral = self.basis, LATERAL in self.force
        given = lateral, basis.elsewhere, basis.wavelengths_nm
        return field_images(self.bank, basis.rates, farthest_um, *given)

    @property
    def images(self) -> np.ndarray:
        return self._images[0]

    @property
    def places(self) -> Places:
        return self._images[1]

    @cached_property
    def _mirrored(self) -> bool:
        return mirrored(self.images[:, 0], self.places)

    @cached_property
    def reach_um(self) -> float:
        return self.bank.psf.shape[-1] / 2 * self.bank.pitch_um + self.bank.lateral_um

    @cached_property
    def alias(self) -> Alias:
        """What sim grids cost."""
        return Alias(
            self.images,
            self.places,
            self.bank.pitch_um,
            self.sensor,
            self._placed,
            self.basis.coefficients,
            self._chief_ray,
            self.sigma,
            math.lcm(*self.sensor.period),
        )

    @property
    def coarse_stride(self) -> int:
        # Half a sample a pixel, but a whole one for 4 x 4 sites: between samples each would have
        # kernels of its own, and shaders/optics/columns sums four.
        return 4 if self.planes.period == 4 else 1

    @property
    def contrast(self) -> float:
        """By how much what PSFs lack far out counts more where the scene is dark."""
        return contrast_of(self._placed)

    def _edge(self, pitch_um: float) -> Edge:
        """Return the scene's edges on a sim grid."""
        pixel = max(round(self.sensor.pixel_pitch_um / pitch_um), 1)
        return Edge(self._edge_contrast, pixel)

    @cached_property
    def _edge_contrast(self) -> float:
        return edge_contrast(self._placed, self.scene.spectra.sum(axis=1), self.half_um)

    @property
    def coarse_pitch_um(self) -> float:
        return self.sensor.pixel_pitch_um * self.planes.period / self.coarse_stride

    @cached_property
    def _lost(self) -> dict[float, float]:
        """Return what cuts cost, by radius."""
        fit = [cut for cut in CUTS_UM if cut < self.reach_um / 2]
        where = (self.bank.pitch_um, self.coarse_pitch_um, self.sensor)
        probes = self.images[list(self.places.probes)]
        return {cut: cut_error(probes, *where, cut) for cut in fit}

    @cached_property
    def _tails(self) -> dict[float, tuple[float, tuple[int, int]]]:
        """Return what the tails' nodes cost and the fewest cells between them, by cut to try."""
        limit = self.accuracy.tolerance / self.contrast
        fit = [cut for cut, lost in self._lost.items() if lost <= limit]
        return {cut: self._tail_nodes(cut) for cut in fit[:CUTS_TRIED]}

    def _parts(self, cut_um: float | None) -> list[np.ndarray]:
        """Return the weights of the samples of the PSFs in each scale."""
        n = self.images.shape[-1]
        if cut_um is None:
            return [np.ones((n, n))]
        core = core_window(distances_um(n, self.bank.pitch_um), cut_um)
        return [core, 1 - core]

    def _first(self, weight: np.ndarray, pitch_um: float) -> FieldKernels:
        """Return kernels of the first plane in green, or the only channel: the list's middle.

        In all channels where the quantum efficiency of each goes with the place in its own way.
        """
        if self.basis.elsewhere is not None:
            return self._channels(weight, pitch_um)
        middle = len(self.sensor.channels) // 2
        images = self.images[:, :1, middle : middle + 1]
        return field_kernels(images, self.places, self.bank.pitch_um, pitch_um, weight)

    def _channels(self, weight: np.ndarray, pitch_um: float) -> FieldKernels:
        """Return kernels of the first plane in all channels."""
        images = self.images[:, :1]
        return field_kernels(images, self.places, self.bank.pitch_um, pitch_um, weight)

    def _tail_nodes(self, cut_um: float) -> tuple[float, tuple[int, int]]:
        """Return the error that the tails' nodes leave, and the fewest cells between them."""
        weight = self._parts(cut_um)[1]
        middle = len(self.sensor.channels) // 2
        # The tail holds some per cent of the energy, and its error counts as much less.
        images = self.images[self.places.main, 0, middle]
        share = float(((images * weight).sum(axis=(1, 2)) / images.sum(axis=(1, 2))).max())
        few, lag = cells_within(
            self._first(weight, self.coarse_pitch_um),
            self.coarse_pitch_um,
            self.reach_um,
            self.half_um,
            TAIL_SHARE * self.accuracy.tolerance / share,
            self.reach_um,
        )
        return lag * share, few


def held_um(kernels: FieldKernels, pitch_um: float, reach_um: float) -> float:
    """Return how far kernels of PSFs that reach so far are sampled: as they ring."""
    return max(reach_um, (RINGING - GUARD) * pitch_um) if kernels.ringing else reach_um


def _samples(oversampling: int) -> str:
    return f"{oversampling} sample{'s' * (oversampling > 1)}"


def shown_mixtures(scene: Scene) -> np.ndarray | None:
    """Return coefficients (P, M) of samples of a spectral photograph; None of other scenes.

    The samples lie on a lattice; each spectrum adds the sample with the largest share of it. A
    scene of bands shows smooth spectra: far fewer planes keep these apart than the bands
    themselves.
    """
    if isinstance(scene.source, Chart) or len(scene.spectra) <= FEW_SPECTRA:
        return None
    planes = scene.source.planes.reshape(len(scene.spectra), -1)
    total = planes.sum(axis=0, dtype=np.float64)
    lit = np.flatnonzero(total > 0)
    if not len(lit):
        return None
    share = planes[:, lit] / total[lit]
    lattice = np.linspace(0, len(lit) - 1, min(SHOWN, len(lit))).astype(int)
    return planes[:, lit[np.union1d(lattice, share.argmax(axis=1))]].T.astype(np.float64)


def _commonest_first(scene: Scene) -> np.ndarray:
    """Return the scene's spectra, those of most primitives first."""
    counts = np.zeros(len(scene.spectra))
    if isinstance(scene.source, Chart):
        np.add.at(counts, [shape.material for shape in scene.source.primitives], 1)
        counts[scene.source.background] = np.inf
    return np.argsort(-counts, kind="stable")

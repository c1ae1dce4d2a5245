"""The choice of planes, oversampling, cut, PSF nodes and blocks for a tolerance."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

from gpusim.optics.methods import METHODS, check_method
from gpusim.optics.spectral_basis import MAX_PLANES, camera_basis
from gpusim.plan.accuracy import Accuracy
from gpusim.plan.alias import Alias
from gpusim.plan.candidates import Candidate, RunnerUp, choose
from gpusim.plan.costs import LAVAPIPE, Costs
from gpusim.plan.density import Density, LensShare
from gpusim.plan.describe import describe
from gpusim.plan.halo import halo_levels
from gpusim.plan.mixtures import commonest_first, shown_mixtures
from gpusim.plan.problem import Problem
from gpusim.plan.reach import within_reach
from gpusim.plan.shares import ANGLE_SHARE, WORST_TO_RMS
from gpusim.plan.signal import brightest_e
from gpusim.plan.stages import Plan
from gpusim.plan.ways import candidates, scales_of
from gpusim.psf.field_bank import FieldBank
from gpusim.scene.scene import Scene
from gpusim.sensor.effects import EFFECTS
from gpusim.sensor.sensor import Sensor


def plan_optics(
    bank: FieldBank,
    sensor: Sensor,
    scene: Scene,
    accuracy: Accuracy,
    costs: Costs = LAVAPIPE,
    *,
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
    given = {"noise": noise, "method": method, "force": force, "exposure_s": exposure_s}
    return plans_optics(bank, sensor, scene, accuracy, costs, count=1, density=density, **given)[0]


def plans_optics(
    bank: FieldBank,
    sensor: Sensor,
    scene: Scene,
    accuracy: Accuracy,
    costs: Costs = LAVAPIPE,
    *,
    count: int,
    noise: bool = True,
    method: str | None = None,
    force: Collection[str] = (),
    exposure_s: float = math.inf,
    density: Density | None = None,
) -> list[Plan]:
    """Return the plan of `plan_optics`, and then those that it takes for the next cheapest.

    At most `count` in all; all meet the tolerance that the first one is made for.
    """
    corner_um = math.hypot(sensor.rows, sensor.cols) / 2 * sensor.pixel_pitch_um
    lens = None if density is None else LensShare(density, bank, corner_um)
    levels, bank = bank.levels, bank.levels[0]
    check_method(method)
    methods = METHODS if method is None else (method,)
    signal = (
        brightest_e(bank, sensor, scene, exposure_s),
        sensor.temporal_dark_noise_e,
        sensor.full_well_e,
    )
    relative = accuracy.relative(*signal)
    shown = shown_mixtures(scene)
    given = {"bank": bank, "sensor": sensor, "scene": scene, "costs": costs, "force": force}
    given |= {"levels": levels, "aliases": {}}
    last: Problem | None = None

    def attempt(tolerance: float) -> _Attempt:
        nonlocal last
        basis = camera_basis(
            bank,
            sensor,
            scene.spectra,
            0.0 if "spectra" in force else WORST_TO_RMS * tolerance,
            commonest_first(scene),
            place_error=ANGLE_SHARE * tolerance,
            wavelengths_nm=scene.wavelengths_nm,
            mixtures=shown,
        )
        asked = replace(relative, tolerance=tolerance)
        if lens is not None:
            asked = replace(asked, tolerance=lens.left_of(tolerance))
        if last is not None and last.has_basis(basis):
            problem = last.to(asked)
        else:
            problem = Problem(accuracy=asked, basis=basis, **given)
        last = problem
        ways = candidates(problem, methods, "tail" in force)
        return _Attempt(problem, ways, choose(ways)[0], lens, tolerance)

    floor = None if lens is None else lens.excess
    found, shortfall = within_reach(attempt, accuracy, accuracy.share(*signal), floor)
    return found.plans(count, noise, shortfall)


def alias_of(bank: FieldBank, sensor: Sensor, scene: Scene, accuracy: Accuracy) -> Alias:
    """Return what predicts the errors of sim grids, as the planner makes it for a tolerance."""
    core, allowed = bank.levels[0], WORST_TO_RMS * accuracy.tolerance
    basis = camera_basis(
        core,
        sensor,
        scene.spectra,
        allowed,
        commonest_first(scene),
        place_error=ANGLE_SHARE * allowed,
        wavelengths_nm=scene.wavelengths_nm,
        mixtures=shown_mixtures(scene),
    )
    seen = {"bank": core, "levels": bank.levels, "sensor": sensor, "scene": scene, "basis": basis}
    return Problem(**seen, accuracy=accuracy, costs=LAVAPIPE, force=()).alias


def _plan(
    problem: Problem,
    chosen: Candidate,
    lens: LensShare | None,
    *,
    runners_up: tuple[RunnerUp, ...],
    noise: bool,
    shortfall: str,
) -> Plan:
    """Return a candidate as a plan."""
    scales = scales_of(problem, chosen)
    halo = halo_levels(problem.levels, problem.accuracy, problem.seen_shares)
    of_lens = () if lens is None else lens.stages
    stages = describe(problem, chosen, scales[0], of_lens, halo, noise=noise)
    costs_s = {stage.name: stage.predicted_cost_s or 0.0 for stage in stages}
    return Plan(
        basis=problem.basis,
        scales=scales,
        stages=stages,
        name=chosen.name,
        predicted_s=sum(part.layout.frame_s for part in chosen.parts)
        + sum(costs_s[effect.name] for effect in EFFECTS),
        kernels_s=sum(part.layout.kernels_s for part in chosen.parts) + costs_s["point sources"],
        rates=problem.costs.source,
        runners_up=runners_up,
        halo=halo,
        highlights=problem.highlights,
        tolerance=problem.accuracy.tolerance,
        shortfall=shortfall,
    )


@dataclass(frozen=True, eq=False)
class _Attempt:
    """What came of planning for one tolerance: see `gpusim.plan.reach.Attempt`."""

    problem: Problem
    candidates: list[Candidate]
    chosen: Candidate
    lens: LensShare | None
    tolerance: float

    def plans(self, count: int, noise: bool, shortfall: str) -> list[Plan]:
        """Return the chosen candidate as a plan, and then the next cheapest; `count` at most."""
        rest = [one for one in self.candidates if one is not self.chosen]
        others = [one for one in rest if one.parts and one.excess <= 1]
        taken = [self.chosen, *sorted(others, key=lambda one: one.cost_s)][:count]
        runners_up = choose(self.candidates)[1]
        return [
            _plan(
                self.problem,
                one,
                self.lens,
                runners_up=runners_up if one is self.chosen else (),
                noise=noise,
                shortfall=shortfall,
            )
            for one in taken
        ]

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

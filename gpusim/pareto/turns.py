"""Render, certify and time all variants in turns; find the planner's regret.

The errors are certified, not estimated: all plans are held against the exact model at the same
pixels, which are evaluated once. Times are medians over rounds through all plans, so that a machine
that is faster now and slower then is so for all; ratios are taken within a round.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np

from gpusim.calibrate.rates import adapter_costs
from gpusim.camera import Camera
from gpusim.certify import Certificate, Measure, Share, compare, glare_at
from gpusim.certify.budget import WORST_TO_RMS
from gpusim.errors import UserError
from gpusim.gpu import Device, default_device
from gpusim.pareto import knobs
from gpusim.pareto.knobs import Variant
from gpusim.plan import Accuracy, Plan
from gpusim.plan.deadline import predicted_parts
from gpusim.render import Renderer
from gpusim.scene.scene import Scene

ROUNDS = 3  # at least: the fewest of which a median leaves out one that was disturbed
FURTHER = 2  # prepared frames of each plan in a round
BUDGET_S = 60.0  # of all rounds together
KINDS = ("frame", "first")  # what is timed: a prepared frame, and a first one


@dataclass(frozen=True)
class Point:
    """What became of a variant.

    Attributes
    ----------
    family, name : str
    chosen : bool
        Whether it is the plan that the tolerance asked for leads to.
    tolerance : float
        Tolerance that the planner was given, in the unit of the sweep.
    plan : str
        How it convolves, where the planner made the plan; empty of knobs that were turned.
    predicted : float or None
        Error by the planner's models, relative: root of the sum of the parts' squares.
    total_rms, total_worst, engine_rms : float or None
        Certified, in the unit of the sweep: all parts of the error, and the engine's alone.
    met : bool
        Whether the certificate meets its tolerance.
    frame_s, frame_low_s, frame_high_s : float or None
        Seconds of a prepared frame: median over the rounds, and quartiles.
    first_s, first_low_s, first_high_s : float or None
        Seconds of a first frame. Planning, placing the scene and making the kernels are included.
        The bank of the lens is at hand, and all shaders are compiled. The planning is that of the
        chosen plan.
    regret, first_regret : float or None
        Time of the planner's plans that meet their tolerance, over that of the fastest of all plans
        that meet the same tolerance. It is the median of the ratios within each round; 1 at least.
    fastest, first_fastest : str
        Which that is.
    samples_per_pixel, nodes, reach_samples : str
        One text with the values of all scales.
    planes : int or None
    obstacle : str
        Why there is no frame; empty where there is one.
    """

    family: str
    name: str
    chosen: bool
    tolerance: float
    plan: str = ""
    predicted: float | None = None
    total_rms: float | None = None
    total_worst: float | None = None
    engine_rms: float | None = None
    met: bool = False
    frame_s: float | None = None
    frame_low_s: float | None = None
    frame_high_s: float | None = None
    first_s: float | None = None
    first_low_s: float | None = None
    first_high_s: float | None = None
    regret: float | None = None
    fastest: str = ""
    first_regret: float | None = None
    first_fastest: str = ""
    samples_per_pixel: str = ""
    nodes: str = ""
    reach_samples: str = ""
    planes: int | None = None
    obstacle: str = ""


@dataclass(frozen=True)
class Sweep:
    """All points, the chosen one first, and what they cost to certify and to time.

    Attributes
    ----------
    points : tuple of Point
    certificate : Certificate
        Certificate of the chosen plan.
    shortfall : str
        Shortfall of the chosen plan: see `gpusim.plan.Plan`.
    rounds : int
        Rounds in which all were timed.
    """

    points: tuple[Point, ...]
    certificate: Certificate
    shortfall: str
    rounds: int


@dataclass(eq=False)
class _Run:
    """A variant that renders: its plan, its certificate, and its times by round."""

    variant: Variant
    plan: Plan
    errors: dict[str, float]
    certificate: Certificate
    times: dict[str, list[float]] = field(default_factory=lambda: {kind: [] for kind in KINDS})

    def within(self, tolerance: float) -> bool:
        """Return whether the certified errors meet a tolerance."""
        rms, worst = self.certificate.total_rms, self.certificate.total_worst
        return rms <= tolerance and worst <= WORST_TO_RMS * tolerance


def sweep(
    camera: Camera,
    scene: Scene,
    accuracy: Accuracy,
    exposure_s: float,
    *,
    device: Device | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    budget_s: float = BUDGET_S,
    leave_out: Collection[str] = (),
    clock: Callable[[], float] = time.perf_counter,
) -> Sweep:
    """Render, certify and time the variants around the plan for an accuracy.

    Parameters
    ----------
    camera, scene
    accuracy : Accuracy
        What the chosen plan is made for; its probes are those of all.
    exposure_s : float
    device : Device, optional
    progress : callable, optional
        Called with (what, done, total).
    budget_s : float
        Seconds for all rounds together: no round is begun that would exceed them, but ROUNDS are.
    leave_out : collection of str
        Names of variants that are of no interest.
    clock : callable
        By which frames are timed. `time.process_time` counts what this process took of the
        processors, all threads together: on a busy machine whose adapter is its processor it tells
        plans apart where the wall clock does not.

    Raises
    ------
    UserError
        When the chosen plan cannot be rendered. Others that cannot are points with an obstacle.
    """
    report, device = progress or (lambda what, done, total: None), device or default_device()
    costs = adapter_costs(device)
    chosen = Renderer(camera, scene, accuracy, device, report, exposure_s=exposure_s, costs=costs)
    accuracy = chosen.accuracy  # that of a time is found
    known = _known(camera, chosen)

    def renderer(asked: Accuracy, plan: Plan | None = None, method: str | None = None) -> Renderer:
        given = {"exposure_s": exposure_s, "plan": plan, "costs": costs, "method": method}
        return Renderer(known, scene, asked, device, **given)

    # By transforms: the knobs that are turned are theirs.
    turned = cache(lambda: renderer(replace(accuracy, probes=0), method="fft"))
    try:
        named = knobs.variants(accuracy, chosen.period)
        everything = [variant for variant in named if variant.name not in leave_out]
        first = chosen.capture(
            exposure_s,
            progress=lambda what, *step: report("truth", *step) if what == "certify" else None,
        )
        judge = _judge(camera, chosen, first.certificate, exposure_s)
        runs = [_Run(everything[0], chosen.plan, {}, first.certificate)]
        obstacles: dict[Variant, str] = {}
        for done, variant in enumerate(everything[1:], start=1):
            report("certificates", done, len(everything))
            try:
                made = _made(variant, turned, renderer, [run.plan for run in runs])
            except UserError as obstacle:
                obstacles[variant] = _in_words(obstacle)
                continue
            if made is None:
                continue
            one, errors = made
            try:
                rate = one.capture(exposure_s, keep=("rate",)).rate
                found = judge(rate, one.glare, variant.accuracy)
                runs.append(_Run(variant, one.plan, errors, found))
            finally:
                one.release()
        report("certificates", len(everything), len(everything))
    finally:
        chosen.release()
        if turned.cache_info().currsize:
            turned().release()
    rounds = _time(runs, renderer, exposure_s, budget_s=budget_s, report=report, clock=clock)
    points = {run.variant: _point(run, runs) for run in runs}
    points |= {variant: _missing(variant, why) for variant, why in obstacles.items()}
    in_order = tuple(points[variant] for variant in everything if variant in points)
    return Sweep(in_order, first.certificate, runs[0].plan.shortfall, rounds)


def _in_words(obstacle: UserError) -> str:
    """Return why a variant cannot be rendered."""
    return f"{obstacle.problem} {obstacle.value}; allowed: {obstacle.allowed}"


def _known(camera: Camera, chosen: Renderer) -> SimpleNamespace:
    """Return a camera with the bank of the chosen plan.

    Other plans know no more of the lens, and do not wait for it.
    """
    return SimpleNamespace(
        title=camera.title,
        sensor=camera.sensor,
        bank=lambda *_, **__: chosen.bank,
        lens=SimpleNamespace(title=camera.lens.title),
    )


def _made(
    variant: Variant,
    turned: Callable[[], Renderer],
    renderer: Callable[..., Renderer],
    others: Sequence[Plan],
) -> tuple[Renderer, dict[str, float]] | None:
    """Return what renders a variant, with the errors that turning the knobs of `turned` predicts.

    None where its plan is one of the others under another name.
    """
    plan, errors = variant.change(turned()) if variant.change else (None, {})
    if variant.change and _kernels(plan) in [_kernels(other) for other in others]:
        return None
    return renderer(replace(variant.accuracy, probes=0), plan), errors


def _judge(
    camera: Camera, chosen: Renderer, certificate: Certificate, exposure_s: float
) -> Callable[[np.ndarray, np.ndarray, Accuracy], Certificate]:
    """Return what certifies other renders at the same probes, by the exact model evaluated there.

    The parts of the error that are the lens's and the sensor's are those of the chosen plan: other
    plans have the same bank, and the same sensor after them.
    """
    sensor, count = camera.sensor, certificate.probes
    pixels = np.array([(probe.row, probe.col) for probe in certificate.points])
    truth = np.array([probe.truth for probe in certificate.points]) / exposure_s
    truth -= glare_at(sensor, chosen.glare, pixels)
    bank = Share(certificate.bank_rms, certificate.bank_worst, count)
    readout = Share(certificate.sensor_rms, certificate.sensor_worst, count)

    def judge(rate: np.ndarray, glare: np.ndarray, asked: Accuracy) -> Certificate:
        whole = truth + glare_at(sensor, glare, pixels)
        at = rate[tuple(pixels.T)].astype(np.float64)
        return compare(
            Measure(sensor, exposure_s, asked),
            pixels,
            whole,
            at,
            seconds=certificate.seconds,
            bank=bank,
            readout=readout,
            window=certificate.window,
            notes=certificate.notes,
        )

    return judge


def _kernels(plan: Plan) -> tuple:
    """Return what tells the work of plans apart: grids, methods, and how the PSFs are cut."""
    return tuple(
        (scale.grid, scale.method, scale.pitch_um, float(scale.kernels.splines[0, 0, 0].sum()))
        for scale in plan.scales
    )


def _time(
    runs: Sequence[_Run],
    renderer: Callable[..., Renderer],
    exposure_s: float,
    *,
    budget_s: float,
    report: Callable[[str, int, int], None],
    clock: Callable[[], float],
) -> int:
    """Time all plans in rounds, there and back; return how many rounds.

    Everything is compiled by now: every plan has rendered a frame. To each first frame counts the
    planning of the chosen plan in the same round.
    """

    def frame(one: Renderer) -> None:
        one.drop_light()  # what is timed is the convolution
        one.capture(exposure_s)

    def seconds(work: Callable[[], object]) -> float:
        begun = clock()
        work()
        return clock() - begun

    started = time.perf_counter()
    rounds = 0
    while True:
        for done, run in enumerate(runs if rounds % 2 == 0 else runs[::-1]):
            report(f"round {rounds + 1}", done, len(runs))
            begun = clock()
            one = renderer(replace(run.variant.accuracy, probes=0), run.plan)
            try:
                one.capture(exposure_s)
                run.times["first"].append(clock() - begun)
                frames = [seconds(partial(frame, one)) for _ in range(FURTHER)]
                run.times["frame"].append(float(np.median(frames)))
                if run is runs[0]:
                    planning_s = seconds(one.planning.plan)
            finally:
                one.release()
        for run in runs:
            run.times["first"][-1] += planning_s
        rounds += 1
        report(f"round {rounds}", len(runs), len(runs))
        spent = time.perf_counter() - started
        if rounds >= ROUNDS and spent * (rounds + 1) / rounds > budget_s:
            return rounds


def _regret(run: _Run, runs: Sequence[_Run], kind: str) -> tuple[float | None, str]:
    """Return a plan's time over that of the fastest that meets its tolerance, and which it is."""
    tolerance = run.variant.accuracy.tolerance
    if run.variant.family != knobs.CHOSEN or not run.within(tolerance):
        return None, ""
    fastest = min(
        (one for one in runs if one.within(tolerance)),
        key=lambda one: float(np.median(one.times[kind])),
    )
    ratios = np.array(run.times[kind]) / np.array(fastest.times[kind])
    return max(1.0, float(np.median(ratios))), fastest.variant.name


def _point(run: _Run, runs: Sequence[_Run]) -> Point:
    plan, variant, certificate = run.plan, run.variant, run.certificate
    parts = {**predicted_parts(plan), **run.errors}
    grids = [scale.grid for scale in plan.scales]
    times = {}
    for kind in KINDS:
        low, middle, high = np.percentile(run.times[kind], (25, 50, 75)).tolist()
        times |= {f"{kind}_s": middle, f"{kind}_low_s": low, f"{kind}_high_s": high}
    (regret, fastest), (first_regret, first_fastest) = (_regret(run, runs, kind) for kind in KINDS)
    return Point(
        family=variant.family,
        name=variant.name,
        chosen=run is runs[0],
        tolerance=variant.accuracy.tolerance,
        plan="" if run.errors else plan.name,
        predicted=math.sqrt(sum(error**2 for error in parts.values())),
        total_rms=certificate.total_rms,
        total_worst=certificate.total_worst,
        engine_rms=certificate.engine_rms,
        met=run.within(variant.accuracy.tolerance),
        **times,
        regret=regret,
        fastest=fastest,
        first_regret=first_regret,
        first_fastest=first_fastest,
        samples_per_pixel=" + ".join(f"{grid.oversampling:g}" for grid in grids),
        nodes=" + ".join(f"{grid.nodes[0]} x {grid.nodes[1]}" for grid in grids),
        reach_samples=" + ".join(str(grid.half_size) for grid in grids),
        planes=plan.basis.coefficients.shape[1],
    )


def _missing(variant: Variant, why: str) -> Point:
    """Return the point of a variant that cannot be rendered."""
    return Point(variant.family, variant.name, False, variant.accuracy.tolerance, obstacle=why)

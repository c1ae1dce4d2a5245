"""Error against run time: plans around the chosen one, each rendered, timed and certified.

The errors are certified, not estimated: all plans are held against the truth model at the same
pixels, which are evaluated once.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gpusim.camera import Camera
from gpusim.certify import Certificate, choose_probes, compare, glare_at, true_rates
from gpusim.chain import Renderer
from gpusim.errors import UserError
from gpusim.gpu import Device
from gpusim.lens.places import Places
from gpusim.optics.convolve import Scale
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import core_window, distances_um, field_images, field_kernels
from gpusim.optics.methods import METHODS
from gpusim.plan import Accuracy, Plan
from gpusim.plan.optics import ALIAS_TO_RMS, WORST_TO_RMS
from gpusim.plan.optics import CUTS_UM as PLANNED_CUTS_UM
from gpusim.plan.predict import alias_error, cut_error
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene

TOLERANCES = (3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
NODE_FACTORS = (0.25, 0.5, 0.7, 1.4, 2.0)  # of the chosen cells along each axis
OVERSAMPLINGS = (2, 4)
CUTS_UM = (6.0, 10.0, 16.0, 24.0)
REPEATS = 3  # of which the fastest counts, after one to warm up
GUARD = 8  # sim samples around the kernels, as in gpusim.plan.layout
TRANSFORMS = (256, 512, 1024)
CHOSEN = "planner"


@dataclass(frozen=True)
class Variant:
    """One way to render.

    Attributes
    ----------
    family : str
        What is varied: plans of one family make one line of the diagram.
    name : str
    accuracy : Accuracy
        From which the planner makes the plan.
    change : callable, optional
        Takes the renderer of the chosen plan and returns the plan to use instead, with the errors
        predicted of the parts that differ.
    """

    family: str
    name: str
    accuracy: Accuracy
    change: Callable[[Renderer], tuple[Plan, dict[str, float]]] | None = None


@dataclass(frozen=True)
class Point:
    """What became of a variant.

    Attributes
    ----------
    family, name : str
    chosen : bool
        Whether it is the plan that the tolerance asked for leads to.
    tolerance : float
        That the planner was given, in the unit of the sweep.
    predicted : float or None
        Error by the planner's models, relative: root of the sum of the parts' squares.
    rms_relative, worst_relative, rms_sigma, worst_sigma : float or None
        Certified.
    wall_s, prepare_s : float or None
        Of a frame, and of what further frames do not spend.
    samples_per_pixel, nodes, reach_samples : str
        Of each scale.
    planes : int or None
    obstacle : str
        Why there is no frame; empty where there is one.
    """

    family: str
    name: str
    chosen: bool
    tolerance: float
    predicted: float | None = None
    rms_relative: float | None = None
    worst_relative: float | None = None
    rms_sigma: float | None = None
    worst_sigma: float | None = None
    wall_s: float | None = None
    prepare_s: float | None = None
    samples_per_pixel: str = ""
    nodes: str = ""
    reach_samples: str = ""
    planes: int | None = None
    obstacle: str = ""


@dataclass(frozen=True)
class Sweep:
    """All points, the chosen one first, and what they cost to certify."""

    points: tuple[Point, ...]
    probes: int
    truth_s: float


def variants(accuracy: Accuracy, sensor_period: int) -> Iterator[Variant]:
    """Yield the chosen plan, the planner's plans at other tolerances, and single knobs around it.

    Another method or knob is one more line here.
    """
    yield Variant(CHOSEN, f"tolerance {accuracy.text}", accuracy)
    step = accuracy.tolerance / 1e-3  # the same steps below and above, in either unit
    for tolerance in TOLERANCES if accuracy.unit == "relative" else [step * t for t in TOLERANCES]:
        if not math.isclose(tolerance, accuracy.tolerance):
            try:
                other = replace(accuracy, tolerance=tolerance)
            except UserError:  # beyond the range
                continue
            yield Variant(CHOSEN, f"tolerance {other.text}", other)
    for method in METHODS:
        if method != "fft":  # the chosen plan's
            yield Variant("method", method, accuracy, _method(method))
    for factor in NODE_FACTORS:
        yield Variant("PSF nodes", f"{factor:g} x the nodes", accuracy, _nodes(factor))
    for oversampling in OVERSAMPLINGS:
        if oversampling * sensor_period <= 8:
            name = f"{oversampling} samples a pixel"
            yield Variant("oversampling", name, accuracy, _oversampling(oversampling))
    for cut_um in CUTS_UM:
        yield Variant("cut of the PSF", f"core of {cut_um:g} um", accuracy, _cut(cut_um))
    yield Variant("cut of the PSF", "not cut", accuracy, _cut(None))


def _method(method: str) -> Callable[[Renderer], tuple[Plan, dict[str, float]]]:
    """Return what plans for another method, whatever it costs."""

    def change(renderer: Renderer) -> tuple[Plan, dict[str, float]]:
        return renderer.planned(method), {}

    return change


def _nodes(factor: float) -> Callable[[Renderer], tuple[Plan, dict[str, float]]]:
    """Return what changes the cells between PSF nodes, on all scales, by a factor."""

    def change(renderer: Renderer) -> tuple[Plan, dict[str, float]]:
        plan = renderer.plan
        scales = []
        for scale in plan.scales:
            cells = tuple(max(1, round(count * factor)) for count in scale.grid.cells)
            scales.append(replace(scale, grid=replace(scale.grid, cells=cells)))
        first, now = plan.scales[0].grid.cells, scales[0].grid.cells
        # Linear interpolation's error goes with the spacing squared.
        growth = max(a / b for a, b in zip(first, now, strict=True)) ** 2
        before = predicted_parts(plan)["nodes"]
        return replace(plan, scales=tuple(scales)), {"nodes": before * growth}

    return change


def _oversampling(oversampling: int) -> Callable[[Renderer], tuple[Plan, dict[str, float]]]:
    """Return what puts the finest scale on another sim grid, with the chosen nodes."""

    def change(renderer: Renderer) -> tuple[Plan, dict[str, float]]:
        plan, sensor = renderer.plan, renderer.camera.sensor
        first = plan.scales[0]
        reach_um = (first.grid.half_size - GUARD) * first.pitch_um
        cut_um = None
        if len(plan.scales) > 1:  # the core must go on matching the tail
            cut_um = reach_um = max(cut for cut in PLANNED_CUTS_UM if cut <= reach_um)
        part = _core(renderer, cut_um)
        fine = _fine(renderer, oversampling, reach_um, part, first.name)
        alias = (
            ALIAS_TO_RMS * alias_error(renderer.bank, oversampling, sensor, first.sigma)
            if isinstance(renderer.scene.source, Chart)
            else 0.0
        )
        return replace(plan, scales=(fine, *plan.scales[1:])), {"alias": alias}

    return change


def _cut(cut_um: float | None) -> Callable[[Renderer], tuple[Plan, dict[str, float]]]:
    """Return what cuts the PSFs elsewhere, with the chosen nodes for the core."""

    def change(renderer: Renderer) -> tuple[Plan, dict[str, float]]:
        plan, sensor, bank = renderer.plan, renderer.camera.sensor, renderer.bank
        first = plan.scales[0]
        oversampling = round(first.grid.oversampling)
        whole_um = _reach_um(renderer)
        core = _core(renderer, cut_um)
        if cut_um is None:
            whole = _fine(renderer, oversampling, whole_um, core, "whole")
            return replace(plan, scales=(whole,)), {"cut": 0.0}
        fine = _fine(renderer, oversampling, cut_um, core, "core")
        period = renderer.period
        stride = 4 if period == 4 else 1
        pitch_um = sensor.pixel_pitch_um * period / stride
        images, places = _images(renderer)
        kernels = field_kernels(images, places, bank.pitch_um, pitch_um, 1 - core)
        cells = plan.scales[1].grid.cells if len(plan.scales) > 1 else (4, 4)
        grid = _grid(renderer, stride, whole_um / pitch_um, cells)
        tail = Scale("tail", grid, pitch_um, first.sigma, kernels)
        lost = cut_error(images[places.main], bank.pitch_um, pitch_um, sensor, cut_um)
        return replace(plan, scales=(fine, tail)), {"cut": lost}

    return change


def _images(renderer: Renderer) -> tuple[np.ndarray, Places]:
    """Return the channel kernels at the fields that a plan needs, as `plan_optics` takes them."""
    bank, sensor = renderer.bank, renderer.camera.sensor
    corner_um = math.hypot(sensor.rows, sensor.cols) * sensor.pixel_pitch_um / 2
    farthest_um = corner_um + math.sqrt(2) * _reach_um(renderer)
    basis = renderer.plan.basis
    return field_images(bank, basis.rates, farthest_um, elsewhere=basis.elsewhere)


def _reach_um(renderer: Renderer) -> float:
    """Return the distance from its chief ray to which a whole PSF reaches."""
    bank = renderer.bank
    return bank.psf.shape[-1] / 2 * bank.pitch_um + bank.lateral_um


def _core(renderer: Renderer, cut_um: float | None) -> np.ndarray:
    """Return the weight of the samples of the PSFs that lie in the core."""
    n = _images(renderer)[0].shape[-1]
    if cut_um is None:
        return np.ones((n, n))
    return core_window(distances_um(n, renderer.bank.pitch_um), cut_um)


def _fine(
    renderer: Renderer, oversampling: int, reach_um: float, part: np.ndarray, name: str
) -> Scale:
    """Return the finest scale at another oversampling or reach."""
    sensor, first = renderer.camera.sensor, renderer.plan.scales[0]
    pitch_um = sensor.pixel_pitch_um / oversampling
    images, places = _images(renderer)
    kernels = field_kernels(images, places, renderer.bank.pitch_um, pitch_um, part)
    stride = oversampling * renderer.period
    grid = _grid(renderer, stride, reach_um / pitch_um, first.grid.cells)
    return Scale(name, grid, pitch_um, first.sigma, kernels)


def _grid(renderer: Renderer, stride: int, reach: float, cells: tuple[int, int]) -> SimGrid:
    """Return a sim grid of kernels that reach so many samples, in the shortest transform."""
    sensor = renderer.camera.sensor
    half = math.ceil((reach + GUARD) / stride) * stride
    for length in TRANSFORMS:
        if length - 2 * half >= max(8 * stride, length // 4):
            where = sensor.rows, sensor.cols, stride, renderer.period, length, half, cells
            return SimGrid(*where, renderer.layers)
    raise UserError(
        "The kernels are too wide for the longest transform.",
        field="reach",
        value=f"{2 * half} samples",
        allowed=f"{TRANSFORMS[-1] * 3 // 4}",
    )


def predicted_parts(plan: Plan) -> dict[str, float]:
    """Return the planner's predicted errors by part, relative: RMS, and of cuts the bound."""
    of = {stage.name: stage.predicted_error or 0.0 for stage in plan.stages if stage.runs}
    # The planes' prediction is that of the worst spectrum in its weakest channel.
    planes = max(of.get("paint", 0.0), of.get("warp", 0.0)) / WORST_TO_RMS
    nodes = max(of.get(stage, 0.0) for stage in ("columns", "direct"))  # by method
    return {"planes": planes, "alias": of.get("rows", 0.0), "nodes": nodes}


def sweep(
    camera: Camera,
    scene: Scene,
    accuracy: Accuracy,
    exposure_s: float,
    device: Device | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Sweep:
    """Render, time and certify the variants around the plan for an accuracy.

    Parameters
    ----------
    camera, scene
    accuracy : Accuracy
        What the chosen plan is made for; its probes are those of all.
    exposure_s : float
    device : Device, optional
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    UserError
        When the chosen plan cannot be rendered. Others that cannot are points with an obstacle.
    """
    report = progress or (lambda what, done, total: None)
    sensor = camera.sensor
    unprobed = replace(accuracy, probes=0)
    # By transforms: the knobs that are turned are theirs.
    chosen = Renderer(camera, scene, unprobed, device, exposure_s=exposure_s, method="fft")
    try:
        all_of_them = list(variants(accuracy, chosen.period))
        rate, seconds = _timed(chosen, exposure_s)
        pixels = choose_probes(rate, math.lcm(*sensor.period), accuracy.probes)
        started = time.perf_counter()
        truth = true_rates(
            chosen.bank,
            sensor,
            scene,
            chosen.placed,
            pixels,
            lambda done, total: report("truth", done, total),
        )
        truth_s = time.perf_counter() - started

        def judged(rendered: np.ndarray, renderer: Renderer, asked: Accuracy) -> Certificate:
            whole = truth + glare_at(sensor, renderer.glare, pixels)
            at = rendered[tuple(pixels.T)].astype(np.float64)
            return compare(sensor, pixels, whole, at, exposure_s, asked, truth_s)

        certificate = judged(rate, chosen, accuracy)
        points = [_point(all_of_them[0], chosen, {}, certificate, seconds, chosen=True)]
        for done, variant in enumerate(all_of_them[1:], start=1):
            report("variants", done, len(all_of_them))
            points.append(_rendered(variant, chosen, exposure_s, judged))
        report("variants", len(all_of_them), len(all_of_them))
    finally:
        chosen.release()
    return Sweep(tuple(points), len(pixels), truth_s)


def _rendered(
    variant: Variant, chosen: Renderer, exposure_s: float, judged: Callable[..., Certificate]
) -> Point:
    """Render, time and certify one variant."""
    unprobed = replace(variant.accuracy, probes=0)
    try:
        plan, errors = variant.change(chosen) if variant.change else (None, {})
        renderer = Renderer(
            chosen.camera, chosen.scene, unprobed, chosen.device, exposure_s=exposure_s, plan=plan
        )
    except UserError as obstacle:
        name, tolerance = variant.name, variant.accuracy.tolerance
        why = f"{obstacle.problem} {obstacle.value}; allowed: {obstacle.allowed}"
        return Point(variant.family, name, False, tolerance, obstacle=why)
    try:
        rate, seconds = _timed(renderer, exposure_s)
        return _point(variant, renderer, errors, judged(rate, renderer, variant.accuracy), seconds)
    finally:
        renderer.release()


def _timed(renderer: Renderer, exposure_s: float) -> tuple[np.ndarray, float]:
    """Return the frame's electrons/s and the least seconds of some runs, after one to warm up."""
    captures = [renderer.capture(exposure_s, keep=("rate",)) for _ in range(1 + REPEATS)]
    return captures[0].rate, min(capture.wall_s for capture in captures[1:])


def _point(
    variant: Variant,
    renderer: Renderer,
    errors: dict[str, float],
    certificate: Certificate,
    seconds: float,
    chosen: bool = False,
) -> Point:
    plan = renderer.plan
    parts = {**predicted_parts(plan), **errors}
    grids = [scale.grid for scale in plan.scales]
    return Point(
        family=variant.family,
        name=variant.name,
        chosen=chosen,
        tolerance=variant.accuracy.tolerance,
        predicted=math.sqrt(sum(error**2 for error in parts.values())),
        rms_relative=certificate.rms_relative,
        worst_relative=certificate.worst_relative,
        rms_sigma=certificate.rms_sigma,
        worst_sigma=certificate.worst_sigma,
        wall_s=seconds,
        prepare_s=sum(renderer.prepare_s.values()),
        samples_per_pixel=" + ".join(f"{grid.oversampling:g}" for grid in grids),
        nodes=" + ".join(f"{grid.nodes[0]} x {grid.nodes[1]}" for grid in grids),
        reach_samples=" + ".join(str(grid.half_size) for grid in grids),
        planes=plan.basis.coefficients.shape[1],
    )

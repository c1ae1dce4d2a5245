"""Plans around the chosen one: other tolerances and methods, and single knobs turned by hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gpusim.errors import UserError
from gpusim.optics.convolve import Scale
from gpusim.optics.grid import SimGrid
from gpusim.optics.images import field_images
from gpusim.optics.kernels import core_window, distances_um, field_kernels
from gpusim.optics.methods import METHODS
from gpusim.plan import Accuracy, Plan
from gpusim.plan.blocks import TRANSFORMS
from gpusim.plan.choice import alias_of
from gpusim.plan.deadline import predicted_parts
from gpusim.plan.predict import GUARD, cut_error
from gpusim.plan.problem import CUTS_UM as PLANNED_CUTS_UM
from gpusim.plan.ways import LARGEST_STRIDE, held_um
from gpusim.psf.places import Places
from gpusim.render import Renderer

TOLERANCES = (3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
NODE_FACTORS = (0.25, 0.5, 0.7, 1.4, 2.0)  # of the chosen cells along each axis
OVERSAMPLINGS = (2, 4)
CUTS_UM = (6.0, 10.0, 16.0, 24.0)
RUNNERS_UP = 3  # plans that the planner takes for the next cheapest
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
        Accuracy from which the planner makes the plan.
    change : callable, optional
        Takes a renderer whose plan is the cheapest by transforms for the accuracy, and returns the
        plan to use instead, with the errors predicted of the parts that differ.
    """

    family: str
    name: str
    accuracy: Accuracy
    change: Callable[[Renderer], tuple[Plan, dict[str, float]]] | None = None


def variants(accuracy: Accuracy, sensor_period: int) -> Iterator[Variant]:
    """Yield the chosen plan, the planner's plans at other tolerances, and others around it.

    Others are the planner's runners-up, its plans for each method, and single knobs turned on its
    plan for transforms. Another method or knob is one more line here.
    """
    yield Variant(CHOSEN, f"tolerance {accuracy.text}", accuracy)
    step = accuracy.tolerance / 1e-3  # the same steps below and above, in either unit
    for tolerance in TOLERANCES if accuracy.unit == "relative" else [step * t for t in TOLERANCES]:
        if not math.isclose(tolerance, accuracy.tolerance):
            try:
                # Without best effort: one that cannot be met is a point that says so.
                other = replace(accuracy, tolerance=tolerance, best_effort=False)
            except UserError:  # beyond the range
                continue
            yield Variant(CHOSEN, f"tolerance {other.text}", other)
    for number in range(1, RUNNERS_UP + 1):
        yield Variant("runner-up", f"runner-up {number}", accuracy, _runner_up(number))
    for method in METHODS:
        yield Variant("method", f"by {method}", accuracy, _method(method))
    for factor in NODE_FACTORS:
        yield Variant("PSF nodes", f"{factor:g} x the nodes", accuracy, _nodes(factor))
    for oversampling in OVERSAMPLINGS:
        if oversampling * sensor_period <= LARGEST_STRIDE:
            name = f"{oversampling} samples a pixel"
            yield Variant("oversampling", name, accuracy, _oversampling(oversampling))
    for cut_um in CUTS_UM:
        yield Variant("cut of the PSF", f"core of {cut_um:g} um", accuracy, _cut(cut_um))
    yield Variant("cut of the PSF", "not cut", accuracy, _cut(None))


def _runner_up(number: int) -> Callable[[Renderer], tuple[Plan, dict[str, float]]]:
    """Return what takes a plan that lost by its predicted time alone."""

    def change(renderer: Renderer) -> tuple[Plan, dict[str, float]]:
        plans = renderer.planning.plans(1 + RUNNERS_UP)
        if number >= len(plans):
            raise UserError(
                "There is no such plan within the tolerance.",
                value=f"runner-up {number}",
                allowed=f"{len(plans) - 1} at most",
            )
        return plans[number], {}

    return change


def _method(method: str) -> Callable[[Renderer], tuple[Plan, dict[str, float]]]:
    """Return what plans for another method, whatever it costs."""

    def change(renderer: Renderer) -> tuple[Plan, dict[str, float]]:
        return renderer.planning.plan(method), {}

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
    """Return what puts the finest scale on another sim grid."""

    def change(renderer: Renderer) -> tuple[Plan, dict[str, float]]:
        given = renderer.bank, renderer.camera.sensor, renderer.scene, renderer.accuracy
        alias = alias_of(*given).error(oversampling)
        return oversampled(renderer, oversampling), {"alias": alias}

    return change


def oversampled(renderer: Renderer, oversampling: int) -> Plan:
    """Return a renderer's plan with its finest scale on another sim grid, and the same nodes."""
    plan = renderer.plan
    first = plan.scales[0]
    reach_um = (first.grid.half_size - GUARD) * first.pitch_um
    cut_um = None
    if len(plan.scales) > 1:  # the core must go on matching the tail
        cut_um = reach_um = max(cut for cut in PLANNED_CUTS_UM if cut <= reach_um)
    fine = _fine(renderer, oversampling, reach_um, _core(renderer, cut_um), first.name)
    return replace(plan, scales=(fine, *plan.scales[1:]))


def _cut(cut_um: float | None) -> Callable[[Renderer], tuple[Plan, dict[str, float]]]:
    """Return what cuts the PSFs elsewhere, with the chosen nodes for the core."""

    def change(renderer: Renderer) -> tuple[Plan, dict[str, float]]:
        plan, sensor, bank = renderer.plan, renderer.camera.sensor, renderer.core
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
    bank, sensor = renderer.core, renderer.camera.sensor
    corner_um = math.hypot(sensor.rows, sensor.cols) * sensor.pixel_pitch_um / 2
    farthest_um = corner_um + math.sqrt(2) * _reach_um(renderer)
    basis = renderer.plan.basis
    seen = {"elsewhere": basis.elsewhere, "wavelengths_nm": basis.wavelengths_nm}
    return field_images(bank, basis.rates, farthest_um, **seen)


def _reach_um(renderer: Renderer) -> float:
    """Return the distance from its chief ray to which a whole PSF reaches."""
    bank = renderer.core
    return bank.psf.shape[-1] / 2 * bank.pitch_um + bank.lateral_um


def _core(renderer: Renderer, cut_um: float | None) -> np.ndarray:
    """Return the weight of the samples of the PSFs that lie in the core."""
    n = _images(renderer)[0].shape[-1]
    if cut_um is None:
        return np.ones((n, n))
    return core_window(distances_um(n, renderer.core.pitch_um), cut_um)


def _fine(
    renderer: Renderer, oversampling: int, reach_um: float, part: np.ndarray, name: str
) -> Scale:
    """Return the finest scale at another oversampling or reach."""
    sensor, first = renderer.camera.sensor, renderer.plan.scales[0]
    pitch_um = sensor.pixel_pitch_um / oversampling
    images, places = _images(renderer)
    kernels = field_kernels(images, places, renderer.core.pitch_um, pitch_um, part)
    reach_um = held_um(kernels, pitch_um, reach_um)  # on a coarser grid sharp PSFs ring farther
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

"""The chain of a candidate, described stage by stage: what runs, why, and what it should cost."""

from __future__ import annotations

from collections.abc import Callable

from gpusim.optics.nodes import Scale
from gpusim.plan.candidates import Candidate, Part
from gpusim.plan.halo import HaloLevel, describe_halo
from gpusim.plan.lens import describe_lens
from gpusim.plan.problem import Problem
from gpusim.plan.stage import PlanStage
from gpusim.sensor.effects import EFFECTS, EXPOSURE, Effect


def describe(
    problem: Problem,
    chosen: Candidate,
    first: Scale,
    of_lens: tuple[PlanStage, ...],
    halo: tuple[HaloLevel, ...],
    *,
    noise: bool,
) -> tuple[PlanStage, ...]:
    """Describe the chain, stage by stage, in the order that light takes.

    Parameters
    ----------
    problem : Problem
    chosen : Candidate
    first : Scale
        The core of its PSFs, onto whose grid the scene is brought.
    of_lens : tuple of PlanStage
        What the sampling of the lens errs by.
    halo : tuple of HaloLevel
        Levels that are rendered.
    noise : bool
        Whether the sensor's noise and fixed patterns are asked for.
    """
    layouts = [part.layout for part in chosen.parts]

    def cost(stage: str) -> float:
        return sum(layout.seconds.get(stage, 0.0) for layout in layouts)

    by_angle = problem.basis.elsewhere is not None
    return (
        *_scene_stages(problem, chosen, first, cost),
        _dark_blocks(chosen),
        *describe_lens(problem.bank, problem.sensor, problem.chief_ray, problem.force),
        *of_lens,
        describe_halo(problem.levels, halo),
        PlanStage(
            "qe by angle",
            by_angle,
            "averaged over the cone of light at each field, in the kernels"
            if by_angle
            else "the sensor file gives one for all angles",
        ),
        *_convolution_stages(chosen, cost),
        PlanStage(
            "tail",
            len(layouts) > 1,
            f"PSFs beyond {chosen.cut_um:g} um on a grid of {chosen.parts[1].pitch_um:.3g} um"
            if len(layouts) > 1
            else "whole PSFs on one grid cost less, or the tolerance allows no cut",
            chosen.errors.get("cut"),
        ),
        _point_sources(problem),
        *_sensor_stages(problem, noise),
    )


def _scene_stages(
    problem: Problem, chosen: Candidate, first: Scale, cost: Callable[[str], float]
) -> tuple[PlanStage, ...]:
    """Describe how the scene comes onto the sim grid."""
    basis, scene = problem.basis, problem.scene
    is_chart, identity = problem.is_chart, problem.identity(first)
    planes = basis.coefficients.shape[1]
    source = f"{planes} of {len(scene.spectra)} spectra are told apart by the camera"
    return (
        PlanStage(
            "illumination",
            bool(scene.illumination),
            scene.illumination or "no map was given: the target is lit evenly",
        ),
        PlanStage(
            "paint",
            is_chart,
            f"chart low-passed by {chosen.sigma} samples; {source}"
            if is_chart
            else "the scene is a raster",
            basis.residual if is_chart else None,
            cost("paint") if is_chart else None,
        ),
        PlanStage(
            "warp",
            not is_chart and not identity,
            "the scene is a chart: painted where it lands"
            if is_chart
            else f"identity: no distortion, and the grid is the raster's own; {source}"
            if identity
            else f"cubic spline; {source}",
            None if is_chart or identity else basis.residual,
            None if is_chart or identity else cost("warp"),
        ),
    )


def _dark_blocks(chosen: Candidate) -> PlanStage:
    """Say which blocks are left out."""
    counts = [count for part in chosen.parts for count in part.layout.needed.values()]
    dark = counts.count(0)
    return PlanStage(
        "dark blocks",
        False,
        f"{dark} of {len(counts)} see no light, or lie beyond the image circle"
        if dark
        else f"none: all {len(counts)} see light",
    )


def _convolution_stages(chosen: Candidate, cost: Callable[[str], float]) -> tuple[PlanStage, ...]:
    """Describe the passes of the methods that the scales take."""

    def scales(*methods: str) -> str:
        """Say what a pass works on: each scale that has it, and how."""
        return "; ".join(
            f"{part.name}: {_blocks(part)}" for part in chosen.parts if part.method in methods
        )

    transformed = scales("fft", "modes")
    used = {
        "fft rows": (scales("fft"), "no scale is convolved by PSF nodes and transforms"),
        "modes": (scales("modes"), "no scale has PSFs that are sums of few modes"),
        "fft columns": (transformed and "products with the kernels' spectra", "no transforms"),
        "inverse fft": (
            transformed and "inverse transform at the photosites only",
            "no transforms",
        ),
        "direct": (scales("direct"), "no scale has a support that is small enough"),
    }
    errors = {
        "fft rows": chosen.errors["alias"],
        "modes": chosen.errors.get("modes"),
        "fft columns": chosen.errors["nodes"],
        "direct": chosen.errors.get("support"),
    }
    if not transformed:  # else they are counted there, of both scales
        errors["direct"] = max(chosen.errors["nodes"], chosen.errors.get("support", 0.0))
    return tuple(
        PlanStage(name, True, text, errors.get(name), cost(name))
        if text
        else PlanStage(name, False, otherwise)
        for name, (text, otherwise) in used.items()
    )


def _blocks(part: Part) -> str:
    """Say how one scale is cut into blocks, and how its PSFs vary."""
    grid = part.layout.grid
    lit = sum(count > 0 for count in part.layout.needed.values())
    across, down = (count + 1 for count in part.options.get("map_cells", grid.cells))
    fewer = f", kernels of {part.nodes}" if 0 < part.nodes < across * down else ""
    return (
        f"{lit} blocks at {part.pitch_um:.3g} um, {part.text}, {across} x {down} PSF nodes{fewer}, "
        f"reach {grid.half_size} samples"
    )


def _point_sources(problem: Problem) -> PlanStage:
    """Describe the stage; its cost is that of the whole frame, and no further frame has it."""
    count = 0 if problem.is_chart else len(problem.placed.highlights)
    if not count:
        return PlanStage("point sources", False, "no part of the scene outshines the rest")
    work = {} if problem.highlights is None else problem.highlights.work()
    cost_s = sum((problem.costs.seconds(name, amount) for name, amount in work.items()), 0.0)
    text = f"{count} highlights, each with the PSF of its own place, once a scene"
    return PlanStage("point sources", True, text, None, cost_s)


def _sensor_stages(problem: Problem, noise: bool) -> tuple[PlanStage, ...]:
    """Describe what comes after the light."""
    sensor, costs, force = problem.sensor, problem.costs, problem.force

    def described(effect: Effect) -> PlanStage:
        needed = effect.has(sensor) and (noise or not effect.random)
        forced = not needed and effect.forced and effect.name in force
        reason = effect.reason(sensor, needed, noise) + ", forced" * forced
        if effect is EXPOSURE and not noise:
            reason += ", full well"  # which the noise stage holds to otherwise
        runs = needed or forced
        cost_s = costs.seconds(*effect.work(sensor)) if runs and effect.work else None
        return PlanStage(effect.name, runs, reason, None, cost_s)

    return tuple(map(described, EFFECTS))

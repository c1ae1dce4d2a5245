"""The plan and its description, stage by stage: what runs, why, and what it should cost."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Collection
from dataclasses import dataclass

from gpusim.optics.nodes import Scale
from gpusim.optics.spectral_basis import Basis
from gpusim.plan.candidates import Candidate, Part, RunnerUp
from gpusim.plan.costs import Costs
from gpusim.plan.halo import HaloLevel
from gpusim.plan.stage import PlanStage, Stage
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.effects import EFFECTS, EXPOSURE, Effect, running
from gpusim.sensor.sensor import Sensor

COLUMNS = 100  # of the plan's text
NAME = 26  # of which a stage and whether it runs take
REASON = 52  # of which a reason may take
RIM = "image circle"  # the stage that leaves black what lies beyond it


@dataclass(frozen=True)
class Plan:
    """What a render does.

    Attributes
    ----------
    basis : Basis
        The scene's spectra, reduced.
    scales : tuple of Scale
        The core of the PSFs on the sim grid; their tail, where it is cut off, on a coarse one.
    stages : tuple of PlanStage
        In the order that light takes.
    name : str
        How the convolution is done, in a line.
    predicted_s : float
        Time of one frame, everything together.
    kernels_s : float
        Time of the kernels and the highlights' light, which are made once.
    rates : str
        Whose rates the predictions are made from.
    runners_up : tuple of RunnerUp
        Other ways to convolve, and why each lost.
    halo : tuple of HaloLevel
        Levels of the bank's halo that are rendered.
    tolerance : float
        Tolerance that it was made for, relative to the local signal.
    shortfall : str
        Where the tolerance asked for cannot be met, and best effort was: for which one the plan was
        made instead, and why. Else empty.
    """

    basis: Basis
    scales: tuple[Scale, ...]
    stages: tuple[PlanStage, ...]
    name: str
    predicted_s: float
    kernels_s: float
    rates: str
    runners_up: tuple[RunnerUp, ...]
    tolerance: float
    shortfall: str = ""
    halo: tuple[HaloLevel, ...] = ()

    def runs(self, name: str) -> bool:
        """Return whether a stage runs.

        Raises
        ------
        ValueError
            Where no `Stage` has that name.
        """
        name = Stage(name)
        return any(stage.runs for stage in self.stages if stage.name == name)

    def text(self) -> str:
        """Return the plan as lines of text, at most 100 columns wide."""
        lines = [f"{'':{NAME}}{'':{REASON}}{'error':>10}{'time':>11}"]
        for stage in self.stages:
            state = "run" if stage.runs else "skip"
            first = f"{state:5}{stage.name}"
            lines += _row(first, stage.reason, stage.predicted_error, stage.predicted_cost_s)
        lines += _row("", "with all dispatches", None, self.predicted_s)
        lines += _row("", "kernels and highlights, made once", None, self.kernels_s)
        lines += ["", *_row("chosen", self.name, None, None)]
        if self.shortfall:
            lines += _row("best effort", self.shortfall, None, None)
        for other in self.runners_up:
            lines += _row(
                "lost",
                f"{other.name}: {other.lost}",
                other.predicted_error,
                other.predicted_cost_s,
            )
        return "\n".join([*lines, "", f"Times from {self.rates}."])


def _row(first: str, reason: str, error: float | None, cost_s: float | None) -> list[str]:
    """Return a reason in as many lines as it needs, the numbers on the first of them."""
    lines = textwrap.wrap(reason, REASON)
    numbers = ("" if error is None else f"{error:.1e}", "" if cost_s is None else f"{cost_s:.3f} s")
    lines[0] = f"{first:{NAME}}{lines[0]:{REASON}}{numbers[0]:>10}{numbers[1]:>11}".rstrip()
    return [lines[0], *(f"{'':{NAME}}{line}" for line in lines[1:])]


def describe(
    chosen: Candidate,
    basis: Basis,
    sensor: Sensor,
    scene: Scene,
    costs: Costs,
    identity: bool,
    noise: bool,
    force: Collection[str],
    of_lens: tuple[PlanStage, ...],
    point_sources: PlanStage,
) -> tuple[PlanStage, ...]:
    """Describe the chain, stage by stage.

    ``identity``: of the warp onto the first grid; ``of_lens``: what the lens does to the image;
    ``point_sources``: how highlights are held apart.
    """
    planes = basis.coefficients.shape[1]
    is_chart = isinstance(scene.source, Chart)
    layouts = [part.layout for part in chosen.parts]
    counts = [count for layout in layouts for count in layout.needed.values()]
    dark = counts.count(0)

    def cost(stage: str) -> float:
        return sum(layout.seconds.get(stage, 0.0) for layout in layouts)

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
        PlanStage(
            "dark blocks",
            False,
            f"{dark} of {len(counts)} see no light, or lie beyond the image circle"
            if dark
            else f"none: all {len(counts)} see light",
        ),
        *of_lens,
        PlanStage(
            "qe by angle",
            basis.elsewhere is not None,
            "averaged over the cone of light at each field, in the kernels"
            if basis.elsewhere is not None
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
        point_sources,
        *_sensor_stages(sensor, costs, noise, force),
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


def _sensor_stages(
    sensor: Sensor, costs: Costs, noise: bool, force: Collection[str]
) -> tuple[PlanStage, ...]:
    """Describe what comes after the light."""

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


def sensor_runs(sensor: Sensor, noise: bool = True) -> Callable[[str], bool]:
    """Return whether a stage of the sensor runs, by name, as ``Plan.runs`` does.

    ``noise``: with its noise and fixed patterns.
    """
    names = running(sensor, noise)

    def runs(name: str) -> bool:
        return Stage(name) in names

    return runs

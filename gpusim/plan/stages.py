"""The plan and its description, stage by stage: what runs, why, and what it should cost."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from gpusim.optics.fold import Basis
from gpusim.optics.nodes import Scale
from gpusim.plan.candidates import Candidate, Part, RunnerUp
from gpusim.plan.costs import LAVAPIPE, Costs
from gpusim.plan.halo import HaloLevel
from gpusim.plan.stage import PlanStage
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.cti_model import Cti
from gpusim.sensor.noise_model import LineNoise, Masks
from gpusim.sensor.sensor import Sensor

COLUMNS = 100  # of the plan's text
REASON = 60  # of which a reason may take
RIM = "image circle"  # the stage that leaves black what lies beyond it
CCD_STAGES = ("smear", "bloom", "parallel cti", "serial cti")


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
        """Return whether a stage runs."""
        return any(stage.runs for stage in self.stages if stage.name == name)

    def text(self) -> str:
        """Return the plan as lines of text, at most 100 columns wide."""
        lines = [f"{'':18}{'':{REASON}}{'error':>10}{'time':>11}"]
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
    lines[0] = f"{first:18}{lines[0]:{REASON}}{numbers[0]:>10}{numbers[1]:>11}".rstrip()
    return [lines[0], *(f"{'':18}{line}" for line in lines[1:])]


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
    splat: PlanStage,
) -> tuple[PlanStage, ...]:
    """Describe the chain, stage by stage.

    ``identity``: of the warp onto the first grid; ``of_lens``: what the lens does to the image;
    ``splat``: how highlights are held apart.
    """
    planes = basis.coefficients.shape[1]
    is_chart = isinstance(scene.source, Chart)
    layouts = [part.layout for part in chosen.parts]
    counts = [count for layout in layouts for count in layout.needed.values()]
    dark = counts.count(0)

    def cost(stage: str) -> float:
        return sum(layout.seconds.get(stage, 0.0) for layout in layouts)

    def part(name: str, needed: bool, used: str, unused: str) -> PlanStage:
        """Describe a stage or a part of one that nothing needs where it changes nothing."""
        forced = not needed and name in force
        return PlanStage(name, needed or forced, used if needed else unused + ", forced" * forced)

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
        splat,
        *_sensor_stages(sensor, costs, noise, part),
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
        "rows": (scales("fft"), "no scale is convolved by PSF nodes and transforms"),
        "modes": (scales("modes"), "no scale has PSFs that are sums of few modes"),
        "columns": (transformed and "products with the kernels' spectra", "no transforms"),
        "lattice": (transformed and "inverse transform at the photosites only", "no transforms"),
        "direct": (scales("direct"), "no scale has a support that is small enough"),
    }
    errors = {
        "rows": chosen.errors["alias"],
        "modes": chosen.errors.get("modes"),
        "columns": chosen.errors["nodes"],
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
    sensor: Sensor,
    costs: Costs,
    noise: bool,
    part: Callable[[str, bool, str, str], PlanStage],
) -> tuple[PlanStage, ...]:
    """Describe what comes after the light."""

    def timed(stage: PlanStage) -> PlanStage:
        pixels = math.prod(sensor.frame.read[2:])
        cost_s = costs.seconds(stage.name, pixels) if stage.runs else None
        return replace(stage, predicted_cost_s=cost_s)

    def spread(name: str, kind: str, what: str) -> PlanStage:
        kernels = sensor.crosstalk and getattr(sensor.crosstalk, kind)
        if kernels is None:
            return PlanStage(name, False, f"the sensor file gives no {kind} cross-talk")
        work = math.prod(sensor.frame.pixels[2:]) * kernels.side**2
        side = f"{kernels.side} x {kernels.side}"
        return PlanStage(
            name, True, f"{side} pixels {what}", None, costs.seconds("crosstalk", work)
        )

    off = "noise is switched off"
    lines, masks, law = sensor.lines or LineNoise(), sensor.masks or Masks(), sensor.read_noise_law

    def effect(name: str, used: str, unused: str) -> PlanStage:
        """Describe a part of exposure or noise, which may be drawn also where it is zero."""
        return part(name, noise and name in sensor.effects, used, unused if noise else off)

    def fixed(name: str, used: str | None, unused: str) -> PlanStage:
        """Describe what cannot be done where the sensor has it not."""
        runs = noise and name in sensor.effects
        return PlanStage(name, runs, used if runs else unused if noise else off)

    glare, sites = sensor.veiling_glare, len(sensor.site_channels())
    mosaic = part(
        "mosaic",
        sites > 1 or glare > 0,
        f"{sites} CFA sites" if sites > 1 else "adds the veiling glare",
        "a sensor without filters or veiling glare: the plane is the frame",
    )
    black = sensor.optical_black
    return (
        timed(mosaic),
        PlanStage(
            "flare",
            glare > 0,
            f"veiling glare {glare:.2%} of the mean, added by mosaic"
            if glare > 0
            else "the sensor file gives none",
        ),
        timed(
            PlanStage(
                "border",
                black is not None,
                f"{black.top} + {black.bottom} rows and {black.left} + {black.right} columns of "
                "optical black"
                if black
                else "the sensor file gives no optical black",
            )
        ),
        spread("crosstalk", "optical", "of light and diffusing charge"),
        effect("prnu", f"{sensor.prnu_percent:g} % of the signal", "all pixels respond alike"),
        effect(
            "prnu lines",
            f"rows {lines.prnu_row_percent:g} %, columns {lines.prnu_column_percent:g} %",
            "all rows and columns respond alike",
        ),
        fixed("gain mask", masks.gain, "the sensor file names no multiplicative mask"),
        effect("dcnu", f"{sensor.dcnu_percent:g} % of the dark current", "dark current is even"),
        timed(
            PlanStage("exposure", True, "exposure time, dark current" + ", full well" * (not noise))
        ),
        fixed("defects", "dead, hot and stuck pixels", "the sensor file lists none"),
        fixed("two numbers", "a normal law in place of Poisson's", "shot noise has Poisson's law"),
        fixed(
            "knee",
            f"soft from {sensor.full_well_knee:.0%} of the full well on",
            "the full well is a hard limit",
        ),
        timed(PlanStage("noise", noise, "shot noise, full well" if noise else off)),
        spread("coupling", "electrical", "of collected charge, by the crosstalk stage"),
        effect("dsnu", f"{sensor.dsnu_e:g} e-", "all pixels have the same offset"),
        effect(
            "dsnu lines",
            f"rows {lines.dsnu_row_e:g} e-, columns {lines.dsnu_column_e:g} e-",
            "all rows and columns have the same offset",
        ),
        fixed("offset mask", masks.offset_e, "the sensor file names no additive mask"),
        effect(
            "reset noise",
            f"{sensor.reset_noise_at(None):.3g} e- at the reference temperature",
            "none is left",
        ),
        effect(
            "read noise",
            f"{sensor.temporal_dark_noise_e:g} e-" + ", by its table" * (law is not None),
            "it is one of the two numbers"
            if "two numbers" in sensor.effects
            else "the sensor has no temporal dark noise",
        ),
        effect(
            "line noise",
            f"rows {lines.row_noise_e:g} e-, columns {lines.column_noise_e:g} e-",
            "rows and columns are as quiet as their pixels",
        ),
        *_shift_stages(sensor, costs, timed),
        PlanStage(
            "linearity",
            sensor.linearity is not None,
            _linearity(sensor) if sensor.linearity else "the response is a straight line",
        ),
        part(
            "column fpn",
            noise and sensor.column_offset is not None,
            "offsets of the columns' converters, in adc",
            "the converters of all columns are alike" if noise else off,
        ),
        timed(PlanStage("adc", True, _converter(sensor))),
        timed(
            PlanStage(
                "merge",
                sensor.dual_gain is not None,
                f"reads at two gains, switched at {sensor.dual_gain.switch_dn} DN"
                if sensor.dual_gain
                else "the sensor reads at one gain",
            )
        ),
    )


def sensor_runs(sensor: Sensor, noise: bool = True) -> Callable[[str], bool]:
    """Return whether a stage of the sensor runs, by name, as ``Plan.runs`` does.

    ``noise``: with its noise and fixed patterns.
    """

    def part(name: str, needed: bool, used: str, unused: str) -> PlanStage:
        return PlanStage(name, needed, used if needed else unused)

    stages = _sensor_stages(sensor, LAVAPIPE, noise, part)
    return {one.name for one in stages if one.runs}.__contains__


def _shift_stages(
    sensor: Sensor, costs: Costs, timed: Callable[[PlanStage], PlanStage]
) -> tuple[PlanStage, ...]:
    """Describe what a CCD does to its charge on the way."""
    pixels = math.prod(sensor.frame.read[2:])
    none = "the sensor file gives none" if sensor.is_ccd else "the charge is not shifted"
    smear = sensor.smear
    by = smear and ("line by line" if smear.leak is None else f"{smear.leak:g} of the light leaks")

    def transfer(name: str, cti: Cti | None) -> PlanStage:
        if cti is None:
            return PlanStage(name, False, none)
        if cti.traps:
            work = pixels * (cti.groups + 1) / 2
            reason = f"{len(cti.traps)} kinds of traps, {cti.groups} groups of transfers"
            return PlanStage(name, True, reason, None, costs.seconds("traps", work))
        reason = f"{cti.inefficiency:g} of each packet left behind in each transfer"
        return PlanStage(name, True, reason, None, costs.seconds("cti", pixels))

    return (
        timed(PlanStage("smear", True, f"{smear.kind.replace('_', ' ')}, {by}"))
        if smear
        else PlanStage("smear", False, none),
        timed(PlanStage("bloom", True, "charge above the full well flows along the columns"))
        if sensor.bloom
        else PlanStage("bloom", False, none),
        transfer("parallel cti", sensor.parallel_cti),
        transfer("serial cti", sensor.serial_cti),
    )


def _linearity(sensor: Sensor) -> str:
    """Say how far the read-out is from a straight line."""
    low, high = sensor.linearity.error_percent(sensor.saturation_e)
    return f"linearity error {low:+.2g} to {high:+.2g} % (EMVA 1288), in adc"


def _converter(sensor: Sensor) -> str:
    """Say what the converter does."""
    text = f"{sensor.bit_depth} bit"
    if sensor.analogue_gain != 1:
        text += f", analogue gain {sensor.analogue_gain:g}"
    if sensor.channel_black_level_dn:
        text += ", a black level for each channel"
    return text

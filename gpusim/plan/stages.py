"""The plan and its description, stage by stage: what runs, why, and what it should cost."""

from __future__ import annotations

from dataclasses import dataclass

from gpusim.optics.convolve import Scale
from gpusim.optics.fold import Basis
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor

# Measured on lavapipe with 2 cores, ns for each sample that a stage touches; only the order of
# magnitude is meant.
NS_PER_SAMPLE = {
    "paint": 30.0,
    "warp": 25.0,
    "rows": 8.0,
    "columns": 8.0,
    "lattice": 20.0,
    "splat": 300.0,
    "mosaic": 3.0,
    "exposure": 20.0,
    "noise": 60.0,
    "adc": 3.0,
}


@dataclass(frozen=True)
class PlanStage:
    """One stage of the chain: whether it runs, and why."""

    name: str
    runs: bool
    reason: str
    predicted_error: float | None = None
    predicted_cost_s: float | None = None


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
    """

    basis: Basis
    scales: tuple[Scale, ...]
    stages: tuple[PlanStage, ...]

    def text(self) -> str:
        """Return the plan as lines of text."""
        lines = []
        for stage in self.stages:
            error = "" if stage.predicted_error is None else f", error {stage.predicted_error:.1e}"
            cost = "" if stage.predicted_cost_s is None else f", {stage.predicted_cost_s:.2f} s"
            lines.append(
                f"{'run ' if stage.runs else 'skip'} {stage.name:9} {stage.reason}{error}{cost}"
            )
        return "\n".join(lines)


def describe(
    scales: list[Scale],
    basis: Basis,
    sensor: Sensor,
    scene: Scene,
    predicted: dict[str, float],
    identity: bool,
) -> tuple[PlanStage, ...]:
    """Describe the chain, stage by stage; ``identity``: of the warp onto the first grid."""
    planes = basis.coefficients.shape[1]
    is_chart = isinstance(scene.source, Chart)
    pixels = sensor.rows * sensor.cols
    grids = [scale.grid for scale in scales]
    blocks = [grid.blocks[0] * grid.blocks[1] for grid in grids]

    def cost(stage: str, samples: float) -> float:
        return NS_PER_SAMPLE[stage] * samples * 1e-9

    source = f"{planes} of {len(scene.spectra)} spectra are told apart by the camera"
    areas = sum(b * g.block[0] * g.block[1] for b, g in zip(blocks, grids, strict=True))
    fine = grids[0]
    tail = (
        f"; tail on a grid of {scales[1].pitch_um:.3g} um, reach {grids[1].half_size} samples"
        if len(scales) > 1
        else "; whole PSF on one grid"
    )
    glare = sensor.veiling_glare
    highlights = 0 if is_chart else len(scene.source.split.rows)
    # Pixels that one highlight lights.
    lit = (2 * grids[-1].half_size / grids[-1].oversampling) ** 2
    return (
        PlanStage("illumination", False, "the target is lit evenly"),
        PlanStage(
            "paint",
            is_chart,
            f"chart low-passed by {scales[0].sigma} samples; {source}"
            if is_chart
            else "the scene is a raster",
            predicted["planes"] if is_chart else None,
            cost("paint", areas) if is_chart else None,
        ),
        PlanStage(
            "warp",
            not is_chart and not identity,
            "the scene is a chart: painted where it lands"
            if is_chart
            else f"identity: no distortion, and the grid is the raster's own; {source}"
            if identity
            else f"cubic spline; {source}",
            None if is_chart or identity else predicted["planes"],
            None if is_chart or identity else cost("warp", areas * planes),
        ),
        PlanStage(
            "rows",
            True,
            f"{sum(blocks)} blocks, {fine.oversampling:g} samples a pixel, transforms of "
            + " and ".join(str(length) for length in sorted({grid.length for grid in grids})),
            predicted["alias"],
            cost(
                "rows",
                sum(b * g.block[1] * g.length * planes for b, g in zip(blocks, grids, strict=True)),
            ),
        ),
        PlanStage(
            "columns",
            True,
            f"{fine.nodes[0]} x {fine.nodes[1]} PSF nodes, reach {fine.half_size} samples{tail}",
            predicted["nodes"] + predicted["cut"] * (len(scales) > 1),
            cost(
                "columns",
                sum(2 * b * g.length**2 * planes for b, g in zip(blocks, grids, strict=True)),
            ),
        ),
        PlanStage(
            "lattice",
            True,
            "inverse transform at the photosites only; pixel aperture folded into the kernels",
            None,
            cost(
                "lattice",
                sum(b * g.sites * g.window**2 for b, g in zip(blocks, grids, strict=True)),
            ),
        ),
        PlanStage(
            "splat",
            highlights > 0,
            f"{highlights} highlights, each with the PSF of its own place"
            if highlights
            else "no part of the scene outshines the rest",
            None,
            cost("splat", highlights * lit) if highlights else None,
        ),
        PlanStage("mosaic", True, f"{fine.sites} CFA sites", None, cost("mosaic", pixels)),
        PlanStage(
            "flare",
            glare > 0,
            f"veiling glare {glare:.2%} of the mean, added by mosaic"
            if glare > 0
            else "the sensor file gives none",
        ),
        PlanStage("cross-talk", False, "the sensor file gives none"),
        PlanStage("exposure", True, "PRNU, dark current, DSNU", None, cost("exposure", pixels)),
        PlanStage("noise", True, "Poisson, full well, read noise", None, cost("noise", pixels)),
        PlanStage("smear, cti", False, "a CMOS sensor does not shift its charge"),
        PlanStage("adc", True, f"{sensor.bit_depth} bit", None, cost("adc", pixels)),
    )

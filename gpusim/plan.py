"""The planner: what runs, how, and what is left out, without touching a device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.bank import Bank
from gpusim.optics.chief_ray import chief_ray_map
from gpusim.optics.convolve import Scale
from gpusim.optics.fold import Basis, edge_responses, reduce_spectra, spectral_weights
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import (
    BAND_EDGE,
    FieldKernels,
    core_window,
    distances_um,
    field_images,
    field_kernels,
    low_pass,
    sampled_kernels,
)
from gpusim.optics.paint import SIGMA, primitives_by_block
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor

# The planes' error is that of the worst spectrum in its weakest channel; the rest is well below it.
WORST_TO_RMS = 5.0
# What least-squares nodes gain over interpolation between samples: see
# gpusim.optics.kernels.node_kernels.
NODE_GAIN = 2.45
# Share of the tolerance that is left to the nodes; a photograph's contrast is larger than a
# chart's.
NODE_SHARE = 0.8
TAIL_SHARE = 0.4  # for the nodes of the tails, which add in the squares
# Signal of a white next to a dark neighbour's: the tail of an edge is measured against the dark
# side.
CONTRAST = 20.0
# Radii at which the core of the PSFs may be cut from their tail, um.
CUTS_UM = (6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0)
KERNEL_BYTES = (
    640 << 20
)  # of the 1 GiB that the device may use; the rest is for planes, frames and scratch
TRANSFORMS = (256, 512, 1024)  # lengths that shaders/common/line_fft takes

# Measured on lavapipe with 2 cores, ns for each sample that a stage touches; only the order of
# magnitude is meant.
NS_PER_SAMPLE = {
    "paint": 30.0,
    "warp": 25.0,
    "rows": 8.0,
    "columns": 8.0,
    "lattice": 20.0,
    "mosaic": 3.0,
    "exposure": 20.0,
    "noise": 60.0,
    "adc": 3.0,
}


@dataclass(frozen=True)
class Accuracy:
    """Every trade-off between error and run time.

    Attributes
    ----------
    tolerance : float
        Root mean square error of the mean signal over probe pixels, half of them on the steepest
        edges, relative to the local signal; no probe may err by more than ten times it. The
        engine's approximations (planes, PSF nodes, oversampling, cut of the PSFs) are planned
        from it.
    probes : int
        Pixels of the certificate; 0 leaves it out.
    """

    tolerance: float = 1e-3
    probes: int = 64

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not 1e-5 <= self.tolerance <= 0.1:
            raise UserError(
                "The tolerance is out of range.",
                field="tolerance",
                value=self.tolerance,
                allowed="1e-5 to 0.1, relative to the local signal",
            )
        if self.probes < 0:
            raise UserError(
                "Too few probes.", field="certify", value=self.probes, allowed="0 or more"
            )


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


def edge_integral(frequency: np.ndarray, spectrum: np.ndarray) -> float:
    """Bound an edge response by its transfer function: 2 int |H(f)| / (2 pi f) df."""
    return float(2 * np.trapezoid(np.abs(spectrum) / (2 * np.pi * frequency), frequency))


def alias_error(bank: Bank, oversampling: float, sensor: Sensor, sigma: float) -> float:
    """Predict the error of an edge response that the sim grid causes.

    Along one axis, at the axis and the reference wavelength: what the grid folds into the band, and
    what lies above it. Frequencies in cycles per sim sample.
    """
    pitch_um = sensor.pixel_pitch_um / oversampling
    psf = bank.psf[0, bank.reference].sum(axis=0, dtype=np.float64)
    positions_um = (np.arange(len(psf)) - len(psf) // 2) * bank.pitch_um
    f = np.linspace(0.5, 1.0, 100)

    def transfer(frequency: np.ndarray) -> np.ndarray:
        mtf = np.abs(np.exp(-2j * np.pi * np.outer(frequency / pitch_um, positions_um)) @ psf)
        # Beyond the bank's own Nyquist frequency the sum only repeats; the bank's PSFs end below
        # it.
        mtf[frequency / pitch_um > 0.5 / bank.pitch_um] = 0.0
        return mtf * np.sinc(frequency * oversampling * np.sqrt(sensor.fill_factor))

    folded = np.exp(-2 * np.pi**2 * sigma**2 * (f**2 - (1 - f) ** 2)) * low_pass(
        (1 - f) / pitch_um, pitch_um
    )
    return edge_integral(f, transfer(f)) + edge_integral(f, folded * transfer(1 - f))


def cut_error(
    images: np.ndarray, bank_pitch_um: float, coarse_pitch_um: float, sensor: Sensor, cut_um: float
) -> float:
    """Predict the error of an edge response when the PSF's tail beyond a cut goes to a coarse grid.

    What the coarse grid loses of the tail: its spectrum along both axes from the end of the coarse
    band on, through the pixel aperture, for the first plane on the axis and at the last field.
    """
    n = images.shape[-1]
    tail = 1 - core_window(distances_um(n, bank_pitch_um), cut_um)
    frequency = np.fft.rfftfreq(n, bank_pitch_um)
    lost = frequency > BAND_EDGE * 0.5 / coarse_pitch_um
    aperture = np.sinc(frequency * sensor.pixel_pitch_um * np.sqrt(sensor.fill_factor))
    worst = 0.0
    for image in images[[0, -1], 0].reshape(-1, n, n):
        for axis in (0, 1):
            spectrum = np.fft.rfft(np.fft.ifftshift((image * tail).sum(axis=axis))) * aperture
            worst = max(worst, edge_integral(frequency[lost], spectrum[lost]) / abs(image.sum()))
    return worst


def node_error(
    kernels: FieldKernels,
    pitch_um: float,
    reach_um: float,
    half_um: tuple[float, float],
    spacing_um: float,
) -> float:
    """Predict the error of an edge response that bilinear interpolation between PSF nodes causes.

    Compares the kernel at the middle of a cell with the mean of its four corners, on the axis, at
    half field and in the corner of the sensor, as far as `reach_um`; the root of the mean square
    over these, relative to what the kernel holds.
    """
    half_size = int(np.ceil(reach_um / pitch_um))
    squares = []
    for fraction in (0.0, 0.5, 1.0):
        x, y = (max(fraction * half - spacing_um / 2, 0.0) for half in half_um)
        shifts = (-spacing_um / 2, spacing_um / 2)
        corners = [
            sampled_kernels(kernels, x + dx, y + dy, pitch_um, half_size, 1)[0, 0]
            for dx in shifts
            for dy in shifts
        ]
        kernel = sampled_kernels(kernels, x, y, pitch_um, half_size, 1)[0, 0]
        for axis in (0, 1):
            response = np.cumsum((sum(corners) / 4 - kernel).sum(axis=axis)) / kernel.sum()
            squares.append(np.abs(response).max() ** 2)
    return float(np.sqrt(np.mean(squares))) / NODE_GAIN


def cells_within(
    kernels: FieldKernels,
    pitch_um: float,
    reach_um: float,
    half_um: tuple[float, float],
    allowed: float,
) -> tuple[tuple[int, int], float]:
    """Return the fewest cells between PSF nodes that keep an error, and the error they leave."""
    # Linear interpolation's error goes with the spacing squared.
    trial_um = half_um[1] / 4
    trial = node_error(kernels, pitch_um, reach_um, half_um, trial_um)
    spacing_um = trial_um * np.sqrt(allowed / max(trial, 1e-12))
    cells = tuple(int(np.clip(np.ceil(2 * half / spacing_um), 1, 32)) for half in half_um)
    widest = max(2 * half / count for half, count in zip(half_um, cells, strict=True))
    return cells, trial * (widest / trial_um) ** 2


def plan_optics(bank: Bank, sensor: Sensor, scene: Scene, accuracy: Accuracy) -> Plan:
    """Choose planes, oversampling, the cut of the PSFs, nodes and blocks for a tolerance.

    Raises
    ------
    UserError
        When a PSF is wider than the longest transform allows, or the CFA period is no power of two.
    """
    is_chart = isinstance(scene.source, Chart)
    period = sensor.period[0]
    if period not in (1, 2, 4) or sensor.period[1] != period:
        raise UserError(
            "The convolution samples CFA patterns of 1, 2 or 4 rows and columns.",
            field="cfa.pattern",
            value=f"{sensor.period[0]} x {sensor.period[1]}",
            allowed="1 x 1, 2 x 2 or 4 x 4",
        )
    worst = WORST_TO_RMS * accuracy.tolerance
    basis = reduce_spectra(
        scene.spectra,
        spectral_weights(bank, sensor),
        edge_responses(bank),
        worst,
        _commonest_first(scene),
    )
    sigma = SIGMA if is_chart else 0.0
    half_um = (sensor.cols * sensor.pixel_pitch_um / 2, sensor.rows * sensor.pixel_pitch_um / 2)
    images, radius_um = field_images(bank, basis.weights, float(np.hypot(*half_um)))
    everything = np.ones(images.shape[-2:])

    if is_chart:
        chief_ray, placed = chief_ray_map(bank), scene.source.placed(half_um[1])

    def needed(grid: SimGrid, pitch_um: float) -> dict[tuple[int, int], int]:
        if is_chart:
            return primitives_by_block(placed, basis.coefficients, grid, pitch_um, chief_ray)[1]
        return dict.fromkeys(np.ndindex(grid.blocks), basis.coefficients.shape[1])

    for oversampling in (2, 4):
        alias = alias_error(bank, oversampling, sensor, sigma) if is_chart else 0.0
        if alias <= accuracy.tolerance or oversampling * period == 8:
            break
    pitch_um = sensor.pixel_pitch_um / oversampling
    reach_um = bank.psf.shape[-1] / 2 * bank.pitch_um + np.ptp(bank.real_height_um, axis=1).max()

    # Half a sample a pixel, but a whole one for 4 x 4 sites: between samples each would have
    # kernels of its own, and shaders/optics/columns sums four.
    coarse_stride = 4 if period == 4 else 1
    coarse_pitch_um = sensor.pixel_pitch_um * period / coarse_stride
    cut = None
    for cut_um in CUTS_UM:
        lost = cut_error(images, bank.pitch_um, coarse_pitch_um, sensor, cut_um)
        if lost <= accuracy.tolerance / CONTRAST and cut_um < reach_um / 2:
            cut = cut_um
            break
    core = (
        everything
        if cut is None
        else core_window(distances_um(len(everything), bank.pitch_um), cut)
    )
    kernels = field_kernels(images, radius_um, bank.pitch_um, pitch_um, core)
    # Green, or the only channel: the middle of the list.
    middle = len(sensor.channels) // 2

    def first(of: FieldKernels) -> FieldKernels:
        return FieldKernels(of.splines[:, :1, middle : middle + 1], radius_um, bank.pitch_um)

    # 20 um hold 98 % of the energy at f/2.8.
    cells, nodes = cells_within(
        first(kernels), pitch_um, 20.0, half_um, NODE_SHARE * accuracy.tolerance
    )

    grid = _cheapest(
        sensor,
        oversampling * period,
        period,
        (cut or reach_um) / pitch_um,
        cells,
        lambda g: needed(g, pitch_um),
    )
    scales = [Scale("core" if cut else "whole", grid, pitch_um, sigma, kernels)]
    if cut is not None:
        tail = field_kernels(images, radius_um, bank.pitch_um, coarse_pitch_um, everything - core)
        # The tail holds some per cent of the energy, and its error counts as much less.
        whole = images[:, 0, middle].sum(axis=(1, 2))
        share = float(((images[:, 0, middle] * (everything - core)).sum(axis=(1, 2)) / whole).max())
        few, lag = cells_within(
            first(tail),
            coarse_pitch_um,
            reach_um,
            half_um,
            TAIL_SHARE * accuracy.tolerance / share,
        )
        nodes = float(np.hypot(nodes, lag * share))
        coarse = _cheapest(
            sensor,
            coarse_stride,
            period,
            reach_um / coarse_pitch_um,
            few,
            lambda g: needed(g, coarse_pitch_um),
        )
        scales.append(Scale("tail", coarse, coarse_pitch_um, sigma, tail))
    predicted = {"planes": basis.residual, "alias": alias, "nodes": nodes, "cut": lost}
    return Plan(basis, tuple(scales), _stages(scales, basis, sensor, scene, predicted))


def _commonest_first(scene: Scene) -> np.ndarray:
    """Return the scene's spectra, those of most primitives first."""
    counts = np.zeros(len(scene.spectra))
    if isinstance(scene.source, Chart):
        np.add.at(counts, [shape.material for shape in scene.source.primitives], 1)
        counts[scene.source.background] = np.inf
    return np.argsort(-counts, kind="stable")


def _cheapest(
    sensor: Sensor,
    stride: int,
    period: int,
    reach: float,
    cells: tuple[int, int],
    needed: Callable[[SimGrid], dict[tuple[int, int], int]],
) -> SimGrid:
    """Return the grid that takes the least work, among those whose kernels fit the memory.

    `reach` of the kernels in sim samples; `cells` are the fewest that the tolerance allows;
    `needed` returns the planes that each block of a grid needs.
    """
    # 8 samples: half an aperture, half a sample to the pixel's centre, and the ringing of the
    # band's end.
    half_size = int(np.ceil((reach + 8) / stride)) * stride
    channels = len(sensor.channels) if stride % period == 0 else period**2
    best = None
    for length in TRANSFORMS:
        largest = (length - 2 * half_size) // stride * stride
        if largest < 8 * stride:
            continue
        for blocks in range(1, 5):
            extent = SimGrid(
                sensor.rows, sensor.cols, stride, period, length, half_size, cells
            ).extent
            finer = tuple(
                max(count, -(-size // (blocks * largest)))
                for count, size in zip(cells, extent, strict=True)
            )
            grid = SimGrid(sensor.rows, sensor.cols, stride, period, length, half_size, finer)
            planes = needed(grid)
            at_nodes = sum(grid.planes_at(node, planes) for node in np.ndindex(grid.nodes))
            if at_nodes * channels * (length // 2 + 1) * length * 8 > KERNEL_BYTES:
                continue
            # The inverse transforms and the products of a block cost about as much as the forward
            # ones of a plane.
            work = (
                sum(1 + count for count in planes.values() if count) * length**2 * np.log2(length)
            )
            if best is None or work < best[0]:
                best = (work, grid)
    if best is None:
        raise UserError(
            "The kernels of this lens do not fit: its PSF is too wide or changes too fast.",
            field="tolerance",
            value=f"{2 * half_size} sim samples wide, {cells[0] + 1} x {cells[1] + 1} PSF nodes",
            allowed=f"{TRANSFORMS[-1] - 8 * stride} samples, {KERNEL_BYTES >> 20} MiB of kernels: "
            "a looser tolerance, or a smaller region of the sensor",
        )
    return best[1]


def _stages(
    scales: list[Scale], basis: Basis, sensor: Sensor, scene: Scene, predicted: dict[str, float]
) -> tuple[PlanStage, ...]:
    """Describe the chain, stage by stage."""
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
            not is_chart,
            "the scene is a chart: painted where it lands"
            if is_chart
            else f"cubic spline; {source}",
            None if is_chart else predicted["planes"],
            None if is_chart else cost("warp", areas * planes),
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

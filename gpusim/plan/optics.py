"""The choice of planes, oversampling, cut, PSF nodes and blocks for a tolerance."""

from __future__ import annotations

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.field_bank import FieldBank
from gpusim.optics.chief_ray import chief_ray_map
from gpusim.optics.convolve import Scale
from gpusim.optics.fold import MAX_PLANES, edge_responses, reduce_spectra, spectral_weights
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import (
    FieldKernels,
    core_window,
    distances_um,
    field_images,
    field_kernels,
)
from gpusim.optics.paint import SIGMA, primitives_by_block
from gpusim.optics.warp import is_identity
from gpusim.plan.accuracy import Accuracy
from gpusim.plan.layout import cheapest_grid
from gpusim.plan.predict import alias_error, cells_within, cut_error
from gpusim.plan.stages import Plan, describe
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor

# The planes' error is that of the worst spectrum in its weakest channel; the rest is well below it.
WORST_TO_RMS = 5.0
# Share of the tolerance that is left to the nodes; a photograph's contrast is larger than a
# chart's.
NODE_SHARE = 0.8
TAIL_SHARE = 0.4  # for the nodes of the tails, which add in the squares
# Signal of a white next to a dark neighbour's: the tail of an edge is measured against the dark
# side.
CONTRAST = 20.0
# Of an edge's height, and both sides: the dark side feels it more. Measured: certified RMS of
# edges of 16:1 with more nodes than matter, 3.4e-4 where the edge response errs by 1.5e-4.
ALIAS_TO_RMS = 2.3
# Radii at which the core of the PSFs may be cut from their tail, um.
CUTS_UM = (6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0)


def plan_optics(bank: FieldBank, sensor: Sensor, scene: Scene, accuracy: Accuracy) -> Plan:
    """Choose planes, oversampling, the cut of the PSFs, nodes and blocks for a tolerance.

    Raises
    ------
    UserError
        When a PSF is wider than the longest transform allows, the CFA period is no power of two, or
        a part of the error cannot be as small as the tolerance asks: which, and how small it is.
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
    if basis.residual > worst:
        raise UserError(
            "The tolerance cannot be met: the planes of the scene's spectra cannot err by less.",
            field="tolerance",
            value=accuracy.tolerance,
            allowed=f"{basis.residual / WORST_TO_RMS:.1e} or more: the shaders carry {MAX_PLANES} "
            "planes, and this camera tells more spectra of this scene apart",
        )
    sigma = SIGMA if is_chart else 0.0
    half_um = (sensor.cols * sensor.pixel_pitch_um / 2, sensor.rows * sensor.pixel_pitch_um / 2)
    # Sources around the sensor count too, and so do the nodes beyond them.
    reach_um = bank.psf.shape[-1] / 2 * bank.pitch_um + bank.lateral_um
    farthest_um = float(np.hypot(*half_um) + np.sqrt(2) * reach_um)
    images, places = field_images(bank, basis.weights, farthest_um)
    everything = np.ones(images.shape[-2:])

    if is_chart:
        chief_ray, placed = chief_ray_map(bank), scene.source.placed(half_um[1])

    def needed(grid: SimGrid, pitch_um: float) -> dict[tuple[int, int], int]:
        if is_chart:
            return primitives_by_block(placed, basis.coefficients, grid, pitch_um, chief_ray)[1]
        return dict.fromkeys(np.ndindex(grid.blocks), basis.coefficients.shape[1])

    for oversampling in (2, 4):
        alias = 0.0
        if is_chart:
            alias = ALIAS_TO_RMS * alias_error(bank, oversampling, sensor, sigma)
        if alias <= accuracy.tolerance or oversampling * period == 8:
            break
    if alias > accuracy.tolerance:
        raise UserError(
            "The tolerance cannot be met: the alias of edges on the sim grid cannot be less.",
            field="tolerance",
            value=accuracy.tolerance,
            allowed=f"{alias:.1e} or more: {oversampling} samples a pixel are the most, and the "
            "lens's PSFs hold finer detail than these carry",
        )
    pitch_um = sensor.pixel_pitch_um / oversampling

    # Half a sample a pixel, but a whole one for 4 x 4 sites: between samples each would have
    # kernels of its own, and shaders/optics/columns sums four.
    coarse_stride = 4 if period == 4 else 1
    coarse_pitch_um = sensor.pixel_pitch_um * period / coarse_stride
    cut = None
    probes = images[list(places.probes)]
    for cut_um in CUTS_UM:
        lost = cut_error(probes, bank.pitch_um, coarse_pitch_um, sensor, cut_um)
        if lost <= accuracy.tolerance / CONTRAST and cut_um < reach_um / 2:
            cut = cut_um
            break
    core = (
        everything
        if cut is None
        else core_window(distances_um(len(everything), bank.pitch_um), cut)
    )
    kernels = field_kernels(images, places, bank.pitch_um, pitch_um, core)
    # Green, or the only channel: the middle of the list.
    middle = len(sensor.channels) // 2

    def first(of: FieldKernels) -> FieldKernels:
        return FieldKernels(of.splines[:, :1, middle : middle + 1], places, bank.pitch_um)

    # 20 um hold 98 % of the energy at f/2.8.
    cells, nodes = cells_within(
        first(kernels), pitch_um, 20.0, half_um, NODE_SHARE * accuracy.tolerance
    )

    grid = cheapest_grid(
        sensor,
        oversampling * period,
        period,
        (cut or reach_um) / pitch_um,
        cells,
        lambda g: needed(g, pitch_um),
    )
    scales = [Scale("core" if cut else "whole", grid, pitch_um, sigma, kernels)]
    if cut is not None:
        tail = field_kernels(images, places, bank.pitch_um, coarse_pitch_um, everything - core)
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
        coarse = cheapest_grid(
            sensor,
            coarse_stride,
            period,
            reach_um / coarse_pitch_um,
            few,
            lambda g: needed(g, coarse_pitch_um),
        )
        scales.append(Scale("tail", coarse, coarse_pitch_um, sigma, tail))
    predicted = {"planes": basis.residual, "alias": alias, "nodes": nodes, "cut": lost}
    # A raster of another pitch is never identical, and placing a finer one takes a while.
    identity = (
        not is_chart
        and bool(np.isclose(scene.source.pitch_um(*half_um), pitch_um, rtol=1e-9))
        and is_identity(scene.source.placed(*half_um, pitch_um), scales[0], chief_ray_map(bank))
    )
    described = describe(scales, basis, sensor, scene, predicted, identity)
    return Plan(basis, tuple(scales), described)


def _commonest_first(scene: Scene) -> np.ndarray:
    """Return the scene's spectra, those of most primitives first."""
    counts = np.zeros(len(scene.spectra))
    if isinstance(scene.source, Chart):
        np.add.at(counts, [shape.material for shape in scene.source.primitives], 1)
        counts[scene.source.background] = np.inf
    return np.argsort(-counts, kind="stable")

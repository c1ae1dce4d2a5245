"""FFTs and inverse FFT together, against a convolution summed in space over whole frames."""

import numpy as np
import pytest
from harness import assert_close
from optics.made import ULP, bank, convolve_for
from optics.whole_frame import (
    BLURRED,
    LENS,
    WEIGHTS,
    by_layer,
    camera,
    check_rectangles,
    on_device,
    source,
)

from gpusim.gpu import Device, Kernel, ShaderError
from gpusim.optics.convolve import Convolve
from gpusim.optics.grid import SimGrid
from gpusim.optics.modes import Decomposition, Modes
from gpusim.optics.nodes import Scale, folds_of
from gpusim.plan.blocks import TRANSFORMS
from gpusim.psf.bank import Bank
from gpusim.sensor.aperture import Response

F32 = np.float32

# Frame, stride, period, length, reach, cells. Blocks: several a cell, none of a round size.
CASES = {
    "two samples a pixel": (SimGrid(33, 46, 4, 2, 256, 96, (2, 1)), 0.8),
    "one site": (SimGrid(30, 35, 2, 1, 256, 32, (1, 2)), 0.8),
    "sixteen sites": (SimGrid(29, 31, 8, 4, 512, 32, (2, 2)), 0.0),
    # On coarse grids kernels are band-limited: the tails of a PSF, as the planner has it.
    "sixteen samples a pixel": (SimGrid(13, 11, 16, 1, 256, 64, (1, 1)), 0.8),
    "eight samples a pixel": (SimGrid(14, 18, 16, 2, 256, 64, (2, 1)), 0.8),
    "sixteen sites, four samples a pixel": (SimGrid(12, 10, 16, 4, 256, 64, (1, 1)), 0.8),
    "sixteen sites, a sample a pixel": (SimGrid(29, 31, 4, 4, 256, 16, (2, 1)), 0.8),
    "a plane for each of three channels": (SimGrid(30, 35, 2, 1, 256, 32, (1, 2), 3), 0.8),
    "of six channels, a sample a pixel": (SimGrid(30, 35, 1, 1, 256, 16, (1, 1), 6), 0.8),
    "sites between samples": (SimGrid(34, 47, 1, 2, 256, 16, (2, 2)), 0.8),
}


@pytest.mark.parametrize("name", CASES)
def test_each_sample_is_spread_by_the_mixture_of_its_nodes(device: Device, name: str):
    grid, sigma = CASES[name]
    scale, site_channels = camera(grid, sigma, LENS if grid.oversampling > 1 else BLURRED)
    blocks = source(grid, len(WEIGHTS))
    # Blocks that need no, one or two planes, as a chart has them.
    needed = {block: (2, 1, 2, 0, 1)[sum(block) % 5] for block in blocks}
    frame = (0, 0, grid.rows, grid.cols)
    found = on_device(device, Convolve, scale, site_channels, blocks, needed, frame)
    # Three hundred roundings at most (108 and 6 log2 M of the transforms, 50 of sums and products),
    # of sums of positive numbers, or nearly: kernels and sources have no large negative parts.
    for image, expected in by_layer(found, scale, site_channels, blocks, needed):
        assert_close(image, expected, atol=300 * ULP * np.abs(expected).max())


# The lens is symmetric. The last two entries say which ways blocks beyond the middle are mirror
# images, and at how many nodes kernels are made.
FOLDED = {
    "both ways": (SimGrid(36, 48, 4, 2, 256, 96, (2, 3)), 0.8, (True, True), 2 * 3),
    "several blocks a cell": (SimGrid(60, 80, 4, 2, 256, 108, (2, 1)), 0.8, (True, True), 2 * 2),
    "down alone": (SimGrid(36, 47, 4, 2, 256, 32, (2, 2)), 0.8, (False, True), 3 * 2),
    "sixteen sites": (SimGrid(32, 36, 8, 4, 512, 32, (3, 2)), 0.8, (True, True), 3 * 2),
    "one site": (SimGrid(28, 36, 2, 1, 256, 32, (4, 1)), 0.8, (True, True), 3 * 2),
    "a plane for each of three channels": (
        SimGrid(28, 36, 2, 1, 256, 32, (2, 2), 3),
        0.8,
        (True, True),
        2 * 2,
    ),
}


@pytest.mark.parametrize("name", FOLDED)
def test_blocks_beyond_the_middle_are_mirror_images_of_others(device: Device, name: str):
    grid, sigma, folds, nodes = FOLDED[name]
    scale, site_channels = camera(grid, sigma, bank())
    assert scale.kernels.mirrored
    blocks = source(grid, len(WEIGHTS))
    needed = {block: (2, 1, 2, 1, 1)[sum(block) % 5] for block in blocks}
    made = []

    def convolve(*arguments: object) -> Convolve:
        made.append(Convolve(*arguments))
        return made[-1]

    frame = (0, 0, grid.rows, grid.cols)
    found = on_device(device, convolve, scale, site_channels, blocks, needed, frame)
    assert (made[0].folds, made[0].made) == (folds, nodes)
    # Roundings as for the lens of the cases above: the same transforms, read the other way round.
    for image, expected in by_layer(found, scale, site_channels, blocks, needed):
        assert_close(image, expected, atol=300 * ULP * np.abs(expected).max())


@pytest.mark.parametrize(
    ("parts", "motion", "even"),
    [
        (((0.0, 0.0, 0.8, 0.6, 1.0),), (0.0, 0.0), True),
        (((0.1, 0.0, 0.8, 0.6, 1.0),), (0.0, 0.0), False),
        (((0.0, 0.1, 0.8, 0.6, 1.0),), (0.0, 0.0), False),
        (((0.0, 0.0, 0.8, 0.6, 1.0),), (0.2, 0.0), True),
        (((0.0, 0.0, 0.8, 0.6, 1.0),), (0.2, 0.1), False),
        (((-0.2, 0.0, 0.4, 0.8, 0.5), (0.2, 0.0, 0.4, 0.8, 0.5)), (0.0, 0.0), True),
        (((-0.2, 0.0, 0.4, 0.8, 0.4), (0.2, 0.0, 0.4, 0.8, 0.6)), (0.0, 0.0), False),
    ],
)
def test_an_aperture_that_is_not_its_mirror_image_folds_nothing(parts, motion, even):
    grid = FOLDED["both ways"][0]
    response = Response(parts, motion)
    assert folds_of(grid, True, response, 2) == (even, even)
    # It is even if what it sees of any wave is real, and the same of waves to the other side.
    f = np.linspace(-0.9, 0.9, 7)
    seen = response.spectrum(f, f[:, None])
    same = np.allclose(seen, seen[:, ::-1]) and np.allclose(seen, seen[::-1])
    assert (same and np.allclose(seen.imag, 0)) == even


def test_neither_a_skew_lens_nor_kernels_beside_the_pixel_fold_anything():
    grid = FOLDED["both ways"][0]
    assert folds_of(grid, True, 1.0, 2) == (True, True)
    assert folds_of(grid, False, 1.0, 2) == (False, False)
    assert folds_of(grid, True, 1.0, 0) == (False, False)


@pytest.mark.parametrize("lens", [LENS, bank()], ids=["skew", "symmetric"])
def test_a_rectangle_gets_the_same_bits_as_the_whole(device: Device, lens: Bank):
    grid, sigma = SimGrid(36, 48, 4, 2, 256, 96, (2, 3)), 0.8
    scale, site_channels = camera(grid, sigma, lens)
    rects = [(0, 0, 8, 10), (14, 20, 8, 10), (30, 44, 4, 2)]
    check_rectangles(device, Convolve, scale, site_channels, rects)


# Samples per pixel and CFA period: the core's sim grids, and the coarse ones of the tails.
PLANNED = [
    (16, 1),
    (8, 2),
    (4, 4),
    (2, 1),
    (2, 2),
    (2, 4),
    (4, 1),
    (4, 2),
    (1, 1),
    (0.5, 2),
    (1, 4),
]


@pytest.mark.parametrize("length", TRANSFORMS)
@pytest.mark.parametrize(("oversampling", "period"), PLANNED)
def test_every_planned_kernel_fits_16_kib_of_workgroup_memory(
    device: Device, length: int, oversampling: float, period: int
):
    grid = SimGrid(64, 64, int(oversampling * period), period, length, 8 * period, (1, 1))
    sites = [site % 3 for site in range(grid.sites)]
    stage = convolve_for(device, grid, sites, 3)
    size = 2 * grid.half_size
    one = Decomposition(
        np.zeros((1, 2, 3, size, size), F32), np.ones((1, 33, 33)), np.ones(1), np.ones(1)
    )
    scale = Scale("test", grid, 1.0, 0.0, None)
    modes = [
        Modes(device, scale, {(0, 0): planes}, 1.0, sites, decomposition=one) for planes in (1, 2)
    ]
    kernels = [stage.fft_rows, stage.inverse_fft]
    kernels += [kernel for one in modes for kernel in (one.modes, one.inverse_fft)]
    for kernel in kernels:
        assert kernel.workgroup_bytes == 16 * length <= 16384
        assert np.prod(kernel.workgroup_size) == length // 8 <= 256
    for passes in (stage.fft_columns, *(one.fft_columns for one in modes)):
        assert all(kernel.workgroup_bytes == 0 for kernel, _ in passes)
    for part in (stage, *modes):
        part.release()


def test_the_next_longer_transform_is_refused():
    """The control of the test above: 2048 samples need 32 KiB, which not every adapter has."""
    with pytest.raises(ShaderError, match="32768 bytes of workgroup storage"):
        Kernel("optics/fft_rows", T=2048, LANES=256, FIRST_RADIX=4, BX=64, BY=64)

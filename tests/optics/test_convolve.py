"""Rows, columns and lattice together, against a convolution summed in space over whole frames.

No blocks and no transforms of blocks: each source sample is spread by its own mixture of the four
nodes' kernels over the whole frame, one channel at a time, and taken at the photosites.
"""

import numpy as np
import pytest
import scipy.fft
from harness import assert_close
from optics.made import ULP, bank

from gpusim.gpu import Device, Recording
from gpusim.optics.convolve import Convolve, Scale, Scratch
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import (
    aperture_spectrum,
    field_images,
    field_kernels,
    node_kernels,
    sampled_kernels,
)

F32 = np.float32
LENS = bank(skew_um=2.0)
BLURRED = bank(size=128, sigma_um=(6.0, 6.2, 6.5), skew_um=5.0, coma_um=6.0)
PITCH_UM = 1.55
FILL = 0.9
WEIGHTS = np.random.default_rng(21).uniform(1, 9, (2, 3, 3))  # planes, channels, wavelengths

# Frame, stride, period, length, reach, cells. Blocks: several a cell, none of a round size.
CASES = {
    "two samples a pixel": (SimGrid(33, 46, 4, 2, 256, 96, (2, 1)), 0.8),
    "one site": (SimGrid(30, 35, 2, 1, 256, 32, (1, 2)), 0.8),
    "sixteen sites": (SimGrid(29, 31, 8, 4, 512, 32, (2, 2)), 0.0),
    # On coarse grids kernels are band-limited: the tails of a PSF, as the planner has it.
    "sixteen sites, a sample a pixel": (SimGrid(29, 31, 4, 4, 256, 16, (2, 1)), 0.8),
    "sites between samples": (SimGrid(34, 47, 1, 2, 256, 16, (2, 2)), 0.8),
}


def source(grid: SimGrid, planes: int) -> dict[tuple[int, int], np.ndarray]:
    """Return smooth noise (planes, BY, BX) for each block: white up to a third of Nyquist."""
    rng = np.random.default_rng(grid.rows)
    width, height = (b * n for b, n in zip(grid.block, grid.blocks, strict=True))
    noise = scipy.fft.rfft2(rng.uniform(0, 1, (planes, height, width)))
    frequency = np.hypot(scipy.fft.rfftfreq(width), scipy.fft.fftfreq(height)[:, None])
    smooth = scipy.fft.irfft2(noise * np.exp(-((frequency / 0.12) ** 2)), s=(height, width))
    smooth = smooth.astype(F32)
    by, bx = grid.block[::-1]
    return {
        (x, y): np.ascontiguousarray(smooth[:, y * by : (y + 1) * by, x * bx : (x + 1) * bx])
        for x, y in np.ndindex(grid.blocks)
    }


def camera(grid: SimGrid, sigma: float) -> tuple[Scale, list[int]]:
    """Return a scale of kernels, and the channel of each site."""
    pitch_um = PITCH_UM / grid.oversampling
    lens = LENS if grid.oversampling > 1 else BLURRED
    images, places = field_images(lens, WEIGHTS, 1e9)
    kernels = field_kernels(images, places, 0.5, pitch_um, np.ones(images.shape[-2:]))
    return Scale("test", grid, pitch_um, sigma, kernels), [2, 1, 1, 0, 1, 2, 0, 1] * 2


def on_device(device, scale, site_channels, blocks, needed, rect):
    """Return the planes (S, rows, cols) of the CFA sites of a rectangle."""
    grid = scale.grid
    sites = site_channels[: grid.sites]
    aperture_um = PITCH_UM * np.sqrt(FILL)
    stage = Convolve(device, scale, needed, aperture_um, sites)
    stage.load([block for block in grid.blocks_for(*rect) if needed[block]])
    rec = Recording(device)
    shape = (grid.sites, *(-(-side // grid.period) for side in rect[2:]))
    rates = rec.buffer("rates", shape, F32)
    rec.clear(rates)
    scratch = Scratch(rec, "test", grid, len(WEIGHTS))
    for block in grid.blocks_for(*rect):
        if needed[block]:
            rec.upload(scratch.planes, blocks[block])
            stage.record(rec, block, needed[block], scratch, rates, rect)
    label = rec.download(rates)
    result = rec.run()[label]
    stage.release()
    return result


def in_space(scale: Scale, site_channels: list[int], blocks, needed) -> np.ndarray:
    """Return electrons/s of every pixel (rows, cols), in float64."""
    grid = scale.grid
    width, height = (b * n for b, n in zip(grid.block, grid.blocks, strict=True))
    whole = np.zeros((len(WEIGHTS), height, width))
    for (x, y), part in blocks.items():
        by, bx = part.shape[1:]
        used = needed[x, y]
        whole[:used, y * by : (y + 1) * by, x * bx : (x + 1) * bx] = part[:used]
    size = scipy.fft.next_fast_len(max(width, height) + 2 * grid.half_size)
    aperture = aperture_spectrum(size, PITCH_UM * np.sqrt(FILL) / scale.pitch_um, scale.sigma, 0.0)
    f = scipy.fft.fftfreq(size)
    nodes = {}

    def points(x: int, y: int) -> np.ndarray:
        if (x, y) not in nodes:
            at = (np.array(grid.node_position((x, y))) - grid.centre) * scale.pitch_um
            nodes[x, y] = sampled_kernels(
                scale.kernels, *at, scale.pitch_um, grid.half_size, len(WEIGHTS)
            )
        return nodes[x, y]

    spectra = np.zeros((3, size, size), complex)
    for x, y in np.ndindex(grid.nodes):
        kernel = node_kernels(lambda dx, dy, x=x, y=y: points(x + dx, y + dy))
        share = []
        for axis, n in enumerate((x, y)):
            cell = grid.block[axis] * grid.blocks_per_cell[axis]
            position = (np.arange((width, height)[axis]) + 0.5) / cell
            share.append(np.maximum(1 - np.abs(position - n), 0))
        weighted = scipy.fft.fft2(whole * np.outer(share[1], share[0]), s=(size, size))
        spectra += np.einsum("jyx,jcyx->cyx", weighted, scipy.fft.fft2(kernel, s=(size, size)))
    spectra *= aperture[:, None] * aperture
    result = np.empty((grid.rows, grid.cols))
    # A pixel's centre, in samples from that of the first source sample plus the kernels' reach.
    rows, cols = (
        (np.arange(count) + 0.5) * grid.oversampling - 0.5 + 2 * grid.half_size
        for count in (grid.rows, grid.cols)
    )
    for channel in range(3):
        back = [np.exp(2j * np.pi * np.outer(at, f)) / size for at in (rows, cols)]
        image = (back[0] @ spectra[channel] @ back[1].T).real
        for site, of_site in enumerate(site_channels[: grid.sites]):
            if of_site == channel:
                row, col = site // grid.period, site % grid.period
                part = np.s_[row :: grid.period, col :: grid.period]
                result[part] = image[part]
    return result


def mosaic(planes: np.ndarray, period: int, shape: tuple[int, int]) -> np.ndarray:
    whole = np.empty((planes.shape[1] * period, planes.shape[2] * period))
    for site, plane in enumerate(planes):
        whole[site // period :: period, site % period :: period] = plane
    return whole[: shape[0], : shape[1]]


@pytest.mark.parametrize("name", CASES)
def test_each_sample_is_spread_by_the_mixture_of_its_nodes(device: Device, name: str):
    grid, sigma = CASES[name]
    scale, site_channels = camera(grid, sigma)
    blocks = source(grid, len(WEIGHTS))
    # Blocks that need no, one or two planes, as a chart has them.
    needed = {block: (2, 1, 2, 0, 1)[sum(block) % 5] for block in blocks}
    found = on_device(device, scale, site_channels, blocks, needed, (0, 0, grid.rows, grid.cols))
    expected = in_space(scale, site_channels, blocks, needed)
    image = mosaic(found, grid.period, expected.shape)
    # Three hundred roundings at most (108 and 6 log2 M of the transforms, 50 of sums and products),
    # of sums of positive numbers, or nearly: kernels and sources have no large negative parts.
    assert_close(image, expected, atol=300 * ULP * np.abs(expected).max())


def test_a_rectangle_gets_the_same_bits_as_the_whole(device: Device):
    grid, sigma = CASES["two samples a pixel"]
    scale, site_channels = camera(grid, sigma)
    blocks = source(grid, len(WEIGHTS))
    needed = dict.fromkeys(blocks, 2)
    whole = on_device(device, scale, site_channels, blocks, needed, (0, 0, grid.rows, grid.cols))
    for rect in [(0, 0, 8, 10), (14, 20, 7, 9), (30, 44, 3, 2)]:
        part = on_device(device, scale, site_channels, blocks, needed, rect)
        row, col = rect[0] // 2, rect[1] // 2
        shape = part.shape[1:]
        assert_close(part, whole[:, row : row + shape[0], col : col + shape[1]].copy(), atol=0)

"""A frame convolved in space: sources, kernels, and what every method must make of them.

No blocks and no transforms of blocks: each source sample is spread by its own mixture of the four
nodes' kernels over the whole frame, one channel at a time, and taken at the photosites.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.fft
from harness import assert_close
from optics.made import at_lines, bank

from gpusim.gpu import Device, Recording
from gpusim.optics.grid import SimGrid
from gpusim.optics.images import field_images
from gpusim.optics.kernel_spectra import aperture_spectrum
from gpusim.optics.kernels import field_kernels
from gpusim.optics.nodes import Rates, Scale
from gpusim.optics.sampling import node_kernels, sampled_kernels
from gpusim.psf.bank import Bank

F32 = np.float32
LENS = bank(skew_um=2.0)
BLURRED = bank(size=128, sigma_um=(6.0, 6.2, 6.5), skew_um=5.0, coma_um=6.0)  # for coarse grids
PITCH_UM = 1.55
FILL = 0.9
WEIGHTS = np.random.default_rng(21).uniform(1, 9, (2, 3, 3))  # planes, channels, wavelengths


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


def camera(grid: SimGrid, sigma: float, lens: Bank = LENS) -> tuple[Scale, list[int]]:
    """Return a scale of kernels, and the channel of each site."""
    pitch_um = PITCH_UM / grid.oversampling
    images, places = field_images(lens, at_lines(lens, WEIGHTS), 1e9)
    kernels = field_kernels(images, places, 0.5, pitch_um, np.ones(images.shape[-2:]))
    return Scale("test", grid, pitch_um, sigma, kernels), [2, 1, 1, 0, 1, 2, 0, 1] * 2


def on_device(
    device: Device,
    make: Callable,
    scale: Scale,
    site_channels: list[int],
    blocks: dict[tuple[int, int], np.ndarray],
    needed: dict[tuple[int, int], int],
    rect: tuple[int, int, int, int],
) -> np.ndarray:
    """Return the planes (S, rows, cols) of the CFA sites of a rectangle.

    `make` gets (device, scale, needed, aperture_um, site_channels) and returns the stage.
    """
    grid = scale.grid
    stage = make(device, scale, needed, PITCH_UM * np.sqrt(FILL), site_channels[: grid.sites])
    stage.load([block for block in grid.blocks_for(*rect) if needed[block]])
    rec = Recording(device)
    shape = (grid.sites, *(-(-side // grid.period) for side in rect[2:]))
    rates = rec.buffer("rates", shape, F32)
    rec.clear(rates)
    scratch = stage.scratch(rec, len(WEIGHTS))
    for block in grid.blocks_for(*rect):
        if needed[block]:
            rec.upload(scratch.planes, blocks[block])
            stage.record(rec, block, needed[block], scratch, Rates(rates, rect))
    label = rec.download(rates)
    result = rec.run()[label]
    stage.release()
    return result


def check_rectangles(
    device: Device, make: Callable, scale: Scale, site_channels: list[int], rects: list[tuple]
) -> None:
    """Fail unless rectangles of a frame get the same bits as the whole."""
    grid = scale.grid
    blocks = source(grid, len(WEIGHTS))
    needed = dict.fromkeys(blocks, 2)
    frame = (0, 0, grid.rows, grid.cols)
    whole = on_device(device, make, scale, site_channels, blocks, needed, frame)
    for rect in rects:
        part = on_device(device, make, scale, site_channels, blocks, needed, rect)
        row, col = rect[0] // grid.period, rect[1] // grid.period
        shape = part.shape[1:]
        assert_close(part, whole[:, row : row + shape[0], col : col + shape[1]].copy(), atol=0)


def in_space(
    scale: Scale,
    site_channels: list[int],
    blocks: dict[tuple[int, int], np.ndarray],
    needed: dict[tuple[int, int], int],
    cells: tuple[int, int] | None = None,
    kernels_of: Callable[[int, int], np.ndarray] | None = None,
) -> np.ndarray:
    """Return electrons/s of every pixel (rows, cols), in float64.

    `cells` between PSF nodes, where they are not the grid's; `kernels_of` the nodes, where they are
    not the scale's.
    """
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
    cells = cells or grid.cells
    spacing = [side / count for side, count in zip((width, height), cells, strict=True)]
    nodes = {}

    def points(x: int, y: int) -> np.ndarray:
        if (x, y) not in nodes:
            at = np.array([x * spacing[0], y * spacing[1]]) + grid.start - grid.centre
            at *= scale.pitch_um
            nodes[x, y] = sampled_kernels(
                scale.kernels, *at, scale.pitch_um, grid.half_size, planes=len(WEIGHTS)
            )
        return nodes[x, y]

    spectra = np.zeros((3, size, size), complex)
    for x, y in np.ndindex(cells[0] + 1, cells[1] + 1):
        if kernels_of is None:
            kernel = node_kernels(lambda dx, dy, x=x, y=y: points(x + dx, y + dy))
        else:
            kernel = kernels_of(x, y)
        share = []
        for axis, n in enumerate((x, y)):
            position = (np.arange((width, height)[axis]) + 0.5) / spacing[axis]
            share.append(np.maximum(1 - np.abs(position - n), 0))
        weighted = scipy.fft.fft2(whole * np.outer(share[1], share[0]), s=(size, size))
        spectra += np.einsum("jyx,jcyx->cyx", weighted, scipy.fft.fft2(kernel, s=(size, size)))
    spectra *= aperture[:, None] * aperture
    if scale.kernels.ringing:
        # Kernels hold the band times a raised cosine over all of it; their spectra are to end as
        # the grid's does, from 0.85 of the Nyquist frequency on.
        cycles = np.minimum(np.hypot(f, f[:, None]), 0.5)
        ends = (1 + np.cos(np.pi * np.clip((2 * cycles - 0.85) / 0.15, 0, 1))) / 2
        held = (1 + np.cos(2 * np.pi * cycles)) / 2
        spectra *= np.where(cycles < 0.5, ends / np.where(cycles < 0.5, held, 1.0), 0.0)
    result = np.empty((grid.rows, grid.cols))
    # A pixel's centre, in samples from that of the first source sample plus the kernels' reach.
    rows, cols = (
        (np.arange(count) + 0.5) * grid.oversampling - 0.5 - first + grid.half_size
        for count, first in zip((grid.rows, grid.cols), grid.start[::-1], strict=True)
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


def by_layer(
    found: np.ndarray,
    scale: Scale,
    site_channels: list[int],
    blocks: dict[tuple[int, int], np.ndarray],
    needed: dict[tuple[int, int], int],
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return image and reference: of the filter pattern, or of each layer's channel."""
    grid = scale.grid
    if grid.layers == 1:
        expected = in_space(scale, site_channels, blocks, needed)
        return [(mosaic(found, grid.period, expected.shape), expected)]
    alone = replace(scale, grid=replace(grid, layers=1))
    return [
        (layer.astype(float), in_space(alone, [channel], blocks, needed))
        for layer, channel in zip(found, site_channels, strict=False)
    ]

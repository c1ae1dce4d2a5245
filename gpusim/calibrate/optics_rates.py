"""The rates of the optics' stages, on the device and on the host."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from gpusim.calibrate.timing import fastest
from gpusim.gpu import Device, Kernel, Recording, Use
from gpusim.optics.chief_ray import radial_map
from gpusim.optics.convolve import Convolve
from gpusim.optics.direct import Direct, direct_work
from gpusim.optics.grid import SimGrid
from gpusim.optics.highlight_tables import boxes
from gpusim.optics.kernel_spectra import kernel_spectra
from gpusim.optics.kernels import FieldKernels, interleaved
from gpusim.optics.methods import Convolution
from gpusim.optics.modes import Decomposition, Modes
from gpusim.optics.nodes import Rates, Scale
from gpusim.optics.paint import SIGMA, TILE, Paint
from gpusim.optics.point_sources import HIGHLIGHT, SQUARE
from gpusim.optics.sampling import sampled_kernels
from gpusim.optics.warp import Warp
from gpusim.parallel import each
from gpusim.plan.blocks import TRANSFORMS
from gpusim.plan.costs import LAVAPIPE, UNITS, Costs
from gpusim.psf.places import Heights
from gpusim.scene.chart import Chart, Disc
from gpusim.scene.raster import PlacedRaster

# Numbers that shaders/optics/fft_columns loads and stores for a sample of a transform, of a
# product, and of the inverse; and how much they weigh against a measured time.
LOADS, HELD = np.array([9.0, 2.0, 6.0]), 0.2
NODES = 16  # of which kernels are timed
# Blocks of 256 that one run convolves: a pass of one such dispatch is mostly its beginning and end.
BLOCKS = 3
PLANES = 3
# Boxes take that share of a table's time: 0.26 and 0.23 for tables of 294 and 420 samples a side (a
# desk's lamps before the demonstration camera and the phone).
BOXES = 0.24
SUPPORT = 12  # of the direct sum, sim samples
FLAT = radial_map(lambda real_um: real_um * (1 + 0.01 * (real_um / 1e4) ** 2), 1e4)


def _grid(length: int, period: int) -> SimGrid:
    """Return a sim grid of one block, which takes three quarters of the transform."""
    stride = 2 * period
    half_size = length // 8
    side = (length - 4 * half_size) // 2
    return SimGrid(side, side, stride, period, length, half_size, (1, 1))


def _scale(grid: SimGrid, channels: int = 1) -> Scale:
    # Any place between the first two is made of four fields.
    places = Heights(np.array([0.0, 1.0, 2.0]))
    nothing = FieldKernels(np.zeros((4, 1, channels, 4, 4), np.float32), places, 0.5)
    return Scale("calibration", grid, 1.0, SIGMA, nothing)


def host_rates(device: Device) -> dict[str | int, float]:
    """Time the making of kernels, on all cores, and their way to the device.

    Kernels of three planes and three channels go into memory that the second turn finds in use, as
    further frames do. A first frame's take up to three times as long.
    """
    half_size, length = 32, 256
    kernels = _scale(_grid(length, 2)).kernels
    splines = interleaved(4, 3, 3, 128)
    splines[...] = 1.0
    kernels = replace(kernels, splines=splines)

    def sample(number: int) -> np.ndarray:
        return sampled_kernels(kernels, 0.2, 0.01 * number, 0.775, half_size, planes=3)

    def spectra(sampled: np.ndarray) -> np.ndarray:
        outputs = [(channel, 0.5, 0.5) for channel in range(3)]
        return kernel_spectra(sampled, length, 2.0, SIGMA, outputs)

    spectra(sample(0))  # what is made once
    times = [time.perf_counter()]
    sampled = each(sample, range(NODES))
    times.append(time.perf_counter())
    nodes = [
        device.resident("node", one.view(np.float32), Use.TEXELS) for one in each(spectra, sampled)
    ]
    device.wait()
    times.append(time.perf_counter())
    for node in nodes:
        node.destroy()
    of_kernels, of_spectra = np.diff(times) / (9 * NODES)
    return {
        "kernels": 1e9 * of_kernels / (2 * half_size) ** 2,
        "spectra": 1e9 * of_spectra / length**2,
    }


def point_source_rates(device: Device) -> dict[str | int, float]:
    """Time the spectra of tables' boxes, on all cores, and highlights that light every pixel.

    The boxes are BOXES of what a table takes.
    """
    side, lines, near, cells, count = 256, 13, 64, 4 * SQUARE, 2
    shifts = np.linspace(-1.0, 1.0, 2 * lines).reshape(lines, 2)

    def one(number: int) -> np.ndarray:
        return boxes(side, 0.5, 1.55, shifts, angle=0.1 * number, square=2.0 * np.eye(2))

    started = time.perf_counter()
    each(one, range(4))
    boxes_s = (time.perf_counter() - started) / 4

    rows = np.zeros(count, HIGHLIGHT)
    rows["pixel"], rows["axis"] = cells, (0.1, 0.0)
    starts = count * np.arange((cells // SQUARE) ** 2 + 1, dtype=np.uint32)
    arrays = {
        "highlights": rows.view(np.uint32),
        "radiance": np.ones((count, 1, 4), np.float32),
        "starts": starts,
        "near": np.tile(np.arange(count, dtype=np.uint32), len(starts)),
        "kernels": np.ones((1, 3, 1, near**2, 4), np.float32),
    }
    rec = Recording(device)
    rates = rec.buffer("rates", (4, cells, cells), np.float32)
    rec.clear(rates)
    buffers = {}
    for name, array in arrays.items():
        use = Use.TEXELS if name == "kernels" else Use.DATA
        buffers[name] = rec.buffer(name, array.shape, array.dtype, use)
        rec.upload(buffers[name], array)
    groups = (cells // SQUARE, cells // SQUARE, 4)
    whole = {"first": (0, 0), "origin": (0, 0), "size": (cells, cells)}
    sites = {"across": groups[0], "site_channels": (0, 0, 0, 0), "fours": 1}
    sites |= {"reach2": 30.0**2, "near2": 30.0**2, "step": 1.0}
    kernel = Kernel("optics/point_sources", S=4, PERIOD=2, C=3, NEAR=near, FAR=0)
    kernel.record(rec, groups, whole | sites, **buffers, rates=rates)
    return {
        "tables": 1e9 * boxes_s / BOXES / (lines * side**2),
        "point sources": 1e9 * fastest(rec)["point sources"] / (count * 4 * cells**2),
    }


def source_rates(device: Device) -> dict[str | int, float]:
    """Time paint on tiles with and without edges, and warp."""
    scale = _scale(_grid(512, 2))
    samples = BLOCKS * np.prod(scale.grid.block)
    half = 256 / TILE
    dots = tuple(
        Disc(TILE * (x + 0.5), TILE * (y + 0.5), TILE / 3, 1)
        for y in np.arange(-half, half)
        for x in np.arange(-half, half)
    )
    coefficients = np.array([[1.0], [0.5]])
    times = []
    for primitives in ((), dots):
        chart = Chart(("white", "grey"), 0, primitives)
        stage = Paint(device, chart, coefficients, scale, FLAT)
        times.append(_stage_time(device, stage)["paint"])
        tiles = device.read(stage.lists[0])
        touched = int(tiles[:, 2].sum()) * TILE**2 * BLOCKS
        stage.release()
    raster = PlacedRaster(np.ones((1, 256, 256), np.float32), 2.0, -256.0, -256.0, "")
    warp = Warp(device, raster, np.eye(1), scale, FLAT)
    warp_s = _stage_time(device, warp)["warp"]
    warp.release()
    return {
        "paint": 1e9 * times[0] / samples,
        "edges": 1e9 * max(times[1] - times[0], 0.1 * times[0]) / touched,
        "warp": 1e9 * warp_s / samples,
    }


def _stage_time(device: Device, stage: Paint | Warp) -> dict[str, float]:
    stage.prepare([(0, 0)])
    stage.load([(0, 0)])
    rec = Recording(device)
    planes = rec.buffer("planes", (1, *stage.grid.block[::-1]), np.float32)
    for _ in range(BLOCKS):
        stage.record(rec, (0, 0), planes)
    return fastest(rec)


def transform_rates(device: Device) -> dict[str | int, float]:
    """Time FFT of rows, FFT of columns and inverse FFT: by planes, channels and length."""
    at_256 = {
        (channels, planes): _convolved(device, 256, channels, planes)
        for channels in (1, 3)
        for planes in (1, PLANES)
    }
    # The three rates of the FFT of columns from four times, each counted by its share.
    work, times = [], []
    grid = _grid(256, 2)
    unit = {
        name: 1e9 if name in ("fft columns", "products", "inverse columns") else 0.0
        for name in UNITS
    }
    for (channels, planes), found in at_256.items():
        count = np.array([planes])
        work.append(
            [
                Costs(
                    "", unit | {other: 0.0 for other in unit if other != name}, {256: 1.0}
                ).transforms(grid, channels, count)["fft columns"]
                for name in ("fft columns", "products", "inverse columns")
            ]
        )
        times.append(found["fft columns"])
    parts = np.array(work) / np.array(times)[:, None]
    # Four times that differ little tell three rates badly apart: they are held to what counts on a
    # processor, the numbers that each unit loads and stores.
    likely = LOADS * np.linalg.lstsq(parts @ LOADS[:, None], np.ones(len(times)))[0]
    rates, _ = nnls(
        np.concatenate([parts, np.diag(HELD / likely)]), np.append(np.ones(len(times)), [HELD] * 3)
    )
    units = Costs("", dict.fromkeys(UNITS, 1e9), {256: 1.0}).transforms(grid, 3, np.array([PLANES]))
    ns = {
        stage: 1e9 * at_256[3, PLANES][stage] / units[stage]
        for stage in ("fft rows", "inverse fft")
    }
    ns |= dict(zip(("fft columns", "products", "inverse columns"), 1e9 * rates, strict=True))
    return ns | _length_rates(device, ns)


def _length_rates(device: Device, ns: dict[str, float]) -> Mapping[int, float]:
    """Return how much slower per sample long transforms are, from the rates at 256.

    On a processor its caches decide it, and the table's ratios are taken: measured ones were 1.05
    to 3.6 at 512 and 1.2 to 11.8 at 1024 on one busy machine, and their kernels take half a minute
    to compile on Mesa 25.
    """
    if device.report()["type"] == "CPU":
        return LAVAPIPE.lengths
    alike = Costs("", dict.fromkeys(UNITS, 0.0) | ns, dict.fromkeys(TRANSFORMS, 1.0))
    lengths = {256: 1.0}
    for length in TRANSFORMS:
        if length != 256:
            # As many planes as a photograph has: kernels around a block then take 36 MiB at
            # T = 512, which no cache holds. Those of one plane take a third.
            found = _convolved(device, length, 3, PLANES)
            expected = alike.transforms(_grid(length, 2), 3, np.array([PLANES]))
            lengths[length] = sum(found.values()) / sum(expected.values())
    return lengths


def other_rates(device: Device) -> dict[str | int, float]:
    """Time the forward pass of modes, and the direct sum."""
    grid, sites = _grid(256, 2), [0, 1, 1, 2]
    size = (2, 1, 3, 2 * grid.half_size, 2 * grid.half_size)
    two = Decomposition(np.zeros(size, np.float32), np.ones((2, 2, 2)), np.ones(2), np.zeros(2))
    modes = Modes(device, _scale(grid, 3), {(0, 0): 1}, 1.0, sites, decomposition=two)
    direct = Direct(device, _scale(grid, 3), {(0, 0): 1}, 1.0, sites, support=SUPPORT)
    for one in (modes, direct):
        one.load([(0, 0)])
    times = [_blocks_time(device, one, 1) for one in (modes, direct)]
    madds = direct_work(grid, SUPPORT, {(0, 0): 1}, sites)
    samples = grid.block[1] * grid.length * np.log2(grid.length)
    return {"modes": 1e9 * times[0]["modes"] / samples, "direct": 1e9 * times[1]["direct"] / madds}


def _convolved(device: Device, length: int, channels: int, planes: int) -> dict[str, float]:
    """Return the seconds of each pass of the FFTs for one block of a Bayer pattern."""
    grid = _grid(length, 2)
    sites = [0, 1, 1, 2] if channels == 3 else [0] * 4
    convolution = Convolve(device, _scale(grid, channels), {}, 1.0, sites)
    size = planes * length // 2 * length * channels * 2
    for node in np.ndindex(grid.nodes):
        convolution.nodes[node] = device.resident(
            "node", np.zeros(size, np.float32), convolution.use
        )
    return _blocks_time(device, convolution, planes)


def _blocks_time(device: Device, convolution: Convolution, planes: int) -> dict[str, float]:
    """Return the seconds of each pass for a block of zeros."""
    grid = convolution.grid
    blocks = BLOCKS if grid.length == 256 else 1
    rec = Recording(device)
    scratch = convolution.scratch(rec, planes)
    rates = rec.buffer("rates", (4, grid.rows // 2, grid.cols // 2), np.float32)
    rec.clear(scratch.planes)
    rec.clear(rates)
    for _ in range(blocks):
        whole = Rates(rates, (0, 0, grid.rows, grid.cols))
        convolution.record(rec, (0, 0), planes, scratch, whole)
    found = fastest(rec)
    convolution.release()
    return {stage: seconds / blocks for stage, seconds in found.items()}

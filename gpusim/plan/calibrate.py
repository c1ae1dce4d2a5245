"""Measure an adapter's rates for the cost model, once, and keep them in the user's cache."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from gpusim.config.text import read_json
from gpusim.errors import UserError
from gpusim.gpu import Device, Kernel, Recording, Use
from gpusim.gpu.wgsl import shaders_sha256
from gpusim.optics.chief_ray import radial_map
from gpusim.optics.convolve import Convolve
from gpusim.optics.direct import Direct, direct_work
from gpusim.optics.grid import SimGrid
from gpusim.optics.highlight_tables import boxes
from gpusim.optics.kernel_spectra import kernel_spectra
from gpusim.optics.kernels import FieldKernels, interleaved
from gpusim.optics.methods import Convolution
from gpusim.optics.modes import Decomposition, Modes
from gpusim.optics.nodes import Scale
from gpusim.optics.paint import SIGMA, TILE, Paint
from gpusim.optics.point_sources import HIGHLIGHT, SQUARE
from gpusim.optics.sampling import sampled_kernels
from gpusim.optics.warp import Warp
from gpusim.plan.costs import UNITS, Costs, content_of, costs_of
from gpusim.plan.layout import TRANSFORMS
from gpusim.plan.stage import stage_of
from gpusim.psf.places import Heights
from gpusim.scene.chart import Chart, Disc
from gpusim.scene.raster import PlacedRaster
from gpusim.sensor.adc import record_adc
from gpusim.sensor.adc_model import DualGain
from gpusim.sensor.bloom import record_bloom
from gpusim.sensor.border import record_border
from gpusim.sensor.crosstalk import record_crosstalk
from gpusim.sensor.crosstalk_model import Kernels
from gpusim.sensor.cti import record_cti
from gpusim.sensor.cti_model import Cti, Species
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.load import load_sensor
from gpusim.sensor.merge import record_merge
from gpusim.sensor.mosaic import record_mosaic
from gpusim.sensor.noise import record_noise
from gpusim.sensor.smear import record_smear
from gpusim.sensor.smear_model import Smear
from gpusim.sensor.traps import record_traps

# Numbers that shaders/optics/fft_columns loads and stores for a sample of a transform, of a
# product, and of the inverse; and how much they weigh against a measured time.
LOADS, HELD = np.array([9.0, 2.0, 6.0]), 0.2
NODES = 16  # of which kernels are timed
# Blocks of 256 that one run convolves: a pass of one such dispatch is mostly its beginning and end.
BLOCKS = 3
TURNS = 2  # in which everything is timed; the first also compiles
RUNS = 3  # in each turn, of which the fastest counts
SIDE = 512  # of the frame for the sensor's stages, pixels
PLANES = 3
# Boxes take that share of a table's time: 0.26 and 0.23 for tables of 294 and 420 samples a side (a
# desk's lamps before the demonstration camera and the phone).
BOXES = 0.24
SUPPORT = 12  # of the direct sum, sim samples
FLAT = radial_map(lambda real_um: real_um * (1 + 0.01 * (real_um / 1e4) ** 2), 1e4)
NOTHING = """
struct Params { number: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> found: array<u32>;
@compute @workgroup_size(1, 1, 1)
fn main() { found[0] = params.number; }
"""
Progress = Callable[[int, int], None]


def adapter_costs(
    device: Device, *, again: bool = False, progress: Progress | None = None
) -> Costs:
    """Return the rates of a device, from the cache or measured now.

    Parameters
    ----------
    device : Device
    again : bool
        Measure even if the cache has them.
    progress : callable, optional
        Called with (measurements done, measurements in all).

    Notes
    -----
    The cache is ``$XDG_CACHE_HOME/gpusim/costs`` (``~/.cache`` where unset). The key is a hash of
    the adapter, its driver, the shaders and this file. Where the cache cannot be written the rates
    are measured every time.
    """
    path = _path(device)
    found = None if again else _read(path)
    if found is None:
        found = measure(device, progress)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(f".{os.getpid()}.part")
            part.write_text(json.dumps(content_of(found), indent=1))
            part.replace(path)
        except OSError:
            pass  # the next process measures again
    return found


def cached_costs(device: Device) -> Costs | None:
    """Return the rates of a device if they were measured before."""
    return _read(_path(device))


def _path(device: Device) -> Path:
    report = device.report()
    digest = hashlib.sha256(shaders_sha256().encode() + Path(__file__).read_bytes())
    for name in ("adapter", "driver", "backend", "wgpu"):
        digest.update(str(report[name]).encode() + b"\0")
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gpusim" / "costs"
    return folder / f"{digest.hexdigest()[:32]}.json"


def _read(path: Path) -> Costs | None:
    """Return what a file holds, or None if it is no whole set of rates."""
    try:
        return costs_of(read_json(path, "the rates"))
    except (UserError, ValueError):
        return None


def planned_costs(file: Path) -> Costs:
    """Return the rates that the plan of a report was made from: they make the same plan again.

    Raises
    ------
    UserError
        The file is no report of a render, or its rates are none.
    """
    report = read_json(file, "the report")
    try:
        return costs_of(report["costs"] if isinstance(report, dict) else None)
    except (KeyError, ValueError) as error:
        raise UserError(
            "the file does not say which rates its plan was made from",
            file=file,
            field="costs",
            value=str(error),
            allowed="a report.json that gpusim render wrote",
        ) from error


def measure(device: Device, progress: Progress | None = None) -> Costs:
    """Time every stage on a small piece of its work.

    All are timed in turns, and each counts as in the turn that it took least time in: a plan weighs
    them against one another, and a machine with other work runs now faster and now slower.
    """
    tell = progress or (lambda done, total: None)
    parts = (_host, _point_sources, _source, _transforms, _others, _sensor, _ccd, _dispatch)
    best: dict[Callable, tuple[float, dict[str | int, float]]] = {}
    for number, part in enumerate(TURNS * parts):
        tell(number, TURNS * len(parts))
        started = time.perf_counter()
        rates = part(device)
        spent = time.perf_counter() - started
        if part not in best or spent < best[part][0]:
            best[part] = (spent, rates)
    tell(TURNS * len(parts), TURNS * len(parts))
    ns: dict[str, float] = {}
    lengths: dict[int, float] = {}
    for _, rates in best.values():
        lengths |= {key: float(rates.pop(key)) for key in TRANSFORMS if key in rates}
        ns |= {name: float(rate) for name, rate in rates.items()}
    return Costs(f"measured on {device.report()['adapter']}", ns, lengths)


def _fastest(rec: Recording) -> dict[str, float]:
    """Return the least seconds of each stage over some runs."""
    rec.run()  # compiles, and fills the pool
    runs = [rec.run().times_s for _ in range(RUNS)]
    return {stage_of(path): min(run[path] for run in runs) for path in runs[0]}


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


def _host(device: Device) -> dict[str | int, float]:
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
        return sampled_kernels(kernels, 0.2, 0.01 * number, 0.775, half_size, 3)

    def spectra(sampled: np.ndarray) -> np.ndarray:
        outputs = [(channel, 0.5, 0.5) for channel in range(3)]
        return kernel_spectra(sampled, length, 2.0, SIGMA, outputs)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        spectra(sample(0))  # what is made once
        times = [time.perf_counter()]
        sampled = list(pool.map(sample, range(NODES)))
        times.append(time.perf_counter())
        nodes = [
            device.resident("node", one.view(np.float32), Use.TEXELS)
            for one in pool.map(spectra, sampled)
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


def _point_sources(device: Device) -> dict[str | int, float]:
    """Time the spectra of tables' boxes, on all cores, and highlights that light every pixel.

    The boxes are BOXES of what a table takes.
    """
    side, lines, near, cells, count = 256, 13, 64, 4 * SQUARE, 2
    shifts = np.linspace(-1.0, 1.0, 2 * lines).reshape(lines, 2)

    def one(number: int) -> np.ndarray:
        return boxes(side, 0.5, 1.55, shifts, 0.1 * number, 2.0 * np.eye(2))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        started = time.perf_counter()
        list(pool.map(one, range(4)))
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
        "point sources": 1e9 * _fastest(rec)["point sources"] / (count * 4 * cells**2),
    }


def _source(device: Device) -> dict[str | int, float]:
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
    return _fastest(rec)


def _transforms(device: Device) -> dict[str | int, float]:
    """Time FFT of rows, FFT of columns and inverse FFT: by planes, channels and length."""
    at_256 = {
        (channels, planes): _convolved(device, 256, channels, planes)
        for channels in (1, 3)
        for planes in (1, PLANES)
    }
    # As many planes as a photograph has: kernels around a block then take 36 MiB at T = 512, which
    # no cache holds. Those of one plane take a third.
    others = {
        length: _convolved(device, length, 3, PLANES) for length in TRANSFORMS if length != 256
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
    alike = Costs("", dict.fromkeys(UNITS, 0.0) | ns, dict.fromkeys(TRANSFORMS, 1.0))
    lengths = {256: 1.0}
    for length, found in others.items():
        expected = alike.transforms(_grid(length, 2), 3, np.array([PLANES]))
        lengths[length] = sum(found.values()) / sum(expected.values())
    return ns | lengths


def _others(device: Device) -> dict[str | int, float]:
    """Time the forward pass of modes, and the direct sum."""
    grid, sites = _grid(512, 2), [0, 1, 1, 2]
    size = (2, 1, 3, 2 * grid.half_size, 2 * grid.half_size)
    two = Decomposition(np.zeros(size, np.float32), np.ones((2, 2, 2)), np.ones(2), np.zeros(2))
    modes = Modes(device, _scale(grid, 3), {(0, 0): 1}, 1.0, sites, two)
    direct = Direct(device, _scale(grid, 3), {(0, 0): 1}, 1.0, sites, SUPPORT)
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
        rect = (0, 0, grid.rows, grid.cols)
        convolution.record(rec, (0, 0), planes, scratch, rates, rect)
    found = _fastest(rec)
    convolution.release()
    return {stage: seconds / blocks for stage, seconds in found.items()}


def _sensor(device: Device) -> dict[str | int, float]:
    """Time mosaic, border, cross-talk of 3 x 3, exposure, noise, adc, merge at a mid-grey."""
    sensor = load_sensor("imx477").roi(SIDE, SIDE)
    rec = Recording(device)
    planes = rec.buffer("planes", (4, SIDE // 2, SIDE // 2), np.float32)
    glare = rec.buffer("glare", 4, np.float32)
    rec.upload(planes, np.full(planes.shape, 1e5, np.float32))
    rec.clear(glare)
    rate = record_mosaic(rec, planes, glare, sensor, (SIDE, SIDE))
    whole, even = (0, 0, SIDE, SIDE), Kernels({"*": [[1 / 9] * 3] * 3})
    rate = record_border(rec, rate, whole, whole)
    rate = record_crosstalk(rec, rate, even, sensor, whole, whole)
    mean = record_exposure(rec, rate, sensor, 0.01)
    dn = record_adc(rec, record_noise(rec, mean, sensor, seed=1), sensor)
    low = {"temporal_dark_noise_e": 12, "black_level_dn": 256, "switch_dn": 3800}
    dual = DualGain(system_gain_dn_per_e=sensor.system_gain_dn_per_e / 8, **low)
    record_merge(rec, dn, dn, sensor.model_copy(update={"dual_gain": dual}), label="merged")
    found = {stage: 1e9 * seconds / SIDE**2 for stage, seconds in _fastest(rec).items()}
    return found | {"crosstalk": found["crosstalk"] / 9}


def _ccd(device: Device) -> dict[str | int, float]:
    """Time what CCDs do to their charge, at a mid-grey."""
    rec = Recording(device)
    rate = rec.buffer("rate", (SIDE, SIDE), np.float32)
    rec.upload(rate, np.full(rate.shape, 1e3, np.float32))
    charge = record_smear(rec, rate, rate, Smear(kind="frame_transfer", row_s=1e-6))
    charge, _ = record_bloom(rec, charge, 1e5)
    charge = record_cti(rec, charge, 1e-5, label="shifted")
    traps = Cti(traps=(Species(density=1.0, release_transfers=5.0),), groups=1)
    record_traps(rec, charge, traps, well_e=1e5)
    return {stage: 1e9 * seconds / SIDE**2 for stage, seconds in _fastest(rec).items()}


def _dispatch(device: Device) -> dict[str | int, float]:
    """Time what a dispatch of next to nothing costs, in a pass of its own, host and device."""
    kernels = [Kernel.from_text(f"calibration/{name}", NOTHING) for name in ("this", "that")]
    spans = []
    for _ in range(RUNS + 1):
        started = time.perf_counter()
        rec = Recording(device)
        found = rec.buffer("found", 1, np.uint32)
        for number in range(64):
            kernels[number % 2].record(rec, (1, 1, 1), {"number": number}, found=found)
        rec.run()
        spans.append((time.perf_counter() - started) / 64)
    return {"dispatch": 1e9 * min(spans)}

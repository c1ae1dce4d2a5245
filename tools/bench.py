#!/usr/bin/env python
"""Time one named job, warm: tools/bench.py NAME --json prints one line, --list names the jobs.

``render-demo`` times a whole capture of the demonstration camera, and its error is the
certificate's. Each stage has a job of its own on a frame of 12 MP, against a copy of the same bytes
on the same device, and against NumPy or SciPy where they do the same work; the error of a stage is
the tests' matter. Times are wall clock around a run that waits for the device, but for rows,
columns and lattice, which only run together: theirs are the device's own. Ratios hold better than
seconds.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates

from gpusim.camera import load_camera
from gpusim.chain import Renderer
from gpusim.gpu import Device, Kernel, Recording, default_device
from gpusim.optics.chief_ray import ChiefRayMap
from gpusim.optics.convolve import Convolve, Scale, Scratch
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels
from gpusim.optics.paint import Paint
from gpusim.optics.warp import Warp
from gpusim.plan import Accuracy
from gpusim.scene.chart import Chart, Disc
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import make_scene
from gpusim.sensor.adc import record_adc
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.mosaic import record_mosaic
from gpusim.sensor.noise import record_noise

ROWS, COLS = 3040, 4056  # the whole IMX477: 12 MP
SECONDS, REPEATS = 5.0, 5  # a job is repeated until both are reached
COPY_BYTES = 64 << 20  # of the buffer that the copy reads and writes: larger than the caches
COPY = """
struct Params { count: u32, }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> source: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> target_: array<vec4f>;
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let i = id.y * 65536u + id.x;
    if (i < params.count) { target_[i] = source[i]; }
}
"""


@dataclass
class Job:
    """What is timed: a run on the device, what it moves, and who else does the same."""

    run: Callable[[], object]
    pixels: int
    nbytes: int = 0
    peers: dict[str, Callable[[], object]] = field(default_factory=dict)
    facts: dict[str, object] = field(default_factory=dict)


def seconds(run: Callable[[], object]) -> tuple[float, float]:
    """Return the best and the median time of a run, warm."""
    run()
    times: list[float] = []
    while len(times) < REPEATS or sum(times) < SECONDS:
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return min(times), statistics.median(times)


def copier(device: Device, nbytes: int) -> Callable[[], object]:
    """Return a run that copies as many bytes as a stage reads and writes."""
    source = device.resident("source", np.zeros(COPY_BYTES // 4, np.float32))
    target = device.empty("target", COPY_BYTES // 4, np.float32)
    kernel = Kernel.from_text("copy", COPY)
    rec = Recording(device)
    left = nbytes // 2  # a copy of n bytes reads n and writes n
    while left > 0:
        count = min(left, COPY_BYTES) // 16
        groups = (min(-(-count // 64), 1024), -(-count // 65536), 1)
        kernel.record(rec, groups, {"count": count}, source=source, target_=target)
        left -= COPY_BYTES
    return rec.run


def render_demo(device: Device) -> Job:
    """Time a whole capture of the demonstration camera, with everything resident."""
    camera = load_camera("demo")
    renderer = Renderer(camera, make_scene("demo"), Accuracy(probes=64), device)
    certificate = renderer.capture(1 / 60).certificate
    renderer.accuracy = Accuracy(probes=0)
    facts: dict[str, object] = {
        "error": {"rms": certificate.rms_relative, "worst": certificate.worst_relative},
        "certify_s": certificate.seconds,
        "prepare_s": renderer.prepare_s,
    }

    def run() -> None:
        facts["times_s"] = renderer.capture(1 / 60).times_s

    return Job(run, camera.sensor.rows * camera.sensor.cols, facts=facts)


def frame() -> tuple[SimGrid, Scale]:
    """Return the sim grid of the 12 MP frame, as the planner lays it, and kernels of one plane."""
    grid = SimGrid(ROWS, COLS, 4, 2, 256, 40, (24, 18))
    n = 96
    line = (np.arange(n) - n // 2) * 0.5
    blob = np.exp(-(line**2 + line[:, None] ** 2) / (2 * 2.0**2)).astype(np.float32)
    kernels = FieldKernels(np.tile(blob, (2, 1, 3, 1, 1)), np.array([0.0, 1e4]), 0.5)
    return grid, Scale("bench", grid, 0.775, 0.8, kernels)


def chief_ray() -> ChiefRayMap:
    """Return a barrel distortion of some per cent."""
    return ChiefRayMap(np.array([1.0, 0.03, 0, 0, 0, 0, 0, 0]), 5000.0)


def source_stage(device: Device, stage: Paint | Warp, scratch_planes: int, nbytes: int) -> Job:
    """Time paint or warp over all blocks of the frame."""
    rec = Recording(device)
    scratch = Scratch(rec, "bench", stage.grid, scratch_planes)
    for block in stage.grid.blocks_for(0, 0, ROWS, COLS):
        stage.record(rec, block, scratch.planes)
    return Job(rec.run, ROWS * COLS, nbytes)


def block_bytes(grid: SimGrid) -> int:
    """Return the bytes of one plane over all blocks."""
    return 4 * grid.blocks[0] * grid.blocks[1] * grid.block[0] * grid.block[1]


def paint(device: Device) -> Job:
    """Time a chart of 2000 dots in one coefficient plane."""
    grid, scale = frame()
    dots = [Disc(x * 120.0, y * 120.0, 20.0, 1) for y in range(-19, 20) for x in range(-26, 27)]
    chart = Chart(("white", "black"), 0, tuple(dots))
    stage = Paint(device, chart, np.array([[1.0], [0.05]]), scale, chief_ray())
    return source_stage(device, stage, 1, block_bytes(grid))


def warp(device: Device) -> Job:
    """Time a photograph of 12 MP in one plane; the peer is SciPy's cubic spline."""
    grid, scale = frame()
    planes = np.random.default_rng(1).random((1, ROWS, COLS), np.float32)
    raster = PlacedRaster(planes, 1.55, -COLS * 0.775, -ROWS * 0.775, "")
    stage = Warp(device, raster, np.eye(1), scale, chief_ray())
    job = source_stage(device, stage, 1, block_bytes(grid) + planes.nbytes)
    coefficients = raster.spline_coefficients()[0]
    points = np.mgrid[0:ROWS:0.5, 0:COLS:0.5].astype(np.float32)

    def peer() -> None:
        map_coordinates(coefficients, points, np.float32, order=3, prefilter=False)

    job.peers["scipy"] = peer
    return job


def convolution(device: Device, stage: str) -> Job:
    """Time one of rows, columns and lattice over the frame, one plane to three channels."""
    _, scale = frame()
    # One cell: the kernels of four nodes serve all blocks.
    grid = SimGrid(ROWS, COLS, 4, 2, 256, 40, (1, 1))
    part = Convolve(
        device,
        Scale("bench", grid, scale.pitch_um, scale.sigma, scale.kernels),
        dict.fromkeys(np.ndindex(grid.blocks), 1),
        1.55,
        [0, 1, 1, 2],
    )
    rec = Recording(device)
    scratch = Scratch(rec, "bench", grid, 1)
    rates = rec.buffer("rates", (4, ROWS // 2, COLS // 2), np.float32)
    for buffer in (scratch.planes, scratch.spectra, scratch.folded, rates):
        rec.clear(buffer)
    for block in grid.blocks_for(0, 0, ROWS, COLS):
        part.record(rec, block, 1, scratch, rates, (0, 0, ROWS, COLS))
    blocks = grid.blocks[0] * grid.blocks[1]
    spectra = grid.block[1] * grid.length * 8
    folded = 4 * (grid.length // 2 + 1) * grid.window * 8
    nbytes = {
        "rows": grid.block[0] * grid.block[1] * 4 + spectra,
        "columns": spectra + 4 * 3 * (grid.length // 2 + 1) * grid.length * 8 + folded,
        "lattice": folded + 2 * 4 * 4 * grid.window**2,
    }[stage] * blocks
    # The three stages feed each other: all run, and the device's clock says what one of them took.
    shares: list[float] = []

    def run() -> None:
        shares.append(rec.run().times_s[f"optics/{stage}"])

    job = Job(run, ROWS * COLS, nbytes, facts={"device_s": shares})
    if stage == "rows":
        lines = np.zeros((blocks * grid.block[1], grid.length), np.complex64)
        job.peers["scipy"] = lambda: scipy.fft.fft(lines, axis=1, workers=2)
    return job


def sensor_stage(device: Device, stage: str) -> Job:
    """Time one pointwise stage of the sensor on the frame."""
    sensor = load_camera("demo").sensor
    rng = np.random.default_rng(1)
    plane = (rng.random((ROWS, COLS)) * 2000).astype(np.float32)
    rec = Recording(device)
    nbytes = 2 * plane.nbytes
    peers: dict[str, Callable[[], object]] = {}
    if stage == "mosaic":
        sites = device.resident("sites", plane.reshape(4, ROWS // 2, COLS // 2))
        glare = device.resident("glare", np.ones(4, np.float32))
        record_mosaic(rec, sites, glare, sensor, (ROWS, COLS))
    else:
        frame_in = device.resident("frame", plane)
        if stage == "exposure":
            record_exposure(rec, frame_in, sensor, 1 / 60)
        elif stage == "noise":
            record_noise(rec, frame_in, sensor, seed=1)
            peers["numpy"] = lambda: (
                rng.poisson(plane) + rng.standard_normal(plane.shape, np.float32)
            )
        else:
            record_adc(rec, frame_in, sensor)
    return Job(rec.run, ROWS * COLS, nbytes, peers)


JOBS: dict[str, tuple[str, Callable[[Device], Job]]] = {
    "render-demo": ("a whole capture of the demonstration camera, warm", render_demo),
    "paint": ("chart to sim grid, 12 MP", paint),
    "warp": ("photograph to sim grid, 12 MP", warp),
    "rows": ("row transforms, 12 MP, one plane", lambda d: convolution(d, "rows")),
    "columns": (
        "column transforms and products, 12 MP, one plane",
        lambda d: convolution(d, "columns"),
    ),
    "lattice": ("inverse transforms, 12 MP", lambda d: convolution(d, "lattice")),
    "mosaic": ("sites to pixels, 12 MP", lambda d: sensor_stage(d, "mosaic")),
    "exposure": ("PRNU and dark current, 12 MP", lambda d: sensor_stage(d, "exposure")),
    "noise": ("shot and read noise, 12 MP", lambda d: sensor_stage(d, "noise")),
    "adc": ("quantisation, 12 MP", lambda d: sensor_stage(d, "adc")),
}


def commit() -> str | None:
    """Return the commit of this checkout, marked when files differ from it."""
    here = Path(__file__).parent
    command = ["git", "-C", str(here), "describe", "--always", "--dirty=+dirty", "--exclude", "*"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    return found.stdout.strip() or None


def measure(name: str, device: Device) -> dict[str, object]:
    """Run one job and its peers."""
    job = JOBS[name][1](device)
    print(f"{name}: timing", file=sys.stderr)
    best, median = seconds(job.run)
    if "device_s" in job.facts:
        shares = job.facts.pop("device_s")[1:]
        best, median = min(shares), statistics.median(shares)
    peers = {}
    runs = dict(job.peers)
    if job.nbytes:
        runs["copy"] = copier(device, job.nbytes)
    for peer, run in runs.items():
        print(f"{name}: timing {peer}", file=sys.stderr)
        peers[peer] = seconds(run)[0]
    report = device.report()
    return {
        "name": name,
        "best_s": best,
        "median_s": median,
        "pixels": job.pixels,
        "peers": peers,
        "ratio": best / min(peers.values()) if peers else None,
        "error": job.facts.pop("error", None),
        "bytes": job.nbytes,
        **job.facts,
        "adapter": report["adapter"],
        "driver": report["driver"],
        "commit": commit(),
    }


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("name", nargs="?", help="a job")
    parser.add_argument("--json", action="store_true", help="print one line of JSON")
    parser.add_argument("--list", action="store_true", help="name the jobs")
    options = parser.parse_args()
    if options.list or options.name is None:
        for name, (what, _) in JOBS.items():
            print(f"{name:12} {what}")
        return 0
    if options.name not in JOBS:
        print(f"There is no job {options.name!r}; allowed: {', '.join(JOBS)}", file=sys.stderr)
        return 2
    result = measure(options.name, default_device())
    if options.json:
        print(json.dumps(result))
    else:
        for key, value in result.items():
            print(f"{key:10} {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The jobs of tools/bench.py: what each times, its peers, and its error against the reference."""

from __future__ import annotations

import dataclasses
import math
import resource
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import scipy.fft
from bench_burst import burst_job
from bench_ccd import linear_job, smear_job, trap_job
from bench_isp import develop_job
from bench_preview import preview_job
from bench_regret import regret_job
from scipy.ndimage import map_coordinates

from gpusim.camera import Camera, load_camera
from gpusim.certify import ExactModel, Measure, choose_probes, compare, glare_at
from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.gpu import Array, Device, Kernel, Recording
from gpusim.lens.prescription import Prescription
from gpusim.lens.samples import sample_field
from gpusim.lens.system import System, build
from gpusim.lens.wavefront import pupils
from gpusim.optics.chief_ray import radial_map
from gpusim.optics.convolve import Convolve, Scale, Scratch
from gpusim.optics.direct import Direct, direct_work
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels
from gpusim.optics.modes import Decomposition, Modes
from gpusim.optics.nodes import Rates
from gpusim.optics.paint import Paint
from gpusim.optics.warp import Warp
from gpusim.plan import Accuracy
from gpusim.psf.bank import Bank
from gpusim.psf.compute import bank_of
from gpusim.psf.generator import Generator
from gpusim.psf.places import Heights
from gpusim.psf.psf import intensity
from gpusim.psf.sampling import default_fields_deg
from gpusim.reference.adc import adc
from gpusim.reference.crosstalk import crosstalk
from gpusim.reference.direct import direct
from gpusim.reference.exposure import exposure
from gpusim.reference.fft_columns import fft_columns
from gpusim.reference.fft_rows import fft_rows
from gpusim.reference.inverse_fft import inverse_fft
from gpusim.reference.modes import modes as modes_reference
from gpusim.reference.mosaic import mosaic
from gpusim.reference.noise import noise
from gpusim.reference.paint import paint
from gpusim.reference.warp import warp
from gpusim.render import Capture, Renderer
from gpusim.scene import Chart, Disc, PlacedRaster, Raster, Scene, make_scene
from gpusim.scene.spectra import rgb_reflectances, white_radiance
from gpusim.sensor.adc import record_adc
from gpusim.sensor.crosstalk import record_crosstalk
from gpusim.sensor.crosstalk_model import Kernels
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.load import load_sensor
from gpusim.sensor.mosaic import record_mosaic
from gpusim.sensor.noise import record_noise
from gpusim.sensor.planes import planes_of
from gpusim.sensor.sensor import Sensor

EXPOSURE_S = 1 / 60
PITCH_UM, SIM_PITCH_UM, SIGMA = 1.55, 0.775, 0.8
CHIEF_RAY = radial_map(lambda um: um * (1 + 0.03 * (um / 5e3) ** 2), 5e3)  # barrel, some per cent
RADIUS = CHIEF_RAY.radius_um / SIM_PITCH_UM
SITES = [0, 1, 1, 2]  # channels of a Bayer pattern
# The frame jobs: PSFs of 63 x 63 samples (two a pixel), of a lens whose corners are those of the
# sensor, at f/2.8; errors of a tenth of the noise's sigma.
FRAME_PSF = 63
FRAME_FOCAL_MM, SCALING_FOCAL_MM = 12.0, 24.0
SCALING = (0.285, 0.57, 1.0, 2.0)  # of the frame's sides: 1, 4, 12 and 49 MP
# Further frames of each, for so long at least: one of 1 MP takes 1.3 s, in which a shared machine
# may be half as fast as in the next.
FURTHER_S = 15.0
FRAME_SIGMA, FRAME_PROBES = 0.1, 256
DOT_UM = 30.0  # radius of the dots that paint paints
# More to the right than to the left, and from green to red more than to the others.
SPREAD = Kernels(
    {
        "*": [[0.002, 0.012, 0.002], [0.011, 0.93, 0.013], [0.002, 0.01, 0.002]],
        "G>R": [[0.0, 0.014, 0.0], [0.012, 0.0, 0.015], [0.0, 0.012, 0.0]],
    }
)
PART = 64  # side of what a sensor stage's error is found on, pixels
Run = Callable[[], object]


@dataclass
class Job:
    """What is timed, and with what it is compared.

    Attributes
    ----------
    run : callable
        Waits for the device.
    pixels : int
        Pixels of the frame.
    error : dict
    nbytes, samples : int
        That a run reads and writes, and that it computes; without bytes there is no copy.
    flops : int
        Operations of a run that count: 5 n log2 n of a complex transform of n, 8 of a complex
        product that is added up, 2 of a multiply-add; 0 where nothing else is to be counted.
    peers : dict of (callable, float)
        Runs of others, and how many of them do the same work.
    facts : callable
        Returns what else is reported of the best run, from what it returned.
    """

    run: Run
    pixels: int
    error: dict[str, object]
    nbytes: int = 0
    samples: int = 0
    peers: dict[str, tuple[Run, float]] = field(default_factory=dict)
    facts: Callable[[object], dict[str, object]] = lambda best: {}
    flops: int = 0


def of_transforms(count: int, length: int) -> int:
    """Return the operations of complex transforms, by the usual count."""
    return round(5 * count * length * math.log2(length))


class OneStage(Recording):
    """A recording that keeps the dispatches of one stage, and leaves the others out."""

    def __init__(self, device: Device, path: str) -> None:
        super().__init__(device)
        self._path = path

    def dispatch(self, kernel: Kernel, *rest: object) -> None:
        """Append a dispatch of the stage."""
        if kernel.path == self._path:
            super().dispatch(kernel, *rest)


def error(actual: np.ndarray, expected: np.ndarray) -> dict[str, object]:
    """Return the largest difference over the largest value of the reference."""
    worst = np.abs(actual - expected).max() / np.abs(expected).max()
    return {"measure": "largest difference over largest value", "worst": float(worst)}


def convolved(renderer: Renderer, **how: object) -> Capture:
    """Capture with what is prepared, but not with the light of the frame before."""
    renderer.drop_light()
    return renderer.capture(EXPOSURE_S, **how)


def render_demo(device: Device, frame: tuple[int, int]) -> Job:
    """Time a capture of the demonstration camera, whose frame is its own."""
    camera = load_camera("demo")
    renderer = Renderer(camera, make_scene("demo"), Accuracy(probes=64), device)
    certificate = renderer.capture(EXPOSURE_S).certificate
    renderer.accuracy = Accuracy(probes=0)
    return Job(
        lambda: convolved(renderer),
        camera.sensor.rows * camera.sensor.cols,
        {
            "measure": f"relative to the true signal at {certificate.probes} probes",
            "worst": certificate.worst_relative,
            "rms": certificate.rms_relative,
        },
        facts=lambda capture: {
            "times_s": capture.times_s,
            "prepare_s": capture.prepare_s,
            "certify_s": certificate.seconds,
        },
    )


@dataclass(frozen=True)
class FrameCamera:
    """A camera whose PSFs end FRAME_PSF samples of the sim grid from side to side."""

    sensor: Sensor
    lens: Prescription

    def bank(self, progress: Callable[[int, int], None] | None = None) -> Bank:
        """Return the lens's bank with the middle of its PSFs, of unit energy again.

        As far on one side of the chief ray as on the other: the first row and column, which have no
        partner, are empty, as in the bank itself. With them the PSFs would be those of a lens
        without an axis (up to 0.4 % of the light lay there), and kernels of mirrored nodes no
        mirror images.
        """
        bank = Camera(self.lens, self.sensor, "frame").bank(progress)
        kept = round(FRAME_PSF * SIM_PITCH_UM / bank.pitch_um / 2)
        middle = bank.psf.shape[-1] // 2
        part = bank.psf[..., middle - kept : middle + kept, middle - kept : middle + kept].copy()
        part[..., 0, :] = part[..., 0] = 0.0
        psf = part / part.sum(axis=(2, 3), keepdims=True, dtype=np.float64)
        return dataclasses.replace(bank, psf=psf.astype(np.float32), halo=None)


def frame_camera(
    rows: int, cols: int, focal_length_mm: float, largest: tuple[int, int] | None = None
) -> FrameCamera:
    """Return the sensor of the demonstration camera, as large as wanted, behind its lens.

    The lens's field is that of the largest sensor.
    """
    camera = load_camera("demo")
    sensor = load_sensor("imx477").model_copy(update={"rows": rows, "cols": cols})
    half_um = math.hypot(*(largest or (rows, cols))) / 2 * sensor.pixel_pitch_um
    # 7 % beyond the corner: the PSFs' reach and the distortion.
    field_deg = math.degrees(math.atan(1.07e-3 * half_um / focal_length_mm))
    lens = load_prescription("double-gauss").scaled(focal_length_mm)
    return FrameCamera(sensor, lens.stopped(camera.lens.f_number).limited(field_deg))


def photograph(rows: int, cols: int) -> Scene:
    """Return a made-up photograph in RGB, the same for the same size: no two parts alike.

    Clouds of four sizes in the logarithm, 1 : 200 from the darkest to the brightest, of slightly
    different colours; upon them 400 rectangles with sharp edges, and a hundred lamps ten times as
    bright as white.
    """
    rng = np.random.default_rng(4)
    grey = np.zeros((rows, cols), np.float32)
    for side, share in ((6, 1.2), (24, 0.6), (96, 0.4), (384, 0.3)):
        coarse = rng.standard_normal((side, side)).astype(np.float32)
        at = np.meshgrid(
            np.linspace(0, side - 1, rows), np.linspace(0, side - 1, cols), indexing="ij"
        )
        grey += share * map_coordinates(coarse, at, np.float32, order=1)
    planes = np.stack([grey + 0.1 * part for part in rng.standard_normal(3).astype(np.float32)])
    planes = 0.18 * np.exp(np.clip(planes, -3.3, 2.0))
    for number in range(500):
        high, wide = (rows * rng.uniform(0.005, 0.05, 2)).astype(int) + 1
        top, left = rng.integers(0, rows - high + 1), rng.integers(0, cols - wide + 1)
        place = np.s_[:, top : top + high, left : left + wide]
        if number < 400:
            planes[place] = rng.uniform(0.03, 0.9, (3, 1, 1))
        else:
            round_ = np.hypot(*np.ogrid[-1 : 1 : high * 1j, -1 : 1 : wide * 1j]) < 1
            planes[place] = np.where(round_, 10.0, planes[place])
    spectra = rgb_reflectances() * white_radiance("D65", 300.0)
    return Scene("photograph", spectra, Raster(planes), "D65", spectra.sum(axis=0))


def peak_rss_bytes() -> int:
    """Return the most memory that this process has held so far: host, and lavapipe's device."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


class FrameRender:
    """Renders of one camera and scene, from the scene in memory to the raw; PSF bank cached.

    The first call also certifies, and fills `error`.
    """

    def __init__(self, device: Device, camera: FrameCamera, scene: Scene) -> None:
        self.device, self.camera, self.scene = device, camera, scene
        self.error: dict[str, object] = {}
        self.bank = camera.bank()

    def __call__(
        self, tile: tuple[int, int, int, int] | None = None, further_s: float = 0.0
    ) -> Capture:
        """Plan, prepare and render; of the frame, or of a rectangle.

        Keeps the time in `first_s`. Then renders with what is prepared, once or more until
        `further_s` seconds have gone by, if any are given, and keeps those times in `further`.
        """
        started = time.perf_counter()
        # A lens that is known by its bank alone: nothing is traced while the clock runs.
        known = SimpleNamespace(
            title="frame",
            sensor=self.camera.sensor,
            bank=lambda progress: self.bank,
            lens=SimpleNamespace(title=self.camera.lens.title),
        )
        accuracy = Accuracy(FRAME_SIGMA, 0 if self.error else FRAME_PROBES, "sigma")
        renderer = Renderer(known, self.scene, accuracy, self.device, exposure_s=EXPOSURE_S)
        try:
            capture = renderer.capture(EXPOSURE_S, tile=tile)
            self.first_s, self.further = time.perf_counter() - started, []
            while sum(self.further) < further_s:
                started = time.perf_counter()
                convolved(renderer, tile=tile)
                self.further.append(time.perf_counter() - started)
        finally:
            renderer.release()
        if not self.error:
            found = capture.certificate
            self.error.update(
                measure=f"of the true signal, and of the noise's sigma, at {found.probes} probes",
                worst=found.worst_relative,
                rms=found.rms_relative,
                worst_sigma=found.worst_sigma,
                rms_sigma=found.rms_sigma,
                met=found.met,
                certify_s=found.seconds,
            )
        return capture


def frame_facts(capture: Capture) -> dict[str, object]:
    """Return what else is known of a render."""
    return {
        "planes": capture.plan.basis.coefficients.shape[1],
        "times_s": capture.times_s,
        "prepare_s": capture.prepare_s,
        "work": capture.work,
        "memory": capture.memory,
        "peak_rss_bytes": peak_rss_bytes(),
        "scales": {scale.name: str(scale.grid) for scale in capture.plan.scales},
    }


def frame_job(device: Device, frame: tuple[int, int], mono: bool) -> Job:
    """Time the whole sensor: a photograph in three planes, or a chart in one beside it."""
    camera = frame_camera(*frame, FRAME_FOCAL_MM)
    colour = partial(FrameRender, device, camera, photograph(*frame))
    if not mono:
        render = colour()
        return Job(render, math.prod(frame), render.error, facts=frame_facts)
    render = FrameRender(device, camera, make_scene("slanted-edge"))
    peers = {"frame-12mp": (colour(), 1.0)}
    return Job(render, math.prod(frame), render.error, peers=peers, facts=frame_facts)


def scaling_job(device: Device, frame: tuple[int, int]) -> Job:
    """Time frames of 1, 4, 12 and 48 MP of one camera and one kind of scene, one after another.

    Each size gives the time of the first frame, with plan and kernels, and the median of further
    ones of the same renderer. The first call, which warms up, renders a corner of each: that
    compiles what it needs.
    """
    sizes = [tuple(2 * round(side * part / 2) for side in frame) for part in SCALING]
    warm: list[bool] = []
    found: dict[str, object] = {}

    def run() -> None:
        for height, width in sizes:
            camera = frame_camera(height, width, SCALING_FOCAL_MM, sizes[-1])
            render = FrameRender(device, camera, photograph(height // 2, width // 2))
            render.error["measure"] = "not certified here: see frame-12mp"
            if not warm:
                render((0, 0, 16, 16))
                continue
            capture = render(None, FURTHER_S)
            found[f"{height * width / 1e6:.3g} MP"] = {
                "ns_per_pixel": 1e9 * render.first_s / (height * width),
                "further_ns_per_pixel": 1e9 * statistics.median(render.further) / (height * width),
                "further_frames": len(render.further),
                **frame_facts(capture),
            }
        warm.append(True)

    def facts(best: object) -> dict[str, object]:
        ratios = {}
        for name in ("", "further_"):
            each = [size[f"{name}ns_per_pixel"] for size in found.values()]
            ratios[f"{name}largest_over_smallest"] = max(each) / min(each)
        return {**ratios, "sizes": found}

    pixels = sum(map(math.prod, sizes))
    return Job(run, pixels, {"measure": "not certified here: see frame-12mp"}, facts=facts)


TOLERANCES = (1e-2, 1e-3, 1e-4)
TOLERANCE_SCENES = ("slanted-edge", "dots", "grey", "demo", "colorchecker")
TOLERANCE_LENSES = {
    "double-gauss": lambda: load_camera("demo").lens,
    "tessar": lambda: load_prescription("tessar").scaled(8.0).limited(14.0),
    "cooke-triplet": lambda: load_prescription("cooke-triplet").scaled(8.0).limited(14.0),
}
LARGEST = (288, 384)  # of the frames on which tolerances are certified: 15 x 3 renders


def tolerances_job(
    device: Device,
    frame: tuple[int, int],
    lenses: dict[str, Callable] = TOLERANCE_LENSES,
    scenes: tuple[str, ...] = TOLERANCE_SCENES,
    probes: int = 64,
) -> Job:
    """Certify three tolerances on five scenes and three lenses, and time each.

    What is timed in the end is the last of them again. The exact model of a lens and scene is
    evaluated once. A tolerance that is refused counts as not met, and says why.
    """
    rows, cols = (min(side, most) for side, most in zip(frame, LARGEST, strict=True))
    sensor = load_sensor("imx477").roi(rows, cols)
    table, slower, worst, last = [], 0, 0.0, None
    for lens, load in lenses.items():
        camera = Camera(load(), sensor, lens)
        for name in scenes:
            scene, pixels, times = make_scene(name), None, []
            for tolerance in TOLERANCES:
                found = {"lens": lens, "scene": name, "tolerance": tolerance, "met": False}
                table.append(found)
                try:
                    renderer = Renderer(camera, scene, Accuracy(tolerance, 0), device)
                except UserError as refused:
                    found["refused"] = refused.problem
                    continue
                shots = [convolved(renderer, keep=("rate",)) for _ in range(3)]
                rate = shots[0].rate
                if pixels is None:
                    pixels = choose_probes(rate, sensor.period[0], probes)
                    exact = ExactModel(renderer.bank, sensor, scene, renderer.placed)
                    true = exact.rates(pixels)
                whole = true + glare_at(sensor, renderer.glare, pixels)
                at = rate[tuple(pixels.T)].astype(np.float64)
                by = Measure(sensor, EXPOSURE_S, Accuracy(tolerance, probes))
                certificate = compare(by, pixels, whole, at, seconds=0.0)
                found["met"] = certificate.met
                found["rms"] = certificate.rms_relative
                found["worst"] = certificate.worst_relative
                found["best_s"] = min(shot.wall_s for shot in shots[1:])
                times.append(found["best_s"])
                worst = max(worst, certificate.rms_relative / tolerance)
                if last is not None:
                    last.release()
                last = renderer
                print(found, file=sys.stderr, flush=True)
            slower += sum(tight < loose for loose, tight in pairwise(times))
    return Job(
        lambda: convolved(last),
        rows * cols,
        {"measure": "largest certified RMS error over its tolerance", "worst": worst},
        facts=lambda best: {
            "certified": table,
            "not_met": sum(not found["met"] for found in table),
            "looser_but_slower": slower,
        },
    )


def sim_grid(frame: tuple[int, int]) -> SimGrid:
    """Return the sim grid of a frame, in blocks and with a reach as the planner chooses them."""
    cells = tuple(math.ceil((2 * side + 80) / 176) for side in frame[::-1])
    return SimGrid(*frame, stride=4, period=2, length=256, half_size=40, cells=cells)


def scale_of(grid: SimGrid) -> Scale:
    """Return a scale with kernels of one plane and three channels, alike over the field."""
    line = (np.arange(96) - 48) * 0.5
    blob = np.exp(-(line**2 + line[:, None] ** 2) / (2 * 2.0**2)).astype(np.float32)
    heights = Heights(np.array([0.0, 1e4, 2e4]))  # any place is made of four fields
    kernels = FieldKernels(np.tile(blob, (4, 1, 3, 1, 1)), heights, 0.5)
    return Scale("bench", grid, SIM_PITCH_UM, SIGMA, kernels)


def source_stage(
    device: Device, stage: Paint | Warp, block: tuple[int, int], place: tuple, expected: np.ndarray
) -> Job:
    """Time paint or warp over all blocks; `expected` is the reference at a place of one block."""
    grid = stage.grid
    planes = device.empty("planes", (1, grid.block[1], grid.block[0]), np.float32)
    blocks = grid.blocks_for(0, 0, grid.rows, grid.cols)
    stage.prepare(blocks)
    stage.load(blocks)
    sample, rec = Recording(device), Recording(device)
    stage.record(sample, block, planes)
    sample.run()
    for other in blocks:
        stage.record(rec, other, planes)
    samples = planes.nbytes // 4 * grid.blocks[0] * grid.blocks[1]
    found = error(device.read(planes)[0][place], expected)
    return Job(rec.run, grid.rows * grid.cols, found, 4 * samples, samples)


def paint_job(device: Device, frame: tuple[int, int]) -> Job:
    """Time a chart of dots, 150 um apart, in one coefficient plane."""
    grid = sim_grid(frame)
    across, down = (int(side * PITCH_UM / 300) for side in frame[::-1])
    dots = [
        Disc(150.0 * x, 150.0 * y, DOT_UM, 1)
        for y in range(-down, down + 1)
        for x in range(-across, across + 1)
    ]
    coefficients = np.array([[1.0], [0.05]])
    chart = Chart(("white", "black"), 0, tuple(dots))
    stage = Paint(device, chart, coefficients, scale_of(grid), CHIEF_RAY)
    # The dot on the axis, where its edge is farthest down.
    edge = np.add(grid.centre, (0, DOT_UM / SIM_PITCH_UM)) + grid.half_size
    block = tuple(int(at // side) for at, side in zip(edge, grid.block, strict=True))
    x, y = (int(at % side) // 8 * 8 for at, side in zip(edge, grid.block, strict=True))
    dot = {
        "kind": "disc",
        "centre": (0.0, 0.0),
        "half_size": (DOT_UM / SIM_PITCH_UM, 0.0),
        "material": 1,
        "under": 0,
    }
    expected = paint(
        [dot],
        coefficients,
        0,
        origin_xy=tuple(np.add(grid.block_origin(block), (x + 0.5, y + 0.5)) - grid.centre),
        shape=(8, 8),
        sigma=SIGMA,
        distortion=CHIEF_RAY.pieces,
        radius=RADIUS,
    )[0]
    return source_stage(device, stage, block, np.s_[y : y + 8, x : x + 8], expected)


def warp_job(device: Device, frame: tuple[int, int]) -> Job:
    """Time a photograph in one coefficient plane; SciPy samples an eighth of the points."""
    grid = sim_grid(frame)
    # The contrast is low: Warp keeps splines from ringing below zero, which the reference does not.
    planes = 1 + 0.1 * np.random.default_rng(1).random((1, *frame), np.float32)
    left, top = -frame[1] * PITCH_UM / 2, -frame[0] * PITCH_UM / 2
    stage = Warp(
        device, PlacedRaster(planes, PITCH_UM, left, top, ""), np.eye(1), scale_of(grid), CHIEF_RAY
    )
    block = (0, 0)
    corner = np.array(grid.block_origin(block)) + 0.5 - grid.centre
    expected = warp(
        # The spline of a part is that of the whole 64 samples off the cut: 0.27^64 = 1e-36.
        planes[0, :512, :512],
        tuple(corner),
        grid.block[::-1],
        (frame[1] / 2 - 0.5, frame[0] / 2 - 0.5),
        SIM_PITCH_UM / PITCH_UM,
        distortion=CHIEF_RAY.pieces,
        radius=RADIUS,
    )
    job = source_stage(device, stage, block, np.s_[:, :], expected)
    job.nbytes += planes.nbytes
    coefficients = device.read(stage.planes[0])
    points = np.mgrid[0 : frame[0] / 8 : 0.5, 0 : frame[1] : 0.5].astype(np.float32)
    sample = partial(map_coordinates, coefficients, points, np.float32, prefilter=False)
    job.peers["scipy"] = (sample, 8.0)
    return job


def convolution_job(stage: str, device: Device, frame: tuple[int, int]) -> Job:
    """Time one pass of the FFTs alone over all blocks: one plane, three channels."""
    grid = sim_grid(frame)
    length, window = grid.length, grid.window
    part = Convolve(device, scale_of(grid), {}, PITCH_UM, SITES)
    # The kernels of 64 nodes serve all: 50 MiB, so that they come from memory as in a render.
    few = SimGrid(64, 64, 4, 2, length, grid.half_size, (7, 7))
    one = dict.fromkeys(np.ndindex(few.blocks), 1)
    kernels = Convolve(device, scale_of(few), one, PITCH_UM, SITES)
    kernels.load(one)
    part.nodes = {(x, y): kernels.nodes[x % 8, y % 8] for x, y in np.ndindex(grid.nodes)}
    scratch = Scratch(SimpleNamespace(buffer=device.empty), "bench", grid, 1)
    sites = (4, frame[0] // 2, frame[1] // 2)
    rates = device.resident("rates", np.zeros(sites, np.float32))
    rng = np.random.default_rng(1)
    planes, spectra, folded = (
        rng.standard_normal(array.shape, np.float32)
        for array in (scratch.planes, scratch.spectra, scratch.folded)
    )
    folded[:, :, 0, :, 1] = 0  # the frequency that is its own mirror image
    device.write(scratch.planes, planes)
    device.write(scratch.spectra, spectra)
    device.write(scratch.folded, folded)

    sample, rec = (OneStage(device, f"optics/{stage}") for _ in range(2))
    part.record(sample, (0, 0), 1, scratch, Rates(rates, (0, 0, *frame)))
    sample.run()
    for block in grid.blocks_for(0, 0, *frame):
        part.record(rec, block, 1, scratch, Rates(rates, (0, 0, *frame)))
    (first_x, step_x), (first_y, step_y) = grid.node_weights((0, 0))
    peers: dict[str, tuple[Run, float]] = {}
    blocks = grid.blocks[0] * grid.blocks[1]
    if stage == "fft_rows":
        lines = complex_of(spectra)[0]
        found = error(
            complex_of(device.read(scratch.spectra))[:, :8],
            fft_rows(planes[:, :8], first_x, step_x, length),
        )
        nbytes, samples = planes.nbytes + spectra.nbytes, lines.size
        flops = of_transforms(grid.block[1], length)
        peers["scipy"] = (lambda: scipy.fft.fft(lines, workers=2), blocks)
    elif stage == "fft_columns":
        packed = [device.read(part.nodes[x, y]) for y in (0, 1) for x in (0, 1)]
        kernels = [unpacked(node, length) for node in packed]
        places = [(channel, 2 * (s % 2), 2 * (s // 2)) for s, channel in enumerate(SITES)]
        found = error(
            by_site(device.read(scratch.folded)),
            fft_columns(
                complex_of(spectra),
                kernels,
                first_s=first_y,
                step_s=step_y,
                sites=places,
                stride=grid.stride,
            ),
        )
        nbytes = spectra.nbytes + 4 * packed[0].nbytes + folded.nbytes
        samples = length**2 // 2
        # Left and right, for upper and for lower nodes; of each channel the way back.
        flops = of_transforms((4 + 3) * length // 2, length) + 8 * 4 * 3 * samples
        lines = np.resize(complex_of(spectra), (4, length // 2 + 1, length))
        four = np.ascontiguousarray(np.swapaxes(np.stack(kernels)[:, :, 0], 1, 2))

        def peer() -> None:
            products = (four * scipy.fft.fft(lines, workers=2)[:, None]).sum(axis=0)
            scipy.fft.ifft(products[SITES, :, :window], workers=2)

        peers["scipy"] = (peer, blocks)
    else:
        start = grid.window_origin((0, 0))
        expected = inverse_fft(
            by_site(folded), np.zeros((4, window, window)), start, (1, 1), grid.seen
        )
        found = error(device.read(rates)[:, :window, :window], expected)
        samples = 4 * window**2
        nbytes = folded.nbytes + 2 * 4 * samples
        flops = of_transforms(2 * window, window)  # of two sites together
    return Job(
        rec.run,
        frame[0] * frame[1],
        found,
        blocks * nbytes,
        blocks * samples,
        peers,
        flops=blocks * flops,
    )


def modes_job(device: Device, frame: tuple[int, int]) -> Job:
    """Time the rows of modes alone over all blocks: one plane, two modes."""
    grid = SimGrid(*frame, stride=4, period=2, length=256, half_size=40, cells=(1, 1))
    maps = np.random.default_rng(1).standard_normal((2, 9, 9))
    one = np.ones(2)
    modes = Decomposition(np.zeros((2, 1, 3, 80, 80), np.float32), maps, one, one)
    blocks = grid.blocks_for(0, 0, *frame)
    part = Modes(
        device, scale_of(grid), dict.fromkeys(blocks, 1), PITCH_UM, SITES, decomposition=modes
    )
    part.load(blocks)
    scratch = part.scratch(SimpleNamespace(buffer=device.empty), 1)
    rates = device.resident("rates", np.zeros((4, frame[0] // 2, frame[1] // 2), np.float32))
    planes = np.random.default_rng(2).standard_normal(scratch.planes.shape, np.float32)
    device.write(scratch.planes, planes)
    sample, rec = (OneStage(device, "optics/modes") for _ in range(2))
    part.record(sample, (0, 0), 1, scratch, Rates(rates, (0, 0, *frame)))
    sample.run()
    for block in blocks:
        part.record(rec, block, 1, scratch, Rates(rates, (0, 0, *frame)))
    step = tuple(8 / (b * n) for b, n in zip(grid.block, grid.blocks, strict=True))
    lines = complex_of(device.read(scratch.spectra))[0]
    expected = modes_reference(planes[:, :8], maps, tuple(h / 2 for h in step), step, grid.length)
    nbytes = planes.nbytes + lines.nbytes
    return Job(
        rec.run,
        frame[0] * frame[1],
        error(lines[:8], expected[0]),
        len(blocks) * nbytes,
        len(blocks) * lines.size,
        {"scipy": (lambda: scipy.fft.fft(lines, workers=2), len(blocks))},
        flops=len(blocks) * of_transforms(grid.block[1], grid.length),
    )


def direct_job(device: Device, frame: tuple[int, int]) -> Job:
    """Time the sum over 16 x 16 taps over all blocks: one plane, three channels."""
    cells = tuple(math.ceil((2 * side + 24) / 240) for side in frame[::-1])
    grid = SimGrid(*frame, stride=4, period=2, length=264, half_size=12, cells=cells)
    part = Direct(device, scale_of(grid), {}, PITCH_UM, SITES, support=8)
    few = SimGrid(64, 64, 4, 2, 264, 12, (3, 3))
    one = dict.fromkeys(np.ndindex(few.blocks), 1)
    kernels = Direct(device, scale_of(few), one, PITCH_UM, SITES, support=8)
    kernels.load(one)
    part.nodes = {(x, y): kernels.nodes[x % 4, y % 4] for x, y in np.ndindex(grid.nodes)}
    scratch = part.scratch(SimpleNamespace(buffer=device.empty), 1)
    rates = device.resident("rates", np.zeros((4, frame[0] // 2, frame[1] // 2), np.float32))
    planes = np.random.default_rng(1).standard_normal(scratch.planes.shape, np.float32)
    device.write(scratch.planes, planes)
    sample, rec = Recording(device), Recording(device)
    part.record(sample, (0, 0), 1, scratch, Rates(rates, (0, 0, *frame)))
    sample.run()
    found = device.read(rates)
    blocks = grid.blocks_for(0, 0, *frame)
    for block in blocks:
        part.record(rec, block, 1, scratch, Rates(rates, (0, 0, *frame)))
    layout = part.layout
    first = -layout.high - 4 * layout.first_group(0)
    taps = np.empty((4, 1, 4, layout.lines, layout.lines))
    for node, site in np.ndindex(4, 4):
        packed = device.read(part.nodes[node % 2, node // 2])[0, site // 2, 0]
        lines = packed[:, :, site % 2].reshape(layout.lines, -1)
        start = first + layout.offsets[site % 2]
        taps[node, 0, site] = lines[::-1, start : start + layout.lines][:, ::-1]
    (first_s, step_s), (first_t, step_t) = grid.node_weights((0, 0))
    places = [(2 * (site % 2), 2 * (site // 2)) for site in range(4)]
    expected = direct(
        planes,
        taps,
        low=layout.low,
        first=(first_s, first_t),
        step=(step_s, step_t),
        sites=places,
        stride=4,
        reach=grid.half_size,
    )
    left, top = (-origin for origin in grid.window_origin((0, 0)))
    inside = expected[:, top:, left:][:, : found.shape[1], : found.shape[2]]
    samples = expected.size
    return Job(
        rec.run,
        frame[0] * frame[1],
        error(found[:, : inside.shape[1], : inside.shape[2]], inside),
        len(blocks) * (planes.nbytes + 2 * 4 * samples),
        len(blocks) * samples,
        flops=2 * direct_work(grid, 8, dict.fromkeys(blocks, 1), SITES),
    )


def complex_of(pairs: np.ndarray) -> np.ndarray:
    """Return the complex numbers of pairs (..., 2)."""
    return pairs.view(np.complex64)[..., 0]


def unpacked(packed: np.ndarray, length: int) -> np.ndarray:
    """Return one plane's kernel spectra (kx, 1, channel, ky), as `kernel_spectra` packs them."""
    by_lane = packed.view(np.complex64).reshape(length // 16, length // 256, 16, 3, 8, 8, 2)
    lines = by_lane.transpose(0, 5, 3, 4, 6, 2, 1).reshape(length // 2, 1, 3, length)
    return np.concatenate([lines, np.zeros_like(lines[:1])])


def by_site(folded: np.ndarray) -> np.ndarray:
    """Return (S, T/2+1, M) from (S/2, M, T/2, 2, 2): two sites side by side, two parts each."""
    pairs = complex_of(folded)
    lines = pairs.transpose(0, 3, 2, 1).reshape(-1, pairs.shape[2], pairs.shape[1])
    return np.concatenate([lines, np.zeros_like(lines[:, :1])], axis=1)


def sensor_job(stage: str, device: Device, frame: tuple[int, int]) -> Job:
    """Time a stage of the sensor, at signals from darkness to 2000 electrons."""
    sensor = load_camera("demo").sensor
    plane = 2000 * np.random.default_rng(1).random(frame, np.float32)
    sites = plane.reshape(4, frame[0] // 2, frame[1] // 2)
    part = plane[:PART, :PART]
    glare = np.arange(1, 5, dtype=np.float32)
    keyed = {
        "serial_number": sensor.serial_number,
        "origin": (sensor.first_row, sensor.first_col),
    }
    peers: dict[str, tuple[Run, float]] = {}
    source = device.resident("plane", sites if stage == "mosaic" else plane)
    if stage == "mosaic":
        light = device.resident("glare", glare)
        record = partial(record_mosaic, planes=source, glare=light, sensor=sensor, shape=frame)
        table = planes_of(sensor).sites
        expected = mosaic(sites, glare, table, 2, (PART, PART))
    elif stage == "crosstalk":
        whole = (0, 0, *frame)
        record = partial(
            record_crosstalk,
            signal=source,
            kernels=SPREAD,
            sensor=sensor,
            given=whole,
            wanted=whole,
            frame=whole,
        )
        # Beyond the last pixels of the part the frame goes on.
        inner = (slice(PART - 1), slice(PART - 1))
        names = np.tile(np.array(sensor.cfa.pattern), (PART // 2, PART // 2))
        expected = crosstalk(part, names, SPREAD.between, (2, 2))[inner]
    elif stage == "exposure":
        record = partial(record_exposure, rate=source, sensor=sensor, exposure_s=EXPOSURE_S)
        current = sensor.dark_current_at(sensor.reference_temperature_c)
        prnu = sensor.prnu_percent / 100
        expected = exposure(part, EXPOSURE_S, prnu=prnu, dark_current_e_per_s=current, **keyed)
    elif stage == "noise":
        record = partial(record_noise, mean=source, sensor=sensor, seed=1)
        names = ("full_well_e", "temporal_dark_noise_e", "dsnu_e")
        figures = {name: getattr(sensor, name) for name in names}
        expected = noise(part, seed=1, frame=0, **figures, **keyed)
        rng = np.random.default_rng(1)
        peers["numpy"] = (lambda: rng.poisson(plane) + rng.standard_normal(frame, np.float32), 1.0)
    else:
        record = partial(record_adc, electrons=source, sensor=sensor)
        gain, black = sensor.system_gain_dn_per_e, sensor.black_level_dn
        expected = adc(part, gain, black, sensor.bit_depth).astype(float)
    sample, rec = Recording(device), Recording(device)
    label = sample.download(record(sample))
    record(rec)
    rows, cols = expected.shape
    found = error(sample.run()[label][:rows, :cols], expected)
    return Job(rec.run, plane.size, found, 2 * plane.nbytes, plane.size, peers)


def sensor_chain_job(device: Device, frame: tuple[int, int]) -> Job:
    """Time exposure, noise and adc, one after the other; the error is that of the electrons."""
    sensor = load_camera("demo").sensor
    mean = 2000 * np.random.default_rng(1).random(frame, np.float32)
    rate = mean / np.float32(EXPOSURE_S)
    source = device.resident("rate", rate)

    def recorded(rec: Recording) -> tuple[Array, Array]:
        exposed = record_exposure(rec, source, sensor, EXPOSURE_S)
        electrons = record_noise(rec, exposed, sensor, seed=1)
        return electrons, record_adc(rec, electrons, sensor)

    keyed = {
        "serial_number": sensor.serial_number,
        "origin": (sensor.first_row, sensor.first_col),
    }
    current = sensor.dark_current_at(sensor.reference_temperature_c)
    prnu = sensor.prnu_percent / 100
    part = rate[:PART, :PART].astype(float)
    expected = exposure(part, EXPOSURE_S, prnu=prnu, dark_current_e_per_s=current, **keyed)
    figures = {
        name: getattr(sensor, name) for name in ("full_well_e", "temporal_dark_noise_e", "dsnu_e")
    }
    expected = noise(expected, seed=1, frame=0, **figures, **keyed)
    sample, rec = Recording(device), Recording(device)
    label = sample.download(recorded(sample)[0])
    recorded(rec)
    found = error(sample.run()[label][:PART, :PART], expected)
    rng = np.random.default_rng(1)
    peers = {"numpy poisson": (lambda: rng.poisson(mean), 1.0)}
    return Job(rec.run, mean.size, found, 6 * mean.nbytes, mean.size, peers)


def bank_lens() -> Prescription:
    """Return the lens of the banks: the double Gauss of the demonstration camera."""
    return load_camera("demo").lens


BANK_LINES_NM = np.linspace(400.0, 700.0, 7)
BANK_REFERENCE_NM = BANK_LINES_NM[3]
BANK_SIZE, BANK_PITCH_UM, BANK_RAYS = 256, 0.5, 256


def traced(device: Device, lens: Prescription) -> Generator:
    """Trace the lens at 15 fields and 7 wavelengths."""
    return Generator(
        device,
        build(lens),
        BANK_LINES_NM,
        default_fields_deg(lens),
        pitch_um=BANK_PITCH_UM,
        size=BANK_SIZE,
        rays=BANK_RAYS,
    )


def bank_error(generator: Generator) -> dict[str, object]:
    """Return the largest difference of PSFs from the float64 path, over their peaks."""
    system, worst = generator.system, 0.0
    index = system.index(BANK_LINES_NM)
    for at in (0, 7, 14):
        spread = generator.spread(at)
        samples = sample_field(system, index, np.radians(generator.field_deg[at]))
        # 1024 nodes: the float64 path's own error is then 1e-4 of the peak.
        window_um = BANK_SIZE * BANK_PITCH_UM
        for line, pupil in enumerate(pupils(samples, BANK_LINES_NM, window_um, 1024)):
            true, _ = intensity(pupil, BANK_LINES_NM[line], BANK_SIZE, BANK_PITCH_UM)
            worst = max(worst, float(np.abs(spread.psf[line] - true).max() / true.max()))
    return {"measure": "largest difference from float64 over the PSF's peak", "worst": worst}


def optiland_peers(system: System) -> dict[str, tuple[Run, float]]:
    """Return optiland's runs for one PSF of the bank, where it is installed (extra ``judges``).

    Its FFTPSF has a pitch that goes with the wavelength, here 0.5 um by the size of its grid. Its
    MMDFTPSF and its HuygensPSF give the bank's own grid at every wavelength. HuygensPSF is timed
    with 64 x 64 rays and samples and named so: its work goes with their product, 256 times as much
    for a PSF of the bank, which would take minutes. That is at most: 128 took 12.5 times as long as
    64, not 16.
    """
    try:
        from optiland.materials import IdealMaterial
        from optiland.optic import Optic
        from optiland.psf import FFTPSF, MMDFTPSF, HuygensPSF
    except ImportError:
        return {}
    optic = Optic()
    optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    vertices = [*system.geometry.vertex_z, system.image_z_mm]
    index = system.index(np.array([BANK_REFERENCE_NM]))[:, 0]
    for i, surface in enumerate(system.prescription.surfaces):
        optic.surfaces.add(
            index=i + 1,
            radius=np.inf if surface.radius is None else surface.radius,
            thickness=vertices[i + 1] - vertices[i],
            is_stop=i == system.geometry.stop,
            material=IdealMaterial(n=float(index[i + 1])),
        )
    optic.surfaces.add(index=len(vertices))
    optic.set_aperture("imageFNO", system.prescription.f_number)
    optic.fields.set_type("angle")
    optic.fields.add(y=0)
    optic.fields.add(y=system.prescription.max_field_deg)
    line_um = 1e-3 * BANK_REFERENCE_NM
    optic.wavelengths.add(value=line_um, is_primary=True)
    grid = round(line_um * system.prescription.f_number * (BANK_RAYS - 1) / BANK_PITCH_UM)
    at = {"field": (0, 0.5), "wavelength": line_um}
    beams = 15 * len(BANK_LINES_NM)
    return {
        "optiland FFTPSF": (
            lambda: FFTPSF(optic, **at, num_rays=BANK_RAYS, grid_size=grid),
            beams,
        ),
        "optiland MMDFTPSF": (
            lambda: MMDFTPSF(
                optic,
                **at,
                num_rays=BANK_RAYS,
                image_size=BANK_SIZE,
                pixel_pitch=BANK_PITCH_UM,
            ),
            beams,
        ),
        "optiland HuygensPSF (64 x 64 rays and samples, times 256)": (
            lambda: HuygensPSF(optic, **at, num_rays=64, image_size=64),
            beams * (BANK_RAYS / 64) ** 2 * (BANK_SIZE / 64) ** 2,
        ),
    }


def psf_bank(device: Device, frame: tuple[int, int]) -> Job:
    """Time a bank of the double Gauss, from the prescription."""
    lens = bank_lens()
    kept = traced(device, lens)

    def run() -> None:
        generator = traced(device, lens)
        bank_of(generator, BANK_REFERENCE_NM)
        generator.release()

    return Job(
        run,
        15 * len(BANK_LINES_NM) * BANK_SIZE**2,
        bank_error(kept),
        peers=optiland_peers(kept.system),
        facts=lambda best: {"largest_residual_waves": float(kept.residual_waves.max())},
    )


def psf_refocus(device: Device, frame: tuple[int, int]) -> Job:
    """Time another focus of a lens that is traced already."""
    kept = traced(device, bank_lens())
    return Job(
        lambda: bank_of(kept, BANK_REFERENCE_NM, focus_um=10.0),
        15 * len(BANK_LINES_NM) * BANK_SIZE**2,
        bank_error(kept),
    )


JOBS: dict[str, tuple[str, Callable[[Device, tuple[int, int]], Job]]] = {
    "render-demo": ("a capture of the demonstration camera, source to raw", render_demo),
    "frame-12mp": (
        "the whole sensor and a photograph, three planes",
        partial(frame_job, mono=False),
    ),
    "frame-12mp-mono": (
        "the whole sensor and a black-and-white chart",
        partial(frame_job, mono=True),
    ),
    "scaling": ("frames of 1, 4, 12 and 48 MP: time for each pixel", scaling_job),
    "regret": (
        "the planner's time over the fastest known plan's, five scenes, three lenses",
        partial(regret_job, job=Job, lenses=TOLERANCE_LENSES, scenes=TOLERANCE_SCENES),
    ),
    "tolerances": ("three tolerances, five scenes, three lenses, certified", tolerances_job),
    "psf-bank": ("PSFs of a double Gauss from its prescription, 15 fields x 7 lines", psf_bank),
    "psf-refocus": ("the same at another focus", psf_refocus),
    "develop-12mp": (
        "a raw frame to a picture of 8 bits, demosaiced by Malvar's filters",
        partial(develop_job, method="malvar", job=Job),
    ),
    "develop-12mp-directional": (
        "the same, demosaiced along edges",
        partial(develop_job, method="directional", job=Job),
    ),
    "burst": ("20 frames of 512 x 512 of one light", partial(burst_job, job=Job)),
    "preview-sensor": (
        "20 turns of the exposure knob, each to its draft on a screen of 1528 x 774",
        partial(preview_job, what="sensor", job=Job),
    ),
    "preview-pan": ("20 frames of what is there, moved", partial(preview_job, what="pan", job=Job)),
    "preview-focus": (
        "a turn of the focus knob, to its draft",
        partial(preview_job, what="focus", job=Job),
    ),
    "paint": ("a chart onto the sim grid, one plane", paint_job),
    "warp": ("a photograph onto the sim grid, one plane", warp_job),
    "fft-rows": ("row transforms, one plane", partial(convolution_job, "fft_rows")),
    "fft-columns": (
        "column transforms and kernel products, one plane to three channels",
        partial(convolution_job, "fft_columns"),
    ),
    "inverse-fft": (
        "inverse row transforms and overlap-add",
        partial(convolution_job, "inverse_fft"),
    ),
    "modes": ("row transforms weighted with two maps, one plane", modes_job),
    "direct": ("a sum over 16 x 16 taps, one plane to three channels", direct_job),
    "mosaic": ("filter sites to pixels", partial(sensor_job, "mosaic")),
    "crosstalk": ("shares of eight neighbours, by channel", partial(sensor_job, "crosstalk")),
    "exposure": ("exposure time, PRNU, dark current", partial(sensor_job, "exposure")),
    "noise": ("shot noise, full well, read noise", partial(sensor_job, "noise")),
    "adc": ("quantisation", partial(sensor_job, "adc")),
    "sensor-12mp": ("exposure, noise and adc: electrons/s to digital numbers", sensor_chain_job),
    "smear": (
        "light in a CCD's packets on their way along the columns",
        partial(smear_job, job=Job),
    ),
    "cti-linear": (
        "charge-transfer inefficiency, linear, along columns and rows, 2048 x 2048",
        partial(linear_job, job=Job),
    ),
    "cti-trap": (
        "the same by traps of one species, along columns, 2048 x 2048",
        partial(trap_job, job=Job),
    ),
}

"""The chain: scene -> lens -> optics -> sensor -> raw digital numbers, and what it cost."""

from __future__ import annotations

import math
import os
import time
from collections import defaultdict, deque
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from gpusim.camera import Camera
from gpusim.certify import (
    Certificate,
    MeanSignal,
    Placed,
    Share,
    bank_share,
    certify,
    sensor_share,
)
from gpusim.errors import UserError
from gpusim.gpu import (
    Array,
    Device,
    OutOfMemoryError,
    Recording,
    Resident,
    Result,
    default_device,
)
from gpusim.gpu.pool import mebibytes
from gpusim.heap import trim_heap
from gpusim.isp.optics import Optics, optics_of
from gpusim.lens.bank import default_lines_nm
from gpusim.lens.field_bank import FieldBank, seen_as
from gpusim.lens.prescription import Prescription
from gpusim.optics.chief_ray import chief_ray_map
from gpusim.optics.flare import veiling_glare
from gpusim.optics.fold import spectral_weights
from gpusim.optics.halo import Halo, coarse_grid
from gpusim.optics.halo import needed as coarse_rects
from gpusim.optics.methods import Convolution, convolution
from gpusim.optics.paint import Paint
from gpusim.optics.splat import Splat
from gpusim.optics.warp import Warp
from gpusim.plan import Accuracy, Plan, plans_optics
from gpusim.plan.band import Band, band_of, with_band
from gpusim.plan.calibrate import adapter_costs
from gpusim.plan.costs import Costs
from gpusim.plan.density import Density, bank_density
from gpusim.plan.tiles import (
    RESERVE_BYTES,
    SMALLEST_PX,
    STRIP_SHARE,
    Rect,
    aligned,
    halves,
    strip_bytes,
    strips,
    tile_bytes,
    tiles_of,
)
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.ccd import ReadOut, needed, record_tile, taking
from gpusim.sensor.frame import overlap, parts_around
from gpusim.sensor.planes import planes_of
from gpusim.sensor.readout import Shot, noise_seed, record_readout, rects_of
from gpusim.sensor.sensor import Sensor

Progress = Callable[[str, int, int], None]

KEPT_SHARE = 4  # of the budget, a quarter at most of the host's memory for the light of a frame


@dataclass(frozen=True)
class Capture:
    """One frame and how it was made.

    Attributes
    ----------
    raw : ndarray (rows, cols), uint16
        Digital numbers: of all that is read out, or of the rectangle that was asked for.
    rate, electrons : ndarray (rows, cols), float32, or None
        Electrons/s before the exposure, and electrons before the ADC, where they were kept.
    white_e : dict of str to float
        Mean electrons that the scene's white makes on the axis, by channel.
    transmission : ndarray (61,)
        Of the lens, at WAVELENGTHS_NM.
    optics : Optics
        What files say of the lens.
    notes : tuple of str
        How the scene was read and placed.
    plan : Plan
    times_s : dict of str to float
        Seconds by stage, on the device's clock.
    wall_s : float
        From the recording of the first tile to the last byte of the raw; without preparation and
        certificate.
    prepare_s : dict of str to float
        Seconds spent before the first tile, which further frames of the same scene do not spend.
        Kernels that the memory does not hold all at once are made within the render: see
        ``times_s["kernels"]``.
    memory : dict of str to int
        Of the device, bytes: ``budget_bytes``, and ``peak_bytes`` that were held at most.
    work : dict of str to int
        How many ``tiles`` were rendered and ``blocks`` convolved, and of how many PSF nodes the
        kernels were made (``nodes``).
    rect : (int, int, int, int)
        First row and column, rows and columns of the raw, counted from the first lit pixel: the
        border of optical black has negative numbers.
    device : dict
        Adapter, driver and limits.
    certificate : Certificate or None
    camera, scene, seed, frame, exposure_s, accuracy
        What was asked for.
    temperature_c : float
        Of the sensor.
    costs : Costs or None
        The rates that the plan was made from: with them it is made again.
    band : Band
        The wavelengths that were rendered, and what no data describe.
    """

    raw: np.ndarray
    rate: np.ndarray | None
    electrons: np.ndarray | None
    white_e: dict[str, float]
    transmission: np.ndarray
    optics: Optics
    notes: tuple[str, ...]
    plan: Plan
    times_s: dict[str, float]
    wall_s: float
    prepare_s: dict[str, float]
    memory: dict[str, int]
    work: dict[str, int]
    rect: Rect
    device: dict
    certificate: Certificate | None
    camera: Camera
    scene: Scene
    seed: int
    frame: int
    exposure_s: float
    accuracy: Accuracy
    temperature_c: float
    band: Band
    costs: Costs | None = None

    @property
    def lit(self) -> Rect:
        """The pixels that see light: their first row and column, rows and columns."""
        return overlap(self.rect, self.camera.sensor.frame.lit)

    @property
    def active_area(self) -> Rect:
        """Where these lie in the raw: first row and column, rows and columns."""
        row, col, rows, cols = self.lit
        return row - self.rect[0], col - self.rect[1], rows, cols

    @property
    def masked_areas(self) -> list[Rect]:
        """Where pixels shielded from light lie in the raw."""
        shielded = parts_around(self.lit, overlap(self.rect, self.camera.sensor.frame.pixels))
        first_row, first_col = self.rect[:2]
        return [(row - first_row, col - first_col, *size) for row, col, *size in shielded]


class Look(NamedTuple):
    """What a camera sees of a scene: its wavelengths, the scene at these, and the lens's PSFs."""

    band: Band
    scene: Scene
    density: Density | None
    bank: FieldBank


def look(
    camera: Camera,
    scene: Scene,
    accuracy: Accuracy,
    exposure_s: float = math.inf,
    progress: Callable[[int, int], None] | None = None,
) -> Look:
    """Choose wavelengths, fields and lines for a tolerance, and trace the lens.

    ``exposure_s``: the longest that will be captured; ``progress``: called with (done, total).
    """
    # A camera that brings a bank along may have no lens to ask.
    lens, sensor = getattr(camera, "lens", None), camera.sensor
    band = band_of(lens, sensor, scene, accuracy)
    scene = scene.on(band.wavelengths_nm)
    density = bank_density(lens, sensor, scene, accuracy, exposure_s, progress)
    sampling = {} if density is None else density.sampling
    if density is None and isinstance(lens, Prescription):
        sampling = {"wavelengths_nm": default_lines_nm(*band.wavelengths_nm[[0, -1]])}
    bank = seen_as(camera.bank(progress=progress, **sampling), scene.projection)
    return Look(band, scene.before(bank.efl_mm), density, bank)


class Renderer:
    """A camera in front of a scene, planned and prepared on a device.

    Scene and kernels come onto the device with the first frame that needs them, and stay there for
    the next as far as the memory goes. The light on the pixels is kept, on the host, so that a
    further frame of the same rectangle costs the sensor alone, whatever its exposure and seed.

    Parameters
    ----------
    camera : Camera
    scene : Scene
    accuracy : Accuracy
    device : Device, optional
    progress : callable, optional
        Called with (what, done, total).
    memory_bytes : int, optional
        Budget of GPU memory, by default the device's. It changes how the work is cut, and not one
        bit of the result.
    exposure_s : float, optional
        Longest exposure that will be captured. It matters only to a tolerance in sigmas: the plan
        then counts on the noise of the brightest signal that the scene makes in it, and without it
        on that of the full well, which suffices for all exposures.
    plan : Plan, optional
        Use this one: the planner is not asked.
    costs : Costs, optional
        From which the plan is made; by default those of the device, measured once.
    noise : bool
        Whether to draw the sensor's noise and fixed patterns; else the frame is the mean signal.
    method : str, optional
        By which to convolve: one of gpusim.optics.methods.METHODS; by default the cheapest.
    force : collection of str
        Stages to run that the plan would leave out: for tests.

    Raises
    ------
    UserError
        When the plan cannot be met or the memory does not suffice.
    """

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        accuracy: Accuracy | None = None,
        device: Device | None = None,
        progress: Progress | None = None,
        memory_bytes: int | None = None,
        exposure_s: float | None = None,
        plan: Plan | None = None,
        *,
        costs: Costs | None = None,
        noise: bool = True,
        method: str | None = None,
        force: Collection[str] = (),
    ) -> None:
        self.camera, self.scene, self.accuracy = camera, scene, accuracy or Accuracy()
        self.longest_s = math.inf if exposure_s is None else exposure_s
        self.device = device or default_device()
        pool = self.device.pool
        self.memory_bytes = pool.budget if memory_bytes is None else memory_bytes
        self.prepare_s: dict[str, float] = {}
        self.sources: list[Paint | Warp] = []
        self.convolutions: list[Convolution] = []
        self.splat: Splat | None = None
        self.splatted: _Splatted | None = None
        self.kept: dict[Rect, np.ndarray] = {}  # electrons/s of the planes, by tile
        self.halo: Halo | None = None
        self.tight = False  # the adapter has less than the budget: kernels of one block at a time
        self.resident_glare: Resident | None = None
        report = progress or (lambda what, done, total: None)
        if costs is None:
            # Before the budget counts: a calibration needs some 300 MiB.
            costs = adapter_costs(
                self.device, progress=lambda done, total: report("calibrate", done, total)
            )
        pool.clear()  # what others left behind is no part of this renderer's peak
        # OpenBLAS's own threads wait by spinning: after each call of some size, a tenth of a second
        # of a core that what follows needs.
        with pool.within(self.memory_bytes), threadpool_limits(1):
            try:
                self._prepare(report, costs, noise, method, force, plan)
            except BaseException:
                self.release()
                raise
            self.peak_bytes = pool.peak

    def _prepare(
        self,
        report: Progress,
        costs: Costs,
        noise: bool,
        method: str | None,
        force: Collection[str],
        plan: Plan | None,
    ) -> None:
        """Plan, and place the scene on the sensor."""
        camera, sensor = self.camera, self.camera.sensor
        started = time.perf_counter()
        asked = self.accuracy, self.longest_s
        seen = look(camera, self.scene, *asked, lambda *done: report("lens", *done))
        self.band, self.density, self.scene = seen.band, seen.density, seen.scene
        scene = self.scene
        self.bank, self.core = seen.bank, seen.bank.levels[0]
        started = self._spent("lens", started)
        self._costs, self._noise = costs, noise
        self.plan = plan or self.planned(method, force)
        started = self._spent("plan", started)

        half_um = tuple(side * sensor.pixel_pitch_um / 2 for side in (sensor.cols, sensor.rows))
        chief_ray = chief_ray_map(self.core, "distortion" in force)
        coefficients = self.plan.basis.coefficients
        for scale in self.plan.scales:
            if isinstance(scene.source, Chart):
                stage, placed = Paint, scene.source.placed(half_um[1])
            else:
                stage, placed = Warp, scene.source.placed(*half_um, scale.pitch_um)
            if scale is self.plan.scales[0]:
                self.placed = placed
            self.sources.append(stage(self.device, placed, coefficients, scale, chief_ray))
        basis = self.plan.basis
        glare = veiling_glare(
            self.core, sensor, self.placed, basis.weights, coefficients, basis.elsewhere
        )
        self.glare = glare.astype(np.float32)
        self.resident_glare = self.device.resident("glare", self.glare)
        if isinstance(self.placed, PlacedRaster) and len(self.placed.highlights):
            lights = self.placed.highlights, scene.spectra, self.plan.tolerance
            self.splat = Splat(self.device, self.core, sensor, *lights, scene.wavelengths_nm)
        sites = list(planes_of(sensor).channels)
        for scale, source in zip(self.plan.scales, self.sources, strict=True):
            convolve = convolution(self.device, scale, source.needed, sensor.response_um, sites)
            self.convolutions.append(convolve)
        self._spent("scene", started)

    def planned(self, method: str | None = None, force: Collection[str] = ()) -> Plan:
        """Return the plan for a method, or for the cheapest: see `gpusim.plan.plan_optics`."""
        return self.plans(1, method, force)[0]

    def plans(
        self, count: int, method: str | None = None, force: Collection[str] = ()
    ) -> list[Plan]:
        """Return the plan and what the planner takes for the next cheapest ways, `count` in all."""
        sensor = self.camera.sensor
        given = self.bank, sensor, self.scene, self.accuracy, self._costs, self._noise
        found = plans_optics(
            *given, method, force, self.longest_s, count=count, density=self.density
        )
        return [with_band(plan, self.band) for plan in found]

    def release(self) -> None:
        """Give the device's memory back; the renderer cannot be used any more."""
        for part in (*self.sources, *self.convolutions):
            part.release()
        if self.halo is not None:
            self.halo.release()
        if self.resident_glare is not None:
            self.resident_glare.destroy()
        trim_heap()

    def drop_light(self) -> None:
        """Forget the light of the last frame: the next one is convolved anew, with what is held."""
        self.kept.clear()

    def keep_light(self, tile: Rect, rates: Resident) -> None:
        """Keep the light of a tile of whole periods, as long as a share of the budget holds it."""
        held = sum(one.nbytes for one in self.kept.values())
        if held + rates.nbytes <= self.memory_bytes // KEPT_SHARE:
            self.kept[tile] = self.device.read(rates)

    def _spent(self, what: str, started: float) -> float:
        now = time.perf_counter()
        self.prepare_s[what] = self.prepare_s.get(what, 0.0) + now - started
        return now

    def capture(
        self,
        exposure_s: float,
        *,
        seed: int = 0,
        frame: int = 0,
        temperature_c: float | None = None,
        tile: tuple[int, int, int, int] | None = None,
        tile_px: int | None = None,
        keep: tuple[str, ...] = (),
        folder: Path | None = None,
        progress: Progress | None = None,
    ) -> Capture:
        """Render one frame, or a rectangle of it.

        Parameters
        ----------
        exposure_s : float
        seed : int
            Of the temporal noise, 0 to 2^64 - 1.
        frame : int
            Frames of one seed have independent noise; so have those of other exposures and gains.
        temperature_c : float, optional
            Of the sensor; by default that at which its dark current was measured.
        tile : (x, y, width, height), optional
            The rectangle of lit pixels to render, and nothing that it does not need. It is the
            same, bit for bit, as that of the whole frame.
        tile_px : int, optional
            Largest side of what is rendered at once, by default chosen from the memory. It changes
            the memory that is needed, and not one bit of the result.
        keep : tuple of str
            Of "rate" and "electrons".
        folder : path, optional
            Where to keep raw and planes as files while they are made, so that they take no memory
            of the host; they are there as long as the capture is used.
        progress : callable, optional
            Called with (what, done, total).

        Raises
        ------
        UserError
            For an exposure, temperature, seed, rectangle or tile out of range, or when the memory
            does not suffice for the smallest tile.
        """
        sensor = self.camera.sensor
        _check("exposure", exposure_s, 0 < exposure_s < np.inf, "seconds above 0")
        if self.accuracy.unit == "sigma":
            longest = f"{self.longest_s:g} s or less, for which the tolerance in sigmas was planned"
            _check("exposure", exposure_s, exposure_s <= self.longest_s, longest)
        _check("seed", seed, 0 <= seed < 2**64, "0 to 2^64 - 1")
        _check("frame", frame, 0 <= frame < 2**32, "0 to 2^32 - 1")
        rect = _rectangle(tile, sensor)
        if tile_px is not None:
            _check("tile-size", tile_px, tile_px >= self.period, f"{self.period} or more")
        names = {"dn": np.uint16} | dict.fromkeys(keep, np.float32)
        if self.accuracy.probes:
            names |= dict.fromkeys(("rate", "mean"), np.float32)
        if temperature_c is None:
            temperature_c = sensor.reference_temperature_c
        sensor.dark_current_at(temperature_c)  # refuses what is none
        kind = _ShiftedShot if sensor.is_ccd else _Shot
        own_seed = noise_seed(seed, exposure_s, sensor.analogue_gain)
        taken = Shot(exposure_s, own_seed, frame, temperature_c)
        shot = kind(self, rect, names, folder, taken)
        report = progress or (lambda what, done, total: None)
        made = sum(convolve.made for convolve in self.convolutions)
        with self.device.pool.within(self.memory_bytes):
            self._hold(shot.rect, tile_px, report)
            started = time.perf_counter()
            shot.render(tile_px, lambda done, total: report("render", done, total))
            wall_s = time.perf_counter() - started
            self.peak_bytes = max(self.peak_bytes, self.device.pool.peak)

        certificate = None
        if self.accuracy.probes:
            seen = overlap(rect, sensor.frame.lit)
            top, left = seen[0] - rect[0], seen[1] - rect[1]

            def readout(pixels: np.ndarray) -> tuple[Share, str]:
                with self.device.pool.within(self.memory_bytes):
                    made = shot.mean_signal()
                noise = self.plan.runs("noise")
                return sensor_share(
                    sensor, made, pixels, exposure_s, temperature_c, noise, self.accuracy
                )

            light = shot.on_rect("rate")[top : top + seen[2], left : left + seen[3]]
            certificate = certify(
                self.bank,
                sensor,
                self.scene,
                self.placed,
                light,
                self.glare,
                exposure_s,
                self.accuracy,
                lambda done, total: report("certify", done, total),
                origin=seen[:2],
                readout=readout,
                judged=lambda: bank_share(
                    self.bank,
                    self.camera.lens,
                    sensor,
                    self.scene,
                    self.placed,
                    light,
                    seen[:2],
                    exposure_s,
                    self.accuracy,
                    lambda done, total: report("trace anew", done, total),
                    self.band.dropped,
                ),
            )
        return Capture(
            costs=self._costs,
            band=self.band,
            raw=shot.on_rect("dn"),
            rate=shot.on_rect("rate") if "rate" in keep else None,
            electrons=shot.on_rect("electrons") if "electrons" in keep else None,
            white_e=self._white_e(exposure_s),
            transmission=np.interp(
                WAVELENGTHS_NM, self.core.wavelengths_nm, self.core.transmission
            ),
            optics=optics_of(self.camera.lens.title, self.bank),
            notes=self.scene.notes
            + ((self.placed.note,) if isinstance(self.placed, PlacedRaster) else ())
            + tuple(shot.notes),
            plan=self.plan,
            times_s=dict(shot.times_s),
            wall_s=wall_s,
            prepare_s=dict(self.prepare_s),
            memory={"budget_bytes": self.memory_bytes, "peak_bytes": self.peak_bytes},
            work={**shot.work, "nodes": sum(c.made for c in self.convolutions) - made},
            rect=rect,
            device=self.device.report(),
            certificate=certificate,
            camera=self.camera,
            scene=self.scene,
            seed=seed,
            frame=frame,
            exposure_s=exposure_s,
            accuracy=self.accuracy,
            temperature_c=temperature_c,
        )

    def lines(self, rect: Rect) -> Iterator[tuple[int, list[tuple[int, int]]]]:
        """Yield the blocks that a rectangle of lit pixels needs, where there is light, by line.

        A line is a row of cells between PSF nodes. In the order in which they are added up: with
        the number of their scale.
        """
        for number, (scale, source) in enumerate(zip(self.plan.scales, self.sources, strict=True)):
            grid = scale.grid
            blocks = [block for block in grid.blocks_for(*rect) if source.needed[block]]
            for _, line in groupby(blocks, key=lambda block: grid.cell_of(block)[1]):
                yield number, list(line)

    def working_bytes(self) -> int:
        """Return the device memory that is taken for a while, beside tile, scene and kernels."""
        planes = self.plan.basis.coefficients.shape[1]
        scratch = max(convolve.scratch_bytes(planes) for convolve in self.convolutions)
        strip = strip_bytes(self.frame, self.memory_bytes, self._around)
        return max(scratch, strip) + RESERVE_BYTES

    def room(self) -> int:
        """Return the device memory that scene and kernels may take, those of now dropped."""
        pool = self.device.pool
        held = sum(convolve.held_bytes for convolve in self.convolutions)
        return pool.budget - pool.in_use + held - self.working_bytes()

    def load(
        self,
        number: int,
        blocks: list[tuple[int, int]],
        progress: Callable[[], None] | None = None,
    ) -> None:
        """Make the kernels of blocks; drop others, first of other scales, as far as need be."""
        convolve = self.convolutions[number]
        if self.tight:
            self.drop(number, blocks)
        held = sum(convolve.held_bytes for convolve in self.convolutions)
        lacking = convolve.missing_bytes(blocks) - (self.room() - held)
        for other in self.convolutions:
            if other is not convolve:
                lacking -= other.shed(lacking)
        convolve.shed(lacking, blocks)
        try:
            convolve.load(blocks, progress)
        except OutOfMemoryError:  # the adapter has less than the budget
            self.drop(number, blocks)
            convolve.load(blocks, progress)

    def drop(self, number: int = 0, blocks: Sequence[tuple[int, int]] = ()) -> None:
        """Drop all kernels, but for those of some blocks."""
        for other, convolve in enumerate(self.convolutions):
            convolve.shed(convolve.held_bytes, blocks if other == number else ())

    def least_bytes(self) -> int:
        """Return the device memory that the smallest tile takes, beside what is in use now."""
        planes = self.plan.basis.coefficients.shape[1]
        kernels = max(convolve.block_bytes(planes) for convolve in self.convolutions)
        source = max(
            (self.sources[n].load_bytes(line[:1]) for n, line in self.lines(self.lit(self.frame))),
            default=0,
        )
        side = SMALLEST_PX + 2 * self._around
        tile = tile_bytes((0, 0, side, side), self.period, self.layers)
        return kernels + source + tile + self.working_bytes()

    @property
    def period(self) -> int:
        """Pixels from a sample of the planes to the next: those of tiles lie between such."""
        return self.plan.scales[0].grid.period

    @property
    def layers(self) -> int:
        """Planes of each pixel."""
        return self.plan.scales[0].grid.layers

    @property
    def frame(self) -> Rect:
        """All that is read out."""
        return self.camera.sensor.frame.read

    def lit(self, rect: Rect) -> Rect:
        """Return the lit pixels that a rectangle needs; of one without any, the pixel next to it.

        So that there always are planes of the sites, of which the border then takes nothing.
        """
        _, rect = rects_of(rect, self.camera.sensor, self.plan.runs)
        sides = []
        for first, count, size in zip(
            rect[:2], rect[2:], self.camera.sensor.frame.lit[2:], strict=True
        ):
            begin = min(max(first, 0), size - 1)
            sides.append((begin, max(min(first + count, size) - begin, 1)))
        (row, rows), (col, cols) = sides
        return row, col, rows, cols

    @property
    def _around(self) -> int:
        """Pixels whose light a tile or a strip needs on each side, at most."""
        pixel = self.camera.sensor.rows - 1, 0, 1, 1
        _, seen = rects_of(pixel, self.camera.sensor, self.plan.runs)
        return pixel[0] - seen[0]

    def _hold(self, rect: Rect, tile_px: int | None, report: Progress) -> None:
        """Bring onto the device what further frames need as well, if there is room for all."""
        started = time.perf_counter()
        seen = self.lit(rect)
        self._hold_halo(aligned(seen, self.period), report)
        started = self._spent("halo", started)
        if self.splat is not None:
            self._hold_splat(aligned(seen, self.period), report)
            started = self._spent("splat", started)
        for source, scale in zip(self.sources, self.plan.scales, strict=True):
            source.prepare([b for b in scale.grid.blocks_for(*seen) if source.needed[b]])
        started = self._spent("scene", started)
        wanted: list[list[tuple[int, int]]] = [[] for _ in self.convolutions]
        largest = 0
        for number, line in self.lines(seen):
            wanted[number] += line
            largest = max(largest, self.sources[number].load_bytes(line))
        pairs = list(zip(self.convolutions, wanted, strict=True))
        needed = sum(convolve.load_bytes(blocks) for convolve, blocks in pairs)
        tiles = tiles_of(rect, self.period, self.memory_bytes, tile_px, self.layers)
        planes = max(tile_bytes(self.lit(tile), self.period, self.layers) for tile in tiles)
        if not self.tight and needed + largest + planes <= self.room():
            total = sum(len(c.nodes_of(blocks) - c.nodes.keys()) for c, blocks in pairs)
            done = iter(range(1, total + 1))
            try:
                for number, (_, blocks) in enumerate(pairs):
                    self.load(number, blocks, lambda: report("kernels", next(done), total))
            except OutOfMemoryError:  # the adapter has less: they are made where they are needed
                self.drop()
        self._spent("kernels", started)

    def _hold_halo(self, rect: Rect, report: Progress) -> None:
        """Bring the halo of a rectangle of lit pixels onto the device."""
        if not self.plan.halo or (self.halo is not None and self.halo.covers(rect)):
            return
        if self.halo is not None:
            self.halo.release()
            self.halo = None
        sensor = self.camera.sensor
        banks = [self.bank.levels[level.number] for level in self.plan.halo]
        edges = isinstance(self.scene.source, Chart)
        grids = [coarse_grid(bank, sensor, edges) for bank in banks]
        light = []
        for done, (level, bank, grid, part) in enumerate(
            zip(self.plan.halo, banks, grids, coarse_rects(grids, rect), strict=True)
        ):
            report("halo", done, len(banks))
            renderer = Renderer(
                _CoarseCamera(bank, grid.sensor),
                seen_by(self.scene, sensor, grid.sensor),
                level.accuracy,
                self.device,
                memory_bytes=self.memory_bytes,
                costs=self._costs,
                noise=False,
                method="fft",
            )
            try:
                light.append(renderer.light(part))
            finally:
                renderer.release()
        report("halo", len(banks), len(banks))
        self.halo = Halo(self.device, sensor, grids, light, rect)

    def _hold_splat(self, rect: Rect, report: Progress) -> None:
        """Work out what highlights bring to a rectangle of lit pixels, and keep it on the host."""
        if self.splatted is not None and self.splatted.covers(rect):
            return
        self.splatted = None
        tiles = tiles_of(rect, self.period, self.memory_bytes, None, self.layers)
        light = self.splat.light(tiles, lambda done, total: report("splat", done, total))
        self.splatted = _Splatted(rect, self.period, tiles, light)

    def light(self, rect: Rect) -> np.ndarray:
        """Return the electrons/s (S, rows, cols) of the planes of a rectangle of lit pixels.

        Whole periods of the filter pattern; without veiling glare.
        """
        shot = _Light(self, rect, {}, None, Shot(1.0, 0, 0))
        with self.device.pool.within(self.memory_bytes):
            self._hold(rect, None, lambda what, done, total: None)
            shot.render(None, lambda done, total: None)
        return shot.found

    def _white_e(self, exposure_s: float) -> dict[str, float]:
        """Return the mean electrons that the scene's white makes on the axis, by channel."""
        sensor = self.camera.sensor
        weights = spectral_weights(self.core, sensor, wavelengths_nm=self.scene.wavelengths_nm)
        white = np.einsum("clw,w->c", weights, self.scene.white)
        return {
            name: float(value * exposure_s)
            for name, value in zip(sensor.channels, white, strict=True)
        }


class _Shot:
    """One frame, or a rectangle of it, on its way from the scene to the host."""

    def __init__(
        self,
        renderer: Renderer,
        rect: Rect,
        names: dict[str, type],
        folder: Path | None,
        shot: Shot,
    ) -> None:
        self.renderer, self.rect, self.shot = renderer, rect, shot
        self.planes = {
            name: _on_host(name, self._area(name, rect)[2:], dtype, folder)
            for name, dtype in names.items()
        }
        self.times_s: dict[str, float] = defaultdict(float)
        self.work = {"tiles": 0, "blocks": 0}
        self.notes: list[str] = []

    def render(self, tile_px: int | None, progress: Callable[[int, int], None]) -> None:
        """Render tile after tile; where the memory runs out, halve the tile and go on."""
        renderer = self.renderer
        period = renderer.period
        self._check_memory()
        tiles = deque(tiles_of(self.rect, period, renderer.memory_bytes, tile_px, renderer.layers))
        wanted = {aligned(renderer.lit(tile), period) for tile in tiles}
        renderer.kept = {tile: one for tile, one in renderer.kept.items() if tile in wanted}
        done, left = 0, sum(map(self._steps, tiles))

        def advance() -> None:
            nonlocal done, left
            done, left = done + 1, left - 1
            progress(done, done + left)

        while tiles:
            tile = tiles.popleft()
            try:
                self._tile(tile, advance)
            except OutOfMemoryError as error:
                parts = halves(tile, period)
                if not parts:
                    raise self._too_little(error.value) from error
                renderer.drop()
                renderer.tight = True
                tiles.extendleft(reversed(parts))
                left = sum(map(self._steps, tiles))
                # The last such note stands for those of the halves before it.
                self.notes = [
                    f"GPU memory ran out: tiles of at most {parts[0][3]} x {parts[0][2]} pixels"
                ]

    def _steps(self, tile: Rect) -> int:
        renderer = self.renderer
        whole = aligned(renderer.lit(tile), renderer.period)
        return 1 + (0 if whole in renderer.kept else sum(1 for _ in renderer.lines(whole)))

    def _check_memory(self) -> None:
        pool = self.renderer.device.pool
        held = sum(convolve.held_bytes for convolve in self.renderer.convolutions)
        if self.renderer.least_bytes() > pool.budget - pool.in_use + held:
            others = pool.in_use - held
            raise self._too_little(f"{mebibytes(pool.budget)}, {mebibytes(others)} of it in use")

    def _too_little(self, found: object) -> UserError:
        self.renderer.drop()
        others = self.renderer.device.pool.in_use
        return UserError(
            "The GPU memory does not hold the smallest tile: the kernels around one block, the "
            "block, and the scene that it sees.",
            field="memory",
            value=found,
            allowed=f"at least {mebibytes(self.renderer.least_bytes() + others)}: a larger "
            "--memory, another adapter, or a looser tolerance",
        )

    def _tile(self, tile: Rect, advance: Callable[[], None]) -> None:
        """Render one tile: each block that it needs, from source to sites; highlights; sensor."""
        renderer = self.renderer
        device, period = renderer.device, renderer.period
        whole = aligned(renderer.lit(tile), period)
        count = renderer.plan.scales[0].grid.sites
        sites = (count, whole[2] // period, whole[3] // period)
        rates = device.empty("rates", sites, np.float32)
        try:
            if whole in renderer.kept:
                rec = Recording(device)
                rec.upload(rates, renderer.kept[whole])
                rec.run()
            else:
                self._lit(rates, whole, advance)
                renderer.keep_light(whole, rates)
            self._finish(tile, rates, whole)
            advance()
        finally:
            rates.destroy()
        self.work["tiles"] += 1

    def _lit(self, rates: Resident, whole: Rect, advance: Callable[[], None]) -> None:
        """Bring the light to the planes of the sites of a rectangle: blocks, highlights, halo."""
        renderer = self.renderer
        rec = Recording(renderer.device)
        if renderer.splatted is None:
            rec.clear(rates)
        else:
            rec.upload(rates, renderer.splatted.on(whole))
        rec.run()
        for number, line in renderer.lines(whole):
            parts = deque(self._parts(number, line))
            while parts:
                blocks = parts.popleft()
                try:
                    self._load(number, blocks)
                except OutOfMemoryError:
                    if len(blocks) == 1:
                        raise
                    parts.extendleft([blocks[len(blocks) // 2 :], blocks[: len(blocks) // 2]])
                else:
                    self._blocks(number, blocks, rates, whole)
            advance()
        if renderer.halo is not None:
            rec = Recording(renderer.device)
            renderer.halo.record(rec, rates, whole)
            self._run(rec)

    def _parts(self, number: int, line: list[tuple[int, int]]) -> Iterator[list[tuple[int, int]]]:
        """Cut a line of blocks into parts whose kernels fit the memory together."""
        convolve, source = self.renderer.convolutions[number], self.renderer.sources[number]
        while line:
            count = 1 if self.renderer.tight else len(line)
            while count > 1 and self.renderer.room() < (
                source.load_bytes(line[:count]) + convolve.load_bytes(line[:count])
            ):
                count = -(-count // 2)
            yield line[:count]
            line = line[count:]

    def _load(self, number: int, blocks: list[tuple[int, int]]) -> None:
        """Bring scene and kernels of blocks onto the device."""
        renderer = self.renderer
        renderer.sources[number].load(blocks)
        if renderer.convolutions[number].missing_bytes(blocks):
            started = time.perf_counter()
            renderer.load(number, blocks)
            self.times_s["kernels"] += time.perf_counter() - started

    def _blocks(
        self, number: int, blocks: list[tuple[int, int]], rates: Resident, rect: Rect
    ) -> None:
        """Add blocks to the planes (S, rows, cols) of the sites of a rectangle."""
        renderer = self.renderer
        source = renderer.sources[number]
        rec = Recording(renderer.device)
        convolve = renderer.convolutions[number]
        scratch = convolve.scratch(rec, renderer.plan.basis.coefficients.shape[1])
        for block in blocks:
            source.record(rec, block, scratch.planes)
            convolve.record(rec, block, source.needed[block], scratch, rates, rect)
        self._run(rec)
        self.work["blocks"] += len(blocks)

    def _finish(self, tile: Rect, rates: Resident, whole: Rect) -> None:
        """Take the light on a tile to digital numbers, strip by strip."""
        for strip in strips(tile, self.renderer.memory_bytes):
            self._strip(strip, rates, whole)

    def _strip(self, strip: Rect, rates: Resident, tile: Rect) -> None:
        """Take a strip of rows from the planes of the sites to digital numbers, and to the host."""
        renderer = self.renderer
        rec = Recording(renderer.device)
        outputs = self._outputs(rec, strip, rates, tile)
        # Without noise the electrons are their own mean: one buffer, which comes once.
        for array in {outputs[name].label: outputs[name] for name in self.planes}.values():
            rec.download(array)
        result = self._run(rec)
        for name, plane in self.planes.items():
            part = _part(plane, self._area(name, self.rect), self._area(name, strip))
            part[...] = result[outputs[name].label]

    def _area(self, name: str, rect: Rect) -> Rect:
        """Return what a plane holds of a rectangle: also the pixels around it that it needs."""
        collecting, taking = rects_of(rect, self.renderer.camera.sensor, self.renderer.plan.runs)
        return {"rate": taking, "mean": collecting}.get(name, rect)

    def on_rect(self, name: str) -> np.ndarray:
        """Return a plane, of the rectangle alone."""
        return _part(self.planes[name], self._area(name, self.rect), self.rect)

    def mean_signal(self) -> MeanSignal:
        """Return the light and the mean electrons that the certificate compares."""
        placed = [Placed(self.planes[n], self._area(n, self.rect)) for n in ("rate", "mean")]
        return MeanSignal(*placed)

    def _outputs(
        self, rec: Recording, strip: Rect, rates: Resident, tile: Rect
    ) -> dict[str, Array]:
        """Record what becomes of a strip."""
        renderer = self.renderer
        return record_readout(
            rec,
            rates,
            renderer.resident_glare,
            renderer.camera.sensor,
            strip,
            tile,
            self.shot,
            renderer.plan.runs,
        )

    def _run(self, rec: Recording) -> Result:
        result = rec.run()
        for stage, seconds in result.times_s.items():
            self.times_s[stage.rpartition("/")[2]] += seconds
        return result


class _Splatted:
    """The light of highlights on a rectangle of lit pixels, electrons/s of the planes, by tile."""

    def __init__(self, rect: Rect, period: int, tiles: list[Rect], light: list[np.ndarray]) -> None:
        self.rect, self.period = rect, period
        _, _, rows, cols = aligned(rect, period)
        self.light = np.empty((len(light[0]), rows // period, cols // period), np.float32)
        for tile, part in zip(tiles, light, strict=True):
            self._part(tile)[...] = part

    def covers(self, rect: Rect) -> bool:
        """Return whether the light on a rectangle is there."""
        return overlap(self.rect, rect) == rect

    def on(self, rect: Rect) -> np.ndarray:
        """Return the light (S, rows, cols) on a rectangle of whole periods."""
        return np.ascontiguousarray(self._part(rect))

    def _part(self, rect: Rect) -> np.ndarray:
        period = self.period
        row, col = (
            (own - first) // period for own, first in zip(rect[:2], self.rect[:2], strict=True)
        )
        return self.light[:, row : row + -(-rect[2] // period), col : col + -(-rect[3] // period)]


@dataclass(frozen=True)
class _CoarseCamera:
    """A level of a halo before a coarse sensor."""

    level: FieldBank
    sensor: Sensor

    def bank(self, progress: Callable[[int, int], None] | None = None) -> FieldBank:
        return self.level


def seen_by(scene: Scene, sensor: Sensor, coarse: Sensor) -> Scene:
    """Return the scene as a coarse sensor of another size sees it: where the real one does."""
    half = tuple(side * sensor.pixel_pitch_um / 2 for side in (sensor.cols, sensor.rows))
    if isinstance(scene.source, Chart):
        scale = half[1] / (coarse.rows * coarse.pixel_pitch_um / 2)
        return replace(scene, source=scene.source.placed(scale))
    if scene.source.half_um is not None:
        return scene
    return replace(scene, source=replace(scene.source, half_um=half))


class _Light(_Shot):
    """The light on a rectangle, and no more."""

    def __init__(self, *given) -> None:
        super().__init__(*given)
        period = self.renderer.period
        self.first = self.rect[0] // period, self.rect[1] // period
        _, _, rows, cols = aligned(self.rect, period)
        count = self.renderer.plan.scales[0].grid.sites
        self.found = np.empty((count, rows // period, cols // period), np.float32)

    def _finish(self, tile: Rect, rates: Resident, whole: Rect) -> None:
        period = self.renderer.period
        row, col = (own // period - first for own, first in zip(whole, self.first, strict=False))
        rows, cols = whole[2] // period, whole[3] // period
        self.found[:, row : row + rows, col : col + cols] = self.renderer.device.read(rates)


class _ShiftedShot(_Shot):
    """One frame of a CCD: the tiles bring the light, then charge goes by columns and by rows."""

    def __init__(
        self,
        renderer: Renderer,
        rect: Rect,
        names: dict[str, type],
        folder: Path | None,
        shot: Shot,
    ) -> None:
        sensor = renderer.camera.sensor
        tiled = needed(rect, sensor, renderer.plan.runs)
        light = {"light": np.float32}
        if "rate" in names and renderer.plan.runs("crosstalk"):
            light["rate"] = np.float32
        within = (
            None if folder is None else folder / "light"
        )  # beside what is wanted of the same name
        if within is not None:
            within.mkdir(exist_ok=True)
        super().__init__(renderer, tiled, light, within, shot)
        self.folder = folder
        self.charge = self._charge("charge")
        self.wanted = rect
        self.found = {
            name: _on_host(name, rect[2:], dtype, folder)
            for name, dtype in names.items()
            if name != "mean"  # made when it is asked for
        }

    def render(self, tile_px: int | None, progress: Callable[[int, int], None]) -> None:
        """Render the light of all tiles; then read out."""
        super().render(tile_px, progress)
        read_out = self._read_out(self._run)
        read_out.columns(self.planes["light"], self.rect, self.charge)
        drawn = {name: plane for name, plane in self.found.items() if name != "rate"}
        read_out.rows(self.charge, self.rect[1], self.wanted, drawn)
        if "rate" in self.found:  # none in the overscan
            seen = overlap(self.wanted, self.rect)
            self.found["rate"][...] = 0
            _part(self.found["rate"], self.wanted, seen)[...] = _part(*self._light, seen)

    @property
    def _light(self) -> Placed:
        """The rate of the pixels."""
        name = "rate" if "rate" in self.planes else "light"
        return Placed(self.planes[name], self._area(name, self.rect))

    def _area(self, name: str, rect: Rect) -> Rect:
        sensor, runs = self.renderer.camera.sensor, self.renderer.plan.runs
        return taking(rect, sensor, runs) if name == "rate" else rect

    def _charge(self, name: str) -> np.ndarray:
        """Return room for the charge of whole columns."""
        size = self.renderer.camera.sensor.frame.read[2], self.rect[3]
        return _on_host(name, size, np.float32, self.folder)

    def _read_out(
        self, run: Callable[[Recording], Result], without: Collection[str] = ()
    ) -> ReadOut:
        renderer, runs = self.renderer, self.renderer.plan.runs
        return ReadOut(
            renderer.device,
            renderer.camera.sensor,
            self.shot,
            lambda name: name not in without and runs(name),
            renderer.memory_bytes // STRIP_SHARE,
            run,
        )

    def on_rect(self, name: str) -> np.ndarray:
        """Return a plane, of the rectangle alone."""
        return self.found[name]

    def mean_signal(self) -> MeanSignal:
        """Return light, mean charge of whole columns, and mean electrons that arrive.

        The light goes through the read-out once more, and no noise is drawn.
        """
        read = self.renderer.camera.sensor.frame.read
        columns = read[0], self.rect[1], read[2], self.rect[3]
        charge = self._charge("mean_charge")
        self._read_out(Recording.run, ("noise",)).columns(self.planes["light"], self.rect, charge)
        # Whole rows: the serial register is as long as the frame itself found it.
        seen = overlap(self.wanted, self.rect)
        rows = seen[0], self.rect[1], seen[2], self.rect[3]
        mean = _on_host("mean", rows[2:], np.float32, self.folder)
        later = ("noise", "coupling", "defects")  # what comes once the charge has arrived
        self._read_out(Recording.run, later).rows(charge, rows[1], rows, {"electrons": mean})
        return MeanSignal(self._light, Placed(mean, rows), Placed(charge, columns))

    def _outputs(
        self, rec: Recording, strip: Rect, rates: Resident, tile: Rect
    ) -> dict[str, Array]:
        renderer = self.renderer
        glare, sensor = renderer.resident_glare, renderer.camera.sensor
        return record_tile(rec, rates, glare, sensor, strip, tile, renderer.plan.runs)


def _on_host(name: str, shape: tuple[int, int], dtype: type, folder: Path | None) -> np.ndarray:
    """Return an array in memory, or in a file of a folder."""
    if folder is None:
        return np.empty(shape, dtype)
    file = folder / f"{name}.npy"
    array = np.lib.format.open_memmap(file, mode="w+", dtype=dtype, shape=shape)
    if hasattr(os, "posix_fallocate"):  # a full disk is told here, and kills nothing later
        with file.open("r+b") as opened:
            os.posix_fallocate(opened.fileno(), 0, file.stat().st_size)
    return array


def _part(plane: np.ndarray, area: Rect, rect: Rect) -> np.ndarray:
    """Return the part of a plane, which is that of an area, on a rectangle of it."""
    row, col = rect[0] - area[0], rect[1] - area[1]
    return plane[row : row + rect[2], col : col + rect[3]]


def _rectangle(tile: tuple[int, int, int, int] | None, sensor: Sensor) -> Rect:
    """Return a tile (x, y, width, height) as rows and columns; without one all that is read."""
    if tile is None:
        return sensor.frame.read
    x, y, width, height = tile
    inside = 0 <= x < x + width <= sensor.cols and 0 <= y < y + height <= sensor.rows
    allowed = f"x, y, width, height of pixels within {sensor.cols} x {sensor.rows}"
    _check("tile", tile, inside, allowed)
    return (y, x, height, width)


def _check(field: str, value: object, valid: bool, allowed: str) -> None:
    if not valid:
        raise UserError(f"The {field} is out of range.", field=field, value=value, allowed=allowed)


def capture(
    camera: Camera,
    scene: Scene,
    *,
    exposure_s: float,
    seed: int = 0,
    frame: int = 0,
    temperature_c: float | None = None,
    accuracy: Accuracy | None = None,
    memory_bytes: int | None = None,
    tile: tuple[int, int, int, int] | None = None,
    tile_px: int | None = None,
    keep: tuple[str, ...] = (),
    folder: Path | None = None,
    noise: bool = True,
    method: str | None = None,
    gain: float | None = None,
    costs: Costs | None = None,
    progress: Progress | None = None,
) -> Capture:
    """Prepare a camera and a scene, and render one frame: see `Renderer` and `Renderer.capture`.

    ``gain``: a step of the sensor's analogue gain, see `Sensor.at_gain`. ``costs``: the rates that
    the plan is made from, those of the adapter if not given.
    """
    if gain is not None:
        camera = replace(camera, sensor=camera.sensor.at_gain(gain))
    _rectangle(tile, camera.sensor)  # before the long work
    camera.sensor.dark_current_at(temperature_c)  # as well
    renderer = Renderer(
        camera,
        scene,
        accuracy,
        progress=progress,
        memory_bytes=memory_bytes,
        exposure_s=exposure_s,
        noise=noise,
        method=method,
        costs=costs,
    )
    try:
        return renderer.capture(
            exposure_s,
            seed=seed,
            frame=frame,
            temperature_c=temperature_c,
            tile=tile,
            tile_px=tile_px,
            keep=keep,
            folder=folder,
            progress=progress,
        )
    finally:
        renderer.release()

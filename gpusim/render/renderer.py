"""The chain: scene -> lens -> optics -> sensor -> raw digital numbers."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gpusim.camera import Camera
from gpusim.certify import Certificate, Share, bank_share, certify, sensor_share
from gpusim.errors import UserError
from gpusim.gpu import Device, OutOfMemoryError, Recording, Resident, Result, default_device
from gpusim.heap import trim_heap
from gpusim.isp.optics import Optics, optics_of
from gpusim.optics.chief_ray import chief_ray_map
from gpusim.optics.flare import veiling_glare
from gpusim.optics.fold import spectral_weights
from gpusim.optics.halo import Halo, coarse_grid
from gpusim.optics.halo import needed as coarse_rects
from gpusim.optics.images import field_images
from gpusim.optics.kernels import field_kernels
from gpusim.optics.methods import Convolution, convolution
from gpusim.optics.paint import Paint
from gpusim.optics.splat import Splat
from gpusim.optics.warp import Warp
from gpusim.plan import Accuracy, Plan, plans_optics
from gpusim.plan.band import with_band
from gpusim.plan.calibrate import adapter_costs
from gpusim.plan.costs import Costs
from gpusim.plan.tiles import (
    RESERVE_BYTES,
    SMALLEST_PX,
    Rect,
    aligned,
    strip_bytes,
    tile_bytes,
    tiles_of,
)
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.local import local_psfs
from gpusim.render.anew import planned_anew
from gpusim.render.capture import Capture
from gpusim.render.coarse import CoarseCamera, seen_by
from gpusim.render.deadline import resolved
from gpusim.render.highlights import SplattedLight
from gpusim.render.lighting import Lighting
from gpusim.render.look import look
from gpusim.render.reading import Reader, Reading, lit_for, reading_of
from gpusim.render.recipe import recipe_of
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.frame import overlap
from gpusim.sensor.planes import planes_of
from gpusim.sensor.readout import Shot, noise_seed, rects_of
from gpusim.sensor.sensor import Sensor

Progress = Callable[[str, int, int], None]

KEPT_SHARE = 4  # of the budget, a quarter at most of the host's memory for the light of a frame


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
        Costs from which the plan is made; by default those of the device, measured once.
    noise : bool
        Whether to draw the sensor's noise and fixed patterns; else the frame is the mean signal.
    method : str, optional
        Method of convolution: one of gpusim.optics.methods.METHODS; by default the cheapest.
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
        self.method = method
        self.device = device or default_device()
        pool = self.device.pool
        self.memory_bytes = pool.budget if memory_bytes is None else memory_bytes
        self.prepare_s: dict[str, float] = {}
        self.sources: list[Paint | Warp] = []
        self.convolutions: list[Convolution] = []
        self.splat: Splat | None = None
        self.splatted: SplattedLight | None = None
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
        self.accuracy, self.afforded = resolved(
            camera,
            self.scene,
            self.accuracy,
            costs,
            noise=noise,
            method=method,
            force=force,
            exposure_s=self.longest_s,
            progress=lambda *done: report("lens", *done),
        )
        asked = self.accuracy.planned, self.longest_s
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
        found = plans_optics(
            self.bank,
            sensor,
            self.scene,
            self.accuracy.planned,
            self._costs,
            count=count,
            noise=self._noise,
            method=method,
            force=force,
            exposure_s=self.longest_s,
            density=self.density,
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

    def refocus(self, bank: FieldBank) -> None:
        """Take the PSFs of the same lens at other focus or stop; plan and maps stay: for drafts.

        Only for plans that convolve whole PSFs by transforms, whatever their width, and banks of
        the same wavelengths.
        """
        self.bank, self.core = bank, bank.levels[0]
        self.drop_light()
        basis, (scale,) = self.plan.basis, self.plan.scales
        sensor = self.camera.sensor
        if basis.elsewhere is None:
            response = spectral_weights(self.core, sensor, wavelengths_nm=basis.wavelengths_nm)
            basis = replace(basis, response=response)
            basis = replace(basis, weights=basis.rates.sum(axis=-1))
        reach_um = math.hypot(sensor.rows, sensor.cols) / 2 * sensor.pixel_pitch_um
        images, places = field_images(
            self.core,
            basis.rates,
            reach_um,
            elsewhere=basis.elsewhere,
            wavelengths_nm=basis.wavelengths_nm,
        )
        whole = np.ones(images.shape[-2:])
        kernels = field_kernels(images, places, self.core.pitch_um, scale.pitch_um, whole)
        scale = replace(scale, kernels=kernels)
        self.plan = replace(self.plan, basis=basis, scales=(scale,))
        for convolve in self.convolutions:
            convolve.release()
        sites = list(planes_of(sensor).channels)
        needed = self.sources[0].needed
        self.convolutions = [convolution(self.device, scale, needed, sensor.response_um, sites)]

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
            Seed of the temporal noise, 0 to 2^64 - 1.
        frame : int
            Frames of one seed have independent noise; so have those of other exposures and gains.
        temperature_c : float, optional
            Temperature of the sensor; by default that at which its dark current was measured.
        tile : (x, y, width, height), optional
            The rectangle of lit pixels to render, and nothing that it does not need. It is the
            same, bit for bit, as that of the whole frame.
        tile_px : int, optional
            Largest side of what is rendered at once, by default chosen from the memory. It changes
            the memory that is needed, and not one bit of the result.
        keep : tuple of str
            Any of "rate" and "electrons".
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
        check_shot(exposure_s, seed, frame)
        if self.accuracy.unit == "sigma":
            longest = f"{self.longest_s:g} s or less, for which the tolerance in sigmas was planned"
            _check("exposure", exposure_s, exposure_s <= self.longest_s, longest)
        rect = rectangle(tile, sensor)
        if tile_px is not None:
            _check("tile-size", tile_px, tile_px >= self.period, f"{self.period} or more")
        names = {"dn": np.uint16} | dict.fromkeys(keep, np.float32)
        if self.accuracy.probes:
            names |= dict.fromkeys(("rate", "mean"), np.float32)
        if temperature_c is None:
            temperature_c = sensor.reference_temperature_c
        sensor.dark_current_at(temperature_c)  # refuses what is none
        own_seed = noise_seed(seed, exposure_s, sensor.analogue_gain)
        taken = Shot(exposure_s, own_seed, frame, temperature_c)
        # The seconds of the light and of the read-out are counted together.
        lighting = Lighting(self, rect)
        shot = reading_of(self.reader(lighting.run), rect, names, folder, taken)
        lighting.rect = shot.rect
        report = progress or (lambda what, done, total: None)
        made = sum(convolve.made for convolve in self.convolutions)
        with self.device.pool.within(self.memory_bytes):
            self._hold(shot.rect, tile_px, report)
            started = time.perf_counter()
            lighting.render(tile_px, shot.take, lambda done, total: report("render", done, total))
            shot.finish()
            wall_s = time.perf_counter() - started
            self.peak_bytes = max(self.peak_bytes, self.device.pool.peak)

        certificate = None
        if self.accuracy.probes:
            certificate = self.certificate(shot, rect, exposure_s, temperature_c, report)
        return Capture(
            costs=self._costs,
            recipe=self.recipe,
            band=self.band,
            raw=shot.on_rect("dn"),
            rate=shot.on_rect("rate") if "rate" in keep else None,
            electrons=shot.on_rect("electrons") if "electrons" in keep else None,
            white_e=self.white_e(exposure_s),
            transmission=self.transmission,
            optics=self.optics,
            notes=self.notes + tuple(lighting.notes),
            plan=self.plan,
            times_s=dict(lighting.times_s),
            wall_s=wall_s,
            prepare_s=dict(self.prepare_s),
            memory={"budget_bytes": self.memory_bytes, "peak_bytes": self.peak_bytes},
            work={**lighting.work, "nodes": sum(c.made for c in self.convolutions) - made},
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
            psfs=local_psfs(self.core, sensor, self.scene),
        )

    def certificate(
        self,
        reading: Reading,
        rect: Rect,
        exposure_s: float,
        temperature_c: float,
        report: Progress,
    ) -> Certificate:
        """Judge a rectangle that was read at probe pixels: see `gpusim.certify`.

        Parameters
        ----------
        reading : Reading
            With the planes ``rate`` and ``mean``.
        rect : (row, col, rows, cols)
            What was read.
        exposure_s, temperature_c : float
            Exposure time and temperature with which it was read.
        report : callable
            Called with (what, done, total).
        """
        sensor = self.camera.sensor
        seen = overlap(rect, sensor.frame.lit)
        top, left = seen[0] - rect[0], seen[1] - rect[1]

        def readout(pixels: np.ndarray) -> tuple[Share, str]:
            with self.device.pool.within(self.memory_bytes):
                made = reading.mean_signal()
            noise = self.plan.runs("noise")
            return sensor_share(
                sensor, made, pixels, exposure_s, temperature_c, noise, self.accuracy
            )

        light = reading.on_rect("rate")[top : top + seen[2], left : left + seen[3]]
        return certify(
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
        """Return the lit pixels that a rectangle needs: see `lit_for`."""
        return lit_for(rect, self.camera.sensor, self.plan.runs)

    def reader(self, run: Callable[[Recording], Result]) -> Reader:
        """Return what reads the light out; `run` runs its recordings."""
        return Reader(
            self.device,
            self.camera.sensor,
            self.plan.runs,
            self.resident_glare,
            self.memory_bytes,
            run,
        )

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
        grids = [
            coarse_grid(bank, sensor, edges, first=level.number == 1)
            for level, bank in zip(self.plan.halo, banks, strict=True)
        ]
        light = []
        for done, (level, bank, grid, part) in enumerate(
            zip(self.plan.halo, banks, grids, coarse_rects(grids, rect), strict=True)
        ):
            report("halo", done, len(banks))
            renderer = Renderer(
                CoarseCamera(bank, grid.sensor),
                seen_by(self.scene, sensor, grid.sensor, bank.pitch_um),
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
        self.splatted = SplattedLight(rect, self.period, tiles, light)

    def light(self, rect: Rect, progress: Progress | None = None) -> np.ndarray:
        """Return the electrons/s (S, rows, cols) of the planes of a rectangle of lit pixels.

        Whole periods of the filter pattern; without veiling glare. ``progress``: called with
        (what, done, total).
        """
        report = progress or (lambda what, done, total: None)
        period, (row, col, rows, cols) = self.period, aligned(rect, self.period)
        size = self.plan.scales[0].grid.sites, rows // period, cols // period
        found = np.empty(size, np.float32)

        def take(tile: Rect, rates: Resident, whole: Rect) -> None:
            top, left = (whole[0] - row) // period, (whole[1] - col) // period
            high, wide = whole[2] // period, whole[3] // period
            found[:, top : top + high, left : left + wide] = self.device.read(rates)

        lighting = Lighting(self, rect, lambda tile: tile)
        with self.device.pool.within(self.memory_bytes):
            self._hold(rect, None, report)
            lighting.render(None, take, lambda done, total: report("render", done, total))
        return found

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """What makes the light again: see `gpusim.render.recipe`."""
        given = self.camera, self.scene, self.accuracy, self.longest_s, self.plan, self._costs
        return recipe_of(*given, self.device.report(), noise=self._noise, method=self.method)

    @property
    def transmission(self) -> np.ndarray:
        """Transmission of the lens at WAVELENGTHS_NM, shape (61,)."""
        return np.interp(WAVELENGTHS_NM, self.core.wavelengths_nm, self.core.transmission)

    @property
    def optics(self) -> Optics:
        """What files say of the lens."""
        return optics_of(self.camera.lens.title, self.bank)

    @property
    def notes(self) -> tuple[str, ...]:
        """How the scene was read and placed, and what a time afforded."""
        placed = (self.placed.note,) if isinstance(self.placed, PlacedRaster) else ()
        afforded = (self.afforded,) if self.afforded else ()
        return self.scene.notes + placed + afforded + self._anew

    @property
    def _anew(self) -> tuple[str, ...]:
        if self.accuracy.aim is None:
            return ()
        aim = self.accuracy.in_words(self.accuracy.aim)
        return (f"planned for {aim}: by a looser plan the certificate missed {self.accuracy.text}",)

    def white_e(self, exposure_s: float) -> dict[str, float]:
        """Return the mean electrons that the scene's white makes on the axis, by channel."""
        sensor = self.camera.sensor
        weights = spectral_weights(self.core, sensor, wavelengths_nm=self.scene.wavelengths_nm)
        white = np.einsum("clw,w->c", weights, self.scene.white)
        return {
            name: float(value * exposure_s)
            for name, value in zip(sensor.channels, white, strict=True)
        }


def rectangle(tile: tuple[int, int, int, int] | None, sensor: Sensor) -> Rect:
    """Return a tile (x, y, width, height) as rows and columns; without one all that is read."""
    if tile is None:
        return sensor.frame.read
    x, y, width, height = tile
    inside = 0 <= x < x + width <= sensor.cols and 0 <= y < y + height <= sensor.rows
    allowed = f"x, y, width, height of pixels within {sensor.cols} x {sensor.rows}"
    _check("tile", tile, inside, allowed)
    return (y, x, height, width)


def check_shot(exposure_s: float, seed: int, frame: int) -> None:
    """Refuse an exposure, a seed or a frame number that is none.

    Raises
    ------
    UserError
    """
    _check("exposure", exposure_s, 0 < exposure_s < np.inf, "seconds above 0")
    _check("seed", seed, 0 <= seed < 2**64, "0 to 2^64 - 1")
    _check("frame", frame, 0 <= frame < 2**32, "0 to 2^32 - 1")


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

    Where the certificate misses the tolerance, the frame is made again: see `gpusim.render.anew`.
    ``gain``: a step of the sensor's analogue gain, see `Sensor.at_gain`. ``costs``: the rates that
    the plan is made from, those of the adapter if not given.
    """
    if gain is not None:
        camera = replace(camera, sensor=camera.sensor.at_gain(gain))
    rectangle(tile, camera.sensor)  # before the long work
    camera.sensor.dark_current_at(temperature_c)  # as well

    def attempt(asked: Accuracy) -> Capture:
        # A frame that is not bettered keeps its files.
        own = None if folder is None else Path(tempfile.mkdtemp(dir=folder))
        renderer = Renderer(
            camera,
            scene,
            asked,
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
                folder=own,
                progress=progress,
            )
        finally:
            renderer.release()

    return planned_anew(accuracy or Accuracy(), attempt)

"""The chain: scene -> lens -> optics -> sensor -> raw digital numbers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gpusim.calibrate.rates import adapter_costs
from gpusim.camera import Camera
from gpusim.certify import Judged
from gpusim.gpu import Device, Recording, Resident, Result, default_device
from gpusim.heap import trim_heap
from gpusim.isp.lens_tags import Optics, correction_notes, optics_of
from gpusim.optics.flare import veiling_glare
from gpusim.plan import Accuracy, Plan
from gpusim.plan.costs import Costs
from gpusim.plan.signal import white_rates
from gpusim.plan.tiles import Rect, aligned
from gpusim.psf.field_bank import FieldBank
from gpusim.render.capture import Capture, captured
from gpusim.render.certificate import certified
from gpusim.render.checks import check_planned, check_shot, rectangle
from gpusim.render.coarse import CoarseCamera, coarse_halo
from gpusim.render.lighting import Lighting, planes_on
from gpusim.render.look import Look
from gpusim.render.on_device import OnDevice, Progress
from gpusim.render.planning import planning
from gpusim.render.reading import Reader, Reading, reading_of
from gpusim.render.recipe import recipe_of
from gpusim.render.refocus import refocused
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.readout import Shot, noise_seed

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
    seen : Look, optional
        What the camera sees of the scene, where that is known: the lens is not asked. See
        `gpusim.render.look.through_focus`.
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
        *,
        memory_bytes: int | None = None,
        exposure_s: float | None = None,
        seen: Look | None = None,
        plan: Plan | None = None,
        costs: Costs | None = None,
        noise: bool = True,
        method: str | None = None,
        force: Collection[str] = (),
    ) -> None:
        self.camera, self.scene, self.accuracy = camera, scene, accuracy or Accuracy()
        self.longest_s = math.inf if exposure_s is None else exposure_s
        self.method, self._noise, self._force = method, noise, force
        self.device = device or default_device()
        pool = self.device.pool
        self.memory_bytes = pool.budget if memory_bytes is None else memory_bytes
        self.prepare_s: dict[str, float] = {}
        self.on_device = OnDevice(self.device, camera.sensor, self.memory_bytes)
        self.kept: dict[Rect, np.ndarray] = {}  # electrons/s of the planes, by tile
        self.coarse_plans: dict[float, Plan] = {}  # of the halo's levels, by pitch
        self.resident_glare: Resident | None = None
        self.judged: Judged | None = None  # the bank's part of certificates, where it is known
        report = progress or (lambda what, done, total: None)
        if costs is None:
            # Before the budget counts: a calibration needs some 300 MiB.
            costs = adapter_costs(self.device, progress=lambda *done: report("calibrate", *done))
        pool.clear()  # what others left behind is no part of this renderer's peak
        # OpenBLAS's own threads wait by spinning: after each call of some size, a tenth of a second
        # of a core that what follows needs.
        with pool.within(self.memory_bytes), threadpool_limits(1):
            try:
                self._prepare(report, costs, seen, plan)
            except BaseException:
                self.release()
                raise
            self.peak_bytes = pool.peak

    def _prepare(
        self, report: Progress, costs: Costs, seen: Look | None, plan: Plan | None
    ) -> None:
        """Plan, and place the scene on the sensor."""
        camera, started = self.camera, time.perf_counter()
        self.planning = planning(
            camera,
            self.scene,
            self.accuracy,
            costs,
            noise=self._noise,
            method=self.method,
            force=self._force,
            exposure_s=self.longest_s,
            seen=seen,
            progress=lambda *done: report("lens", *done),
        )
        self.accuracy, seen = self.planning.accuracy, self.planning.seen
        self.band, self.density, self.scene = seen.band, seen.density, seen.scene
        self.bank, self.core, self.costs = seen.bank, seen.bank.levels[0], costs
        started = self._spent("lens", started)
        report("plan", 0, 1)  # highlights of a photograph are cut up here, for seconds
        self.plan = plan or self.planning.plan(self.method, self._force)
        report("plan", 1, 1)
        started = self._spent("plan", started)
        basis, distorted = self.plan.basis, "distortion" in self._force
        self.placed = self.on_device.place(self.scene, self.core, self.plan, distorted)
        light = basis.weights, basis.coefficients
        glare = veiling_glare(
            self.core, camera.sensor, self.placed, *light, elsewhere=basis.elsewhere
        )
        self.glare = glare.astype(np.float32)
        self.resident_glare = self.device.resident("glare", self.glare)
        self._spent("scene", started)

    def release(self) -> None:
        """Give the device's memory back; the renderer cannot be used any more."""
        self.on_device.release()
        if self.resident_glare is not None:
            self.resident_glare.destroy()
        trim_heap()

    def refocus(self, bank: FieldBank) -> None:
        """Take the PSFs of the same lens at other focus or stop; plan and maps stay: for drafts.

        Only for plans that convolve whole PSFs by transforms, whatever their width, and banks of
        the same wavelengths.
        """
        self.bank, self.core = bank, bank.levels[0]
        self.coarse_plans.clear()
        self.drop_light()
        self.plan = refocused(self.plan, self.core, self.camera.sensor)
        self.on_device.convolve(self.plan)

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
        check_planned(self, exposure_s, tile_px)
        if temperature_c is None:
            temperature_c = sensor.reference_temperature_c
        sensor.dark_current_at(temperature_c)  # refuses what is none
        asked = Shot(exposure_s, seed, frame, temperature_c)
        shot = replace(asked, seed=noise_seed(seed, exposure_s, sensor.analogue_gain))
        rect = rectangle(tile, sensor)
        names = {"dn": np.uint16} | dict.fromkeys(keep, np.float32)
        if self.accuracy.certified:
            names |= dict.fromkeys(("rate", "mean"), np.float32)
        # The seconds of the light and of the read-out are counted together.
        lighting = Lighting(self, rect)
        reading = reading_of(self.reader(lighting.run), rect, names, folder, shot)
        lighting.rect = reading.rect
        report = progress or (lambda what, done, total: None)
        made = self.on_device.made
        wall_s = self._read(lighting, reading, tile_px, report)
        certificate = None
        if self.accuracy.certified:
            certificate = certified(self, reading, rect, shot, report)
        return captured(
            self,
            lighting,
            reading,
            asked,
            rect=rect,
            keep=keep,
            wall_s=wall_s,
            nodes=self.on_device.made - made,
            certificate=certificate,
        )

    def _read(
        self, lighting: Lighting, shot: Reading, tile_px: int | None, report: Progress
    ) -> float:
        """Render the light of a reading and read it; return the seconds of that."""
        with self.device.pool.within(self.memory_bytes):
            self.hold(shot.rect, tile_px, report)
            started = time.perf_counter()
            lighting.render(tile_px, shot.take, lambda done, total: report("render", done, total))
            shot.finish()
            wall_s = time.perf_counter() - started
            self.peak_bytes = max(self.peak_bytes, self.device.pool.peak)
        return wall_s

    @property
    def period(self) -> int:
        """Pixels from a sample of the planes to the next: those of tiles lie between such."""
        return self.plan.scales[0].grid.period

    @property
    def layers(self) -> int:
        """Planes of each pixel."""
        return self.plan.scales[0].grid.layers

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

    def hold(self, rect: Rect, tile_px: int | None, report: Progress) -> None:
        """Bring onto the device what further frames need as well, if there is room for all."""
        started = time.perf_counter()
        held, seen = self.on_device, self.on_device.lit(rect)
        self.hold_halo(rect, report)
        started = self._spent("halo", started)
        if held.point_sources is not None:
            held.hold_point_sources(aligned(seen, self.period), report)
            started = self._spent("point sources", started)
        held.hold_scene(seen)
        started = self._spent("scene", started)
        held.hold_kernels(rect, tile_px, report)
        self._spent("kernels", started)

    def hold_halo(self, rect: Rect, report: Progress) -> None:
        """Bring the halo of a rectangle onto the device: that of all its parts."""
        whole = aligned(self.on_device.lit(rect), self.period)
        with self.device.pool.within(self.memory_bytes):
            self.on_device.hold_halo(
                whole, lambda part: coarse_halo(self, part, self._coarse_light, report)
            )

    def _coarse_light(
        self, camera: CoarseCamera, scene: Scene, accuracy: Accuracy, rect: Rect
    ) -> np.ndarray:
        """Return the light of a level of the halo on a rectangle of a coarse sensor."""
        renderer = Renderer(
            camera,
            scene,
            accuracy,
            self.device,
            memory_bytes=self.memory_bytes,
            plan=self.coarse_plans[camera.level.pitch_um],
            costs=self.costs,
            noise=False,
        )
        try:
            return planes_on(renderer, rect)
        finally:
            renderer.release()

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """What makes the light again: see `gpusim.render.recipe`."""
        return recipe_of(
            self.camera,
            self.scene,
            self.accuracy,
            self.longest_s,
            plan=self.plan,
            costs=self.costs,
            device=self.device.report(),
            noise=self._noise,
            method=self.method,
        )

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
        """How the scene was read and placed, what a time afforded, what corrections lack."""
        placed = (self.placed.note,) if isinstance(self.placed, PlacedRaster) else ()
        told, asked = (self.planning.afforded,) if self.planning.afforded else (), self.accuracy
        if asked.aim is not None:
            why = f"by a looser plan the certificate missed {asked.text}"
            told += (f"planned for {asked.in_words(asked.aim)}: {why}",)
        return self.scene.notes + placed + told + correction_notes(self.optics, self.camera.sensor)

    @property
    def white_e_per_s(self) -> dict[str, float]:
        """Mean electrons/s that the scene's white makes on the axis, by channel."""
        return white_rates(self.core, self.camera.sensor, self.scene)

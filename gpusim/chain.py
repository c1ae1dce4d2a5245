"""The chain: scene -> lens -> optics -> sensor -> raw digital numbers, and what it cost."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gpusim.camera import Camera
from gpusim.certify import Certificate, certify
from gpusim.errors import UserError
from gpusim.gpu import Array, Device, Recording, default_device
from gpusim.optics.chief_ray import chief_ray_map
from gpusim.optics.convolve import Convolve, Scratch
from gpusim.optics.flare import veiling_glare
from gpusim.optics.fold import spectral_weights
from gpusim.optics.paint import Paint
from gpusim.optics.warp import Warp
from gpusim.plan import Accuracy, Plan, plan_optics
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.adc import record_adc
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.mosaic import record_mosaic
from gpusim.sensor.noise import record_noise

Progress = Callable[[str, int, int], None]
TILE_PX = 4096  # default side of a tile: a frame of 12 MP in one, its planes of 50 MiB each


@dataclass(frozen=True)
class Capture:
    """One frame and how it was made.

    Attributes
    ----------
    raw : ndarray (rows, cols), uint16
        Digital numbers.
    rate, electrons : ndarray (rows, cols), float32, or None
        Electrons/s before the exposure, and electrons before the ADC, where they were kept.
    white_e : dict of str to float
        Mean electrons that the scene's white makes on the axis, by channel.
    transmission : ndarray (61,)
        Of the lens, at WAVELENGTHS_NM.
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
    device : dict
        Adapter, driver and limits.
    certificate : Certificate or None
    camera, scene, seed, frame, exposure_s, accuracy
        What was asked for.
    """

    raw: np.ndarray
    rate: np.ndarray | None
    electrons: np.ndarray | None
    white_e: dict[str, float]
    transmission: np.ndarray
    notes: tuple[str, ...]
    plan: Plan
    times_s: dict[str, float]
    wall_s: float
    prepare_s: dict[str, float]
    device: dict
    certificate: Certificate | None
    camera: Camera
    scene: Scene
    seed: int
    frame: int
    exposure_s: float
    accuracy: Accuracy


class Renderer:
    """A camera in front of a scene, prepared on a device: plan, kernels and scene are resident.

    Parameters
    ----------
    camera : Camera
    scene : Scene
    accuracy : Accuracy
    device : Device, optional
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    UserError
        When the image circle misses the sensor, the plan cannot be met or the memory does not
        suffice.
    """

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        accuracy: Accuracy | None = None,
        device: Device | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.camera, self.scene, self.accuracy = camera, scene, accuracy or Accuracy()
        self.device = device or default_device()
        self.prepare_s: dict[str, float] = {}
        report = progress or (lambda what, done, total: None)
        sensor = camera.sensor

        started = time.perf_counter()
        self.bank = camera.bank(progress=lambda done, total: report("lens", done, total))
        started = self._spent("lens", started)
        self.plan = plan_optics(self.bank, sensor, scene, self.accuracy)
        started = self._spent("plan", started)

        half_um = tuple(side * sensor.pixel_pitch_um / 2 for side in (sensor.cols, sensor.rows))
        chief_ray = chief_ray_map(self.bank)
        coefficients = self.plan.basis.coefficients
        self.sources = []
        for scale in self.plan.scales:
            if isinstance(scene.source, Chart):
                stage, placed = Paint, scene.source.placed(half_um[1])
            else:
                stage, placed = Warp, scene.source.placed(*half_um, scale.pitch_um)
            if scale is self.plan.scales[0]:
                self.placed = placed
            self.sources.append(stage(self.device, placed, coefficients, scale, chief_ray))
        glare = veiling_glare(self.bank, sensor, self.placed, self.plan.basis.weights, coefficients)
        self.glare = glare.astype(np.float32)
        self.resident_glare = self.device.resident("glare", self.glare)
        started = self._spent("scene", started)

        channels = list(sensor.channels)
        sites = [channels.index(name) for name in sensor.site_channels()]
        total = sum(np.prod(scale.grid.nodes) for scale in self.plan.scales)
        done = iter(range(1, total + 1))
        aperture_um = sensor.pixel_pitch_um * np.sqrt(sensor.fill_factor)
        self.convolutions = [
            Convolve(
                self.device,
                scale,
                source.needed,
                aperture_um,
                sites,
                lambda: report("kernels", next(done), int(total)),
            )
            for scale, source in zip(self.plan.scales, self.sources, strict=True)
        ]
        self._spent("kernels", started)

    def release(self) -> None:
        """Give the device's memory back; the renderer cannot be used any more."""
        for part in (*self.sources, *self.convolutions):
            part.release()
        self.resident_glare.destroy()

    def _spent(self, what: str, started: float) -> float:
        now = time.perf_counter()
        self.prepare_s[what] = now - started
        return now

    def capture(
        self,
        exposure_s: float,
        *,
        seed: int = 0,
        frame: int = 0,
        tile_px: int | None = None,
        keep: tuple[str, ...] = (),
        progress: Progress | None = None,
    ) -> Capture:
        """Render one frame.

        Parameters
        ----------
        exposure_s : float
        seed : int
            Of the temporal noise, 0 to 2^64 - 1.
        frame : int
            Frames of one seed have independent noise.
        tile_px : int, optional
            Largest side of a tile. It changes the memory that is needed, and not one bit of the
            result.
        keep : tuple of str
            Of "rate" and "electrons".
        progress : callable, optional
            Called with (what, done, total).

        Raises
        ------
        UserError
            For an exposure, seed or tile out of range, or when the memory does not suffice.
        """
        sensor = self.camera.sensor
        _check("exposure", exposure_s, 0 < exposure_s < np.inf, "seconds above 0")
        _check("seed", seed, 0 <= seed < 2**64, "0 to 2^64 - 1")
        _check("frame", frame, 0 <= frame < 2**32, "0 to 2^32 - 1")
        side = TILE_PX if tile_px is None else tile_px
        period = self.plan.scales[0].grid.period
        _check("tile-size", side, side >= period, f"{period} or more")
        side -= side % period
        report = progress or (lambda what, done, total: None)

        shape = (sensor.rows, sensor.cols)
        raw = np.empty(shape, np.uint16)
        kept = {"rate": np.empty(shape, np.float32)}
        if "electrons" in keep:
            kept["electrons"] = np.empty(shape, np.float32)
        times_s: dict[str, float] = defaultdict(float)
        tiles = [
            (row, col, min(side, sensor.rows - row), min(side, sensor.cols - col))
            for row in range(0, sensor.rows, side)
            for col in range(0, sensor.cols, side)
        ]
        started = time.perf_counter()
        for number, rect in enumerate(tiles):
            rec = Recording(self.device)
            labels = self._record(rec, rect, exposure_s, seed, frame, tuple(kept))

            def advance(done: int, total: int, number: int = number) -> None:
                report("render", number * total + done, len(tiles) * total)

            result = rec.run(advance)
            row, col, rows, cols = rect
            place = np.s_[row : row + rows, col : col + cols]
            raw[place] = result[labels["dn"]]
            for name, whole in kept.items():
                whole[place] = result[labels[name]]
            for stage, seconds in result.times_s.items():
                times_s[stage.rpartition("/")[2]] += seconds
        wall_s = time.perf_counter() - started

        certificate = None
        if self.accuracy.probes:
            certificate = certify(
                self.bank,
                sensor,
                self.scene,
                self.placed,
                kept["rate"],
                self.glare,
                exposure_s,
                self.accuracy,
                lambda done, total: report("certify", done, total),
            )
        return Capture(
            raw=raw,
            rate=kept["rate"] if "rate" in keep else None,
            electrons=kept.get("electrons"),
            white_e=self._white_e(exposure_s),
            transmission=np.interp(
                WAVELENGTHS_NM, self.bank.wavelengths_nm, self.bank.transmission
            ),
            notes=self.scene.notes
            + ((self.placed.note,) if isinstance(self.placed, PlacedRaster) else ()),
            plan=self.plan,
            times_s=dict(times_s),
            wall_s=wall_s,
            prepare_s=dict(self.prepare_s),
            device=self.device.report(),
            certificate=certificate,
            camera=self.camera,
            scene=self.scene,
            seed=seed,
            frame=frame,
            exposure_s=exposure_s,
            accuracy=self.accuracy,
        )

    def _record(
        self,
        rec: Recording,
        rect: tuple[int, int, int, int],
        exposure_s: float,
        seed: int,
        frame: int,
        keep: tuple[str, ...],
    ) -> dict[str, str]:
        """Record one rectangle of pixels; return the labels of what comes back."""
        sensor = self.camera.sensor
        row, col, rows, cols = rect
        rates = self._record_optics(rec, rect)
        rec.mark()
        period = self.plan.scales[0].grid.period
        origin = (row, col)
        rate = record_mosaic(
            rec,
            rates,
            self.resident_glare,
            sensor,
            (rows, cols),
            origin=origin,
            cell_origin=(row // period, col // period),
        )
        mean = record_exposure(rec, rate, sensor, exposure_s, origin=origin)
        electrons = record_noise(rec, mean, sensor, seed=seed, frame=frame, origin=origin)
        dn = record_adc(rec, electrons, sensor)
        outputs = {"rate": rate, "electrons": electrons, "dn": dn}
        return {name: rec.download(outputs[name]) for name in ("dn", *keep)}

    def _record_optics(self, rec: Recording, rect: tuple[int, int, int, int]) -> Array:
        """Record source and convolution of one rectangle, block after block, scale after scale."""
        period = self.plan.scales[0].grid.period
        planes = self.plan.basis.coefficients.shape[1]
        sites = (period**2, -(-rect[2] // period), -(-rect[3] // period))
        rates = rec.buffer("rates", sites, np.float32)
        rec.clear(rates)
        for scale, source, convolution in zip(
            self.plan.scales, self.sources, self.convolutions, strict=True
        ):
            scratch = Scratch(rec, scale.name, scale.grid, planes)
            line = None
            for block in scale.grid.blocks_for(*rect):
                if line is not None and block[1] != line:
                    rec.mark()
                line = block[1]
                needed = source.needed[block]
                if needed:
                    source.record(rec, block, scratch.planes)
                    convolution.record(rec, block, needed, scratch, rates, rect)
        return rates

    def _white_e(self, exposure_s: float) -> dict[str, float]:
        """Return the mean electrons that the scene's white makes on the axis, by channel."""
        sensor = self.camera.sensor
        white = np.einsum("clw,w->c", spectral_weights(self.bank, sensor), self.scene.white)
        return {
            name: float(value * exposure_s)
            for name, value in zip(sensor.channels, white, strict=True)
        }


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
    accuracy: Accuracy | None = None,
    tile_px: int | None = None,
    keep: tuple[str, ...] = (),
    progress: Progress | None = None,
) -> Capture:
    """Prepare a camera and a scene, and render one frame: see `Renderer` and `Renderer.capture`."""
    renderer = Renderer(camera, scene, accuracy, progress=progress)
    try:
        return renderer.capture(
            exposure_s, seed=seed, frame=frame, tile_px=tile_px, keep=keep, progress=progress
        )
    finally:
        renderer.release()

"""Drafts: the same chain with fewer pixels, PSFs and planes, for a picture while a knob is turned.

A draft's sensor has photosites as large as k x k of the real one's, which count and make noise as
those together (binning). Its lens has few fields and wavelengths, and all light within the window.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from gpusim.camera import Camera
from gpusim.gpu import default_device
from gpusim.known import Known
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build
from gpusim.library.expose import lit
from gpusim.library.light import Light
from gpusim.plan import Accuracy
from gpusim.plan.ways import WHOLE
from gpusim.psf.bank import Bank
from gpusim.psf.compute import bank_of
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.generator import Generator
from gpusim.psf.sampling import REFERENCE_NM, default_fields_deg, window
from gpusim.render.renderer import Renderer
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor

FIELDS, RAYS = 4, 64
TRANSFORM = 512  # cells of a pupil each way: a quarter of the work of a bank's
SIZE = 256  # samples of the PSFs at most: a window of 128 um at 0.5 um
TOLERANCE = 0.1  # the loosest that plans are made for
PIXELS = 250_000  # of a draft: it is read and developed within a frame of the screen
# What of a sensor's figures grows with the photosites that are counted together: electrons with
# their number, noise with its root (sums of independent ones).
BINNED = {
    "full_well_e": 2,
    "dark_current_e_per_s": 2,
    "temporal_dark_noise_e": 1,
    "dsnu_e": 1,
    "system_gain_dn_per_e": -2,
}
# What belongs to single pixels, rows or columns, and is left out of photosites that are binned.
SINGLE = (
    "masks",
    "defects",
    "lines",
    "column_offset",
    "optical_black",
    "overscan",
    "smear",
    "bloom",
    "parallel_cti",
    "serial_cti",
    "dual_gain",
    "linearity",
    "crosstalk",
    "read_noise_law",
    "reset_noise",
    "scan_motion_px",
)


def step_for(pixels: int) -> int:
    """Return how many photosites each way a draft of so many counts together."""
    return max(math.ceil(math.sqrt(pixels / PIXELS)), 1)


def binned(sensor: Sensor, step: int) -> Sensor:
    """Return a sensor whose photosites are as large as step x step of another's."""
    if step == 1:
        return sensor
    period = math.lcm(*sensor.period)
    update: dict[str, Any] = {
        name: getattr(sensor, name) * step**power for name, power in BINNED.items()
    }
    for name in SINGLE:
        update[name] = Sensor.model_fields[name].get_default(call_default_factory=True)
    for name in ("rows", "cols"):
        update[name] = max(getattr(sensor, name) // (step * period), 1) * period
    update["pixel_pitch_um"] = sensor.pixel_pitch_um * step
    update["prnu_percent"] = sensor.prnu_percent / step
    return sensor.unchecked(**update)  # a full well that no single photosite has


class DraftLens:
    """A lens of few fields and wavelengths, traced once, that gives its PSFs at any focus."""

    def __init__(self, lens: Prescription, wavelengths_nm: np.ndarray) -> None:
        self.title, self.source, self.history = lens.title, lens.source, lens.history
        self.known: tuple[Known, ...] = lens.known
        first, last = wavelengths_nm[[0, -1]]
        lines = np.unique([first, REFERENCE_NM, last, (first + REFERENCE_NM) / 2])
        system = build(lens)
        size, pitch_um = window(system, lines)
        self._generator = Generator(
            default_device(),
            system,
            lines,
            default_fields_deg(lens, FIELDS),
            pitch_um=pitch_um,
            size=min(size, SIZE),
            rays=RAYS,
            transform=TRANSFORM,
        )
        self._banks: dict[float, Bank] = {}

    def at(self, shift_um: float) -> Bank:
        """Return the PSFs in an image plane that is moved away from the lens; the last is kept."""
        if shift_um not in self._banks:
            self._banks = {shift_um: bank_of(self._generator, focus_um=shift_um, wide=False)}
        return self._banks[shift_um]

    def bank(self, progress: Callable[[int, int], None] | None = None) -> Bank:
        """Return the PSFs of the image plane asked for last, the lens's own at first."""
        return next(iter(self._banks.values()), None) or self.at(0.0)

    def model_dump(self) -> dict[str, object]:
        """Return what is known of it."""
        return {"title": self.title, "source": self.source}

    def release(self) -> None:
        """Give the device's memory back."""
        self._generator.release()


class Draft:
    """Drafts of a camera before a scene: see the module.

    Parameters
    ----------
    camera : Camera
    scene : Scene
    step : int
        Photosites each way that are counted together.
    lens : DraftLens, optional
        In place of the camera's own.
    """

    def __init__(self, camera: Camera, scene: Scene, step: int, lens: DraftLens | None) -> None:
        self.step = step
        small = Camera(lens or camera.lens, binned(camera.sensor, step), camera.title)
        accuracy = Accuracy(TOLERANCE, 0, best_effort=True)
        # Other PSFs of the lens may be wider than a core that is cut out of these.
        how = {"method": "fft", "force": (WHOLE,)} if lens else {}
        self.renderer = Renderer(small, scene, accuracy, **how)

    @property
    def bank(self) -> FieldBank:
        """PSFs that are used now."""
        return self.renderer.bank

    def refocus(self, bank: FieldBank) -> None:
        """Use the PSFs of the same lens at another focus or stop."""
        self.renderer.refocus(bank)

    def light(self, seen: tuple[int, int, int, int]) -> tuple[Light, tuple[int, int, int, int]]:
        """Return the light on the pixels (x, y, width, height) of the camera that are looked at.

        Returns
        -------
        light : Light
        rect : (x, y, width, height)
            The camera's pixels that it holds.
        """
        sensor, step = self.renderer.camera.sensor, self.step
        period = math.lcm(*sensor.period)
        sides = []
        for first, size, most in zip(seen[:2], seen[2:], (sensor.cols, sensor.rows), strict=True):
            low = min(first // step // period * period, most - period)
            high = min(-(-(first + size) // (step * period)) * period, most)
            sides.append((low, max(high - low, period)))
        (x, width), (y, height) = sides
        light = lit(self.renderer, (y, x, height, width))
        return light, (x * step, y * step, width * step, height * step)

    def release(self) -> None:
        """Give the device's memory back."""
        self.renderer.release()

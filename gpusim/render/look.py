"""What a camera sees of a scene: wavelengths, fields and lines for a tolerance, and the PSFs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from gpusim.camera import Camera
from gpusim.gpu import default_device
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build
from gpusim.plan import Accuracy
from gpusim.plan.band import Band, band_of
from gpusim.plan.density import AnyDensity
from gpusim.psf.compute import bank_of
from gpusim.psf.field_bank import FieldBank, seen_as
from gpusim.psf.generator import Generator
from gpusim.psf.sampling import window
from gpusim.render.axis_survey import bank_density
from gpusim.render.plane_survey import plane_bank_density
from gpusim.scene.scene import Scene


class Look(NamedTuple):
    """What a camera sees of a scene: its wavelengths, the scene at these, and the lens's PSFs."""

    band: Band
    scene: Scene
    density: AnyDensity | None
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
    plane = isinstance(lens, Prescription) and not lens.is_centred
    of_lens = plane_bank_density if plane else bank_density
    # One survey serves all positions of the image plane. Between the fields and lines that 1e-3
    # asks for in best focus, line spreads of a Tessar, a double Gauss at f/2, a phone's lens and
    # the lens of `validate kodak`, 10 to 150 um out of it, erred by 2.5e-4 and 2.9e-4 at most,
    # where 2.5e-4 and 4e-4 are allowed. Another focus may lie far from the best.
    if isinstance(lens, Prescription) and lens.is_centred and lens.focus == "best":
        lens = lens.focused()
    density = of_lens(lens, sensor, scene, accuracy, exposure_s=exposure_s, progress=progress)
    sampling = {} if density is None else density.sampling
    bank = seen_as(camera.bank(progress=progress, **sampling), scene.projection)
    return Look(band, scene.before(bank.principal_distance_mm), density, bank)


def through_focus(
    camera: Camera, scene: Scene, accuracy: Accuracy, shifts_um: Sequence[float]
) -> Iterator[Look]:
    """Yield what a camera sees of a scene with its image plane moved, one position after another.

    The lens is traced once, and surveyed where its image plane stands: fields and lines are the
    same for all positions.

    Parameters
    ----------
    camera : Camera
        Its lens has an axis.
    scene : Scene
    accuracy : Accuracy
    shifts_um : sequence of float
        > 0 away from the lens.
    """
    lens = camera.lens
    still = look(camera, scene, accuracy)
    system, lines = build(lens), still.bank.wavelengths_nm
    size, pitch_um = window(system, lines)
    fields = still.density.sampling["field_deg"]
    given = {"pitch_um": pitch_um, "size": size}
    generator = Generator(default_device(), system, lines, fields, **given)
    try:
        for shift_um in shifts_um:
            bank = seen_as(bank_of(generator, focus_um=shift_um), scene.projection)
            yield still._replace(bank=bank)
    finally:
        generator.release()

"""Sharpness of the Ansys and Meta paper's camera (section 3.3): edges, their noise, and focus.

ROI 1 is the upper edge of the slanted square in the middle of the paper's chart, ROI 3 its right
one. Their SFR is measured in an electron map (the paper's equation 1, by a map of efficiencies over
angle), for the paper's simulation in a map of irradiance too, and predicted from rays: the pupil's
transfer function times the pixel's.

**Focus.** What a shift of the image plane takes from the MTF of ROI 3, by rays and, for the paper's
simulation, rendered. The lens is surveyed and traced once for all positions.

**What the reduced-order model costs**, of ROI 3: `gpusim.validate.ansys_models`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from gpusim.camera import Camera
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import first_order
from gpusim.plan import Accuracy
from gpusim.render.look import Look
from gpusim.render.look import through_focus as looks
from gpusim.scene import make_scene
from gpusim.sensor.sensor import Sensor
from gpusim.validate.ansys import Reading
from gpusim.validate.ansys_electrons import EvenScene, electrons_of
from gpusim.validate.ansys_models import CENTRE_NM, SHOWN, Opened, models_of, opened
from gpusim.validate.ansys_noise import Noise, bars_of
from gpusim.validate.ansys_pixel import angular, radiometric
from gpusim.validate.ansys_square import (
    LAMP,
    ROIS,
    TOLERANCE,
    Square,
    band_of,
    before_chart,
    predicted_mtf,
    predictor_of,
)
from gpusim.validate.ansys_targets import LUMINANCE_CD_M2, half_um
from gpusim.validate.bars import Bar
from gpusim.validate.certified import Certified, certificate_bar
from gpusim.validate.edges import ROI_PX, Found
from gpusim.validate.predict import CHIEF_FIELDS, FIELDS, Predictor

SPARE_PX = 24  # of the field, beyond the regions: PSFs and the slopes about the edges
SHIFTS_UM = (-10.0, 10.0, 20.0)  # of the image plane: figure 14
REALISATIONS = 20  # figures 12 and 13
WIDER = 1.15  # of a field: barrel distortion puts more of it on the sensor than a plain image has
BESIDE_DEG = 0.5  # of the lens's field: rays of its very end are partly stopped
SFR_BAR, FOCUS_BAR = 0.01, 0.005


@dataclass(frozen=True, eq=False)
class Focus:
    """ROI 3 with the image plane moved: MTFs (F,) predicted and, where rendered, measured."""

    shift_um: float
    measured: np.ndarray | None
    predicted: np.ndarray


@dataclass(frozen=True, eq=False)
class Sharpness:
    """What one reading gave.

    Attributes
    ----------
    reading : Reading
    f_number : float
        With which the stand-in works.
    found : dict of (str, int) to Found
        By map, "electrons" or, of the paper's simulation, "irradiance", and region.
    noise : dict of int to Noise
    focus : list of Focus
        By shift, 0 among them; 0 alone until the others are measured: see `with_focus`.
    models : dict of str to ndarray (F,)
        MTFs of ROI 3 by limits and simpler models.
    opened : list of Opened
        The stand-in as it is, and opened to the paper's f/2.
    certificates : dict of str to Certified
        By map, and by shift.
    regions : dict of int to (x, y, width, height)
        In the picture of the whole reading.
    """

    reading: Reading
    f_number: float
    found: dict[tuple[str, int], Found]
    noise: dict[int, Noise]
    focus: list[Focus]
    models: dict[str, np.ndarray]
    opened: list[Opened]
    certificates: dict[str, Certified]
    regions: dict[int, tuple[int, int, int, int]]

    def with_focus(self, found: list[Focus], certificates: dict[str, Certified]) -> Sharpness:
        """Return it with what `through_focus` gave."""
        focus = sorted([*self.focus, *found], key=lambda one: one.shift_um)
        return replace(self, focus=focus, certificates=self.certificates | certificates)

    @property
    def q(self) -> float:
        """The paper's equation 4, at 550 nm: 2 (1 / p) / (1 / (lambda N))."""
        return 2 * 1e-3 * CENTRE_NM * self.f_number / self.reading.pitch_um

    @property
    def area(self) -> float:
        """Area under the SFR of ROI 3 to 1 cycle/px over that of the diffraction limit."""
        limit = self.models["diffraction limit"]
        return float(self.found["electrons", SHOWN].measured_mtf.sum() / limit.sum())

    def losses(self) -> dict[float, tuple[np.ndarray | None, np.ndarray]]:
        """Return by shift what it takes from the MTF, measured (or None) and predicted (F,)."""
        by_shift = {one.shift_um: one for one in self.focus}
        still = by_shift.pop(0.0)
        return {
            shift: (
                None if one.measured is None else still.measured - one.measured,
                still.predicted - one.predicted,
            )
            for shift, one in by_shift.items()
        }

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        name = self.reading.name
        sfr = [one.mtf_error for one in self.found.values()]
        lost = [np.abs(a - b).max() for a, b in self.losses().values() if a is not None]
        focus = f"loss by focus to 1 cycle/px, {name}"
        return [
            Bar.largest(f"SFR of ROI 1 and 3 to 1 cycle/px, {name}", sfr, SFR_BAR, "1"),
            *([Bar.largest(focus, lost, FOCUS_BAR, "1")] if lost else []),
            *bars_of(name, list(self.noise.values())),
            certificate_bar(self.certificates, f"certificates of edges, total, {name}"),
        ]


def reach_px(reading: Reading) -> int:
    """Return how far from the middle the regions reach, and what is needed beside them."""
    half_px = half_um(reading.camera.frame) / reading.pitch_um
    return math.ceil(half_px + ROI_PX[0] / 2) + SPARE_PX


def cropped(reading: Reading) -> Sensor:
    """Return the part of a reading's sensor that holds the square and its edges."""
    side = 2 * reach_px(reading)
    return reading.sensor.model_copy(update={"rows": side, "cols": side})


def narrowed(reading: Reading) -> Prescription:
    """Return a reading's lens with the field that the square needs: renders cost by it."""
    corner_mm = 1e-3 * math.hypot(reach_px(reading), ROI_PX[1] / 2) * reading.pitch_um
    return reading.lens.limited(math.degrees(math.atan(WIDER * corner_mm / reading.efl_mm)))


def rendered(shift_um: float, square: Square) -> Focus:
    """Return ROI 3 as it was rendered."""
    one = square.found(SHOWN)
    return Focus(shift_um, one.measured_mtf, one.predicted_mtf)


def by_rays(shift_um: float, lens: Prescription, sensor: Sensor, predictor: Predictor) -> Focus:
    """Return ROI 3 by rays alone."""
    camera = Camera(lens=lens, sensor=sensor, title="stand-in")
    return Focus(shift_um, None, predicted_mtf(SHOWN, camera, predictor))


def even_scene(reading: Reading) -> EvenScene:
    """Render an even scene, and predict its electrons by equation 1."""
    sensor = angular(reading.sensor)
    field = math.radians(reading.field_deg - BESIDE_DEG)
    reach = 1e3 * reading.efl_mm * math.tan(field) / reading.pitch_um
    predictor = predictor_of(reading.lens, sensor, reach, pupils=FIELDS, chiefs=CHIEF_FIELDS)
    scene = make_scene("grey", LUMINANCE_CD_M2, LAMP)
    camera = Camera(lens=reading.lens, sensor=sensor, title="stand-in")
    end_rad = np.radians([reading.lens.max_field_deg])
    rim_mm = float(predictor.tracer.chief_mm(end_rad, CENTRE_NM)[0])
    return electrons_of(camera, scene, predictor, band_of(sensor), rim_mm=rim_mm)


def sharpness(
    reading: Reading,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Sharpness:
    """Render and measure the square of one reading.

    Parameters
    ----------
    reading : Reading
    progress : callable, optional
        Called with (what, done, total).
    """
    base, lens = cropped(reading), narrowed(reading)
    predictor = predictor_of(lens, base, reach_px(reading))
    found, certificates, noise = {}, {}, {}
    maps = 1 + reading.simulated
    progress(f"edges, {reading.name}", 0, maps)
    with closing(Square(lens, angular(base), predictor)) as square:
        certificates["electrons"] = square.certificate
        found |= {("electrons", number): square.found(number) for number in ROIS}
        for number in reversed(ROIS):  # the light of the last one is still held
            frames = [square.frame(number, seed) for seed in range(REALISATIONS)]
            noise[number] = square.noise(number, frames)
        models = models_of(square, lens)
        aside = (reading.pixels - base.cols) // 2
        regions = {n: (x + aside, y + aside, *size) for n, (x, y, *size) in square.regions.items()}
    if reading.simulated:  # at 3 mm it shares no PSFs with the electron map: 30 s of two cores
        with closing(Square(lens, radiometric(base), predictor)) as square:
            certificates["irradiance"] = square.certificate
            found |= {("irradiance", number): square.found(number) for number in ROIS}
            still = rendered(0.0, square)
    else:
        still = by_rays(0.0, lens, base, predictor)
    progress(f"edges, {reading.name}", maps, maps)
    number = first_order(lens).f_number
    spots = opened(reading.lens)
    return Sharpness(reading, number, found, noise, [still], models, spots, certificates, regions)


def through_focus(
    reading: Reading,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> tuple[list[Focus], dict[str, Certified]]:
    """Return ROI 3 with the image plane moved, with the certificates of the renders.

    Rendered in a map of irradiance, as `sharpness` has it where the plane is not moved.

    Parameters
    ----------
    reading : Reading
    progress : callable, optional
        Called with (what, done, total).
    """
    base, lens = cropped(reading), narrowed(reading)
    found, certificates = [], {}
    seen: Iterable[Look | None] = [None] * len(SHIFTS_UM)
    if reading.simulated:
        sensor = radiometric(base)
        seen = looks(*before_chart(lens, sensor), Accuracy(TOLERANCE), SHIFTS_UM)
    for done, (shift, one) in enumerate(zip(SHIFTS_UM, seen, strict=True)):
        progress(f"focus, {reading.name}", done, len(SHIFTS_UM))
        moved = lens.defocused(shift)
        predictor = predictor_of(moved, base, reach_px(reading))
        if one is None:
            found.append(by_rays(shift, moved, base, predictor))
            continue
        with closing(Square(moved, sensor, predictor, (SHOWN,), one)) as square:
            certificates[f"image plane {shift:+g} um"] = square.certificate
            found.append(rendered(shift, square))
    progress(f"focus, {reading.name}", len(SHIFTS_UM), len(SHIFTS_UM))
    return found, certificates

"""Sharpness of the Ansys and Meta paper's camera (section 3.3): edges, their noise, and focus.

ROI 1 is the upper edge of a slanted square in the middle, ROI 3 its right one. Their SFR is
measured in an electron map (the paper's equation 1, by a map of efficiencies over angle) and in a
map of irradiance, and predicted from rays: the pupil's transfer function times the pixel's.

**Focus.** What a shift of the image plane takes from the MTF of ROI 3, rendered and by rays.

**What the reduced-order model costs.** The paper finds that its model takes geometric aberrations
as a Gaussian and has no chromatic ones. The Gaussian has the variance of the rays along the edge's
normal; without colour all light has the wavelength in the middle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from gpusim.camera import Camera
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build, first_order
from gpusim.metrics.sfr import FREQUENCIES_CY_PX, Sfr, measure_sfr
from gpusim.plan import Accuracy
from gpusim.render import Capture, Renderer
from gpusim.scene import make_scene
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor
from gpusim.validate.ansys import (
    BAND_NM,
    BRIGHT,
    DARK,
    EXPOSURE_S,
    LUMINANCE_CD_M2,
    PROBES,
    Reading,
    drawn,
    weights,
)
from gpusim.validate.ansys_electrons import EvenScene, electrons_of
from gpusim.validate.ansys_noise import Noise, bar_of, sfr_deviation
from gpusim.validate.ansys_pixel import angular, radiometric
from gpusim.validate.bars import Bar
from gpusim.validate.certified import certified
from gpusim.validate.edges import (
    AXES,
    ROI_PX,
    TILT_RAD,
    Found,
    Target,
    compare,
    cut,
    normal_of,
    region_of,
)
from gpusim.validate.kodak_table import Place
from gpusim.validate.predict import FIELDS, Band, Predictor
from gpusim.validate.spheres import SphereTracer
from gpusim.validate.tracers import refracted_losses

LAMP = "5100K"  # of the panels (section 2.1), as a blackbody: D50 is known to 830 nm alone
HALF_PX = 48.0  # of the square's sides
# Of the part of the sensor that holds the square: a lens's first render costs by its field.
CROP_PX = 160
ROIS = {1: "horizontal", 3: "vertical"}  # the upper and the right edge
SHOWN = 3  # the region of the paper's figures 14 and 15
SPARE_PX = 24  # of the field, beyond the square: PSFs and the slopes about its edges
NODES_NM = np.arange(BAND_NM[0], BAND_NM[1] + 1, 50.0)  # every 25 nm: 2.5e-4 of MTF
PUPILS, CHIEFS = 5, 9  # over 14 degrees: 9 pupils are 1.4e-5 of MTF
SHIFTS_UM = (-10.0, 10.0, 20.0)  # of the image plane: figure 14
REALISATIONS = 20  # figures 12 and 13
CENTRE_NM = 550.0  # of a model without colour
FILLED = 0.6  # of the full well, by the brightest pixel of the noisy frames
# Of the renders: planned for 3e-3 they miss MTFs by 0.012, for 1e-3 by 0.004, for this by 0.002.
TOLERANCE = 5e-4
WIDER = 1.15  # of a field: barrel distortion puts more of it on the sensor than a plain image has
SFR_BAR, FOCUS_BAR = 0.01, 0.005


def scene_of(sensor: Sensor) -> Scene:
    """Return a dark square on white, turned by five degrees, in the middle of the picture."""
    side = 2 * HALF_PX
    return drawn(
        "title: a slanted square\nunit: pixels\n"
        f"fills: {{white: {BRIGHT}, black: {DARK}}}\nbackground: white\nshapes:\n"
        f"  - {{shape: rectangle, size: [{side}, {side}], angle_deg: {math.degrees(TILT_RAD)}, "
        "fill: black}\n",
        sensor,
        LAMP,
    )


def predictor_of(
    lens: Prescription, sensor: Sensor, px: float, *, pupils: int = PUPILS
) -> Predictor:
    """Return what predicts edges so far from the axis."""
    system = build(lens)
    tracer = SphereTracer(system)
    widest = math.atan(1e-3 * px * sensor.pixel_pitch_um / tracer.efl_mm)
    losses = refracted_losses(system, NODES_NM)
    return Predictor(tracer, widest, NODES_NM, losses, pupils=pupils, chiefs=CHIEFS)


def band_of(sensor: Sensor) -> Band:
    """Return the light that the sensor sees."""
    return Band("W", *weights(sensor, LAMP))


def edge_of(number: int, sensor: Sensor, predictor: Predictor) -> tuple[Place, Target]:
    """Return an edge of the square: where it is imaged, and what it is."""
    axis, band = ROIS[number], band_of(sensor)
    side = -1 if axis == "horizontal" else 1
    ideal = side * HALF_PX * sensor.pixel_pitch_um * normal_of(axis)
    x, y = predictor.image_um(ideal, band) / sensor.pixel_pitch_um
    target = Target(axis, scene_of(sensor).source, {number: ideal}, band)
    return Place(number, float(x), float(y)), target


def even_light(sensor: Sensor, predictor: Predictor, band: Band, region: tuple) -> np.ndarray:
    """Return the predicted light (rows, cols) of an even scene in a region, over the axis's."""
    left, top, width, height = region
    y, x = np.mgrid[top : top + height, left : left + width] + 0.5
    away_px = np.hypot(x - sensor.cols / 2, y - sensor.rows / 2)
    return predictor.flat_field(away_px * sensor.pixel_pitch_um, band)


class Square:
    """Renders of the square before a sensor, and their edges."""

    def __init__(self, lens: Prescription, sensor: Sensor, predictor: Predictor) -> None:
        self.sensor, self.predictor = sensor, predictor
        self.edges = {number: edge_of(number, sensor, predictor) for number in ROIS}
        self.regions = {
            number: region_of(place, target.axis, sensor)
            for number, (place, target) in self.edges.items()
        }
        x, y, width, height = np.array(list(self.regions.values())).T
        left, top = int(x.min()), int(y.min())
        self.tile = left, top, int((x + width).max()) - left, int((y + height).max()) - top
        camera, scene = Camera(lens=lens, sensor=sensor, title="stand-in"), scene_of(sensor)
        self.renderer, self.capture = certified(
            Accuracy(TOLERANCE, PROBES),
            lambda accuracy: Renderer(camera, scene, accuracy, noise=True),
            lambda renderer: renderer.capture(EXPOSURE_S, tile=self.tile, keep=("rate",)),
        )
        self.rate = self.capture.rate
        self.exposure_s = FILLED * sensor.full_well_e / float(self.rate.max())

    def close(self) -> None:
        """Give the device's memory back."""
        self.renderer.release()

    def frame(self, seed: int) -> np.ndarray:
        """Return the electrons (rows, cols) of a frame with noise."""
        how = {"tile": self.tile, "seed": seed, "keep": ("electrons",)}
        return self.renderer.capture(self.exposure_s, **how).electrons

    def box(self, number: int) -> tuple[int, int, int, int]:
        """Return a region (x, y, width, height) within the tile."""
        left, top, width, height = self.regions[number]
        return left - self.tile[0], top - self.tile[1], width, height

    def region(self, number: int, picture: np.ndarray) -> np.ndarray:
        """Return a region of a picture of the tile, over the light of an even scene."""
        own = cut(picture, self.box(number))
        light = even_light(self.sensor, self.predictor, band_of(self.sensor), self.regions[number])
        return own / light

    def found(self, number: int) -> Found:
        """Return an edge without noise, measured and predicted."""
        place, target = self.edges[number]
        picture, band = self.region(number, self.rate), band_of(self.sensor)
        return compare(place, target, band, picture, self.sensor, self.predictor)

    def noise(self, number: int, frames: list[np.ndarray]) -> Noise:
        """Return an edge in frames of electrons, and what the closed form says of it."""

        def sfr_of(electrons: np.ndarray) -> tuple[np.ndarray, Sfr]:
            picture = self.region(number, electrons)
            return picture, measure_sfr(picture, (0, 0, *picture.shape[::-1]))

        light, clean = sfr_of(self.exposure_s * self.rate)
        levels = np.sort(light.ravel())
        outer = levels.size // 4
        edge, length_px = self.found(number), self.box(number)[2 if ROIS[number] == AXES[1] else 3]
        expected = sfr_deviation(
            clean.distance_px,
            np.interp(clean.distance_px, edge.distance_px, edge.predicted_lsf),
            float(levels[:outer].mean()),
            float(levels[-outer:].mean()),
            self.sensor.temporal_dark_noise_e,
            length_px / math.cos(TILT_RAD),
            clean.rise_px,
        )
        curves = np.array([sfr_of(frame)[1].sfr for frame in frames])
        return Noise(number, curves, clean.sfr, expected, float(clean.distance_px[-1]))


@dataclass(frozen=True, eq=False)
class Focus:
    """ROI 3 with the image plane moved: MTFs measured and predicted (F,)."""

    shift_um: float
    measured: np.ndarray
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
        By map, "electrons" or "irradiance", and region.
    noise : dict of int to Noise
    focus : list of Focus
        By shift, 0 among them; empty where it was not asked for.
    models : dict of str to ndarray (F,)
        MTFs of ROI 3 by limits and simpler models.
    captures : dict of str to Capture
    picture : ndarray (rows, cols)
        A frame of the electron map.
    boxes : dict of int to (x, y, width, height)
        Regions in it.
    """

    reading: Reading
    f_number: float
    found: dict[tuple[str, int], Found]
    noise: dict[int, Noise]
    focus: list[Focus]
    models: dict[str, np.ndarray]
    captures: dict[str, Capture]
    picture: np.ndarray
    boxes: dict[int, tuple[int, int, int, int]]

    @property
    def q(self) -> float:
        """The paper's equation 4, at 550 nm: 2 (1 / p) / (1 / (lambda N))."""
        return 2 * 1e-3 * CENTRE_NM * self.f_number / self.reading.pitch_um

    @property
    def area(self) -> float:
        """Area under the SFR of ROI 3 to 1 cycle/px over that of the diffraction limit."""
        limit = self.models["diffraction limit"]
        return float(self.found["electrons", SHOWN].measured_mtf.sum() / limit.sum())

    def losses(self) -> dict[float, tuple[np.ndarray, np.ndarray]]:
        """Return by shift what it takes from the MTF, measured and predicted (F,)."""
        by_shift = {one.shift_um: one for one in self.focus}
        still = by_shift.pop(0.0, None)
        return {
            shift: (still.measured - one.measured, still.predicted - one.predicted)
            for shift, one in by_shift.items()
        }

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        name = self.reading.name
        sfr = [one.mtf_error for one in self.found.values()]
        lost = [np.abs(a - b).max() for a, b in self.losses().values()]
        focus = f"loss by focus to 1 cycle/px, {name}"
        totals = [one.certificate.total_rms for one in self.captures.values()]
        return [
            Bar.largest(f"SFR of ROI 1 and 3 to 1 cycle/px, {name}", sfr, SFR_BAR, "1"),
            *([Bar.largest(focus, lost, FOCUS_BAR, "1")] if lost else []),
            bar_of(f"sigma of SFR outside its 95 % interval, {name}", list(self.noise.values())),
            Bar.largest(f"certificates of edges, total RMS, {name}", totals, TOLERANCE, "1"),
        ]


def models_of(square: Square, lens: Prescription) -> dict[str, np.ndarray]:
    """Return MTFs of ROI 3: limits of the lens alone, and simpler models with the pixel."""
    sensor, predictor, band = square.sensor, square.predictor, band_of(square.sensor)
    place, target = square.edges[SHOWN]
    ideal, pitch = target.ideal_um[SHOWN], sensor.pixel_pitch_um
    normal, origin = normal_of(target.axis), np.array([place.x, place.y]) * pitch
    f = FREQUENCIES_CY_PX / pitch  # cycles/um
    number = first_order(lens).f_number
    radial = ideal / np.hypot(*ideal)
    own = np.array([abs(normal @ [radial[1], -radial[0]]), normal @ radial])
    field = math.atan(1e-3 * float(np.hypot(*ideal)) / predictor.tracer.efl_mm)
    mean, deviation = (
        np.array([np.interp(nm, predictor.nodes_nm, of) for nm in band.wavelengths_nm])
        for of in predictor.spot_um(field, own)
    )
    chief = predictor.chief_um(np.array([field]), band.wavelengths_nm)[:, 0] * (radial @ normal)

    def airy(nm: np.ndarray) -> np.ndarray:
        at = np.clip(np.multiply.outer(1e-3 * nm * number, f), 0, 1)
        return 2 / np.pi * (np.arccos(at) - at * np.sqrt(1 - at**2))  # Goodman 2005, eq. 6-32

    def gaussian(nm: np.ndarray) -> np.ndarray:
        spread = np.interp(nm, band.wavelengths_nm, deviation)
        away = np.interp(nm, band.wavelengths_nm, mean + chief)
        shape = np.exp(-2 * (np.pi * np.multiply.outer(spread, f)) ** 2)
        return airy(nm) * shape * np.exp(-2j * np.pi * np.multiply.outer(away, f))

    def mean_of(otf: np.ndarray) -> np.ndarray:
        return np.abs(band.weight @ otf / band.weight.sum())

    rays = Predictor(
        predictor.tracer,
        1.01 * field,
        predictor.nodes_nm,
        refracted_losses(build(lens), predictor.nodes_nm),
        pupils=PUPILS,
        chiefs=CHIEFS,
        diffracts=False,
    )
    one = np.array([CENTRE_NM])
    single = Band("550 nm", one, np.ones(1))

    def spread(of: Predictor, light: Band) -> np.ndarray:
        found = of.line_spread(ideal, normal, origin, light)
        real, imaginary = (np.interp(f, found.frequency_cy_um, part)
                           for part in (found.otf.real, found.otf.imag))  # fmt: skip
        return np.hypot(real, imaginary)

    width = pitch * math.sqrt(sensor.fill_factor)
    pixel = np.abs(
        np.sinc(f * width * math.cos(TILT_RAD)) * np.sinc(f * width * math.sin(TILT_RAD))
    )
    return {
        "diffraction limit": mean_of(airy(band.wavelengths_nm)),
        "rays alone": spread(rays, band),
        "lens": spread(predictor, band),
        "lens and pixel": spread(predictor, band) * pixel,
        "Gaussian": mean_of(gaussian(band.wavelengths_nm)) * pixel,
        "no colour": spread(predictor, single) * pixel,
        "Gaussian, no colour": np.abs(gaussian(one)[0]) * pixel,
    }


def cropped(reading: Reading) -> Sensor:
    """Return the middle of a reading's sensor."""
    return reading.sensor.model_copy(update={"rows": CROP_PX, "cols": CROP_PX})


def even_scene(reading: Reading) -> EvenScene:
    """Render an even scene, and predict its electrons by equation 1.

    The whole lens stands before the crop: one that is limited to what the crop sees lacks the light
    that it throws in from beyond, 0.1 to 0.3 %.
    """
    sensor = angular(cropped(reading))
    reach_px = WIDER * CROP_PX / math.sqrt(2)
    predictor = predictor_of(reading.lens, sensor, reach_px, pupils=FIELDS)
    scene = make_scene("grey", LUMINANCE_CD_M2, LAMP)
    camera = Camera(lens=reading.lens, sensor=sensor, title="stand-in")
    return electrons_of(camera, scene, predictor, band_of(sensor))


def sharpness(
    reading: Reading,
    shifts_um: Sequence[float] = (),
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Sharpness:
    """Render and measure the square of one reading.

    Parameters
    ----------
    reading : Reading
    shifts_um : sequence of float
        Of the image plane, beside 0; none: ROI 3 is not followed through focus.
    progress : callable, optional
        Called with (what, done, total).
    """
    positions = sorted((0.0, *shifts_um)) if shifts_um else []
    what, total = f"edges, {reading.name}", 2 + len(positions)
    steps = iter(range(total))
    base = cropped(reading)
    corner = 1e-3 * CROP_PX / math.sqrt(2) * base.pixel_pitch_um / reading.efl_mm
    lens = reading.lens.limited(math.degrees(math.atan(WIDER * corner)))
    far_px = HALF_PX + SPARE_PX + ROI_PX[1] / 2
    predictor = predictor_of(lens, base, far_px)
    found, captures, focus = {}, {}, []

    progress(what, next(steps), total)
    with closing(Square(lens, angular(base), predictor)) as square:
        captures["electrons"] = square.capture
        found |= {("electrons", number): square.found(number) for number in ROIS}
        frames = [square.frame(seed) for seed in range(REALISATIONS)]
        noise = {number: square.noise(number, frames) for number in ROIS}
        models = models_of(square, lens)
        boxes = {number: square.box(number) for number in ROIS}
    progress(what, next(steps), total)
    with closing(Square(lens, radiometric(base), predictor)) as square:
        captures["irradiance"] = square.capture
        found |= {("irradiance", number): square.found(number) for number in ROIS}
    for shift in positions:
        progress(what, next(steps), total)
        moved = lens.defocused(shift)
        with closing(Square(moved, base, predictor_of(moved, base, far_px))) as square:
            captures[f"image plane {shift:+g} um"] = square.capture
            one = square.found(SHOWN)
        focus.append(Focus(shift, one.measured_mtf, one.predicted_mtf))
    progress(what, total, total)
    number = first_order(lens).f_number
    return Sharpness(reading, number, found, noise, focus, models, captures, frames[0], boxes)

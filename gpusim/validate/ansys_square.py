"""The slanted square of the Ansys and Meta paper's sharpness: its renders, edges and regions.

ROI 1 is the upper edge of a slanted square in the middle, ROI 3 its right one. What is measured of
them is in `gpusim.validate.ansys_mtf`.
"""

from __future__ import annotations

import math

import numpy as np

from gpusim.camera import Camera
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build
from gpusim.metrics.sfr import Sfr, measure_sfr
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor
from gpusim.validate.ansys import BAND_NM, BRIGHT, DARK, EXPOSURE_S, PROBES, drawn, weights
from gpusim.validate.ansys_noise import Noise, sfr_deviation
from gpusim.validate.certified import certified
from gpusim.validate.edges import (
    AXES,
    TILT_RAD,
    Found,
    Target,
    compare,
    cut,
    normal_of,
    region_of,
)
from gpusim.validate.kodak_table import Place
from gpusim.validate.predict import Band, Predictor
from gpusim.validate.spheres import SphereTracer
from gpusim.validate.tracers import refracted_losses

LAMP = "5100K"  # of the panels (section 2.1), as a blackbody: D50 is known to 830 nm alone
HALF_PX = 48.0  # of the square's sides
ROIS = {1: "horizontal", 3: "vertical"}  # the upper and the right edge
NODES_NM = np.arange(BAND_NM[0], BAND_NM[1] + 1, 50.0)  # every 25 nm: 2.5e-4 of MTF
PUPILS, CHIEFS = 5, 9  # over 14 degrees: 9 pupils are 1.4e-5 of MTF
FILLED = 0.6  # of the full well, by the brightest pixel of the noisy frames
# Planned for 3e-3 renders miss MTFs by 0.012, for 1e-3 by 0.004, for this by 0.002.
TOLERANCE = 5e-4


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
        return compare(place, target, band, picture, sensor=self.sensor, predictor=self.predictor)

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
            dark_e=float(levels[:outer].mean()),
            bright_e=float(levels[-outer:].mean()),
            read_noise_e=self.sensor.temporal_dark_noise_e,
            pixels_per_px=length_px / math.cos(TILT_RAD),
            rise_px=clean.rise_px,
        )
        curves = np.array([sfr_of(frame)[1].sfr for frame in frames])
        return Noise(number, curves, clean.sfr, expected, float(clean.distance_px[-1]))

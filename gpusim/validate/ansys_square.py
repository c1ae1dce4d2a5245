"""The slanted square of the Ansys and Meta paper's sharpness: its renders, edges and regions.

ROI 1 is the upper edge of the square in the middle of the eSFR chart at 60 cm, ROI 3 its right one.
What is measured of them is in `gpusim.validate.ansys_mtf`.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from gpusim.camera import Camera
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build
from gpusim.metrics.edge import samples_of
from gpusim.metrics.sfr import FREQUENCIES_CY_PX, measure_sfr
from gpusim.plan import Accuracy
from gpusim.render import Capture, Renderer
from gpusim.render.look import Look
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor
from gpusim.validate.ansys import BAND_NM, EXPOSURE_S, PROBES, weights
from gpusim.validate.ansys_noise import Noise, sfr_covariance
from gpusim.validate.ansys_targets import chart, half_um
from gpusim.validate.certified import certified, go_on, pooled
from gpusim.validate.edges import (
    ROI_PX,
    Found,
    Target,
    compare,
    normal_of,
    predicted_lsf,
    region_of,
    transfer,
)
from gpusim.validate.kodak_table import Place
from gpusim.validate.predict import Band, Predictor
from gpusim.validate.spheres import SphereTracer
from gpusim.validate.tracers import refracted_losses

LAMP = "5100K"  # of the panels (section 2.1), as a blackbody: D50 is known to 830 nm alone
ROIS = {1: "horizontal", 3: "vertical"}  # the upper and the right edge
NODES_NM = np.arange(BAND_NM[0], BAND_NM[1] + 1, 50.0)  # every 25 nm: 2.5e-4 of MTF
PUPILS, CHIEFS = 5, 9  # over 14 degrees: 9 pupils are 1.4e-5 of MTF
FILLED = 0.6  # of the full well, by the brightest pixel of the noisy frames
# Planned for 3e-3 renders miss MTFs by 0.012, for 1e-3 by 0.004, for this by 0.002.
TOLERANCE = 5e-4


def predictor_of(
    lens: Prescription, sensor: Sensor, px: float, *, pupils: int = PUPILS, chiefs: int = CHIEFS
) -> Predictor:
    """Return what predicts edges so far from the axis on the ideal plane."""
    system = build(lens)
    tracer = SphereTracer(system)
    widest = math.atan(1e-3 * px * sensor.pixel_pitch_um / tracer.efl_mm)
    losses = refracted_losses(system, NODES_NM)
    return Predictor(tracer, widest, NODES_NM, losses, pupils=pupils, chiefs=chiefs)


def band_of(sensor: Sensor) -> Band:
    """Return the light that the sensor sees."""
    return Band("W", *weights(sensor, LAMP))


def edge_of(number: int, camera: Camera, predictor: Predictor) -> tuple[Place, Target]:
    """Return an edge of the chart's square: where it is imaged, and what it is."""
    sensor, axis, frame = camera.sensor, ROIS[number], camera.frame
    side, band = -1 if axis == "horizontal" else 1, band_of(sensor)
    ideal = side * half_um(frame) * normal_of(axis)
    x, y = predictor.image_um(ideal, band) / sensor.pixel_pitch_um
    target = Target(axis, chart(frame, LAMP).source, {number: ideal}, band)
    return Place(number, float(x), float(y)), target


def predicted_mtf(number: int, camera: Camera, predictor: Predictor) -> np.ndarray:
    """Return the MTF (F,) of an edge by rays and the pixel alone."""
    place, target = edge_of(number, camera, predictor)
    sensor, reach_px = camera.sensor, ROI_PX[0] / 2
    at = np.arange(-reach_px, reach_px, 1 / 32)
    lsf, _ = predicted_lsf(
        place, target, band_of(sensor), sensor=sensor, predictor=predictor, distance_px=at
    )
    return transfer(at, lsf, reach_px)


def even_light(sensor: Sensor, predictor: Predictor, band: Band, region: tuple) -> np.ndarray:
    """Return the predicted light (rows, cols) of an even scene in a region, over the axis's."""
    left, top, width, height = region
    y, x = np.mgrid[top : top + height, left : left + width] + 0.5
    away_px = np.hypot(x - sensor.cols / 2, y - sensor.rows / 2)
    return predictor.flat_field(away_px * sensor.pixel_pitch_um, band)


def before_chart(lens: Prescription, sensor: Sensor) -> tuple[Camera, Scene]:
    """Return a camera and the chart before it."""
    camera = Camera(lens=lens, sensor=sensor, title="stand-in")
    return camera, chart(camera.frame, LAMP)


class Square:
    """Renders of the square's edges before a sensor.

    ``seen``: what the camera sees of the chart, where that is known.
    """

    def __init__(
        self,
        lens: Prescription,
        sensor: Sensor,
        predictor: Predictor,
        numbers: Collection[int] = tuple(ROIS),
        seen: Look | None = None,
    ) -> None:
        self.sensor, self.predictor = sensor, predictor
        camera, scene = before_chart(lens, sensor)
        self.edges = {number: edge_of(number, camera, predictor) for number in numbers}
        self.regions = {
            number: region_of(place, target.axis, sensor)
            for number, (place, target) in self.edges.items()
        }
        self.captures: dict[int, Capture] = {}
        self.renderer, _ = certified(
            Accuracy(TOLERANCE, PROBES // len(numbers)),
            lambda accuracy: Renderer(camera, scene, accuracy, noise=True, seen=seen),
            self._lit,
        )
        self.certificate = pooled(list(self.captures.values()), TOLERANCE)
        self.rates = {number: one.rate for number, one in self.captures.items()}
        brightest = max(float(rate.max()) for rate in self.rates.values())
        self.exposure_s = FILLED * sensor.full_well_e / brightest

    def _lit(self, renderer: Renderer) -> Capture:
        """Render the regions; return the capture of the one whose certificate says more.

        The lens is traced anew for the first alone: they are as far from the axis.
        """
        probes = renderer.accuracy.probes
        for number, region in self.regions.items():
            one = renderer.capture(EXPOSURE_S, tile=region, keep=("rate",))
            go_on(renderer, one, probes)
            self.captures[number] = one
        return max(self.captures.values(), key=lambda one: one.certificate.total_rms)

    def close(self) -> None:
        """Give the device's memory back."""
        self.renderer.release()

    def frame(self, number: int, seed: int) -> np.ndarray:
        """Return the electrons (rows, cols) of an edge in a frame with noise."""
        how = {"tile": self.regions[number], "seed": seed, "keep": ("electrons",)}
        return self.renderer.capture(self.exposure_s, **how).electrons

    def light(self, number: int) -> np.ndarray:
        """Return the light (rows, cols) of an even scene at an edge, over the axis's."""
        return even_light(self.sensor, self.predictor, band_of(self.sensor), self.regions[number])

    def found(self, number: int) -> Found:
        """Return an edge without noise, measured and predicted."""
        place, target = self.edges[number]
        picture, band = self.rates[number] / self.light(number), band_of(self.sensor)
        return compare(place, target, band, picture, sensor=self.sensor, predictor=self.predictor)

    def noise(self, number: int, frames: list[np.ndarray]) -> Noise:
        """Return an edge in frames of electrons, and what the closed form says of it."""
        light, mean_e = self.light(number), self.exposure_s * self.rates[number]
        region = (0, 0, *mean_e.shape[::-1])
        clean, pixels = measure_sfr(mean_e / light, region), samples_of(mean_e / light, region)
        variance = (mean_e + self.sensor.temporal_dark_noise_e**2) / light**2
        levels = np.sort(pixels.value)
        outer = levels.size // 4
        edge = self.found(number)
        covariance = sfr_covariance(
            clean.line.distance(pixels.x, pixels.y),
            (variance.T if pixels.turned else variance).ravel(),
            step_e=float(levels[-outer:].mean() - levels[:outer].mean()),
            distance_px=clean.distance_px,
            lsf=np.interp(clean.distance_px, edge.distance_px, edge.predicted_lsf),
            rise_px=clean.rise_px,
        )
        upto = FREQUENCIES_CY_PX.size
        curves = np.array([measure_sfr(frame / light, region).sfr[:upto] for frame in frames])
        return Noise(number, curves, clean.sfr[:upto], covariance, float(clean.distance_px[-1]))

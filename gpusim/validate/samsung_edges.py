"""Edge spread functions of the Samsung validation (its figure 9), at three wavelengths.

Near-vertical edges lie on the axis, at half the field to the right (their light spreads along the
radius) and, where the sensor reaches so far, at half the field below (across it). Each
channel of a filter array passes one wavelength, so that one render shows all three. An independent
tracer predicts them: of light as a wave, against which the edges are held, and of its rays alone,
which is what the paper compares. Pixels of the sensor are in both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

from gpusim.lens.prescription import Prescription
from gpusim.metrics.sfr import measure_sfr
from gpusim.plan import Accuracy
from gpusim.scene.chart import Chart, Rect
from gpusim.sensor.sensor import Sensor
from gpusim.validate.bars import Bar
from gpusim.validate.certified import Certified, certified_tiles, pooled
from gpusim.validate.edges import TILT_RAD, Target, lit, normal_of, predicted_lsf
from gpusim.validate.kodak_table import Place
from gpusim.validate.predict import Band, Predictor
from gpusim.validate.samsung_camera import (
    LENSES,
    LINES_NM,
    Optics,
    camera_of,
    lens_of,
    lines_predictor,
    lines_sensor,
)

PATTERN = [["B", "G"], ["G", "R"]]
REFERENCE = "G"
TOLERANCE, PROBES = 1.5e-3, 8  # planned for 3e-3 the widest lens missed it, and was rendered twice
EXPOSURE_S = 1 / 60
HALF_FIELD = 0.5
ROI_PX = 96  # sides of the regions: of one channel of four as many pixels as 48 x 48
BLOCK_PX = 150.0  # half sides of the chart's rectangles
WINDOW_PX = 12.0  # about an edge: there its ESF is held against the prediction
STEP_PX = 1 / 32
ESF_BAR = 0.01
# By the direction across the upright edge, as MTFs are named; the field lies along x and along y.
PLACES = {"axis": (0.0, 0.0), "tangential": (1.0, 0.0), "sagittal": (0.0, 1.0)}


@dataclass(frozen=True, eq=False)
class Edge:
    """An edge of one lens, place and channel.

    Attributes
    ----------
    optics : Optics
    where, channel : str
    distance_px : ndarray (D,)
        Across the edge, from where it is predicted: the chief ray of its wavelength.
    measured, wave, rays : ndarray (D,)
        Edge spread functions from 0 to 1: in the render, and as predicted.
    """

    optics: Optics
    where: str
    channel: str
    distance_px: np.ndarray
    measured: np.ndarray
    wave: np.ndarray
    rays: np.ndarray

    @property
    def error(self) -> float:
        """Largest distance from the prediction of light as a wave."""
        return float(np.abs(self.measured - self.wave).max())

    @property
    def from_rays(self) -> float:
        """Largest distance from the prediction of rays alone: what diffraction does."""
        return float(np.abs(self.measured - self.rays).max())


@dataclass(frozen=True, eq=False)
class Edges:
    """All edges, with the certificates of the renders by lens."""

    found: Sequence[Edge]
    certificates: dict[str, Certified]
    tracer: str
    independent: bool

    @classmethod
    def of(cls, parts: Sequence[Edges]) -> Edges:
        """Return the edges of several lenses, all predicted by one program."""
        found = [edge for one in parts for edge in one.found]
        certificates = {name: one for part in parts for name, one in part.certificates.items()}
        return cls(found, certificates, parts[0].tracer, parts[0].independent)

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        bars = []
        for optics in LENSES:
            for field, axis in ((0, True), (HALF_FIELD, False)):
                own = [
                    one.error
                    for one in self.found
                    if one.optics == optics and (one.where == "axis") == axis
                ]
                if own:
                    name = f"ESF of {optics.name} at {field} field, three wavelengths"
                    bars.append(Bar.largest(name, own, ESF_BAR, "of the step"))
        return bars


def band_of(channel: str) -> Band:
    """Return the one wavelength of a channel."""
    return Band(channel, np.array([LINES_NM[channel]]), np.ones(1))


def measure_edges(
    own: bool = False,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
    lenses: Sequence[Optics] = LENSES,
) -> Edges:
    """Render, measure and predict the edges of all lenses."""
    found, certificates = [], {}
    for optics in lenses:
        progress(f"edges, {optics.name}", 0, 1)
        predictor = lines_predictor(optics, own)
        edges, certificates[f"edges, {optics.name}"] = edges_of(optics, lens_of(optics), predictor)
        found += edges
        progress(f"edges, {optics.name}", 1, 1)
    return Edges(found, certificates, predictor.tracer.name, predictor.tracer.independent)


def edges_of(
    optics: Optics, lens: Prescription, predictor: Predictor
) -> tuple[list[Edge], Certified]:
    """Return the edges of a lens, and the certificate of the render."""
    sensor = lines_sensor(PATTERN, LINES_NM)
    places, target = places_of(optics, predictor, sensor)
    camera, scene = camera_of(optics, lens, sensor), lit(target.chart)
    # Those off the axis come first: the bank is judged there.
    tiles = [region_of(place, sensor) for place in reversed(places.values())]
    accuracy = Accuracy(TOLERANCE, PROBES)
    captures = certified_tiles(camera, scene, accuracy, EXPOSURE_S, tiles)[::-1]
    found = []
    for (name, place), capture in zip(places.items(), captures, strict=True):
        for channel in LINES_NM:
            one = edge_of(place, target, channel, capture.rate, sensor=sensor, predictor=predictor)
            found.append(Edge(optics, name, channel, *one))
    return found, pooled(captures, TOLERANCE)


def places_of(
    optics: Optics, predictor: Predictor, sensor: Sensor
) -> tuple[dict[str, Place], Target]:
    """Return the places by name, and the chart with an edge through each."""
    field = np.array([HALF_FIELD * math.radians(optics.full_deg / 2)])
    radius_px = 1e3 * float(predictor.tracer.chief_mm(field, LINES_NM[REFERENCE])[0])
    radius_px /= sensor.pixel_pitch_um
    places = {}
    for number, (name, way) in enumerate(PLACES.items(), start=1):
        x, y = (radius_px * part for part in way)
        if y + ROI_PX < sensor.rows / 2:
            places[name] = Place(number, x, y)
    pitch, reference = sensor.pixel_pitch_um, band_of(REFERENCE)
    ideal = {
        place.number: predictor.ideal_um(np.array([place.x, place.y]) * pitch, reference)
        for place in places.values()
    }
    unit = 2 / (sensor.rows * pitch)  # half-heights a um
    side = BLOCK_PX * pitch * unit
    middles = [(at + BLOCK_PX * pitch * normal_of("vertical")) * unit for at in ideal.values()]
    rects = tuple(Rect(*middle, side, side, TILT_RAD, 1) for middle in middles)
    chart = Chart(("black", "white"), 0, rects)
    return places, Target("vertical", chart, ideal, reference)


def region_of(place: Place, sensor: Sensor) -> tuple[int, int, int, int]:
    """Return the region (x, y, width, height) about a place, on whole periods of the filters."""
    x, y = place.x + sensor.cols / 2 - ROI_PX / 2, place.y + sensor.rows / 2 - ROI_PX / 2
    return 2 * round(x / 2), 2 * round(y / 2), ROI_PX, ROI_PX


def edge_of(
    place: Place,
    target: Target,
    channel: str,
    rate: np.ndarray,
    *,
    sensor: Sensor,
    predictor: Predictor,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return distances and the ESFs: measured, of a wave, of rays alone."""
    band, (left, top, width, height) = band_of(channel), region_of(place, sensor)
    y, x = np.mgrid[top : top + height, left : left + width] + 0.5
    away = np.hypot(x - sensor.cols / 2, y - sensor.rows / 2) * sensor.pixel_pitch_um
    picture = rate / predictor.flat_field(away, band)
    sites = np.array(PATTERN) == channel
    sfr = measure_sfr(picture, (0, 0, width, height), sites=sites)
    at = np.arange(-WINDOW_PX, WINDOW_PX + STEP_PX, STEP_PX)
    far = np.arange(-3 * WINDOW_PX, 3 * WINDOW_PX, STEP_PX)
    curves = []
    for diffracts in (True, False):
        other = copy(predictor)
        other.diffracts, other.found = diffracts, {}
        lsf, normal = predicted_lsf(
            place, target, band, sensor=sensor, predictor=other, distance_px=far
        )
        curves.append(step_of(np.interp(at, far, cumulative_trapezoid(lsf, far, initial=0))))
    # The measured edge crosses the row in the middle of the region; the predicted one the place.
    row = sfr.line.middle_px
    line_x = float(sfr.line.x_of_y(row)) + left - sensor.cols / 2 - place.x
    offset = line_x * normal[0] + (row + top - sensor.rows / 2 - place.y) * normal[1]
    measured = cumulative_trapezoid(sfr.lsf, sfr.distance_px, initial=0)
    return at, step_of(np.interp(at - offset, sfr.distance_px, measured)), *curves


def step_of(esf: np.ndarray) -> np.ndarray:
    """Return an edge spread function from 0 to 1 over its window."""
    return (esf - esf[0]) / (esf[-1] - esf[0])

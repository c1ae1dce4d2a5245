"""Edges measured in a render and predicted from rays: positions, line spreads, transfer functions.

Both sides take the centroid of the line spread within a window as the edge's position, and the
modulus of its transform under the window of `gpusim.metrics.sfr` as the MTF.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from gpusim.metrics.sfr import FREQUENCIES_CY_PX, measure_sfr
from gpusim.scene import make_scene
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor
from gpusim.validate.kodak_table import Place
from gpusim.validate.predict import Band, Predictor

BLACK, WHITE = 0.05, 0.80  # reflectances: 16:1, as in the library's charts without colour
TILT_RAD = math.radians(5.0)  # of the edges: ISO 12233:2017 asks for about 5 degrees
AXES = ("vertical", "horizontal")  # what an edge is nearer to
ROI_PX = (64, 64)  # across the edge, along it
ROW_ROI_PX = (64, 48)  # of near-horizontal edges: their neighbours are 63 px away
ASIDE_PX = 6.0  # from a place to where the slopes of PSFs and light are taken
WINDOW_PX = 8.0  # about the edge, in which centroids are taken


def lit(chart: Chart) -> Scene:
    """Return a chart of two grey materials, black and white, under the light of the library's."""
    grey = make_scene("grey")

    def light(wavelengths_nm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        white = grey.light(wavelengths_nm)[1]
        return np.outer((BLACK, WHITE), white), white

    spectra, white = light(grey.wavelengths_nm)
    return replace(grey, name="edges", source=chart, spectra=spectra, white=white, light=light)


def normal_of(axis: str) -> np.ndarray:
    """Return the unit normal (2,) of a target's edges on the ideal plane: towards +x, or +y."""
    c, s = math.cos(TILT_RAD), math.sin(TILT_RAD)
    return np.array([c, s]) if axis == "vertical" else np.array([-s, c])


@dataclass(frozen=True, eq=False)
class Target:
    """A chart of edges and what follows from where its edges were put.

    Attributes
    ----------
    axis : str
        "vertical" or "horizontal": what the edges are nearer to.
    chart : Chart
    ideal_um : dict of int to ndarray (2,)
        Point of the ideal image plane through which the edge of a place goes.
    reference : Band
        In which it is imaged at the place.
    """

    axis: str
    chart: Chart
    ideal_um: dict[int, np.ndarray]
    reference: Band


@dataclass(frozen=True, eq=False)
class Found:
    """An edge at a place in a band: measured and predicted.

    Attributes
    ----------
    place : Place
    axis, band : str
    measured_px, predicted_px : float
        Across the edge, from the sensor's centre, in the middle of the region.
    measured_mtf, predicted_mtf : ndarray (F,)
        At `FREQUENCIES_CY_PX`.
    distance_px, measured_lsf, predicted_lsf : ndarray (D,)
        Line spreads per pixel over the distance from the predicted centroid.
    picture : ndarray (rows, cols)
        The region, over the predicted light of an even scene.
    """

    place: Place
    axis: str
    band: str
    measured_px: float
    predicted_px: float
    measured_mtf: np.ndarray
    predicted_mtf: np.ndarray
    distance_px: np.ndarray
    measured_lsf: np.ndarray
    predicted_lsf: np.ndarray
    picture: np.ndarray

    @property
    def error_px(self) -> float:
        """Error of the position: measured less predicted."""
        return self.measured_px - self.predicted_px

    @property
    def mtf_error(self) -> float:
        """Largest difference of the transfer functions up to one cycle per pixel."""
        return float(np.abs(self.measured_mtf - self.predicted_mtf).max())


def region_of(place: Place, axis: str, sensor: Sensor) -> tuple[int, int, int, int]:
    """Return the region (x, y, width, height) about a place, pixels."""
    across, along = ROI_PX if axis == "vertical" else ROW_ROI_PX
    width, height = (across, along) if axis == "vertical" else (along, across)
    x, y = place.x + sensor.cols / 2, place.y + sensor.rows / 2
    return math.floor(x - width / 2), math.floor(y - height / 2), width, height


def centroid_px(distance_px: np.ndarray, lsf: np.ndarray) -> float:
    """Return the centroid of a line spread within the window about itself."""
    middle = 0.0
    for _ in range(30):
        at = middle + np.linspace(-WINDOW_PX, WINDOW_PX, 1025)
        value = np.interp(at, distance_px, lsf)
        middle = float(np.trapezoid(value * at, at) / np.trapezoid(value, at))
    return middle


def transfer(distance_px: np.ndarray, lsf: np.ndarray, reach_px: float) -> np.ndarray:
    """Return the MTF (F,) of a line spread under the window of `gpusim.metrics.sfr`."""
    over = np.clip((np.abs(distance_px) / reach_px - 0.75) / 0.25, 0, 1)
    seen = lsf * (0.5 + 0.5 * np.cos(np.pi * over))
    waves = np.exp(-2j * np.pi * np.outer(FREQUENCIES_CY_PX, distance_px))
    size = np.abs(waves @ seen)
    return size / size[0]


def compare(
    place: Place,
    target: Target,
    band: Band,
    picture: np.ndarray,
    *,
    sensor: Sensor,
    predictor: Predictor,
) -> Found:
    """Measure an edge in a picture (rows, cols), and predict it.

    The picture is that of a region alone, over the light of an even scene.
    """
    region = region_of(place, target.axis, sensor)
    sfr = measure_sfr(picture, (0, 0, *region[2:]))
    at = sfr.distance_px
    fine = np.arange(at[0] - 2, at[-1] + 2, 1 / 32)
    shape, normal = predicted_lsf(
        place, target, band, sensor=sensor, predictor=predictor, distance_px=fine
    )
    own = slice(None) if target.axis == "vertical" else slice(None, None, -1)
    x, y = np.array([place.x, place.y])[own]
    nx, ny = normal[own]
    centre = np.array([sensor.cols, sensor.rows])[own] / 2
    first = np.array(region[:2])[own]
    # Where the predicted line crosses the row in the middle of the region.
    offset = centroid_px(fine, shape)
    row = sfr.line.middle_px + first[1] - centre[1]
    predicted = x + (offset - (row - y) * ny) / nx
    line = float(sfr.line.x_of_y(sfr.line.middle_px)) + first[0] - centre[0]
    own_offset = centroid_px(at, sfr.lsf)
    measured = line + own_offset * math.hypot(1, sfr.line.slope)
    lsf = np.interp(at + offset, fine, shape)
    return Found(
        place,
        target.axis,
        band.name,
        measured,
        predicted,
        sfr.sfr[: FREQUENCIES_CY_PX.size],
        transfer(at, lsf, at[-1]),
        at,
        np.interp(at + own_offset, at, sfr.lsf),
        lsf,
        picture,
    )


def predicted_lsf(
    place: Place,
    target: Target,
    band: Band,
    *,
    sensor: Sensor,
    predictor: Predictor,
    distance_px: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the line spread (D,) per pixel over distances from a place, and the edge's normal."""
    ideal, pitch = target.ideal_um[place.number], sensor.pixel_pitch_um
    tilted = normal_of(target.axis)
    step = ASIDE_PX * pitch * np.array([-tilted[1], tilted[0]])
    # The same for all bands, for they are compared along one direction.
    ends = (predictor.image_um(ideal + way * step, target.reference) for way in (1, -1))
    along = np.subtract(*ends)
    normal = np.array([along[1], -along[0]]) / np.hypot(*along)
    normal = normal * np.sign(normal @ tilted)
    across, beside = normal if target.axis == "vertical" else normal[::-1]
    width = pitch * math.sqrt(sensor.fill_factor)
    origin = np.array([place.x, place.y]) * pitch

    def seen(ideal_um: np.ndarray, origin_um: np.ndarray) -> tuple[np.ndarray, float]:
        spread = predictor.line_spread(ideal_um, normal, origin_um, band)
        return spread.through(width, beside / across).at(distance_px * pitch) * pitch, spread.light

    middle, light = seen(ideal, origin)
    # On either side, each about its own image: see the head of gpusim.validate.predict.
    sides = [ideal + way * ASIDE_PX * pitch * tilted for way in (-1, 1)]
    images = [predictor.image_um(side, band) for side in sides]
    home = predictor.image_um(ideal, band)
    before, behind = (
        seen(side, origin + image - home) for side, image in zip(sides, images, strict=True)
    )
    apart = float((images[1] - images[0]) @ normal) / pitch
    change = (behind[0] - before[0]) / apart
    brighter = (behind[1] - before[1]) / apart / light
    centroid = np.trapezoid(middle * distance_px, distance_px)
    total = middle * (1 - (distance_px - centroid) * brighter)
    return total + cumulative_trapezoid(change, distance_px, initial=0), normal


def cut(picture: np.ndarray, region: tuple[int, int, int, int]) -> np.ndarray:
    """Return a region (x, y, width, height) of a picture."""
    x, y, width, height = region
    return picture[y : y + height, x : x + width]

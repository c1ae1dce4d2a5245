"""The validation of Short, Williams & Jones (1999), section 4, with our engine and a stand-in lens.

Edges at the places of their table 1, near-vertical and near-horizontal, are rendered on three
monochrome sensors with the bands of a colour sensor; positions and transfer functions are measured
in the renders and predicted from a lens program's rays (`gpusim.validate.predict`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gpusim.camera import Camera
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build
from gpusim.library.irradiance import on_tile
from gpusim.plan import Accuracy
from gpusim.scene import make_scene
from gpusim.scene.chart import Chart, Rect
from gpusim.scene.spectra import QUADRATURE_NM, WAVELENGTHS_NM
from gpusim.sensor.load import load_sensor
from gpusim.sensor.sensor import Sensor
from gpusim.validate.bars import Bar
from gpusim.validate.certified import Certified, certificate_bar, certified_lights, pooled
from gpusim.validate.edges import (
    AXES,
    TILT_RAD,
    Found,
    Target,
    compare,
    cut,
    lit,
    normal_of,
    region_of,
)
from gpusim.validate.kodak_table import TABLE_1
from gpusim.validate.predict import Band, Predictor
from gpusim.validate.tracers import refracted_losses, tracer_of

LENS = Path(__file__).parents[1] / "data" / "validate" / "kodak-stand-in.yaml"
EFL_MM = 6.6  # Short, Williams & Jones 1999, section 4
SENSOR = "kodak-vga"
BANDS = "RGB"
REFERENCE = "G"  # the band whose predicted places table 1 lists
# The renders', and the probes of each rectangle. At 2e-3 PSFs between nodes move edges by up to
# 5e-3 px, the bar between bands.
TOLERANCE, PROBES = 1.4e-3, 16
EXPOSURE_S = 1 / 60
# Lines that rays are traced at: closest where glass disperses most. Every 25 nm all over moves no
# edge by 2e-4 px and no MTF by 6e-4.
NODES_NM = np.array([400.0, 425.0, 450.0, 475.0, 500.0, 550.0, 620.0, 700.0])
# What has to hold, pixels and of 1. The paper's own errors: positions 0.2 and in the corner 0.4,
# inter-band 0.05 but for one of 0.076.
POSITION_BAR_PX, INTER_BAND_BAR_PX, MTF_BAR = 0.02, 0.005, 0.01
MTF_EDGES = {1: "centre", 3: "mid-field", 5: "edge"}  # figures 10, 11 and 12


class Sheet(NamedTuple):
    """Places that share a chart and a plan.

    Attributes
    ----------
    groups : tuple of tuple of int
        Numbers of those whose regions share a rectangle.
    samples : int, optional
        Samples a pixel, in place of the planner's.
    """

    groups: tuple[tuple[int, ...], ...]
    samples: int | None = None

    @property
    def numbers(self) -> set[int]:
        """Numbers of all places."""
        return {number for one in self.groups for number in one}


# By the axis, where the lens is sharpest, the planner takes 8 samples a pixel: it counts the edges
# of the whole chart. With so many pixels on the steepest edges err by 2e-3 RMS there.
SHEETS = {
    "near the axis": Sheet(((1, 2),), samples=16),
    "farther out": Sheet(((7, 8, 9, 10), (3, 4, 5), (6,))),
}


def stand_in() -> Prescription:
    """Return the stand-in lens at the paper's focal length."""
    return load_prescription(LENS).scaled(EFL_MM)


def mono_sensor(band: str) -> Sensor:
    """Return the sensor with one of its filters on every pixel, and nothing that shifts charge."""
    return _without_array([[band]])


def three_sensors() -> Sensor:
    """Return the three monochrome sensors at once: light has a plane of all pixels for each band.

    So it is for patterns that no grid has (`gpusim.sensor.planes`): this one repeats after three
    pixels. PSFs, plan and certificate are shared.
    """
    return _without_array([list(BANDS)])


def _without_array(pattern: list[list[str]]) -> Sensor:
    sensor = load_sensor(SENSOR)
    efficiency = sensor.quantum_efficiency
    used = {name: efficiency.channels[name] for row in pattern for name in row}
    changes = {
        "cfa": sensor.cfa.model_copy(update={"pattern": pattern}),
        "quantum_efficiency": efficiency.model_copy(update={"channels": used}),
        "veiling_glare": 0.0,
    } | dict.fromkeys(("smear", "parallel_cti", "serial_cti"))
    return sensor.model_copy(update=changes)


def band_of(name: str) -> Band:
    """Return a band's photons times efficiency under the light of the charts.

    They are weighted for the trapezoidal rule: blue still sees light at 400 nm, and its mean would
    lie 0.54 nm off, 0.01 px at the picture's side, if that end counted in full.
    """
    scene = make_scene("grey")
    photons = scene.white * WAVELENGTHS_NM * load_sensor(SENSOR).qe[name] * QUADRATURE_NM
    seen = photons > 1e-6 * photons.max()
    return Band(name, WAVELENGTHS_NM[seen], photons[seen])


def predictor_of(lens: Prescription, *, own: bool = False) -> Predictor:
    """Return what predicts edges before a lens: by optiland, or by our tracer."""
    system = build(lens)
    widest = math.radians(lens.max_field_deg)
    losses = refracted_losses(system, NODES_NM)
    return Predictor(tracer_of(system, own=own), widest, NODES_NM, losses)


def targets(
    predictor: Predictor, sensor: Sensor, numbers: Collection[int] = range(1, 11)
) -> list[Target]:
    """Return both charts: edges whose green images go through places, by their numbers."""
    reference = band_of(REFERENCE)
    points = {
        place.number: predictor.ideal_um(
            np.array([place.x, place.y]) * sensor.pixel_pitch_um, reference
        )
        for place in TABLE_1
        if place.number in numbers
    }
    unit = sensor.pixel_pitch_um / (sensor.rows * sensor.pixel_pitch_um / 2)  # half-heights a px
    made = []
    for axis, shapes in (("vertical", _columns), ("horizontal", _blocks)):
        px = {number: at / sensor.pixel_pitch_um for number, at in points.items()}
        rects = tuple(
            Rect(cx * unit, cy * unit, w * unit, h * unit, TILT_RAD, 1)
            for cx, cy, w, h in shapes(px)
        )
        made.append(Target(axis, Chart(("black", "white"), 0, rects), points, reference))
    return made


def _columns(px: dict[int, np.ndarray]) -> Iterator[tuple[float, float, float, float]]:
    """Yield centre and half sizes of upright stripes, px, whose sides go through the places."""
    normal = normal_of("vertical")
    # Sides (left, right) of stripes; outer ones end 80 px farther out. Rows of stripes lie apart.
    for left, right, half in ((1, 2, 80.0), (3, 4, 80.0), (5, None, 80.0), (None, 6, 80.0),
                              (7, 8, 70.0), (9, None, 70.0), (None, 10, 70.0)):  # fmt: skip
        if not {left, right} & px.keys():
            continue
        first, last = (None if side is None else px[side] for side in (left, right))
        width = 80.0 if first is None or last is None else float((last - first) @ normal)
        start = first if first is not None else last - width * normal
        yield *(start + width / 2 * normal), width / 2, half


def _blocks(px: dict[int, np.ndarray]) -> Iterator[tuple[float, float, float, float]]:
    """Yield centre and half sizes of blocks, px, whose upper sides go through the places."""
    along, normal, depth = normal_of("vertical"), normal_of("horizontal"), 80.0
    for places in ((6, 1, 2, 3, 4, 5), (10, 7, 8, 9)):
        row = [number for number in places if number in px]
        if not row:
            continue
        x = np.array([px[number][0] for number in row])
        middles = (x[1:] + x[:-1]) / 2
        ends = np.concatenate([[x[0] - 45], middles, [x[-1] + 45]])
        for number, left, right in zip(row, ends[:-1], ends[1:], strict=True):
            # Outlines must not touch; steps of 6 px between neighbours lie 30 px from the places.
            half = ((right - left) * math.cos(TILT_RAD) - 1.0) / 2
            away = ((left + right) / 2 - px[number][0]) * math.cos(TILT_RAD)
            yield *(px[number] + away * along + depth / 2 * normal), half, depth / 2


def rectangle(sensor: Sensor, numbers: Collection[int]) -> tuple[int, int, int, int]:
    """Return the rectangle (x, y, width, height) that holds the regions of places."""
    boxes = [
        region_of(place, axis, sensor)
        for place in TABLE_1
        for axis in AXES
        if place.number in numbers
    ]
    x, y, width, height = np.array(boxes).T
    left, top = int(x.min()), int(y.min())
    return left, top, int((x + width).max()) - left, int((y + height).max()) - top


def band_lights(camera: Camera, chart: Chart, sheet: Sheet) -> tuple[Certified, np.ndarray]:
    """Return the light of a chart by band, electrons/s (bands, rows, cols), 0 off a sheet's places.

    The certificate of all groups comes too; the others go by the plan of the first.
    """
    sensor = camera.sensor
    rates = np.zeros((len(sensor.channels), sensor.rows, sensor.cols))
    tiles = [rectangle(sensor, one) for one in sheet.groups]
    accuracy = Accuracy(TOLERANCE, PROBES)
    lights = certified_lights(camera, lit(chart), accuracy, tiles, samples=sheet.samples)
    for tile, light in zip(tiles, lights, strict=True):
        x, y, width, height = tile
        rates[:, y : y + height, x : x + width] = on_tile(light, tile)
    return pooled(lights, TOLERANCE), rates


def even_light(sensor: Sensor, predictor: Predictor, band: Band) -> np.ndarray:
    """Return the predicted light (rows, cols) of an even scene, over that on the axis."""
    rows, cols = sensor.rows, sensor.cols
    y, x = np.mgrid[:rows, :cols] + 0.5
    radius_px = np.hypot(x - cols / 2, y - rows / 2)
    return predictor.flat_field(radius_px * sensor.pixel_pitch_um, band)


@dataclass(frozen=True, eq=False)
class Edges:
    """All edges of all bands, and what they came from.

    Attributes
    ----------
    found : dict of (str, str, int) to Found
        By band, axis and number of the place.
    certificates : dict of str to Certified
        By what was rendered: the edges of each sheet, in all bands.
    tracer : str
        The program that predicted.
    independent : bool
        Whether it is not ours.
    """

    found: dict[tuple[str, str, int], Found]
    certificates: dict[str, Certified]
    tracer: str
    independent: bool

    @classmethod
    def of(cls, parts: Sequence[Edges]) -> Edges:
        """Return the edges of several charts, all predicted by one program."""
        found, certificates = {}, {}
        for one in parts:
            found |= one.found
            certificates |= one.certificates
        return cls(found, certificates, parts[0].tracer, parts[0].independent)

    def apart(self, band: str, axis: str, number: int) -> tuple[float, float]:
        """Return where a band's edge lies from the reference's: predicted and measured, px."""
        own, other = self.found[band, axis, number], self.found[REFERENCE, axis, number]
        return own.predicted_px - other.predicted_px, own.measured_px - other.measured_px

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        bars = []
        for axis in AXES:
            errors = [one.error_px for (_, own, _), one in self.found.items() if own == axis]
            name = f"position of near-{axis} edges, R, G, B"
            bars.append(Bar.largest(name, errors, POSITION_BAR_PX, "px"))
            for band in BANDS.replace(REFERENCE, ""):
                pairs = [self.apart(band, axis, place.number) for place in TABLE_1]
                name = f"{band} to {REFERENCE}, near-{axis} edges"
                errors = [measured - predicted for predicted, measured in pairs]
                bars.append(Bar.largest(name, errors, INTER_BAND_BAR_PX, "px"))
        for number, where in MTF_EDGES.items():
            errors = [self.found[band, "vertical", number].mtf_error for band in BANDS]
            bars.append(Bar.largest(f"MTF to 1 cycle/px, {where}, R, G, B", errors, MTF_BAR, "1"))
        name = f"certificates of {len(self.certificates)} renders of edges, total"
        return [*bars, certificate_bar(self.certificates, name)]


def measure_edges(
    rendered: Prescription,
    predictor: Predictor,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
    *,
    sheets: Collection[str] = tuple(SHEETS),
    axes: Collection[str] = AXES,
) -> Edges:
    """Render, measure and predict edges.

    Parameters
    ----------
    rendered : Prescription
        The lens of the renders.
    predictor : Predictor
        Predicts the lens by rays.
    progress : callable
        Called with (what, done, total).
    sheets : collection of str
        Names of `SHEETS`; by default all edges.
    axes : collection of str
        What the edges are nearer to; by default both.
    """
    found, certificates = {}, {}
    sensor = three_sensors()
    camera = Camera(lens=rendered, sensor=sensor, title="stand-in, three bands")
    own = {name: band_of(name) for name in sensor.channels}
    flat = {name: even_light(sensor, predictor, band) for name, band in own.items()}
    charts = [
        (where, target)
        for where in sheets
        for target in targets(predictor, sensor, SHEETS[where].numbers)
        if target.axis in axes
    ]
    for where, target in charts:
        what = f"near-{target.axis} edges {where}"
        progress(what, 0, 1)
        certificates[what], rates = band_lights(camera, target.chart, SHEETS[where])
        for place in (place for place in TABLE_1 if place.number in target.ideal_um):
            region = region_of(place, target.axis, sensor)
            for (name, band), rate in zip(own.items(), rates, strict=True):
                picture = cut(rate, region) / cut(flat[name], region)
                found[name, target.axis, place.number] = compare(
                    place, target, band, picture, sensor=sensor, predictor=predictor
                )
        progress(what, 1, 1)
    tracer = predictor.tracer
    return Edges(found, certificates, tracer.name, tracer.independent)

"""Cameras of the Samsung validation: three stand-in lenses before a sensor like the IMX477.

The paper names an IMX477 and M12 lenses of 106.8, 50.3 and 14.7 degrees, and publishes no
prescription. Lenses of the library are scaled so that chief rays at half of these angles land in
the corners of the sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from gpusim.camera import Camera
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import System, build, first_order
from gpusim.sensor.load import load_sensor
from gpusim.sensor.sensor import Sensor
from gpusim.validate.predict import Predictor
from gpusim.validate.tracers import OwnTracer, refracted_losses, tracer_of

SENSOR = "imx477"
REFERENCE_NM = 567.0  # of the field angle: the middle one of the paper's wavelengths
SPARE = 1.02  # of the field, beyond the sensor's corners
LINES_NM = {"B": 456.0, "G": REFERENCE_NM, "R": 656.0}  # the paper's
REACH_OF_FIELD = 0.8  # to which rays are traced: optiland aims at no more of a fisheye
LINE_NM = 5.0  # of the spectral samples, between two of which a line of light is shared
LINE_QE = 0.6  # of the channel that sees a line: near the sensor's own peaks


@dataclass(frozen=True)
class Optics:
    """A stand-in: which lens of the library, its full field in degrees, the stop if not its own."""

    name: str
    lens: str
    full_deg: float
    f_number: float | None = None


LENSES = (
    Optics("wide", "fisheye", 106.8),
    Optics("standard", "compact-6mm", 50.3, 2.8),
    Optics("tele", "telephoto", 14.7),
)
WIDE, STANDARD, TELE = LENSES


def corner_mm(sensor: Sensor) -> float:
    """Return the distance of a sensor's corners from its middle."""
    return 1e-3 * sensor.pixel_pitch_um * math.hypot(sensor.rows, sensor.cols) / 2


def lens_of(optics: Optics) -> Prescription:
    """Return a stand-in lens that covers the sensor by its field."""
    lens = load_prescription(optics.lens)
    if optics.f_number is not None:
        lens = lens.stopped(optics.f_number)
    half = np.radians([optics.full_deg / 2])
    reached_mm = float(OwnTracer(build(lens)).chief_mm(half, REFERENCE_NM)[0])
    efl_mm = first_order(lens).efl_mm * corner_mm(load_sensor(SENSOR)) / reached_mm
    return lens.scaled(efl_mm).limited(SPARE * optics.full_deg / 2)


def predictor_of(
    system: System,
    widest_rad: float,
    nodes_nm: np.ndarray,
    *,
    own: bool = False,
    pupils: int = 7,
) -> Predictor:
    """Return what predicts pictures before a lens: by optiland, or by our tracer."""
    losses = refracted_losses(system, nodes_nm)
    return Predictor(tracer_of(system, own=own), widest_rad, nodes_nm, losses, pupils=pupils)


@cache
def lines_predictor(optics: Optics, own: bool) -> Predictor:
    """Return what predicts pictures of a stand-in at the paper's wavelengths."""
    widest = REACH_OF_FIELD * math.radians(optics.full_deg / 2)
    nodes = np.array(sorted(LINES_NM.values()))
    return predictor_of(build(lens_of(optics)), widest, nodes, own=own, pupils=9)


def lines_sensor(pattern: list[list[str]], lines_nm: dict[str, float]) -> Sensor:
    """Return the sensor with filters that each pass one wavelength, and without veiling glare.

    A wavelength between two spectral samples is shared by them, so that it is their mean.
    """
    sensor = load_sensor(SENSOR)
    grid = np.arange(400.0, 701.0, LINE_NM)
    curves = {
        name: (LINE_QE * np.clip(1 - np.abs(grid - nm) / LINE_NM, 0, None)).tolist()
        for name, nm in lines_nm.items()
    }
    changes = {
        "cfa": sensor.cfa.model_copy(update={"pattern": pattern}),
        "quantum_efficiency": sensor.quantum_efficiency.model_copy(
            update={"wavelengths_nm": grid.tolist(), "channels": curves}
        ),
        "veiling_glare": 0.0,
    }
    return sensor.model_copy(update=changes)


def camera_of(optics: Optics, lens: Prescription, sensor: Sensor) -> Camera:
    """Return a stand-in before a sensor."""
    return Camera(lens=lens, sensor=sensor, title=f"{optics.name}, {optics.full_deg} deg")

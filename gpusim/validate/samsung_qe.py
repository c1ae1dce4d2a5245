"""Quantum efficiency by field of the Samsung validation (its figure 5), with the Gr/Gb split.

An even scene is rendered on a sensor whose pixels answer by wavelength and angle: the map of the
library's `eqe-sample`, with micro-lenses shifted less than this lens asks for. At places of the
picture each channel's electrons over the photons that arrive at a pixel are its mean quantum
efficiency. The engine folds the map over the cone of rays and a decomposition over the azimuth;
here it is averaged directly over an independent tracer's rays (`gpusim.validate.averaging`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.lens.prescription import Prescription
from gpusim.plan import Accuracy
from gpusim.scene import make_scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.load import load_sensor
from gpusim.sensor.sensor import Sensor
from gpusim.validate.averaging import Averaging, photons_per_s
from gpusim.validate.bars import Bar
from gpusim.validate.certified import Certified, certified_tiles, pooled
from gpusim.validate.predict import Predictor
from gpusim.validate.samsung_camera import SENSOR, STANDARD, camera_of

MAP = "eqe-sample"
TOLERANCE, PROBES = 1e-3, 4  # of a tile, whose pixels differ in their channel alone
EXPOSURE_S = 1 / 60
SIDE_PX = 16  # of the tiles that are averaged: over them the efficiency is straight to 1e-6
PLACES_MM = ((0, 0), (1.5, 0), (3, 0), (0, 1.1), (0, 2.2), (-1.5, 1.1), (-3, 2.2), (3, 2.2))
CHANNELS = ("R", "Gr", "Gb", "B")
QE_BAR = 1e-3
SHOWN_NM = np.arange(400.0, 701.0, 10.0)


@dataclass(frozen=True, eq=False)
class Place:
    """Mean efficiencies of the channels at a place of the picture."""

    x_mm: float
    y_mm: float
    measured: dict[str, float]
    predicted: dict[str, float]

    def split(self, values: dict[str, float]) -> float:
        """Return Gr over Gb less 1."""
        return values["Gr"] / values["Gb"] - 1


@dataclass(frozen=True, eq=False)
class Efficiency:
    """All places, and spectra by direct averaging at the first and the farthest one.

    ``curves`` holds efficiencies (W,) at `SHOWN_NM` by (number of the place, channel).
    """

    places: Sequence[Place]
    curves: dict[tuple[int, str], np.ndarray]
    certificates: dict[str, Certified]

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        errors = [
            one.measured[name] / one.predicted[name] - 1 for one in self.places for name in CHANNELS
        ]
        splits = [one.split(one.measured) - one.split(one.predicted) for one in self.places]
        return [
            Bar.largest("QE by field, folded against averaged directly", errors, QE_BAR, "of it"),
            Bar.largest("Gr over Gb by field, the same", splits, QE_BAR, "1"),
        ]


def angular_sensor() -> Sensor:
    """Return the sensor with an efficiency that goes with the angle."""
    sensor, angular = load_sensor(SENSOR), load_sensor(MAP)
    names = ("cfa", "quantum_efficiency", "eqe_map", "micro_lens")
    changes = {name: getattr(angular, name) for name in names}
    return sensor.model_copy(update=changes | {"veiling_glare": 0.0})


def measure_qe(lens: Prescription, predictor: Predictor) -> Efficiency:
    """Render an even scene, and average the map directly at places."""
    sensor = angular_sensor()
    camera, scene = camera_of(STANDARD, lens, sensor), make_scene("grey")
    pitch_mm = 1e-3 * sensor.pixel_pitch_um
    tiles = [
        (*(2 * round((side / 2 + at / pitch_mm - SIDE_PX / 2) / 2)
           for side, at in ((sensor.cols, x_mm), (sensor.rows, y_mm))), SIDE_PX, SIDE_PX)
        for x_mm, y_mm in PLACES_MM
    ]  # fmt: skip
    # The farthest comes first: the bank is judged there.
    captures = certified_tiles(camera, scene, Accuracy(TOLERANCE, PROBES), EXPOSURE_S, tiles[::-1])[
        ::-1
    ]
    averaging, places, curves = Averaging(sensor, predictor), [], {}
    sites = np.tile(np.array(sensor.cfa.pattern), (SIDE_PX // 2, SIDE_PX // 2))
    for number, ((left, top, _, _), capture) in enumerate(zip(tiles, captures, strict=True)):
        x, y = (
            (start + SIDE_PX / 2 - side / 2) * pitch_mm
            for start, side in ((left, sensor.cols), (top, sensor.rows))
        )
        photons = photons_per_s(scene, predictor, sensor, math.hypot(x, y))
        found = averaging.at(x, y, WAVELENGTHS_NM)
        places.append(
            Place(
                x,
                y,
                {n: float(capture.rate[sites == n].mean() / photons.sum()) for n in CHANNELS},
                {n: float(photons @ found[n] / photons.sum()) for n in CHANNELS},
            )
        )
        at = np.isin(WAVELENGTHS_NM, SHOWN_NM)
        curves |= {(number, name): found[name][at] for name in CHANNELS}
    # As they were taken: the first has the bank's part.
    certified = pooled(captures[::-1], TOLERANCE)
    return Efficiency(places, curves, {"efficiency": certified})

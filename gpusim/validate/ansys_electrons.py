"""The Ansys paper's equation 1: electrons of an even scene by a map of efficiencies over angle.

    N = t sum over l of (l / h c) <EQE(l)> I(l) A,

with I the irradiance at the pixel and < > the mean over the rays that arrive there. The engine
folds the map over the lens's cone; here it is averaged directly over rays through spheres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gpusim.camera import Camera
from gpusim.plan import Accuracy
from gpusim.render import Capture
from gpusim.scene.scene import Scene
from gpusim.validate.ansys import EXPOSURE_S, PROBES
from gpusim.validate.averaging import Averaging, photons_per_s
from gpusim.validate.bars import Bar
from gpusim.validate.certified import certificate_bar, certificates_of, certified_tiles
from gpusim.validate.predict import Band, Predictor

EVEN_AT = ((0, 0), (0.5, 0), (0, 0.9), (0.9, 0.9))  # of the way to the sides, right and down
EVEN = 8  # pixels of the tiles over which electrons are averaged
BAR = 1e-3
LEAN_NM = 550.0


@dataclass(frozen=True, eq=False)
class Electrons:
    """Electrons of an even scene at a place, mm: rendered, and by equation 1 from rays.

    With the mean efficiency there, and how far the middle of the cone leans at 550 nm, deg.
    """

    x_mm: float
    y_mm: float
    measured: float
    predicted: float
    efficiency: float
    lean_deg: float


@dataclass(frozen=True, eq=False)
class EvenScene:
    """Electrons of an even scene at places of the picture, and a capture with its certificate."""

    places: list[Electrons]
    capture: Capture

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        errors = [one.measured / one.predicted - 1 for one in self.places]
        certificates = certificates_of({"even scene": self.capture}, BAR)
        return [
            Bar.largest("electrons by equation 1", errors, BAR, "of them"),
            certificate_bar(certificates, "certificate of the even scene, total"),
        ]


def electrons_of(camera: Camera, scene: Scene, predictor: Predictor, band: Band) -> EvenScene:
    """Return electrons of an even scene at places of a square picture.

    Parameters
    ----------
    camera : Camera
        Its sensor has efficiencies by angle.
    scene : Scene
    predictor : Predictor
        It predicts the whole picture.
    band : Band
        Whose wavelengths the sensor sees.
    """
    sensor, nm = camera.sensor, band.wavelengths_nm
    pitch_mm, side = 1e-3 * sensor.pixel_pitch_um, sensor.cols
    averaging, found = Averaging(sensor, predictor), []
    tiles = [
        (round(side / 2 * (1 + x) - EVEN / 2), round(side / 2 * (1 + y) - EVEN / 2), EVEN, EVEN)
        for x, y in EVEN_AT
    ]
    captures = certified_tiles(camera, scene, Accuracy(BAR, PROBES), EXPOSURE_S, tiles)
    for (left, top, _, _), capture in zip(tiles, captures, strict=True):
        x_mm, y_mm = ((at + (EVEN - side) / 2) * pitch_mm for at in (left, top))
        away_mm = math.hypot(x_mm, y_mm)
        photons = photons_per_s(scene.on(nm), predictor, sensor, away_mm)
        (share,) = averaging.at(x_mm, y_mm, nm).values()
        measured = float(capture.rate.mean()) * EXPOSURE_S
        predicted, efficiency = float(photons @ share), float(photons @ share / photons.sum())
        (field,) = predictor.field_rad(np.array([1e3 * away_mm]), LEAN_NM)
        share, radial, _ = predictor.cone(field, list(predictor.nodes_nm).index(LEAN_NM)).T
        lean_deg = math.degrees(math.asin(float(share @ radial)))
        places = x_mm, y_mm, measured, predicted * EXPOSURE_S
        found.append(Electrons(*places, efficiency, lean_deg))
    return EvenScene(found, captures[0])

"""The Ansys paper's equation 1: electrons of an even scene by a map of efficiencies over angle.

    N = t sum over l of (l / h c) <EQE(l)> I(l) A,

with I the irradiance at the pixel and < > the mean over the rays that arrive there. The engine
folds the map over the lens's cone; here it is averaged directly over rays through spheres.

Rays do not bend about the pupil's rim, but light does. Where the lens's field ends, nothing from
beyond it makes good what is bent out: 0.1 mm from there an even scene lacks 0.15 %. An elliptic
pupil of half-widths a and b in direction cosines has, far from its image and on the average over
the fringes, the point spread

    h(r, theta) = lambda rho(theta) / (2 pi^2 pi a b r^3),
    rho = (a b)^2 / (a^2 cos^2 theta + b^2 sin^2 theta)^(3/2),

rho the radius of its rim's curvature where that faces theta (Keller 1962, geometrical theory of
diffraction). For a circle it is the mean of Airy's rings, lambda N / (pi^3 r^3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gpusim.camera import Camera
from gpusim.plan import Accuracy
from gpusim.scene.scene import Scene
from gpusim.validate.ansys import EXPOSURE_S
from gpusim.validate.averaging import Averaging, photons_per_s
from gpusim.validate.bars import Bar
from gpusim.validate.certified import Certified, certificate_bar, certified_tiles, pooled
from gpusim.validate.predict import Band, Predictor

EVEN_AT = ((0, 0), (0.5, 0), (0, 0.9), (0.9, 0.9))  # of the way to the sides, right and down
EVEN = 8  # pixels of the tiles over which electrons are averaged
BAR = 1e-3
TOLERANCE = BAR / 2  # of the renders: rays and closed form have the rest
LEAN_NM = 550.0
TURN = 720  # directions about a place towards the rim of the field


@dataclass(frozen=True, eq=False)
class Electrons:
    """Electrons of an even scene at a place, mm: rendered, and by equation 1 from rays.

    With the mean efficiency there, how far the middle of the cone leans at 550 nm, deg, and the
    share of the light that is bent over the rim of the field; the prediction is less by it.
    """

    x_mm: float
    y_mm: float
    measured: float
    predicted: float
    efficiency: float
    lean_deg: float
    past_rim: float


@dataclass(frozen=True, eq=False)
class EvenScene:
    """Electrons of an even scene at places of the picture, and the renders' certificate."""

    places: list[Electrons]
    certificate: Certified

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        errors = [one.measured / one.predicted - 1 for one in self.places]
        return [
            Bar.largest("electrons by equation 1", errors, BAR, "of them"),
            certificate_bar({"": self.certificate}, "certificate of the even scene, total"),
        ]


def electrons_of(
    camera: Camera, scene: Scene, predictor: Predictor, band: Band, *, rim_mm: float
) -> EvenScene:
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
    rim_mm : float
        Where the lens's field ends, from the axis.
    """
    sensor, nm = camera.sensor, band.wavelengths_nm
    pitch_mm, side = 1e-3 * sensor.pixel_pitch_um, sensor.cols
    averaging, found = Averaging(sensor, predictor), []
    tiles = [
        (round(side / 2 * (1 + x) - EVEN / 2), round(side / 2 * (1 + y) - EVEN / 2), EVEN, EVEN)
        for x, y in EVEN_AT
    ]
    accuracy = Accuracy(TOLERANCE, 1)  # pixels of an even tile are all alike
    captures = certified_tiles(camera, scene, accuracy, EXPOSURE_S, tiles)
    for (left, top, _, _), capture in zip(tiles, captures, strict=True):
        x_mm, y_mm = ((at + (EVEN - side) / 2) * pitch_mm for at in (left, top))
        away_mm = math.hypot(x_mm, y_mm)
        photons = photons_per_s(scene.on(nm), predictor, sensor, away_mm)
        (share,) = averaging.at(x_mm, y_mm, nm).values()
        measured, reached = float(capture.rate.mean()) * EXPOSURE_S, photons @ share
        bent = _bent(predictor, away_mm, rim_mm, nm)
        lost, efficiency = float(photons * share @ bent / reached), reached / photons.sum()
        (field,) = predictor.field_rad(np.array([1e3 * away_mm]), LEAN_NM)
        share, radial, _ = predictor.cone(field, list(predictor.nodes_nm).index(LEAN_NM)).T
        lean_deg = math.degrees(math.asin(float(share @ radial)))
        predicted = float(reached) * (1 - lost) * EXPOSURE_S
        found.append(Electrons(x_mm, y_mm, measured, predicted, float(efficiency), lean_deg, lost))
    return EvenScene(found, pooled(captures, TOLERANCE))


def _bent(
    predictor: Predictor, away_mm: float, rim_mm: float, wavelengths_nm: np.ndarray
) -> np.ndarray:
    """Return the share (K,) of a place's light that is bent over the rim of the field."""
    found = []
    for line, node in enumerate(predictor.nodes_nm):
        (field,) = predictor.field_rad(np.array([1e3 * away_mm]), node)
        share, radial, across = predictor.cone(field, line).T
        # A filled ellipse's variance along a half-axis is a quarter of its square.
        variances = share @ (radial - share @ radial) ** 2, share @ across**2
        half = 2 * math.sqrt(variances[0]), 2 * math.sqrt(variances[1])
        found.append(past_rim(half, 1e3 * away_mm, 1e3 * rim_mm, 1e-3 * node))
    return np.interp(wavelengths_nm, predictor.nodes_nm, found)


def past_rim(half: tuple[float, float], away_um: float, rim_um: float, wave_um: float) -> float:
    """Return the share of light that diffraction throws out of a round field: see the head.

    Parameters
    ----------
    half : tuple of float
        Half-widths of the pupil in direction cosines, along the radius and across it.
    away_um, rim_um : float
        Distances of the place and of the field's rim from the axis; the place lies within.
    wave_um : float
    """
    a, b = half
    theta = 2 * math.pi * (np.arange(TURN) + 0.5) / TURN
    outwards, aside = np.cos(theta), np.sin(theta)
    to_rim_um = np.sqrt(rim_um**2 - (away_um * aside) ** 2) - away_um * outwards
    curved = (a * b) ** 2 / ((a * outwards) ** 2 + (b * aside) ** 2) ** 1.5
    # The integral of h r dr from the rim outwards is h r^2 there.
    return wave_um / (math.pi**2 * a * b) * float(np.mean(curved / to_rim_um))

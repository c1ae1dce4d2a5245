"""The largest mean signal that a scene can make, for tolerances in sigmas; that of its white."""

from __future__ import annotations

import numpy as np

from gpusim.optics.angular import AngularResponse
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.psf.field_bank import FieldBank
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor


def brightest_e(bank: FieldBank, sensor: Sensor, scene: Scene, exposure_s: float) -> float:
    """Return a bound of the mean electrons of any pixel.

    The brightest material or sample in the channel that sees most of it, as if it filled the frame,
    at the place where the lens passes most light, with veiling glare; where the quantum efficiency
    goes with the place, with the largest at each wavelength.
    """
    illumination = bank.relative_illumination
    passed = illumination.reshape(-1, illumination.shape[-1]).max(axis=0)
    lines, qe = scene.wavelengths_nm, None
    if sensor.eqe_map is not None:
        qe = AngularResponse(bank, sensor, lines).largest
    weights = spectral_weights(bank, sensor, qe, lines)
    rates = np.einsum("clw,mw,l->cm", weights, scene.spectra, passed)
    if not isinstance(scene.source, Chart):
        planes = scene.source.planes
        rates = np.array([np.tensordot(row, planes, axes=1).max() for row in rates])
    rate = float(rates.max()) * (1 + sensor.veiling_glare)
    return rate * exposure_s if rate > 0 else 0.0  # also of an endless exposure


def white_rates(bank: FieldBank, sensor: Sensor, scene: Scene) -> dict[str, float]:
    """Return the mean electrons/s that the scene's white makes on the axis, by channel."""
    weights = spectral_weights(bank, sensor, wavelengths_nm=scene.wavelengths_nm)
    white = np.einsum("clw,w->c", weights, scene.white)
    return {name: float(rate) for name, rate in zip(sensor.channels, white, strict=True)}

"""A plan for the same lens at other focus or stop: other kernels, all else as it is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gpusim.optics.images import field_images
from gpusim.optics.kernels import field_kernels
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan import Plan
from gpusim.psf.field_bank import FieldBank
from gpusim.sensor.sensor import Sensor


def refocused(plan: Plan, bank: FieldBank, sensor: Sensor) -> Plan:
    """Return a plan that convolves whole PSFs by transforms, with those of another bank."""
    basis, (scale,) = plan.basis, plan.scales
    if basis.elsewhere is None:
        response = spectral_weights(bank, sensor, wavelengths_nm=basis.wavelengths_nm)
        basis = replace(basis, response=response)
        basis = replace(basis, weights=basis.rates.sum(axis=-1))
    reach_um = math.hypot(sensor.rows, sensor.cols) / 2 * sensor.pixel_pitch_um
    images, places = field_images(
        bank,
        basis.rates,
        reach_um,
        elsewhere=basis.elsewhere,
        wavelengths_nm=basis.wavelengths_nm,
    )
    whole = np.ones(images.shape[-2:])
    kernels = field_kernels(images, places, bank.pitch_um, scale.pitch_um, whole)
    return replace(plan, basis=basis, scales=(replace(scale, kernels=kernels),))

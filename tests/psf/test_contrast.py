"""MTF over the field against the transfer functions of single fields."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.formats.lens_file import load_prescription
from gpusim.lens.analysis.fields import WHITE_NM, WHITE_REFERENCE, white_light
from gpusim.lens.entering import stretch
from gpusim.lens.system import build
from gpusim.psf.contrast import field_contrast
from gpusim.psf.otf import DIRECTIONS, field_pupils
from gpusim.psf.sampling import REFERENCE_NM


@pytest.mark.parametrize("field_deg", [0.0, 20.0])
def test_it_is_the_mtf_of_the_fields_own_transfer_function(field_deg: float):
    # Lateral colour of 27 um: at 20 cycles/mm it takes away much of the tangential MTF.
    system = build(load_prescription("tessar").stopped(8))
    light, theta, frequency = white_light(system), np.radians(field_deg), np.array([10.0, 20.0])
    found = field_contrast(system, theta, WHITE_NM, light, frequency)
    exact = field_pupils(system, theta, WHITE_NM, light, reference=WHITE_REFERENCE)
    expected = [np.abs(exact.otf(frequency, way)) for way in DIRECTIONS]
    # `gpusim.psf.otf.COARSE_NODES`: 1e-3 of the rim's rounding.
    np.testing.assert_allclose(found.mtf, expected, rtol=0, atol=2e-3)
    area = stretch(system, REFERENCE_NM, theta).area()
    whole = np.array([pupil.entered for pupil in exact.fine]) / area
    np.testing.assert_allclose(found.light_sr, whole, rtol=1e-3)


def test_a_field_along_x_has_the_mtf_of_one_along_y_turned():
    system = build(load_prescription("double-gauss").scaled(8.3).stopped(2.8))
    light, theta, frequency = white_light(system), np.radians(12.0), np.array([40.0, 120.0])
    along_y = field_pupils(system, theta, WHITE_NM, light, reference=WHITE_REFERENCE)
    along_x = field_pupils(
        system, theta, WHITE_NM, light, reference=WHITE_REFERENCE, azimuth=np.pi / 2
    )
    np.testing.assert_allclose(along_x.shift_um, along_y.shift_um[::-1], atol=1e-5)
    for way, other in zip(DIRECTIONS, reversed(DIRECTIONS), strict=True):
        np.testing.assert_allclose(
            np.abs(along_x.otf(frequency, way)), np.abs(along_y.otf(frequency, other)), atol=2e-3
        )

"""Lens-shading correction against the reference."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import F32, ULP, through

from gpusim.gpu import Device
from gpusim.isp.shading import Shading, record_shading
from gpusim.reference.shading import shading

GIVEN = Shading((0.4, 0.25, -0.1, 0.05, 0.02), (0.47, 0.55))


@pytest.mark.parametrize("first", [(0, 0), (-12, -13), (40, 8)])
def test_the_gain_is_that_of_the_reference(device: Device, first: tuple[int, int]):
    ones = np.full((45, 68), 1, F32)
    frame = (90, 120)
    found = through(
        device, ones, lambda rec, light: record_shading(rec, light, GIVEN, frame, first)
    )
    expected = shading(ones.shape, GIVEN.k, GIVEN.axis, frame, first)
    # Places of up to 100 pixels are exact to 100 ULP of one; a gain of slope 2 in r and some sums.
    assert_close(found, expected, atol=24 * ULP)


def test_light_is_scaled(device: Device):
    light = np.random.default_rng(2).uniform(0, 1, (20, 24)).astype(F32)
    given = (20, 24), (0, 0)
    found = through(device, light, lambda rec, one: record_shading(rec, one, GIVEN, *given))
    assert_close(found, light * shading(light.shape, GIVEN.k, GIVEN.axis, *given), atol=24 * ULP)

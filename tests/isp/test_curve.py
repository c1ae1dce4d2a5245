"""The tone curve against the reference."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import F32, ULP, through
from scipy.interpolate import PchipInterpolator

from gpusim.gpu import Device
from gpusim.isp.curve import STEPS, record_curve
from gpusim.reference.curve import curve

POINTS = [(0.0, 0.02), (0.2, 0.1), (0.6, 0.75), (1.0, 0.98)]
VALUES = np.concatenate(
    [[-1, 0, 1, 3], np.random.default_rng(4).uniform(0, 1, 1000), np.linspace(0, 1, 20)]
).astype(F32)


@pytest.mark.parametrize("points", [POINTS, [(0.0, 0.0), (1.0, 1.0)], [(0.0, 1.0), (1.0, 0.0)]])
def test_values_are_those_of_the_reference(device: Device, points):
    found = through(device, VALUES, lambda rec, values: record_curve(rec, values, points))
    smooth = PchipInterpolator(*np.transpose(points))
    table = smooth(np.linspace(0, 1, STEPS + 1))
    # Places between entries are rounded to 2^-14 of a step of up to 2.5 / 1024; entries to f32.
    assert_close(found, curve(VALUES, table), atol=6 * ULP)
    # Between entries the curve itself is 1e-6 off (see STEPS; second derivatives up to 8).
    assert_close(found, smooth(np.clip(VALUES, 0, 1).astype(float)), atol=3e-6)

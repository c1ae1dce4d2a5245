"""White balance against the reference."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import ULP, scene, through

from gpusim.gpu import Device
from gpusim.isp.balance import record_balance
from gpusim.reference.balance import balance


@pytest.mark.parametrize("period", [(1, 1), (2, 2), (6, 6), (4, 3)])
@pytest.mark.parametrize("shape", [(1, 4), (35, 68)])
def test_light_is_that_of_the_reference(device: Device, period, shape):
    gain = np.random.default_rng(period[1]).uniform(1, 3, period)
    light = scene(*shape, 5)
    found = through(device, light, lambda rec, given: record_balance(rec, given, gain))
    # The gain and the product are rounded.
    assert_close(found, balance(light, gain), rtol=2.5 * ULP)
    assert found.max() == 1 or shape == (1, 4)

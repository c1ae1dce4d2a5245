"""Exposure and highlight roll-off against the reference."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import F32, ULP, through

from gpusim.gpu import Device
from gpusim.isp.libraw import toned
from gpusim.isp.roll_off import record_roll_off
from gpusim.reference.roll_off import roll_off

LIGHT = np.concatenate([[-0.5, 0, 0.25, 1.0], np.linspace(-0.1, 1.0, 1020)]).astype(F32)


def found(device: Device, ev: float, share: float) -> np.ndarray:
    return through(device, LIGHT, lambda rec, light: record_roll_off(rec, light, ev, share))


@pytest.mark.parametrize("ev", [-6.0, -1.0, -0.1, 0.0, 0.3, 1.0, 4.0])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_light_is_that_of_the_reference(device: Device, ev: float, share: float):
    # Slope and product are rounded, of values up to 2^ev; below white, what bends is less steep.
    assert_close(
        found(device, ev, share), roll_off(LIGHT, ev, share), atol=8 * ULP * 2 ** max(ev, 0)
    )


@pytest.mark.parametrize("ev", [-2.0, -0.3, 0.0, 1.5])
def test_without_a_roll_off_it_is_as_the_other_engine_shows_it(device: Device, ev: float):
    lit = LIGHT >= 0
    assert_close(found(device, ev, 0.0)[lit], toned(LIGHT.astype(float), ev)[lit], atol=16 * ULP)


@pytest.mark.parametrize("ev", [0.5, 2.0])
def test_highlights_rise_to_white_and_not_beyond(device: Device, ev: float):
    rising = found(device, ev, 0.3)[4:]
    assert np.all(np.diff(rising) > 0)
    assert rising[-1] == pytest.approx(1, abs=4 * ULP)
    # What is below the knee is scaled, and nothing else.
    dark = LIGHT[4:] * 2**ev < 0.69
    assert_close(rising[dark], LIGHT[4:][dark] * 2**ev, atol=4 * ULP)

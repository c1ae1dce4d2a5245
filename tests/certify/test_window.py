"""Light beyond the widest level of a halo: it counts only where it can land on the sensor."""

from dataclasses import replace

import numpy as np
import pytest
from optics.made import bank, sensor

from gpusim.certify.bank import beyond
from gpusim.plan import Accuracy
from gpusim.psf.halo import LAST_FALLS_FROM, SIZE

SENSOR = sensor()
RATE = np.full((SENSOR.rows, SENSOR.cols), 100.0)
SHARE = 3e-3


def window(reach_um: float) -> tuple[float, tuple[str, ...]]:
    """Return what is said of a bank whose only level of a halo reaches so far."""
    plain = bank(size=32)
    fields, lines = plain.psf.shape[:2]
    held = replace(
        plain,
        halo=np.full((1, fields, lines, SIZE, SIZE), 1e-3 / SIZE**2, np.float32),
        halo_pitch_um=np.array([2 * reach_um / SIZE]),
        beyond_energy=np.full((fields, lines), SHARE),
        halo_misfit=np.zeros((fields, lines)),
    )
    return beyond(held, SENSOR, RATE, (0, 0), 0.01, Accuracy(1e-3))


def test_light_that_can_only_land_beside_the_sensor_costs_nothing():
    corner_um = SENSOR.pixel_pitch_um * np.hypot(SENSOR.rows, SENSOR.cols) / 2
    farthest_um = corner_um + bank(size=32).rectilinear_circle_um
    near, _ = window(0.99 * farthest_um / LAST_FALLS_FROM)
    far, words = window(1.01 * farthest_um / LAST_FALLS_FROM)
    # An even scene lacks that share of itself, against what there would be with it.
    assert near == pytest.approx(SHARE / (1 + SHARE), rel=1e-6)
    assert far == 0.0 and "beside the sensor" in words[0]

"""Light beyond the widest level of a halo: it counts as far as it can land on the sensor."""

from dataclasses import replace

import numpy as np
import pytest
from optics.made import bank, sensor

from gpusim.certify import Measure, Placed
from gpusim.certify.bank import beyond
from gpusim.plan import Accuracy
from gpusim.psf.beyond import landing_share
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.halo import LAST_FALLS_FROM, SIZE

SENSOR = sensor()
RATE = np.full((SENSOR.rows, SENSOR.cols), 100.0)
SHARE = 3e-3
CIRCLE_UM = bank(size=32).rectilinear_circle_um
CORNER_UM = SENSOR.pixel_pitch_um * np.hypot(SENSOR.rows, SENSOR.cols) / 2


def held(from_um: float) -> FieldBank:
    """Return a bank whose only level of a halo begins to fall so far from the chief ray."""
    plain = bank(size=32)
    fields, lines = plain.psf.shape[:2]
    return replace(
        plain,
        halo=np.full((1, fields, lines, SIZE, SIZE), 1e-3 / SIZE**2, np.float32),
        halo_pitch_um=np.array([2 * from_um / LAST_FALLS_FROM / SIZE]),
        beyond_energy=np.full((fields, lines), SHARE),
        halo_misfit=np.zeros((fields, lines)),
    )


def window(from_um: float) -> tuple[float, tuple[str, ...]]:
    """Return what is said of such a bank before an even scene."""
    return beyond(
        held(from_um), Placed(RATE, (0, 0, *RATE.shape)), Measure(SENSOR, 0.01, Accuracy(1e-3))
    )


def test_light_that_can_only_land_beside_the_sensor_costs_nothing():
    far, words = window(1.01 * (CORNER_UM + CIRCLE_UM))
    assert far == 0.0 and "beside the sensor" in words[0]
    near, words = window(0.9 * (CORNER_UM + CIRCLE_UM))
    assert 0.0 < near < 1e-2 * SHARE and "on pixels" in words[0]


def test_all_of_it_costs_where_it_lands_near_by():
    # Beyond a thousandth of the circle's radius, as good as none lands beside it.
    near, _ = window(1e-3 * CIRCLE_UM)
    assert near == pytest.approx(SHARE / (1 + SHARE), rel=5e-3)


def test_shares_are_those_of_an_even_disc():
    from_um = 0.6 * CIRCLE_UM
    middle, rim = landing_share(held(from_um), np.array([0.0, CIRCLE_UM]))
    assert middle == pytest.approx(1 - 0.6, rel=1e-12)
    # At the rim chords are 2 R cos theta: up to alpha, where they are as long as the distance.
    alpha = np.arccos(0.3)
    chords = np.log(1 / np.cos(alpha) + np.tan(alpha))
    assert rim == pytest.approx((2 * alpha - 0.6 * chords) / (2 * np.pi), rel=5e-3)
    # A sum over the disc's own points, half-way out.
    line = (np.arange(2000) + 0.5) / 1000 - 1
    x, y = np.meshgrid(line * CIRCLE_UM, line * CIRCLE_UM)
    r = np.hypot(x - CIRCLE_UM / 2, y)
    far = (np.hypot(x, y) < CIRCLE_UM) & (r > from_um)
    summed = from_um / (2 * np.pi) * np.sum(r[far] ** -3.0) * (CIRCLE_UM / 1000) ** 2
    (half,) = landing_share(held(from_um), np.array([CIRCLE_UM / 2]))
    assert half == pytest.approx(summed, rel=5e-3)


def test_without_a_halo_all_of_it_counts():
    assert landing_share(bank(size=32), np.array([0.0, 50.0])).tolist() == [1.0, 1.0]

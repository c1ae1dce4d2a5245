"""Defects: the stage against its reference; lists and chances; where they come in the read-out."""

import numpy as np
import pytest
from harness import assert_close, run_stage
from scipy.stats import binom, kstest

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.defects import defects
from gpusim.sensor.defects import defects_of, record_defects, record_stuck
from gpusim.sensor.load import load_sensor
from gpusim.sensor.noise_model import Defects
from gpusim.sensor.sensor import Sensor

F32 = np.float32
LEVEL = 1e-3


def sensor_with(rows: int = 40, cols: int = 60, **fields) -> Sensor:
    whole = load_sensor("imx477").model_copy(update={"rows": rows, "cols": cols})
    return whole.model_copy(update={"defects": Defects(**fields)})


def test_pixels_of_a_list_are_changed_and_no_others():
    rng = np.random.default_rng(71)
    plane = rng.uniform(0, 100, (30, 70)).astype(F32)
    places = np.sort(rng.choice(plane.size, 200, replace=False)).astype(np.uint32)
    keep = rng.choice([0, 1], places.size).astype(F32)
    add = rng.uniform(0, 100, places.size).astype(F32)
    found = run_stage(
        "sensor/defects",
        (4, 1, 1),
        {"count": places.size, "limit_e": 120.0},
        {"at": places, "keep": keep, "add": add, "plane": plane.ravel()},
        {"plane": (plane.size, F32)},
    )["plane"]
    pairs = [divmod(int(place), 70) for place in places]
    expected = defects(plane.astype(float), pairs, keep, add, 120.0)
    assert_close(found.reshape(plane.shape), expected, rtol=2.0**-24)  # one rounding, of the sum
    untouched = np.ones(plane.size, bool)
    untouched[places] = False
    assert np.array_equal(found[untouched], plane.ravel()[untouched])
    assert found.max() == 120.0


LIST = [
    {"row": 3, "col": 5, "kind": "dead"},
    {"row": 0, "col": 59, "kind": "hot", "value": 200.0},
    {"row": 39, "col": 0, "kind": "stuck", "value": 1234.0},
]


def recorded(device: Device, sensor: Sensor, rect: tuple[int, int, int, int]) -> np.ndarray:
    rec = Recording(device)
    plane = rec.buffer("plane", rect[2:], F32)
    rec.upload(plane, np.full(rect[2:], 100, F32))
    record_defects(rec, plane, sensor, 0.5, temperature_c=25 + 5.9, origin=rect[:2])
    record_stuck(rec, plane, sensor, origin=rect[:2])
    label = rec.download(plane)
    return rec.run()[label]


def test_each_kind_does_what_it_is_called(device: Device):
    found = recorded(device, sensor_with(pixels=LIST), (0, 0, 40, 60))
    expected = np.full((40, 60), 100.0)
    # 0.5 s at one doubling: dark current 1 e-/s, 1 e- in all; 200 e-/s, 200 e-
    expected[3, 5], expected[0, 59], expected[39, 0] = 1.0, 300.0, 1234.0
    assert_close(found, expected, rtol=2.0**-23)


def test_a_tile_has_its_part_of_the_defects(device: Device):
    sensor = sensor_with(pixels=LIST, hot_fraction=0.02, hot_e_per_s=50.0)
    whole = recorded(device, sensor, (0, 0, 40, 60))
    for row, col, rows, cols in ((2, 4, 5, 9), (30, 0, 10, 60), (0, 0, 1, 1)):
        part = recorded(device, sensor, (row, col, rows, cols))
        assert_close(part, whole[row : row + rows, col : col + cols].copy(), atol=0)


def test_a_region_keeps_its_pixels(device: Device):
    sensor = sensor_with(pixels=LIST, stuck_fraction=0.02)
    whole, region = recorded(device, sensor, (0, 0, 40, 60)), sensor.roi(20, 28)
    part = recorded(device, region, (0, 0, 20, 28))
    row, col = region.first_row, region.first_col
    assert_close(part, whole[row : row + 20, col : col + 28].copy(), atol=0)


def test_chance_makes_as_many_as_it_should():
    fractions = {"dead_fraction": 0.01, "hot_fraction": 0.03, "stuck_fraction": 0.005}
    sensor = sensor_with(500, 400, **fractions, hot_e_per_s=80.0)
    found = defects_of(sensor)
    for kind, fraction in zip(("dead", "hot", "stuck"), fractions.values(), strict=True):
        low, high = binom.interval(1 - LEVEL / 3, 200_000, fraction)
        assert low <= sum(one == kind for one, _ in found.values()) <= high
    hot = [value / 80 for kind, value in found.values() if kind == "hot"]
    stuck = [value / 8180 for kind, value in found.values() if kind == "stuck"]
    assert kstest(hot, "expon").pvalue > LEVEL and kstest(stuck, "uniform").pvalue > LEVEL
    rows, cols = np.array(list(found)).T
    assert kstest(rows / 500, "uniform").pvalue > LEVEL
    assert kstest(cols / 400, "uniform").pvalue > LEVEL


def test_another_piece_has_other_defects():
    sensor = sensor_with(200, 200, dead_fraction=0.01)
    other = sensor.model_copy(update={"serial_number": 1})
    common = defects_of(sensor).keys() & defects_of(other).keys()
    assert len(common) < 20  # 4 by chance
    assert defects_of(sensor) == defects_of(sensor.model_copy(update={"name": "x"}))


def test_without_a_defect_inside_nothing_is_dispatched(device: Device):
    sensor = sensor_with(pixels=LIST)
    rec = Recording(device)
    plane = rec.buffer("plane", (5, 5), F32)
    rec.clear(plane)
    record_defects(rec, plane, sensor, 0.5, origin=(20, 20))
    record_stuck(rec, plane, sensor, origin=(20, 20))
    assert "sensor/defects" not in rec.run().times_s


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/defects").workgroup_size == (64, 1, 1)


@pytest.mark.parametrize("kind", ["dead", "hot", "stuck"])
def test_the_list_wins_over_chance(kind: str):
    value = None if kind == "dead" else 7.0
    sensor = sensor_with(20, 20, stuck_fraction=0.1)
    place = next(iter(defects_of(sensor)))
    pixel = {"row": place[0], "col": place[1], "kind": kind, "value": value}
    listed = sensor_with(20, 20, stuck_fraction=0.1, pixels=[pixel])
    assert defects_of(listed)[place] == (kind, value or 0.0)

"""The frame around the lit pixels: its areas, the stage, and what a sensor makes of its shield."""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten

from gpusim.gpu import Device, Recording
from gpusim.plan.stages import sensor_runs
from gpusim.reference.border import border
from gpusim.sensor.border import record_border
from gpusim.sensor.frame import Border, overlap, parts_around
from gpusim.sensor.load import load_sensor
from gpusim.sensor.readout import Shot, SiteLight, record_readout
from gpusim.sensor.sensor import Sensor

F32 = np.float32
BLACK = Border(top=4, bottom=3, left=6, right=1)


def on_device(inner: np.ndarray, top: int, bottom: int, left: int, right: int) -> np.ndarray:
    rows, cols = inner.shape[0] + top + bottom, inner.shape[1] + left + right
    params = {
        "rows": rows,
        "cols": cols,
        "row0": top,
        "col0": left,
        "inner_rows": inner.shape[0],
        "inner_cols": inner.shape[1],
    }
    result = run_stage(
        "sensor/border",
        (-(-cols // 16), -(-rows // 16), 1),
        params,
        {"inner": inner},
        {"framed": (rows * cols + 40, F32)},
    )
    assert unwritten(result["framed"][rows * cols :]).all()
    return result["framed"][: rows * cols].reshape(rows, cols)


@pytest.mark.parametrize("shape", [(1, 1), (1, 37), (15, 17), (16, 16), (33, 5)])
@pytest.mark.parametrize("sides", [(0, 0, 0, 0), (3, 0, 0, 5), (0, 2, 16, 0), (4, 3, 2, 1)])
def test_a_frame_of_zeros_surrounds_what_is_known(shape: tuple, sides: tuple):
    inner = 1 + np.arange(shape[0] * shape[1], dtype=F32).reshape(shape)
    assert_close(on_device(inner, *sides), border(inner, *sides), atol=0)


def test_the_host_places_one_rectangle_in_another(device: Device):
    inner = np.random.default_rng(3).random((6, 8), F32)
    rec = Recording(device)
    buffer = rec.buffer("inner", (1, 6, 8), F32)
    rec.upload(buffer, inner[None])
    found = rec.download(record_border(rec, buffer, (0, 0, 6, 8), (-4, -6, 13, 15)))
    empty = rec.download(record_border(rec, None, (0, 0, 0, 8), (-4, 0, 4, 8), label="empty"))
    result = rec.run()
    assert_close(result[found], border(inner, 4, 3, 6, 1), atol=0)
    assert_close(result[empty], np.zeros((4, 8)), atol=0)


# --- areas ---


def test_areas_lie_within_each_other():
    frame = small().frame
    assert frame.lit == (0, 0, 20, 30)
    assert frame.pixels == frame.read == (-4, -6, 27, 37)
    assert frame.on_chip((-4, -6, 1, 1)) == (0, 0)
    assert frame.on_chip((4, 6, 1, 1)) == (8, 12)
    bare = small(optical_black=None).frame
    assert bare.lit == bare.pixels == bare.read


def test_parts_around_make_up_the_frame_once():
    count = np.zeros((25, 36), int)
    lit = (3, 5, 20, 30)
    for row, col, rows, cols in [lit, *parts_around(lit, (0, 0, 25, 36))]:
        assert rows > 0 and cols > 0
        count[row : row + rows, col : col + cols] += 1
    assert (count == 1).all()
    assert parts_around(lit, lit) == []
    assert parts_around((0, 0, 4, 6), (0, -2, 4, 8)) == [(0, -2, 4, 2)]


def test_what_rectangles_share():
    assert overlap((-3, -5, 10, 10), (0, 0, 20, 30)) == (0, 0, 7, 5)
    assert overlap((15, 25, 10, 10), (0, 0, 20, 30)) == (15, 25, 5, 5)
    assert 0 in overlap((-3, 0, 3, 10), (0, 0, 20, 30))[2:]


# --- the read-out ---


def small(**changes) -> Sensor:
    return load_sensor("imx477").roi(20, 30).model_copy(update={"optical_black": BLACK} | changes)


def read_out(
    device: Device, sensor: Sensor, rect: tuple, rate_e: float = 4e5, without: tuple = ()
) -> dict[str, np.ndarray]:
    """Return what is read of a rectangle, evenly lit; all stages run that the sensor has."""
    rec = Recording(device)
    sites = rec.buffer("sites", (4, 10, 15), F32)
    rec.upload(sites, np.full((4, 10, 15), rate_e, F32))
    glare = rec.buffer("glare", 4, F32)
    rec.clear(glare)
    shot, has = Shot(exposure_s=0.01, seed=3, frame=0), sensor_runs(sensor)

    def runs(name: str) -> bool:
        return has(name) and name not in without

    found = record_readout(
        rec, SiteLight(sites, glare, (0, 0, 20, 30)), sensor, rect, shot=shot, runs=runs
    )
    labels = {name: rec.download(found[name]) for name in ("rate", "electrons", "dn")}
    result = rec.run()
    return {name: result[label].astype(float) for name, label in labels.items()}


def test_a_shielded_pixel_has_all_but_the_light(device: Device):
    """Dark current 100 e-/s for 0.01 s, DSNU, read noise and black level: no photon, no PRNU."""
    sensor = small(dark_current_e_per_s=2e4, optical_black=Border(top=100, left=200))
    frame = sensor.frame.read
    lit = np.s_[100:, 200:]
    found = read_out(device, sensor, frame)
    masked = np.ones(frame[2:], bool)
    masked[lit] = False
    assert_close(found["rate"][masked], np.zeros(masked.sum()), atol=0)
    assert_close(found["rate"][lit], np.full((20, 30), 4e5), atol=0)
    dark, n = found["electrons"][masked], int(masked.sum())
    # Mean 200 e-; variance 200 + 3^2 + 1.1^2 of shot noise, read noise and DSNU. 4.9 sigma: 1e-6.
    variance = 200 + 9 + 1.21
    assert abs(dark.mean() - 200) < 4.9 * np.sqrt(variance / n)
    assert abs(dark.var() / variance - 1) < 4.9 * np.sqrt(2 / n)
    black_dn = found["dn"][masked].mean() - 256
    assert black_dn == pytest.approx(0.47 * dark.mean(), abs=4.9 * np.sqrt(1 / 12 / n))
    assert found["electrons"][lit].mean() > 4000


def test_lit_pixels_are_those_of_the_sensor_without_a_border(device: Device):
    """But for noise that is keyed by the place on the chip, which the border moves."""
    quiet = {"prnu_percent": 0.0, "dsnu_e": 0.0, "temporal_dark_noise_e": 0.0}
    without = ("noise",)
    framed = read_out(device, small(**quiet), (-4, -6, 27, 37), without=without)
    bare = read_out(device, small(optical_black=None, **quiet), (0, 0, 20, 30), without=without)
    for name, plane in bare.items():
        assert_close(framed[name][4:-3, 6:-1], plane, atol=0)


@pytest.mark.parametrize(
    "rect",
    [
        (-4, -6, 4, 37),  # the upper border alone
        (4, -6, 7, 5),  # within the left one
        (20, 28, 2, 3),  # a corner
        (-1, -2, 9, 13),
        (6, 8, 5, 7),
        (0, 0, 20, 30),
    ],
)
def test_parts_are_those_of_the_whole_bit_for_bit(device: Device, rect: tuple):
    sensor = small(prnu_percent=3.0, dsnu_e=5.0)
    whole = read_out(device, sensor, sensor.frame.read)
    row, col, rows, cols = rect
    part = np.s_[row + 4 : row + 4 + rows, col + 6 : col + 6 + cols]
    for name, plane in read_out(device, sensor, rect).items():
        assert_close(plane, whole[name][part].copy(), atol=0)


def test_a_region_has_the_fixed_pattern_of_its_place_on_the_chip(device: Device):
    sensor = small(prnu_percent=3.0, dsnu_e=5.0, temporal_dark_noise_e=0.0)
    without = ("noise",)  # PRNU alone
    whole = read_out(device, sensor, sensor.frame.read, without=without)
    region = sensor.roi(12, 14)
    found = read_out(device, region, (0, 0, 12, 14), without=without)
    row, col = region.first_row - sensor.first_row, region.first_col - sensor.first_col
    expected = whole["electrons"][4 + row : 16 + row, 6 + col : 20 + col]
    assert_close(found["electrons"], expected.copy(), atol=0)
    assert expected.std() > 0.02 * expected.mean()

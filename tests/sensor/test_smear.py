"""Smear: against float64, in closed form, with the sun in the column, and what it must not do.

Tolerance: sums of rates are exact to 2^-48; weight, product and sum are rounded once each:
2^-24 (mean + 3 weight passed), taken as 3 * 2^-24 of the result.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from pydantic import ValidationError

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.smear import smear
from gpusim.sensor.smear import record_smear
from gpusim.sensor.smear_model import Smear

F32 = np.float32
KINDS = ("interline", "frame_transfer", "cleared")
ROUNDINGS = 3 * 2.0**-24


def on_device(rate, mean, kind: str, weight: float, limit_e=1e30, spare=0) -> np.ndarray:
    rows, cols = rate.shape
    pieces = -(-rows // 32)
    params = {"rows": rows, "cols": cols, "weight": weight, "limit_e": limit_e, "zero": 0}
    arrays = {"rate": rate, "mean": mean}
    outputs = {"sums": ((pieces + 1, cols, 2), F32), "smeared": (rows * cols + spare, F32)}
    for step, height in enumerate((pieces, 1, pieces)):
        result = run_stage(
            "sensor/smear",
            (-(-cols // 64), height, 1),
            params,
            arrays,
            outputs,
            PASSED=KINDS.index(kind),
            STEP=step,
        )
        arrays["sums"] = result["sums"]
    return result["smeared"]


def planes(rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(61)
    return rng.uniform(0, 1e6, (rows, cols)).astype(F32), rng.uniform(0, 100, (rows, cols)).astype(
        F32
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", [(1, 1), (7, 63), (32, 64), (33, 65), (64, 5), (201, 130)])
def test_packets_gather_what_they_pass(kind: str, shape: tuple[int, int]):
    rate, mean = planes(*shape)
    weight = float(F32(1e-5))
    found = on_device(rate, mean, kind, weight, spare=40)
    assert unwritten(found[rate.size :]).all()
    expected = smear(rate, mean.astype(float), kind, weight)
    assert_close(found[: rate.size].reshape(shape), expected, rtol=ROUNDINGS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_dark_row_has_the_closed_form(kind: str):
    # A bright bar of rows 10 to 14; all rows but these are dark, row 15 on are beyond it.
    rate = np.zeros((40, 3), F32)
    rate[10:15] = 1e6
    found = on_device(rate, np.zeros_like(rate), kind, 1e-6).reshape(rate.shape)
    before, bar, beyond = found[:10], found[10:15], found[15:]
    assert_close(beyond, np.full((25, 3), 5.0), rtol=ROUNDINGS)
    assert_close(before, np.full((10, 3), 0.0 if kind == "frame_transfer" else 5.0), rtol=ROUNDINGS)
    inside = {"interline": [5] * 5, "cleared": [4] * 5, "frame_transfer": [0, 1, 2, 3, 4]}[kind]
    assert_close(bar, np.repeat(np.array(inside, float)[:, None], 3, axis=1), rtol=ROUNDINGS)


@pytest.mark.parametrize("kind", KINDS)
def test_the_sun_in_the_column_does_not_drown_what_lies_beside_it(kind: str):
    # One photosite at 1e12 electrons/s over a ramp of some per second: the sum of the others, in
    # its own row too, is found to 48 bits.
    rate = np.arange(1.0, 101.0, dtype=F32)[:, None].repeat(2, axis=1)
    rate[50, 0] = 1e12
    found = on_device(rate, np.zeros_like(rate), kind, 1.0).reshape(rate.shape)
    expected = smear(rate, np.zeros_like(rate, float), kind, 1.0)
    assert_close(found, expected, rtol=ROUNDINGS)
    if kind == "cleared":
        assert found[50, 0] == 5050 - 51


def test_a_full_photosite_goes_on_leaking():
    # Ten times the light is ten times the smear, whatever the photosites hold: rates are unclipped.
    rate, mean = planes(30, 4)
    dim, bright = (
        on_device(scale * rate, np.minimum(mean * scale, 50), "interline", 1e-6)
        - np.minimum(mean * scale, 50).ravel()
        for scale in (F32(1), F32(10))
    )
    assert_close(bright, 10 * dim.astype(float), rtol=1e-4)  # differences of sums near 50


def test_the_result_is_clipped_where_nothing_is_drawn_after_it():
    rate, mean = planes(30, 4)
    whole = on_device(rate, mean, "interline", 1e-6)
    clipped = on_device(rate, mean, "interline", 1e-6, limit_e=60.0)
    assert_close(clipped, np.minimum(whole, F32(60)), atol=0)
    assert np.any(clipped < whole)


def test_columns_do_not_mix_and_parts_are_the_whole_bit_for_bit():
    rate, mean = planes(37, 90)
    whole = on_device(rate, mean, "cleared", 1e-5).reshape(rate.shape)
    part = np.s_[:, 41:77]
    found = on_device(
        np.ascontiguousarray(rate[part]), np.ascontiguousarray(mean[part]), "cleared", 1e-5
    )
    assert_close(found.reshape(37, 36), whole[part].copy(), atol=0)


@pytest.mark.parametrize(
    ("model", "kind", "weight"),
    [
        (Smear(kind="interline", row_s=64e-6, leak=1e-3), "interline", 64e-9),
        (Smear(kind="frame_transfer", row_s=2e-6), "cleared", 2e-6),
        (
            Smear(kind="frame_transfer", row_s=2e-6, cleared_by_shift=False),
            "frame_transfer",
            2e-6,
        ),
    ],
)
def test_the_host_smears_by_the_sensor(device: Device, model: Smear, kind: str, weight: float):
    rate, mean = planes(50, 40)
    rec = Recording(device)
    buffers = [rec.buffer(name, rate.shape, F32) for name in ("rate", "mean")]
    for buffer, plane in zip(buffers, (rate, mean), strict=True):
        rec.upload(buffer, plane)
    label = rec.download(record_smear(rec, *buffers, model))
    expected = smear(rate, mean.astype(float), kind, weight)
    assert_close(rec.run()[label], expected, rtol=ROUNDINGS + 2.0**-24)  # weight rounded to f32


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"kind": "interline", "row_s": 1e-6}, "without a leak"),
        ({"kind": "frame_transfer", "row_s": 1e-6, "leak": 0.1}, "with a leak"),
        ({"kind": "interline", "row_s": 1e-6, "leak": 1.0}, "less than 1"),
        ({"kind": "interline", "row_s": 0.0, "leak": 0.1}, "greater than 0"),
        ({"kind": "rolling", "row_s": 1.0}, "interline"),
    ],
)
def test_a_wrong_file_is_refused(fields: dict, match: str):
    with pytest.raises(ValidationError, match=match):
        Smear.model_validate(fields)


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/smear").workgroup_size == (64, 1, 1)

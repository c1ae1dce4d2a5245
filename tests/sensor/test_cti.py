"""Charge-transfer inefficiency, linear: against the transfers made one by one, and in closed form.

Tolerance: a sum of ``width`` products whose weights are rounded once: at most
(width + 2) 2^-24 of the sum, as all terms are positive; shares left out are below 2^-32 of a
packet at either side.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from pydantic import ValidationError
from scipy.stats import nbinom

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.cti import cti
from gpusim.sensor.cti import record_cti, shares
from gpusim.sensor.cti_model import Cti

F32 = np.float32
BRIGHTEST = 2e4
LEFT_OUT = 2 * 2.0**-32 * BRIGHTEST
INEFFICIENCIES = (1e-8, 1e-6, 1e-4, 1e-2, 0.3)


def on_device(charge, inefficiency: float, serial=False, before=0, spare=0) -> np.ndarray:
    rows, cols = charge.shape
    first, weights = shares(cols if serial else rows, before, inefficiency)
    result = run_stage(
        "sensor/cti",
        (-(-cols // 64), -(-rows // 4), 1) if serial else (-(-cols // 256), rows, 1),
        {"rows": rows, "cols": cols, "width": len(weights)},
        {"charge": charge, "first": first, "weights": weights},
        {"arrived": (rows * cols + spare, F32)},
        SERIAL=serial,
    )
    return result["arrived"]


def packets(rows: int, cols: int, empty: int = 0) -> np.ndarray:
    charge = np.random.default_rng(64).uniform(0, BRIGHTEST, (rows, cols)).astype(F32)
    charge[rows - empty :] = 0
    return charge


def bound(weights: np.ndarray) -> float:
    return (len(weights) + 2) * 2.0**-24


@pytest.mark.parametrize("inefficiency", INEFFICIENCIES)
@pytest.mark.parametrize("shape", [(1, 1), (1, 70), (70, 1), (33, 257), (130, 66)])
def test_what_arrives_is_what_the_transfers_make(inefficiency: float, shape: tuple[int, int]):
    charge = packets(*shape)
    expected = cti(charge, inefficiency)
    _, weights = shares(shape[0], 0, inefficiency)
    found = on_device(charge, inefficiency, spare=300)
    assert unwritten(found[charge.size :]).all()
    assert_close(found[: charge.size].reshape(shape), expected, rtol=bound(weights), atol=LEFT_OUT)
    # Along rows it is the same of the transposed frame.
    across = on_device(np.ascontiguousarray(charge.T), inefficiency, serial=True, spare=300)
    assert unwritten(across[charge.size :]).all()
    assert_close(
        across[: charge.size].reshape(shape[::-1]).T, expected, rtol=bound(weights), atol=LEFT_OUT
    )


def test_lines_may_lie_at_unlike_distances_from_the_read_out():
    """The reference is tested. Where the distance is negative, empty packets come first."""
    charge = packets(12, 3).astype(float)
    charge[:4, 2] = 0
    found = cti(charge, 0.05, before=np.array([0, 30, -4]))
    for line, before in ((0, 0), (1, 30)):
        assert_close(found[:, line], cti(charge[:, line], 0.05, before), rtol=1e-13)
    assert_close(found[4:, 2], cti(charge[4:, 2], 0.05), rtol=1e-13)
    assert not found[:4, 2].any()


@pytest.mark.parametrize("inefficiency", [1e-8, 1e-5, 1e-2])
def test_ten_thousand_transfers(inefficiency: float):
    charge = packets(200, 3)
    expected = cti(charge, inefficiency, before=9_900)
    _, weights = shares(200, 9_900, inefficiency)
    found = on_device(charge, inefficiency, before=9_900).reshape(charge.shape)
    assert_close(found, expected, rtol=bound(weights), atol=LEFT_OUT)


@pytest.mark.parametrize("inefficiency", [1e-8, 1e-6, 1e-4, 1e-2])
@pytest.mark.parametrize("transfers", [1, 10, 1000, 10_000])
def test_a_packet_keeps_the_closed_form(inefficiency: float, transfers: int):
    first, weights = shares(400, transfers - 1, inefficiency)
    kept = np.exp(transfers * np.log1p(-inefficiency))
    # What the nearest packet leaves to the d-th after it: entry d - first[d] of that one's column.
    entry = np.arange(400) - first.astype(int)
    used = (entry >= 0) & (entry < len(weights))
    trail = np.where(used, weights[np.where(used, entry, 0), np.arange(400)], 0.0)
    assert_close(trail[:1], np.array([kept]), rtol=2.0**-23, atol=2.0**-31)
    law = nbinom.pmf(np.arange(400), transfers, 1 - inefficiency)
    assert_close(trail, law, rtol=1e-6, atol=2.0**-31)
    assert abs(trail.sum() - 1) < 1e-6


@pytest.mark.parametrize("serial", [False, True])
@pytest.mark.parametrize("inefficiency", [1e-8, 1e-5, 1e-3, 1e-2])
def test_charge_is_conserved_with_what_the_overscan_holds(inefficiency: float, serial: bool):
    charge = packets(400, 300, empty=60)  # the farthest trails reach 20 packets back
    charge = np.ascontiguousarray(charge.T) if serial else charge
    found = on_device(charge, inefficiency, serial=serial).astype(float)
    # 1e5 roundings of random sign; a weight's own is shared by one line.
    assert found.sum() == pytest.approx(charge.astype(float).sum(), rel=1e-7)


def test_trails_point_away_from_the_read_out():
    charge = np.zeros((20, 20), F32)
    charge[10, 10] = 1000
    for serial in (False, True):
        found = on_device(charge, 1e-3, serial=serial).reshape(20, 20)
        found = found.T if serial else found
        assert found[11, 10] == pytest.approx(1000 * 11 * 1e-3 * (1 - 1e-3) ** 11, rel=1e-6)
        assert np.count_nonzero(found[:10]) == 0
        assert np.count_nonzero(np.delete(found, 10, axis=1)) == 0


@pytest.mark.parametrize("inefficiency", [1e-6, 1e-4, 1e-2])
def test_colours_of_a_filter_array_mix_in_closed_form(inefficiency: float):
    # There are N - 1 chances to fall behind. An even number of them keeps the colour:
    # (1 + (1 - 2e)^(N-1))/2.
    red, green = 400.0, 1000.0
    charge = np.tile(F32([red, green]), (3, 300))
    found = on_device(charge, inefficiency, serial=True).reshape(charge.shape)
    own = (1 + np.exp(np.arange(600) * np.log1p(-2 * inefficiency))) / 2
    colours = np.tile([red, green], 300)
    expected = (1 - inefficiency) * (own * colours + (1 - own) * (red + green - colours))
    _, weights = shares(600, 0, inefficiency)
    assert_close(found[1].copy(), expected, rtol=bound(weights), atol=LEFT_OUT)
    # So the hue shifts across the array, and a grey stays grey.
    ratio = found[1, ::2] / found[1, 1::2]
    assert ratio[-1] - ratio[0] > 0.3 * min(1, inefficiency * 600)
    even = on_device(np.full((3, 600), 1000, F32), inefficiency, serial=True)
    assert_close(even, np.full(1800, 1000 * (1 - inefficiency)), rtol=bound(weights))


@pytest.mark.parametrize("serial", [False, True])
def test_lines_do_not_mix_and_parts_are_the_whole_bit_for_bit(serial: bool):
    charge = packets(80, 80)
    whole = on_device(charge, 1e-3, serial=serial).reshape(charge.shape)
    part = np.s_[13:60] if serial else np.s_[:, 13:60]
    piece = np.ascontiguousarray(charge[part])
    found = on_device(piece, 1e-3, serial=serial).reshape(piece.shape)
    assert_close(found, whole[part].copy(), atol=0)


@pytest.mark.parametrize("serial", [False, True])
def test_the_host_shifts_frames(device: Device, serial: bool):
    charge = packets(50, 70)
    rec = Recording(device)
    buffer = rec.buffer("charge", charge.shape, F32)
    rec.upload(buffer, charge)
    label = rec.download(record_cti(rec, buffer, 1e-3, serial=serial, before=100))
    expected = cti(charge.T if serial else charge, 1e-3, before=100)
    found = rec.run()[label]
    assert_close(found.T if serial else found, expected, rtol=30 * 2.0**-24, atol=LEFT_OUT)


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"inefficiency": -1e-6}, "greater than 0"),
        ({"inefficiency": 1.0}, "less than 1"),
        ({}, "neither"),
        ({"inefficiency": 1e-6, "traps": [{"density": 1, "release_transfers": 1}]}, "both"),
        ({"traps": [{"density": -1, "release_transfers": 1}]}, "greater than or equal to 0"),
        ({"traps": [{"density": 1, "release_transfers": 0}]}, "greater than 0"),
        ({"traps": [{"density": 1, "release_transfers": 1}] * 5}, "at most 4"),
        (
            {"traps": [{"density": 1, "release_transfers": 1}], "well_e": 10, "notch_e": 10},
            "holds the whole well",
        ),
        ({"traps": [{"density": 1, "release_transfers": 1}], "groups": 0}, "greater than"),
    ],
)
def test_a_wrong_file_is_refused(fields: dict, match: str):
    with pytest.raises(ValidationError, match=match):
        Cti.model_validate(fields)


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/cti").workgroup_size == (64, 1, 1)

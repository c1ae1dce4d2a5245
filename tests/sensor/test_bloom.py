"""Bloom: charge is kept whole, flows as documented, and leaves no photosite above the full well.

Whole electrons below 2^24 in each pixel and below 2^48 in a flow are exact: tolerance 0.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.bloom import bloom
from gpusim.sensor.bloom import record_bloom

F32 = np.float32


def on_device(charge, full_well: float, photosites=None, spare=0) -> tuple[np.ndarray, np.ndarray]:
    rows, cols = charge.shape
    first, last = photosites or (0, rows)
    params = {
        "rows": rows,
        "cols": cols,
        "first_row": first,
        "last_row": last,
        "full_well_e": full_well,
        "zero": 0,
    }
    outputs = {"kept": (rows * cols + spare, F32), "spilled": ((2, cols, 2), F32)}
    result = run_stage("sensor/bloom", (-(-cols // 64), 1, 1), params, {"charge": charge}, outputs)
    return result["kept"], result["spilled"].astype(float).sum(axis=2)


def bright(rows: int, cols: int, share: float, top: float) -> np.ndarray:
    """Return whole electrons, a share of which lie above the full well of 1000."""
    rng = np.random.default_rng(62)
    held = rng.integers(0, 1000, (rows, cols))
    hot = rng.random((rows, cols)) < share
    held[hot] = rng.integers(1000, int(top), hot.sum())
    return held.astype(F32)


@pytest.mark.parametrize("shape", [(1, 1), (2, 63), (7, 64), (60, 65), (131, 3)])
@pytest.mark.parametrize(("share", "top"), [(0.0, 1001), (0.05, 2e4), (0.5, 3e3), (1.0, 1e7)])
def test_charge_flows_as_in_the_reference(shape: tuple[int, int], share: float, top: float):
    charge = bright(*shape, share, top)
    expected, left = bloom(charge, 1000)
    found, spilled = on_device(charge, 1000, spare=70)
    assert unwritten(found[charge.size :]).all()
    assert_close(found[: charge.size].reshape(shape), expected, atol=0)
    assert_close(spilled, left, atol=0)


@pytest.mark.parametrize("full_well", [1.0, 777.0, 1e7])
def test_charge_is_conserved_to_the_electron(full_well: float):
    rng = np.random.default_rng(63)
    charge = rng.integers(0, 16_000_000, (500, 40)).astype(F32)  # together up to 8e9: above 2^32
    found, spilled = on_device(charge, full_well)
    kept = found.reshape(charge.shape).astype(float)
    assert kept.max() <= full_well
    assert_close(kept.sum(axis=0) + spilled.sum(axis=0), charge.astype(float).sum(axis=0), atol=0)
    # The control: a lost electron would be seen.
    assert np.all(kept.sum(axis=0) + spilled.sum(axis=0) + 1 != charge.astype(float).sum(axis=0))


def test_a_bright_pixel_makes_a_streak_of_equal_arms():
    charge = np.full((41, 1), 100, F32)
    charge[20] = 1000 + 2 * 900 * 5  # five pixels' room each way
    found, spilled = on_device(charge, 1000)
    streak = np.full(41, 100.0)
    streak[15:26] = 1000
    assert_close(found, streak, atol=0)
    assert_close(spilled, np.zeros((2, 1)), atol=0)


def test_the_odd_electron_goes_away_from_the_read_out():
    charge = np.array([[0], [0], [13], [0], [0]], F32)
    found, _ = on_device(charge, 10)
    assert_close(found, np.array([0, 1, 10, 2, 0], float), atol=0)


def test_rows_without_photosites_are_left_alone():
    charge = bright(30, 5, 0.4, 1e4)
    found, spilled = on_device(charge, 1000, photosites=(4, 26))
    expected, left = bloom(charge, 1000, slice(4, 26))
    found = found.reshape(charge.shape)
    assert_close(found, expected, atol=0)
    assert_close(spilled, left, atol=0)
    outside = np.r_[0:4, 26:30]
    assert_close(found[outside], charge[outside].copy(), atol=0)
    assert charge[outside].max() > 1000


def test_below_the_full_well_nothing_changes():
    charge = bright(50, 70, 0.0, 1001)
    found, spilled = on_device(charge, 1000)
    assert_close(found.reshape(charge.shape), charge, atol=0)
    assert not spilled.any()


def test_the_host_blooms(device: Device):
    charge = bright(40, 66, 0.1, 1e5)
    rec = Recording(device)
    buffer = rec.buffer("charge", charge.shape, F32)
    rec.upload(buffer, charge)
    labels = [rec.download(array) for array in record_bloom(rec, buffer, 1000.0)]
    result = rec.run()
    for label, expected in zip(labels, bloom(charge, 1000), strict=True):
        found = result[label].astype(float)
        assert_close(found.sum(axis=2) if found.ndim == 3 else found, expected, atol=0)


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/bloom").workgroup_size == (64, 1, 1)

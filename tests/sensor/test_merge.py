"""Two reads of one charge: the merge against float64, and what the merged raw is like."""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten

from gpusim.gpu import Device, Kernel, Recording
from gpusim.plan.stages import sensor_runs
from gpusim.reference.merge import merge
from gpusim.sensor.adc_model import ColumnOffset, DualGain, Linearity
from gpusim.sensor.load import load_sensor
from gpusim.sensor.merge import record_merge
from gpusim.sensor.readout import Shot, SiteLight, record_readout
from gpusim.sensor.sensor import Sensor

F32 = np.float32
DUAL = DualGain(
    system_gain_dn_per_e=0.04, temporal_dark_noise_e=12.0, black_level_dn=200.0, switch_dn=3800
)


def hdr(**changes) -> Sensor:
    """Return a sensor of 85 000 e- that reads at 0.47 and 0.04 DN/e-: 11.75 to 1."""
    two = {"dual_gain": DUAL, "full_well_e": 85_000.0, "analogue_gains": ()}
    return load_sensor("imx477").model_copy(update=two | changes)


def on_device(high: np.ndarray, low: np.ndarray, spare: int = 0, **changes) -> np.ndarray:
    rows, cols = high.shape
    params = {
        "rows": rows,
        "cols": cols,
        "switch_dn": 3800,
        "black_high_dn": 256,
        "black_low_dn": 200,
        "ratio": 11.75,
        "max_dn": 46022,
    }
    found = run_stage(
        "sensor/merge",
        (-(-cols // 16), -(-rows // 16), 1),
        params | changes,
        {"high": high, "low": low},
        {"dn": (rows * cols + spare, np.uint32)},
    )
    return found["dn"]


@pytest.mark.parametrize("shape", [(1, 1), (15, 17), (16, 16), (33, 5)])
def test_the_merge_is_that_of_the_reference(shape: tuple):
    rng = np.random.default_rng(4)
    high, low = rng.integers(0, 4096, (2, *shape), dtype=np.uint32)
    high[0, 0], low[-1, -1] = 3800, 4095
    found = on_device(high, low, spare=40)
    assert unwritten(found[high.size :]).all()
    # 11.75 k + 256 - 2350 + 1/2 is exact in f32.
    expected = merge(
        high, low, switch_dn=3800, black_high_dn=256.0, black_low_dn=200.0, ratio=11.75
    )
    assert_close(found[: high.size].reshape(shape), expected, atol=0)


def test_the_switch_is_the_first_code_of_the_low_gain():
    high = np.array([[3799, 3800, 3801]], np.uint32)
    low = np.array([[500, 500, 10]], np.uint32)  # the last lies below black
    assert_close(on_device(high, low), np.array([3799, 256 + 3525, 0]), atol=0)


def test_halves_are_rounded_up_and_no_less():
    high, low = np.full((1, 3), 4000, np.uint32), np.array([[201, 202, 204]], np.uint32)
    # 0.499, 0.998, 1.996; then 0.5, 1.0, 2.0
    found = on_device(high, low, black_high_dn=0, ratio=0.499)
    assert_close(found, np.array([0, 1, 2]), atol=0)
    assert_close(on_device(high, low, black_high_dn=0, ratio=0.5), np.array([1, 1, 2]), atol=0)


def test_the_host_takes_the_figures_of_the_sensor(device: Device):
    high, low = np.random.default_rng(5).integers(0, 4096, (2, 9, 33), dtype=np.uint32)
    rec = Recording(device)
    planes = [rec.buffer(name, (9, 33), "u4") for name in ("high", "low")]
    for plane, codes in zip(planes, (high, low), strict=True):
        rec.upload(plane, codes)
    label = rec.download(record_merge(rec, *planes, hdr()))
    found = rec.run()[label]
    assert hdr().raw_max_dn == 46022  # 256 + 11.75 * 3895
    assert_close(found, on_device(high, low).reshape(9, 33), atol=0)


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/merge").workgroup_size == (16, 16, 1)


# --- the read-out ---

SHAPE = (128, 128)


def shot_of(device: Device, sensor: Sensor, mean_e: float, *off: str, seed: int = 3) -> dict:
    """Return what is read of an even field of so many electrons."""
    sensor = sensor.roi(*SHAPE)
    rec = Recording(device)
    sites = rec.buffer("sites", (4, SHAPE[0] // 2, SHAPE[1] // 2), F32)
    rec.upload(sites, np.full(sites.shape, mean_e, F32))
    glare = rec.buffer("glare", 4, F32)
    rec.clear(glare)
    has = sensor_runs(sensor)
    shot = Shot(exposure_s=1.0, seed=seed, frame=0)
    whole = (0, 0, *SHAPE)
    found = record_readout(
        rec,
        SiteLight(sites, glare, whole),
        sensor,
        whole,
        shot=shot,
        runs=lambda name: has(name) and name not in off,
    )
    labels = {name: rec.download(found[name]) for name in ("electrons", "dn")}
    result = rec.run()
    return {name: result[label].astype(float) for name, label in labels.items()}


QUIET = {"prnu_percent": 0.0, "dsnu_e": 0.0, "dark_current_e_per_s": 0.0}


def test_below_the_switch_it_is_the_sensor_of_one_gain_to_the_bit(device: Device):
    one = shot_of(device, hdr(dual_gain=None), 3000.0)
    two = shot_of(device, hdr(), 3000.0)
    assert one["dn"].max() < 3800
    assert_close(two["dn"], one["dn"], atol=0)
    assert_close(two["electrons"], one["electrons"], atol=0)


@pytest.mark.parametrize("mean_e", [50.0, 3000.0, 7000.0, 7530.0, 7541.0, 8000.0, 3e4, 7.5e4])
def test_the_merged_raw_is_linear_and_its_noise_that_of_the_read(device: Device, mean_e: float):
    """Across the switch, at 7540 e-: mean to 5 sigma; the variance of each side."""
    sensor = hdr(**QUIET)
    found = (shot_of(device, sensor, mean_e)["dn"] - 256) / 0.47
    n = found.size
    low = mean_e > 7540
    # Read noise, and a step of the code: 1/12 of (1/K)^2, in the low gain that of its step.
    read = 12.0**2 + (1 / 0.04) ** 2 / 12 if low else 3.0**2 + (1 / 0.47) ** 2 / 12
    variance = mean_e + read
    # Which read counts is chosen by the noise of the high one: near the switch both are met.
    near = abs(mean_e - 7540) < 5 * np.sqrt(mean_e)
    assert abs(found.mean() - mean_e) < 5 * np.sqrt((mean_e + 12**2 + 52) / n) + near * 1.5
    if not near:
        assert abs(found.var() / variance - 1) < 5 * np.sqrt(2 / n)


def test_the_reads_have_noise_of_their_own(device: Device):
    """With the switch at black, below all codes of light, the low gain counts alone."""
    lowest = DUAL.model_copy(update={"switch_dn": 257})
    sensor = hdr(dual_gain=lowest, **QUIET)
    off = ("noise",)  # no shot noise: the charge is even
    found = shot_of(device, sensor, 2000.0, *off)
    high = found["electrons"] - 2000
    low = (found["dn"] - 256) / 0.47 - 2000
    assert high.std() == pytest.approx(3, rel=5 / np.sqrt(2 * high.size))
    assert low.std() == pytest.approx(np.sqrt(144 + 52.1), rel=5 / np.sqrt(2 * low.size))
    # 128 x 128 unrelated numbers: 3.9 sigma once in 1e4
    assert abs(np.corrcoef(high.ravel(), low.ravel())[0, 1]) < 3.9 / 128


def test_what_the_pixel_has_is_alike_in_both_reads(device: Device):
    """Column offsets and non-linearity are those of the converter: in both reads."""
    curve = Linearity(electrons=[0, 20_000, 90_000], read_e=[0, 20_400, 88_000])
    sensor = hdr(linearity=curve, column_offset=ColumnOffset(sigma_dn=5.0), **QUIET)
    off = ("noise", "read noise")
    plain = hdr(linearity=curve, **QUIET)
    for mean_e in (1000.0, 20_000.0):
        level = shot_of(device, plain, mean_e, *off, "column fpn")["dn"]
        expected = 256 + 0.47 * float(curve.read(np.array(mean_e)))
        # A step of the low gain is 11.75 DN.
        assert_close(level, np.full(SHAPE, expected), atol=0.5 + 11.75 / 2 * (mean_e > 7540))
        offsets = shot_of(device, sensor, mean_e, *off)["dn"] - level
        assert_close(offsets, np.tile(offsets[0], (128, 1)), atol=0)
        ratio = 11.75 if mean_e > 7540 else 1
        assert offsets[0].std() == pytest.approx(5 * ratio, rel=5 / np.sqrt(2 * 128))

"""Analogue-to-digital conversion: against float64, at its clips and its rounding.

Tolerance: codes are exact, except where float32 carries K e + black across a rounding boundary.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.adc import adc
from gpusim.sensor.adc import record_adc
from gpusim.sensor.sensor import load_sensor

F32 = np.float32


def on_device(
    electrons: np.ndarray, gain: float, black: float, bits: int, spare: int = 0
) -> np.ndarray:
    rows, cols = electrons.shape
    params = {
        "rows": rows,
        "cols": cols,
        "system_gain_dn_per_e": gain,
        "black_level_dn": black,
        "max_dn": 2**bits - 1,
    }
    result = run_stage(
        "sensor/adc",
        (-(-cols // 16), -(-rows // 16), 1),
        params,
        {"electrons": electrons},
        {"dn": (rows * cols + spare, np.uint32)},
    )
    return result["dn"]


@pytest.mark.parametrize(
    ("gain", "black", "bits"), [(0.47, 256, 12), (4.1, 63.5, 10), (1, 0, 1), (7.9, 512, 16)]
)
def test_codes_are_those_of_the_reference(gain: float, black: float, bits: int):
    top = 2**bits / gain
    electrons = np.random.default_rng(41).uniform(-0.2 * top, 1.2 * top, (300, 411)).astype(F32)
    expected = adc(electrons, F32(gain), black, bits)
    # Three roundings of at most 2^-24 of the top code carry this share of the pixels over a half,
    # doubled for chance.
    share = 6 * 2.0 ** (bits - 24)
    assert_close(
        on_device(electrons, gain, black, bits).reshape(electrons.shape).astype(int),
        expected.astype(int),
        atol=0,
        outliers=share,
        outlier_atol=1,
    )


def test_halves_round_up_and_codes_are_clipped():
    electrons = F32([[-1e9, -17, -16.5, -16.0, -1.0, 0, 1.0, 2.0, 30, 31, 238, 239, 1e9]])
    # K = 1/2, black 8: exact in f32. -17 is -1/2, which rounds to 0; 1 is 8.5; 31 is 23.5.
    expected = [[0, 0, 0, 0, 8, 8, 9, 9, 23, 24, 127, 127, 127]]
    assert_close(on_device(electrons, 0.5, 8, 7)[None], np.array(expected), atol=0)


def test_a_code_changes_at_its_half():
    steps = (np.arange(256) + 0.5).astype(F32)
    below = np.nextafter(steps, F32(0))
    assert_close(on_device(steps[None], 1, 0, 9), np.arange(256) + 1, atol=0)
    assert_close(on_device(below[None], 1, 0, 9)[1:], np.arange(1, 256), atol=0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 37), (37, 1), (15, 17), (16, 16), (17, 33)])
def test_every_pixel_and_nothing_else_is_written(shape: tuple[int, int]):
    electrons = np.arange(shape[0] * shape[1], dtype=F32).reshape(shape)
    found = on_device(electrons, 1, 3, 16, spare=40)
    assert unwritten(found[electrons.size :]).all()
    assert_close(found[: electrons.size].reshape(shape), electrons + 3, atol=0)


def recorded(device: Device, electrons: np.ndarray) -> np.ndarray:
    rec = Recording(device)
    buffer = rec.buffer("electrons", electrons.shape, F32)
    rec.upload(buffer, electrons)
    label = rec.download(record_adc(rec, buffer, load_sensor("imx477")))
    return rec.run()[label]


def test_the_host_converts_by_the_sensor(device: Device):
    electrons = F32([[0, 100, 5000, 8180, -3]])
    # 256 + 0.47 e: 256, 303, 2606, 4100.6 -> 4095, 254.59 -> 255
    assert_close(recorded(device, electrons), np.array([[256, 303, 2606, 4095, 255]]), atol=0)


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/adc").workgroup_size == (16, 16, 1)

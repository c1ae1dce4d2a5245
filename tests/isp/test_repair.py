"""Defect correction against the reference."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import F32, ULP, through

from gpusim.gpu import Device
from gpusim.isp.repair import SIGMAS, record_repair
from gpusim.reference.repair import repair

NOISE = (1e-4, 1e-6)


def even(rows: int, cols: int, seed: int) -> np.ndarray:
    """Return light with noise and a slope."""
    rng = np.random.default_rng(seed)
    light = np.linspace(0.0, 0.8, cols)[None] * np.linspace(0.5, 1, rows)[:, None]
    return light + rng.normal(0, np.sqrt(NOISE[0] * light + NOISE[1]))


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("shape", [(5, 5), (19, 37), (64, 80)])
def test_pixels_are_those_of_the_reference(device: Device, step: int, shape: tuple):
    rng = np.random.default_rng(shape[1])
    light = even(*shape, 3)
    stuck = rng.uniform(size=shape) < 0.1
    light = np.where(stuck, rng.uniform(0, 1, shape), light).astype(F32)
    found = through(device, light, lambda rec, given: record_repair(rec, given, step, NOISE))
    inner = slice(step, -step), slice(step, -step)
    expected, beyond = repair(light, step, NOISE, SIGMAS)
    # A mean of two is rounded once; whether a pixel stands out is in doubt by some roundings.
    sure = np.abs(beyond) > 16 * ULP
    assert sure.mean() > 0.9
    assert_close(found[inner][sure], expected[sure], atol=2 * ULP)


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_a_stuck_pixel_is_mended_and_noise_is_left(device: Device, value: float):
    light = even(80, 120, 7).astype(F32)
    stuck = light.copy()
    stuck[20:70:8, 30:110:8] = value
    found = through(device, stuck, lambda rec, given: record_repair(rec, given, 2, NOISE))
    inner = slice(2, -2), slice(2, -2)
    assert np.abs(found[inner] - light[inner]).max() < 0.1
    # Two pixels in 9000 at the most: the noise of one leaves the range of eight by 6 sigma never.
    same = through(device, light, lambda rec, given: record_repair(rec, given, 2, NOISE))
    assert np.array_equal(same[inner], light[inner])


def test_an_edge_is_not_mended(device: Device):
    rows, cols = np.indices((60, 60))
    light = np.where(cols + 0.3 * rows > 35, F32(0.9), F32(0.1))
    found = through(device, light, lambda rec, given: record_repair(rec, given, 2, NOISE))
    assert np.array_equal(found[2:-2, 2:-2], light[2:-2, 2:-2])

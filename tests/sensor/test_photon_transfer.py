"""Exposure to DN as a sensor under test: photon transfer, dark level, saturation (EMVA 1288)."""

import numpy as np
import pytest
from scipy.stats import norm

from gpusim.gpu import Device, Recording
from gpusim.sensor.adc import record_adc
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.load import load_sensor
from gpusim.sensor.noise import record_noise
from gpusim.sensor.noise_model import LineNoise
from gpusim.sensor.sensor import Sensor

F32 = np.float32
SHAPE = (512, 512)
PIXELS = SHAPE[0] * SHAPE[1]
LEVEL = 1e-3  # of each test; the seeds are fixed


def capture(
    device: Device, sensor: Sensor, rate_e_per_s: float, exposure_s: float, frame: int
) -> np.ndarray:
    rec = Recording(device)
    rate = rec.buffer("rate", SHAPE, F32)
    rec.upload(rate, np.full(SHAPE, rate_e_per_s, F32))
    mean = record_exposure(rec, rate, sensor, exposure_s)
    electrons = record_noise(rec, mean, sensor, seed=3, frame=frame)
    label = rec.download(record_adc(rec, electrons, sensor))
    return rec.run()[label].astype(float)


LINES = LineNoise(prnu_row_percent=2, prnu_column_percent=3, dsnu_row_e=5, dsnu_column_e=4)


@pytest.mark.parametrize(("prnu_percent", "lines"), [(0.0, None), (5.0, None), (5.0, LINES)])
def test_the_slope_of_photon_transfer_is_the_system_gain(
    device: Device, prnu_percent: float, lines: LineNoise | None
):
    """Temporal variance over mean signal: K, whatever the PRNU: it comes before the noise."""
    sensor = load_sensor("imx477").model_copy(
        update={"prnu_percent": prnu_percent, "bit_depth": 14, "lines": lines, "dcnu_percent": 30}
    )
    signal, variance = [], []
    for rate in (0.0, 1000.0, 2000.0, 4000.0, 6000.0):
        a, b = (capture(device, sensor, rate, 1.0, frame) for frame in (0, 1))
        signal.append((a + b).mean() / 2)
        variance.append(np.mean((a - b) ** 2) / 2)  # the fixed pattern cancels
    signal, variance = np.array(signal) - signal[0], np.array(variance) - variance[0]
    slope = np.sum(signal * variance) / np.sum(signal**2)
    # Var of a variance from PIXELS pairs is 2 variance^2 / PIXELS; weights as in the slope.
    # The dark value is shared, and small.
    sigma = np.sqrt(np.sum(signal**2 * 2 * variance**2 / PIXELS)) / np.sum(signal**2)
    assert abs(slope - sensor.system_gain_dn_per_e) < norm.isf(LEVEL / 2) * sigma


def test_the_fixed_pattern_is_the_prnu(device: Device):
    sensor = load_sensor("imx477").model_copy(update={"prnu_percent": 5.0, "bit_depth": 14})
    a, b = (capture(device, sensor, 6000.0, 1.0, frame) for frame in (0, 1))
    dark = [capture(device, sensor, 0.0, 1.0, frame) for frame in (0, 1)]
    covariance = (
        np.mean((a - a.mean()) * (b - b.mean())) - np.cov(dark[0].ravel(), dark[1].ravel())[0, 1]
    )
    prnu = np.sqrt(covariance) / (a.mean() - dark[0].mean())
    # The standard deviation of PIXELS values has the relative error 1/sqrt(2 PIXELS), and a
    # quarter more for the temporal noise in the covariance.
    assert abs(prnu / 0.05 - 1) < norm.isf(LEVEL / 2) * 1.25 / np.sqrt(2 * PIXELS)


def test_no_light_gives_the_black_level(device: Device):
    sensor = load_sensor("imx477")
    dark = capture(device, sensor, 0.0, 0.01, 0)
    noise_dn = 0.47 * np.sqrt(3**2 + 1.1**2 + 0.01)
    bound = norm.isf(LEVEL / 2) * np.hypot(noise_dn, 0.29) / np.sqrt(PIXELS)
    assert abs(dark.mean() - 256 - 0.47 * 0.01) < bound
    assert abs(dark.std() / np.hypot(noise_dn, 12**-0.5) - 1) < norm.isf(LEVEL / 2) / np.sqrt(
        2 * PIXELS
    )


def test_saturation_gives_the_top_code(device: Device):
    sensor = load_sensor("imx477").model_copy(update={"temporal_dark_noise_e": 0.0, "dsnu_e": 0.0})
    assert np.all(capture(device, sensor, 1e6, 1.0, 0) == 4095)


def test_twice_the_time_is_twice_the_light(device: Device):
    sensor = load_sensor("imx477")
    short, long = (capture(device, sensor, 3000.0, time, 0).mean() - 256 for time in (0.5, 1.0))
    bound = norm.isf(LEVEL / 2) * 0.47 * np.sqrt((1500 * 4 + 3000) / PIXELS)
    assert abs(2 * short - long) < bound  # the fixed pattern is the same in both

"""Exposure: against float64 from the same random words; its fixed pattern; its dark current.

Tolerance of the stage, relative to the light: the gain 1 + PRNU z carries the error of the deviate,
1e-6 PRNU |z| (test_gaussian), and five roundings; the sum with the dark signal one more:
6 * 2^-24 + 1e-6 PRNU |z|.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage
from scipy.stats import chi2, kstest
from sensor import tiles

from gpusim.errors import UserError
from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.exposure import dark_current, exposure
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.load import load_sensor

F32 = np.float32
SERIAL = (3 << 32) + 12345
LEVEL = 1e-3  # of each statistical test; the seeds are fixed
# What few sensors have: off where a test does not ask for it.
EXTRAS = ("PRNU_LINES", "DCNU", "MASK")


def on_device(
    rate: np.ndarray,
    origin=(0, 0),
    exposure_s=0.02,
    prnu=0.01,
    dark_e=0.3,
    spare=0,
    serial=SERIAL,
    limit_e=1e30,
    mask=None,
    figures=None,
    **overrides,
) -> np.ndarray:
    rows, cols = rate.shape
    params = {
        "serial": (serial & 0xFFFFFFFF, serial >> 32),
        "row0": origin[0],
        "col0": origin[1],
        "rows": rows,
        "cols": cols,
        "exposure_s": exposure_s,
        "prnu": prnu,
        "dark_e": dark_e,
        "limit_e": limit_e,
        **dict.fromkeys(("prnu_row", "prnu_column", "log_dcnu"), 0.0),
        **(figures or {}),
    }
    result = run_stage(
        "sensor/exposure",
        (-(-(origin[1] % 4 + cols) // 128), -(-rows // 2), 1),
        params,
        {"rate": rate, "mask": np.zeros(1, F32) if mask is None else mask},
        {"mean": (rows * cols + spare, F32)},
        **(dict.fromkeys(EXTRAS, False) | overrides),
    )
    mean = result["mean"]
    return mean if spare else mean.reshape(rate.shape)


def reference(rate: np.ndarray, exposure_s=0.02, prnu=0.01, dark_e=0.3, **more) -> np.ndarray:
    """Return what `on_device` should: float64, from the same random words and rounded figures."""
    time, response, dark = (float(F32(value)) for value in (exposure_s, prnu, dark_e))
    keys = {"dark_current_e_per_s": dark / time, "serial_number": SERIAL}
    return exposure(rate.astype(float), time, prnu=response, **keys, **more)


def rates(shape: tuple[int, int]) -> np.ndarray:
    return np.random.default_rng(51).uniform(0, 1e5, shape).astype(F32)


def test_means_are_those_of_the_reference():
    rate = rates((150, 411))
    for prnu in (0.0, 0.007, 0.1):
        expected = reference(rate, prnu=prnu, origin=(17, 5))
        found = on_device(rate, (17, 5), prnu=prnu)
        assert_close(found, expected, rtol=6 * 2.0**-24 + 5e-6 * prnu)


@tiles.shapes
@tiles.columns
def test_tiles_are_parts_of_the_whole_bit_for_bit(shape: tuple[int, int], col0: int):
    tiles.check_tile(on_device, rates(tiles.WHOLE), shape, col0)


def test_without_prnu_nothing_is_drawn_and_nothing_changes():
    rate = rates((37, 131))
    drawn = on_device(rate, (3, 2), prnu=0.0)
    assert_close(on_device(rate, (3, 2), prnu=0.0, PRNU=False), drawn, atol=0)
    # The control: where there is PRNU, what is not drawn is missed.
    assert np.any(on_device(rate, (3, 2), PRNU=False) != on_device(rate, (3, 2)))


LINED = {"prnu_row": 0.02, "prnu_column": 0.03}


def test_rows_columns_dark_currents_and_mask_are_those_of_the_reference():
    rate = rates((150, 411))
    mask = np.random.default_rng(52).uniform(0, 2, rate.shape).astype(F32)
    dcnu = 0.8
    lined = {name: float(F32(sigma)) for name, sigma in LINED.items()}
    expected = reference(
        rate, dark_e=50, dcnu=dcnu, mask=mask.astype(float), origin=(17, 5), **lined
    )
    figures = LINED | {"log_dcnu": np.sqrt(np.log1p(dcnu**2))}
    given = {"dark_e": 50, "mask": mask, "figures": figures}
    drawn = dict.fromkeys(EXTRAS, True)
    found = on_device(rate, (17, 5), **given, **drawn)
    # The light errs by nine roundings and 1e-6 of the deviates' shares, 5 sigmas of 6 % together.
    # The dark signal errs by exp, 3 + 2 * 3 ULP of 2^-23, and by its argument to 0.7 * 1e-6 * 5.
    light = 9 * 2.0**-24 + 5e-6 * 0.06
    assert_close(found, expected, rtol=light + 18 * 2.0**-24 + 4e-6)
    for name in EXTRAS:  # the control
        without = on_device(rate, (17, 5), **given, **(drawn | {name: False}))
        assert np.abs(without / expected - 1).max() > 0.01


def test_lines_do_not_depend_on_the_tile():
    drawn = {"figures": LINED, "PRNU_LINES": True, "PRNU": False}
    whole = on_device(np.ones((40, 130), F32), **drawn)
    part = on_device(np.ones((9, 21), F32), (13, 50), **drawn)
    assert_close(part, whole[13:22, 50:71].copy(), atol=0)
    response = whole - whole.mean()
    assert np.linalg.matrix_rank(response.astype(float), tol=1e-6) == 2  # rows and columns alone


def test_rows_and_columns_have_their_variances():
    shape, sigma = (512, 512), 0.01
    for name, axis in (("prnu_row", 1), ("prnu_column", 0)):
        drawn = {"figures": {name: sigma}, "PRNU_LINES": True, "PRNU": False}
        z = on_device(np.ones(shape, F32), exposure_s=1, dark_e=0, **drawn)
        line = (z[:, 0] if axis else z[0]).astype(float)
        assert np.array_equal(z, np.broadcast_to(np.expand_dims(line, axis), shape))
        line = (line - 1) / sigma
        assert kstest(line, "norm").pvalue > LEVEL
        for shift in (1, 2, 4):
            bound = np.sqrt(chi2.isf(LEVEL / 3, 1) / 512)
            assert abs(np.mean(line * np.roll(line, shift))) < bound


def test_dark_currents_have_the_mean_and_the_spread_that_they_should():
    n, dcnu = 512 * 512, 0.5
    figures = {"log_dcnu": np.sqrt(np.log1p(dcnu**2))}
    found = on_device(
        np.zeros((512, 512), F32), dark_e=10, figures=figures, DCNU=True, PRNU=False
    ).astype(float)
    assert found.min() > 0
    bound = np.sqrt(chi2.isf(LEVEL / 2, 1))
    assert abs(found.mean() / 10 - 1) < bound * dcnu / np.sqrt(n)
    # Relative variance of a log-normal's variance: w^4 + 2 w^3 + 3 w^2 - 4, w = 1 + dcnu^2, over n
    w = 1 + dcnu**2
    spread = np.sqrt((w**4 + 2 * w**3 + 3 * w**2 - 4) / n)
    assert abs((found / 10).var() / dcnu**2 - 1) < bound * spread
    z = np.log(found / 10) / figures["log_dcnu"] + figures["log_dcnu"] / 2
    assert kstest(z.ravel(), "norm").pvalue > LEVEL


def test_fixed_patterns_are_unrelated():
    ones = np.ones((256, 256), F32)
    dark = {"figures": {"log_dcnu": 0.1}, "DCNU": True, "PRNU": False}
    fields = [
        on_device(ones, exposure_s=1, dark_e=0),
        on_device(0 * ones, dark_e=1, **dark),
        on_device(ones, figures={"prnu_row": 1e-2}, PRNU_LINES=True, PRNU=False),
        on_device(ones, figures={"prnu_column": 1e-2}, PRNU_LINES=True, PRNU=False),
    ]
    for place, one in enumerate(fields):
        for other in fields[:place]:
            for transposed in (other, other.T):
                # There are 256 lines only.
                bound = 4.5 / 16 if place > 1 else 4.5 / 256
                assert abs(np.corrcoef(one.ravel(), transposed.ravel())[0, 1]) < bound


def test_the_mean_is_clipped_where_nothing_is_drawn_after_it():
    rate = rates((20, 64))
    clipped, whole = on_device(rate, limit_e=700.0), on_device(rate)
    assert_close(clipped, np.minimum(whole, F32(700.0)), atol=0)
    assert np.any(clipped < whole)
    expected = reference(rate, limit_e=700.0)
    assert expected.max() == 700.0
    assert_close(clipped, expected, rtol=6 * 2.0**-24 + 5e-8)


def test_light_is_never_negative_but_dark_signal_stays():
    found = on_device(np.full((64, 64), 100, F32), exposure_s=1, prnu=1, dark_e=0.25)
    assert found.min() == 0.25
    assert 0.1 < (found == 0.25).mean() < 0.2  # Phi(-1) = 0.159
    assert_close(on_device(np.zeros((4, 4), F32), dark_e=0.25), np.full((4, 4), 0.25), atol=0)


def pattern(serial: int = SERIAL, shape=(256, 256)) -> np.ndarray:
    """Return the deviates z of the fixed pattern."""
    found = on_device(np.ones(shape, F32), exposure_s=1, prnu=0.01, dark_e=0, serial=serial)
    return (found.astype(float) - 1) / 0.01


def test_the_pattern_is_normal_and_without_structure():
    z = pattern()
    assert kstest(z.ravel(), "norm").pvalue > LEVEL
    n = z.size
    bound = np.sqrt(chi2.isf(LEVEL / 8, 1))
    for shifted in ((0, 1), (1, 0), (1, 1), (0, 2), (0, 4), (2, 0), (4, 4)):
        assert abs(np.mean(z * np.roll(z, shifted, (0, 1)))) < bound / np.sqrt(n), shifted
    for axis in (0, 1):  # no row or column stands out
        assert np.abs(z.mean(axis)).max() < 4.5 / np.sqrt(256)  # 256 means: 1.7e-3 by chance
        assert z.std(axis).min() > 0.8


def test_another_serial_number_is_another_sensor():
    one = pattern()
    for other in (SERIAL + 1, SERIAL + (1 << 32)):
        correlation = np.corrcoef(one.ravel(), pattern(other).ravel())[0, 1]
        assert abs(correlation) < 3.5 / 256


def recorded(device: Device, rate: np.ndarray, sensor, exposure_s=0.1, **more) -> np.ndarray:
    rec = Recording(device)
    buffer = rec.buffer("rate", rate.shape, F32)
    rec.upload(buffer, rate)
    label = rec.download(record_exposure(rec, buffer, sensor, exposure_s, **more))
    return rec.run()[label]


def test_the_host_exposes_by_the_sensor(device: Device):
    sensor = load_sensor("imx477").model_copy(update={"prnu_percent": 2.0, "serial_number": SERIAL})
    rate = rates((33, 70))
    dark = dark_current(
        sensor.dark_current_e_per_s,
        42,
        sensor.reference_temperature_c,
        sensor.doubling_temperature_c,
    )
    expected = exposure(
        rate.astype(float),
        0.1,
        prnu=0.02,
        dark_current_e_per_s=dark,
        serial_number=SERIAL,
        origin=(3, 9),
    )
    found = recorded(device, rate, sensor, temperature_c=42.0, origin=(3, 9))
    # As above, and exposure_s, prnu and dark_e rounded to f32
    assert_close(found, expected, rtol=9 * 2.0**-24 + 5e-6 * 0.02)


def test_a_region_keeps_the_pattern_of_its_pixels(device: Device):
    sensor = load_sensor("imx477").model_copy(update={"rows": 40, "cols": 60})
    rate = np.ones((40, 60), F32)
    whole = recorded(device, rate, sensor)
    region = sensor.roi(20, 28)
    part = recorded(device, np.ones((20, 28), F32), region)
    first = (region.first_row, region.first_col)
    assert first == (10, 16)
    assert_close(part, whole[first[0] : first[0] + 20, first[1] : first[1] + 28].copy(), atol=0)


def test_dark_current_doubles_with_temperature(device: Device):
    sensor = load_sensor("imx477")
    dark = [
        recorded(device, np.zeros((1, 1), F32), sensor, 10.0, temperature_c=temperature)[0, 0]
        for temperature in (25.0, 25 + 5.9, 25 + 2 * 5.9, None)
    ]
    # 1 e-/s at 25 C, the default, for 10 s; rounded once
    assert_close(np.array(dark), np.array([10.0, 20.0, 40.0, 10.0]), rtol=2.0**-23)


@pytest.mark.parametrize("exposure_s", [-1e-3, float("nan"), float("inf")])
def test_a_time_that_is_none_is_refused(device: Device, exposure_s: float):
    with pytest.raises(UserError, match="not an exposure time") as caught:
        recorded(device, np.zeros((1, 1), F32), load_sensor("imx477"), exposure_s)
    assert caught.value.field == "exposure_s"


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/exposure").workgroup_size == (32, 2, 1)

"""Noise: against float64 from the same random words; tiles, sizes, limits; independence.

The law of the Poisson counts is tested in test_poisson, that of the deviates in test_gaussian.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage
from scipy.stats import chi2, kstest, norm
from sensor import tiles

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.noise import noise, poisson, softened
from gpusim.sensor.load import load_sensor
from gpusim.sensor.noise import record_noise

F32 = np.float32
SEED, SERIAL = (9 << 32) + 77, (5 << 32) + 88
LEVEL = 1e-3  # of each statistical test; the seeds are fixed
QUIET = {"full_well_e": 1e9, "temporal_dark_noise_e": 0.0, "dsnu_e": 0.0}
# What few sensors have: off where a test does not ask for it.
EXTRAS = ("DSNU_LINES", "MASK", "RESET", "LINES", "READ_TABLE")


def on_device(
    mean: np.ndarray,
    origin=(0, 0),
    full_well_e=8180.0,
    temporal_dark_noise_e=3.0,
    dsnu_e=1.5,
    frame=4,
    seed=SEED,
    serial=SERIAL,
    spare=0,
    mask=None,
    quantiles=None,
    figures=None,
    **overrides,
) -> np.ndarray:
    rows, cols = mean.shape
    names = ("knee_e", "variance_per_e", "reset_noise_e", "row_noise_e", "column_noise_e")
    params = {
        "seed": (seed & 0xFFFFFFFF, seed >> 32),
        "serial": (serial & 0xFFFFFFFF, serial >> 32),
        "frame": frame,
        "row0": origin[0],
        "col0": origin[1],
        "rows": rows,
        "cols": cols,
        "full_well_e": full_well_e,
        "temporal_dark_noise_e": temporal_dark_noise_e,
        "dsnu_e": dsnu_e,
        **dict.fromkeys((*names, "dsnu_row_e", "dsnu_column_e"), 0.0),
        **(figures or {}),
    }
    nothing = np.zeros(1, F32)
    result = run_stage(
        "sensor/noise",
        (-(-(origin[1] % 4 + cols) // 128), -(-rows // 2), 1),
        params,
        {
            "mean": mean,
            "mask": nothing if mask is None else mask,
            "quantiles": nothing if quantiles is None else quantiles,
        },
        {"electrons": (rows * cols + spare, F32)},
        **(dict.fromkeys(EXTRAS, False) | overrides),
    )
    electrons = result["electrons"]
    return electrons if spare else electrons.reshape(mean.shape)


def reference(
    mean: np.ndarray, full_well_e=8180.0, temporal_dark_noise_e=3.0, dsnu_e=1.5, **more
) -> np.ndarray:
    """Return what `on_device` should: float64, from the same random words."""
    figures = {"temporal_dark_noise_e": temporal_dark_noise_e, "dsnu_e": dsnu_e}
    keys = {"seed": SEED, "frame": 4, "serial_number": SERIAL}
    return noise(mean.astype(float), full_well_e=full_well_e, **figures, **keys, **more)


def means(shape: tuple[int, int]) -> np.ndarray:
    return np.exp(np.random.default_rng(61).uniform(-7, 10, shape)).astype(F32)


# --- the stage ---


@pytest.mark.parametrize(("read", "dsnu"), [(3.0, 1.5), (0.0, 1.5), (3.0, 0.0)])
def test_electrons_are_those_of_the_reference(read: float, dsnu: float):
    mean = means((150, 411))
    expected = reference(mean, 8180.5, read, dsnu, origin=(17, 5))
    found = on_device(mean, (17, 5), 8180.5, read, dsnu)
    # Two additions of up to 8200: 2^-24 * 8200 * 2 = 1e-3; the deviates 1e-6. A Poisson uniform on
    # a step is rare (test_poisson): at most 5 of 61 650 may differ, by no more than the noise.
    assert_close(found, expected, atol=1.1e-3, outliers=5 / mean.size, outlier_atol=1000)
    assert (mean > 8300).sum() > 1000  # some are full


@tiles.shapes
@tiles.columns
def test_tiles_are_parts_of_the_whole_bit_for_bit(shape: tuple[int, int], col0: int):
    tiles.check_tile(on_device, means(tiles.WHOLE), shape, col0)


def test_a_full_well_stays_full():
    found = on_device(
        np.full((16, 16), 1e7, F32), full_well_e=8180, temporal_dark_noise_e=0, dsnu_e=0
    )
    assert_close(found, np.full((16, 16), 8180.0), atol=0)


def test_means_beyond_the_counts_are_limited():
    """1e12 e- must not overflow the count: it is drawn at 1.6e7, which fills every well."""
    found = on_device(np.full((16, 16), 1e12, F32), **QUIET)
    row, col = np.indices((16, 16))
    expected = poisson(np.full((16, 16), 1.6e7), row, col, 4, SEED)
    # A proposal so near to an integer that f32 carries it across: 1e-3 of them (test_poisson)
    assert (found != expected).sum() <= 3
    assert np.abs(found - expected).max() < 10 * np.sqrt(1.6e7)


def test_no_light_and_no_read_out_noise_is_nothing():
    found = on_device(np.zeros((16, 16), F32), **QUIET)
    assert_close(found, np.zeros((16, 16)), atol=0)


# --- independence ---


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


SIDE = 512
# |correlation| of independent noise exceeds this by chance once in 1e4
UNRELATED = np.sqrt(chi2.isf(1e-4, 1)) / SIDE
SHIFTS = [(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (0, 3), (0, 4), (2, 0), (4, 4)]

PARTS = {
    "shot, sums": (3.0, QUIET),
    "shot, expansion": (900.0, QUIET),
    "read": (0.0, {**QUIET, "temporal_dark_noise_e": 1.0}),
    "dsnu": (0.0, {**QUIET, "dsnu_e": 1.0}),
    "reset": (0.0, {**QUIET, "figures": {"reset_noise_e": 1.0}, "RESET": True}),
    "two numbers": (900.0, {**QUIET, "figures": {"variance_per_e": 1.0}, "GAUSSIAN": True}),
}


def part_of_noise(name: str, **changed) -> np.ndarray:
    mean, settings = PARTS[name]
    return on_device(np.full((SIDE, SIDE), mean, F32), **{**settings, **changed}).astype(float)


@pytest.mark.parametrize("name", PARTS)
def test_neighbours_are_unrelated_and_no_row_or_column_stands_out(name: str):
    field = part_of_noise(name)
    field = (field - field.mean()) / field.std()
    for shift in SHIFTS:
        assert abs(correlation(field, np.roll(field, shift, (0, 1)))) < UNRELATED, shift
    for axis in (0, 1):
        # 512 means of 512: the largest exceeds 4.9 sigma by chance once in 2000
        assert np.abs(field.mean(axis)).max() < 4.9 / np.sqrt(SIDE)
        assert field.std(axis).min() > 0.8


@pytest.mark.parametrize("name", [name for name in PARTS if name != "dsnu"])
def test_frames_and_seeds_are_unrelated(name: str):
    field = part_of_noise(name)
    for changed in ({"frame": 5}, {"seed": SEED + 1}, {"seed": SEED + (1 << 32)}):
        assert abs(correlation(field, part_of_noise(name, **changed))) < UNRELATED, changed
    assert np.array_equal(field, part_of_noise(name, serial=SERIAL + 1))


def test_the_dark_pattern_belongs_to_the_sensor_alone():
    field = part_of_noise("dsnu")
    assert np.array_equal(field, part_of_noise("dsnu", frame=5, seed=SEED + 1))
    for serial in (SERIAL + 1, SERIAL + (1 << 32)):
        assert abs(correlation(field, part_of_noise("dsnu", serial=serial))) < UNRELATED


def test_purposes_are_unrelated_even_under_one_key():
    same_key = {"seed": 7, "serial": 7, "frame": 0}
    fields = [
        part_of_noise(name, **same_key) for name in ("shot, expansion", "read", "dsnu", "reset")
    ]
    for place, one in enumerate(fields):
        for other in fields[:place]:
            for shift in [(0, 0), *SHIFTS]:
                assert abs(correlation(one, np.roll(other, shift, (0, 1)))) < UNRELATED


def lines_of(name: str, **changed) -> np.ndarray:
    """Return the deviates of rows or of columns, each line from the noise that has it alone."""
    drawn = {"DSNU_LINES": name.startswith("dsnu"), "LINES": not name.startswith("dsnu")}
    settings = {**QUIET, "figures": {name: 1.0}, **drawn, **changed}
    field = on_device(np.zeros((SIDE, SIDE), F32), **settings).astype(float)
    axis = 1 if "row" in name else 0
    assert np.array_equal(field, np.broadcast_to(field.mean(axis, keepdims=True), field.shape))
    return field.mean(axis)


LINE_NAMES = ("row_noise_e", "column_noise_e", "dsnu_row_e", "dsnu_column_e")


def test_lines_are_normal_and_unrelated_even_under_one_key():
    same_key = {"seed": 7, "serial": 7, "frame": 0}
    lines = [lines_of(name, **same_key) for name in LINE_NAMES]
    bound = np.sqrt(chi2.isf(1e-4, 1) / SIDE)
    for place, one in enumerate(lines):
        assert kstest(one, "norm").pvalue > LEVEL
        for shift in (1, 2, 3, 4):
            assert abs(correlation(one, np.roll(one, shift))) < bound
        for other in lines[:place]:
            for shift in (-1, 0, 1):
                assert abs(correlation(one, np.roll(other, shift))) < bound


@pytest.mark.parametrize("name", LINE_NAMES)
def test_lines_are_of_the_frame_or_of_the_sensor(name: str):
    bound = np.sqrt(chi2.isf(1e-4, 1) / SIDE)
    line = lines_of(name)
    own, others = {"frame": 5, "seed": SEED + 1}, {"serial": SERIAL + 1}
    if name.startswith("dsnu"):
        own, others = others, own
    for change in own.items():
        assert abs(correlation(line, lines_of(name, **dict([change])))) < bound
    assert np.array_equal(line, lines_of(name, **others))


def test_read_noise_is_normal():
    assert kstest(part_of_noise("read").ravel(), "norm").pvalue > LEVEL


@pytest.mark.parametrize(
    ("what", "override"), [("dsnu_e", "DSNU"), ("temporal_dark_noise_e", "READ_NOISE")]
)
def test_what_is_zero_is_not_drawn_and_nothing_changes(what: str, override: str):
    mean = means((37, 131))
    drawn = on_device(mean, (3, 2), **{what: 0.0})
    assert_close(on_device(mean, (3, 2), **{what: 0.0, override: False}), drawn, atol=0)
    # The control: where it is not zero, what is not drawn is missed.
    assert np.any(on_device(mean, (3, 2), **{override: False}) != on_device(mean, (3, 2)))


# --- the halves ---


@pytest.mark.parametrize("half", ["shot", "read_out"])
def test_a_half_is_that_of_the_reference(half: str):
    charge = means((37, 131))
    halves = {"shot": half == "shot", "read_out": half == "read_out"}
    expected = reference(charge, origin=(3, 2), **halves)
    drawn = dict.fromkeys(("DSNU", "READ_NOISE"), halves["read_out"])
    found = on_device(charge, (3, 2), SHOT=halves["shot"], **drawn)
    if half == "shot":
        assert np.array_equal(found, np.floor(found))
        assert_close(found, expected, atol=0, outliers=1 / charge.size, outlier_atol=1000)
    else:
        # Two additions of up to 22 000: 2^-24 * 22 000 * 2
        assert_close(found, expected, atol=2.8e-3)
        assert found.max() > 20_000  # the well is no part of the read-out


# --- the other laws ---


ALL = {
    "reset_noise_e": 7.0,
    "row_noise_e": 2.0,
    "column_noise_e": 5.0,
    "dsnu_row_e": 3.0,
    "dsnu_column_e": 4.0,
}


def heavy(z: np.ndarray) -> np.ndarray:
    """Return quantiles of a law with tails, at deviates of the normal law."""
    return z + 0.05 * z**3


TABLE = heavy(np.linspace(-6.5, 6.5, 1025)).astype(F32)


def test_everything_that_is_read_with_the_charge_is_that_of_the_reference():
    charge = means((60, 411))
    mask = np.random.default_rng(62).uniform(-50, 50, charge.shape).astype(F32)
    expected = reference(
        charge, shot=False, mask=mask.astype(float), law=heavy, origin=(17, 5), **ALL
    )
    given = {"mask": mask, "quantiles": TABLE, "figures": ALL, "SHOT": False}
    drawn = dict.fromkeys(EXTRAS, True)
    found = on_device(charge, (17, 5), **given, **drawn)
    # Seven additions to 22 000. The table's cells: 3 h^2 / 8 of the second derivative, 0.3 z.
    tolerance = 7 * 2.0**-24 * 22_500 + 3 * (13 / 1024) ** 2 / 8 * 0.3 * 5 + 1e-5 * 12
    assert_close(found, expected, atol=tolerance)
    for name in EXTRAS:  # the control
        without = on_device(charge, (17, 5), **given, **(drawn | {name: False}))
        assert np.abs(without - expected).max() > 1


TWO_NUMBERS = {"GAUSSIAN": True, "DSNU": False, "READ_NOISE": False}


def test_two_numbers_are_those_of_the_reference():
    mean = means((60, 411))
    expected = reference(mean, dsnu_e=0.0, variance_per_e=float(F32(1.3)))
    found = on_device(mean, figures={"variance_per_e": 1.3}, **TWO_NUMBERS)
    # sigma up to 170, deviates to 1e-6 of 5 sigmas, and four roundings of either
    assert_close(found, expected, atol=170 * 5 * 1.5e-6, rtol=4 * 2.0**-24)
    assert found.min() < 0 < (found == 8180).sum()


def test_two_numbers_have_their_variance_on_a_line():
    """The variance is a + b mean: by chi-square at five means."""
    a, b, n = 3.0**2, 0.7, SIDE**2
    settings = {**TWO_NUMBERS, "figures": {"variance_per_e": b}, "full_well_e": 1e6}
    for mean in (0.0, 10.0, 100.0, 1e3, 1e4):
        field = on_device(np.full((SIDE, SIDE), mean, F32), **settings).astype(float)
        sigma = np.sqrt(a + b * mean)
        assert abs(field.mean() - mean) < norm.isf(LEVEL / 20) * sigma / SIDE
        low, high = chi2.interval(1 - LEVEL / 10, n - 1)
        assert low < field.var() * n / sigma**2 < high


@pytest.mark.parametrize("knee", [0.5, 0.9])
def test_a_soft_well_is_that_of_the_reference(knee: float):
    mean = np.geomspace(10, 1e6, 256 * 64).astype(F32).reshape(256, 64)
    figures = {"knee_e": knee * 8180}
    expected = reference(mean, read_out=False, **figures)
    found = on_device(mean, figures=figures, SOFT_SATURATION=True, DSNU=False, READ_NOISE=False)
    # exp to 3 + 2 * 10 ULP of what is at most 1, times 4090; a count now and then (test_poisson)
    tolerance = 4090 * 23 * 2.0**-23 + 2.0**-24 * 8180
    assert_close(found, expected, atol=tolerance, outliers=5 / mean.size, outlier_atol=1.1)
    assert found.max() == 8180


def test_a_soft_well_fills_without_a_step_or_a_kink():
    charge = np.linspace(0, 30_000, 200_001)
    held = softened(charge, 8180.0, 0.8 * 8180)
    slope = np.diff(held) / np.diff(charge)
    assert np.all(slope >= 0) and np.all(slope[charge[1:] < 6544] > 1 - 1e-9)
    assert np.abs(np.diff(slope)).max() < 1.01 * 0.15 / 1636  # the second derivative at the knee
    assert held[-1] < 8180


def test_the_law_of_the_table_is_drawn():
    """Kolmogorov's test against the law whose quantiles the table lists."""
    quiet = {**QUIET, "temporal_dark_noise_e": 1.0}
    field = on_device(np.zeros((SIDE, SIDE), F32), quantiles=TABLE, READ_TABLE=True, **quiet)
    grid = np.linspace(-8, 8, 100_001)
    assert kstest(field.ravel(), lambda x: norm.cdf(np.interp(x, heavy(grid), grid))).pvalue > LEVEL
    assert kstest(field.ravel(), "norm").pvalue < 1e-9  # the control


# --- the host ---


def recorded(device: Device, mean: np.ndarray, sensor, **more) -> np.ndarray:
    rec = Recording(device)
    buffer = rec.buffer("mean", mean.shape, F32)
    rec.upload(buffer, mean)
    label = rec.download(record_noise(rec, buffer, sensor, **more))
    return rec.run()[label]


def test_the_host_adds_the_noise_of_the_sensor(device: Device):
    sensor = load_sensor("imx477").model_copy(
        update={"serial_number": SERIAL, "first_row": 2, "first_col": 6}
    )
    mean = means((33, 70))
    direct = on_device(mean, (5, 15), 8180.0, 3.0, 1.1)
    found = recorded(device, mean, sensor, seed=SEED, frame=4, origin=(3, 9))
    assert_close(found, direct, atol=0)
    first = recorded(device, mean, sensor, seed=SEED, origin=(3, 9))
    assert_close(first, on_device(mean, (5, 15), 8180.0, 3.0, 1.1, frame=0), atol=0)


def test_two_halves_are_the_whole(device: Device):
    sensor, mean = load_sensor("imx477"), means((33, 70))
    drawn = {"seed": SEED, "frame": 4, "origin": (3, 9)}
    rec = Recording(device)
    buffer = rec.buffer("mean", mean.shape, F32)
    rec.upload(buffer, mean)
    charge = record_noise(rec, buffer, sensor, **drawn, label="charge", read_out=False)
    label = rec.download(record_noise(rec, charge, sensor, **drawn, shot=False))
    assert_close(rec.run()[label], recorded(device, mean, sensor, **drawn), atol=0)


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/noise").workgroup_size == (32, 2, 1)

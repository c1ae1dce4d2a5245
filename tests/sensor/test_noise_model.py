"""What sensor files say of noise: reset, laws, masks; the effects they make; wrong ones refused."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import tifffile
from changes import sensor_file
from harness import assert_close
from pydantic import ValidationError
from scipy.stats import norm, t

from gpusim.errors import UserError
from gpusim.gpu import Device, Recording
from gpusim.sensor import noise_model
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.load import load_sensor
from gpusim.sensor.noise import QUANTILES, REACH, record_noise
from gpusim.sensor.noise_model import DefectPixel, ReadNoiseLaw, ResetNoise
from gpusim.sensor.sensor import Sensor

F32 = np.float32


def written(tmp_path: Path, **changes: object) -> Path:
    """Return the file of a small sensor with some fields changed."""
    small = {"rows": 24, "cols": 36, "first_row": 2, "first_col": 4}
    return sensor_file(tmp_path, **(small | changes))


# --- reset noise ---


def test_the_noise_of_a_capacitance_is_that_of_the_text_books():
    """At 300 K 1 fF holds 12.7 electrons of noise, 10 fF 40."""
    assert ResetNoise(capacitance_ff=1).at(26.85) == pytest.approx(12.70, abs=0.005)
    assert ResetNoise(capacitance_ff=10).at(26.85) == pytest.approx(40.17, abs=0.005)
    assert ResetNoise(capacitance_ff=1).at(326.85) == pytest.approx(12.70 * 2**0.5, abs=0.01)
    assert ResetNoise(noise_e=7).at(326.85) == 7


# --- the law of the read noise ---


def test_a_straight_line_is_the_normal_law():
    p = [0.01, 0.3, 0.99]
    law = ReadNoiseLaw(probabilities=p, values=list(40 + 7 * norm.ppf(p)))
    z = np.linspace(-6.5, 6.5, 101)
    assert_close(law.quantiles(z), z, atol=1e-9)


def test_a_law_has_mean_0_and_standard_deviation_1_and_its_own_tails():
    p = np.r_[1e-6, 1e-5, 1e-4, np.linspace(1e-3, 0.999, 401), 1 - np.r_[1e-4, 1e-5, 1e-6]]
    law = ReadNoiseLaw(probabilities=list(p), values=list(3 * t.ppf(p, 5) + 2))

    z = np.linspace(-7.5, 7.5, 300_001)
    values, step = law.quantiles(z), z[1] - z[0]
    assert np.sum(values * norm.pdf(z)) * step == pytest.approx(0, abs=1e-6)
    assert np.sum(values**2 * norm.pdf(z)) * step == pytest.approx(1, abs=1e-6)
    # Student's law of 5 degrees of freedom, scaled to 1: at probability 1e-6 9 sigmas out, not 4.8.
    assert law.quantiles(norm.ppf([1e-6]))[0] == pytest.approx(
        t.ppf(1e-6, 5) / (5 / 3) ** 0.5, rel=0.02
    )


def test_the_host_draws_from_the_table_of_the_law(device: Device, tmp_path: Path):
    p = [float(one) for one in norm.cdf(np.linspace(-4, 4, 33))]
    values = [float(z + 0.1 * z**3) for z in norm.ppf(p)]
    law = {"probabilities": p, "values": values}
    plain = load_sensor(written(tmp_path, dsnu_e=0.0))
    heavy = load_sensor(written(tmp_path, dsnu_e=0.0, read_noise_law=law))
    z, found = (recorded_noise(device, one, np.zeros((24, 36), F32)) / 3 for one in (plain, heavy))
    grid = np.linspace(-REACH, REACH, QUANTILES)
    expected = np.interp(z, grid, heavy.read_noise_law.quantiles(grid))
    # z is known to 2^-23; the table's slope is up to 1 + 0.3 * 4^2 over the law's sigma of 1.4
    assert_close(found, expected, atol=4e-6)
    assert np.abs(found - z).max() > 0.1


def recorded_noise(device: Device, sensor: Sensor, mean: np.ndarray, **more: object) -> np.ndarray:
    rec = Recording(device)
    buffer = rec.buffer("mean", mean.shape, F32)
    rec.upload(buffer, mean)
    label = rec.download(record_noise(rec, buffer, sensor, seed=3, **more))
    return rec.run()[label]


# --- masks ---


def save(path: Path, plane: np.ndarray) -> None:
    if path.suffix == ".npy":
        np.save(path, plane)
    elif path.suffix == ".tif":
        tifffile.imwrite(path, plane)
    else:
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"Y": plane}) as file:
            file.write(str(path))


@pytest.mark.parametrize("suffix", [".npy", ".tif", ".exr"])
def test_a_pair_of_masks_is_applied_pixel_by_pixel(device: Device, tmp_path: Path, suffix: str):
    rng = np.random.default_rng(81)
    gain = rng.uniform(0.5, 1.5, (24, 36)).astype(F32)
    offset = rng.uniform(-90, 90, (24, 36)).astype(F32)
    save(tmp_path / f"gain{suffix}", gain)
    save(tmp_path / f"offset{suffix}", offset)
    masks = {"gain": f"gain{suffix}", "offset_e": f"offset{suffix}"}
    quiet = {"prnu_percent": 0.0, "dsnu_e": 0.0, "temporal_dark_noise_e": 0.0}
    sensor = load_sensor(written(tmp_path, masks=masks, dark_current_e_per_s=0.0, **quiet))
    assert sensor.effects == {"gain mask", "offset mask"}
    rec = Recording(device)
    rate = rec.buffer("rate", (5, 7), F32)
    rec.upload(rate, np.full((5, 7), 100, F32))
    exposed = record_exposure(rec, rate, sensor, 1.0, origin=(3, 9))
    read = record_noise(rec, exposed, sensor, seed=1, origin=(3, 9), shot=False)
    labels = [rec.download(one) for one in (exposed, read)]
    result = rec.run()
    at = np.s_[3:8, 9:16]
    assert_close(result[labels[0]], 100 * gain[at].astype(float), rtol=2.0**-24)
    assert_close(result[labels[1]], 100.0 * gain[at] + offset[at], rtol=2.0**-22, atol=1e-5)
    # A region of the chip has its part.
    region = sensor.roi(10, 12)
    place = (region.first_row, region.first_col)
    part = region.masks.part("gain", place, (10, 12))
    top, left = place[0] - 2, place[1] - 4
    assert np.array_equal(part, gain[top : top + 10, left : left + 12])


@pytest.mark.parametrize(
    ("plane", "said", "allowed"),
    [
        (np.ones((24, 35), F32), "not of the sensor's size", "24 x 36"),
        (np.ones((24, 36, 3), F32), "cannot be read: 3 dimensions", ".npy"),
        (-np.ones((24, 36), F32), "values that are none", "none negative"),
        (np.full((24, 36), np.nan, F32), "values that are none", "finite"),
        (np.array([{}], object), "cannot be read", ".npy"),
        (np.ones((24, 36), complex), "values of type complex128", ".npy"),
        (np.ones((24, 36), bool), "values of type bool", ".npy"),
    ],
)
def test_a_wrong_mask_is_refused(tmp_path: Path, plane: np.ndarray, said: str, allowed: str):
    np.save(tmp_path / "gain.npy", plane)
    with pytest.raises(UserError, match=said) as caught:
        load_sensor(written(tmp_path, masks={"gain": "gain.npy"}))
    assert caught.value.field.startswith("masks")
    assert Path(caught.value.file).name == "gain.npy"
    assert allowed in caught.value.allowed


def test_a_mask_is_what_it_was_when_the_sensor_was_loaded(tmp_path: Path):
    file = tmp_path / "gain.npy"
    np.save(file, np.ones((24, 36), F32))
    first = load_sensor(written(tmp_path, masks={"gain": "gain.npy"}))
    np.save(file, np.full((24, 36), 2, F32))
    second = load_sensor(written(tmp_path, masks={"gain": "gain.npy"}))
    assert first != second  # what was prepared for one is not taken for the other
    whole = (first.first_row, first.first_col), (24, 36)
    assert first.masks.part("gain", *whole).mean() == 1
    assert second.masks.part("gain", *whole).mean() == 2
    noise_model._PLANES.clear()
    assert second.masks.part("gain", *whole).mean() == 2
    with pytest.raises(UserError, match="has changed since"):
        first.masks.part("gain", *whole)


def test_a_mask_that_is_not_there_or_of_another_kind_is_refused(tmp_path: Path):
    (tmp_path / "gain.png").write_bytes(b"x")
    for name in ("none.npy", "gain.png"):
        with pytest.raises(UserError, match="cannot be read"):
            load_sensor(written(tmp_path, masks={"gain": name}))


# --- effects ---

EVERYTHING = {
    "dcnu_percent": 20.0,
    "full_well_knee": 0.9,
    "lines": {
        "prnu_row_percent": 0.1,
        "dsnu_column_e": 1.0,
        "row_noise_e": 0.5,
    },
    "reset_noise": {"noise_e": 3.0},
    "defects": {"hot_fraction": 1e-3, "hot_e_per_s": 100.0},
}


def test_a_sensor_has_the_effects_that_its_file_gives(tmp_path: Path):
    assert load_sensor(written(tmp_path)).effects == {"prnu", "dsnu", "read noise"}
    names = {
        "prnu lines",
        "dcnu",
        "defects",
        "soft saturation",
        "dsnu lines",
        "reset noise",
        "line noise",
    }
    full = load_sensor(written(tmp_path, **EVERYTHING))
    assert full.effects == {"prnu", "dsnu", "read noise"} | names
    two = load_sensor(written(tmp_path, gaussian_variance_per_e=0.0))
    assert two.effects == {"prnu", "dsnu", "two numbers"}


def test_reset_noise_follows_the_temperature(device: Device, tmp_path: Path):
    quiet = {"dsnu_e": 0.0, "temporal_dark_noise_e": 0.0}
    sensor = load_sensor(written(tmp_path, reset_noise={"capacitance_ff": 1.0}, **quiet))
    charge = np.zeros((24, 36), F32)
    cold, hot = (
        recorded_noise(device, sensor, charge, temperature_c=c) for c in (26.85, 1.5 * 300 - 273.15)
    )
    assert_close(hot, np.sqrt(1.5) * cold, rtol=1e-5)
    # 864 deviates: the standard deviation within 4 sigmas of 1/sqrt(2 n)
    assert abs(cold.std() / 12.70 - 1) < 4 / np.sqrt(2 * 864)


# --- wrong files ---


@pytest.mark.parametrize(
    ("changes", "field", "said"),
    [
        ({"lines": {"row_noise_e": -1}}, "lines.row_noise_e", None),
        ({"lines": {"rows": 1}}, "lines.rows", "unknown field"),
        ({"reset_noise": {}}, "reset_noise", "twice or not at all"),
        ({"reset_noise": {"noise_e": 1, "capacitance_ff": 1}}, "reset_noise", "twice"),
        ({"full_well_knee": 0}, "full_well_knee", None),
        ({"full_well_knee": 1.1}, "full_well_knee", None),
        ({"dcnu_percent": -1}, "dcnu_percent", None),
        ({"bloom": True, "full_well_knee": 0.9}, "full_well_knee", "where charge blooms"),
        (
            {
                "gaussian_variance_per_e": 1,
                "read_noise_law": {"probabilities": [0.1, 0.5], "values": [1, 2]},
            },
            None,
            "gaussian_variance_per_e replaces",
        ),
        ({"gaussian_variance_per_e": -0.1}, "gaussian_variance_per_e", None),
        (
            {"read_noise_law": {"probabilities": [0.5, 0.4], "values": [1, 2]}},
            "read_noise_law",
            "do not rise",
        ),
        (
            {"read_noise_law": {"probabilities": [0.5, 1.0], "values": [1, 2]}},
            "read_noise_law",
            "from 0 to 1",
        ),
        (
            {"read_noise_law": {"probabilities": [0.1, 0.5], "values": [1, 2, 3]}},
            "read_noise_law",
            "3 values",
        ),
        (
            {"read_noise_law": {"probabilities": [0.1, 0.5], "values": [2, 1]}},
            "read_noise_law",
            "values do not rise",
        ),
        ({"defects": {"dead_fraction": 0.2}}, "defects.dead_fraction", None),
        ({"defects": {"hot_fraction": 0.01}}, "defects", "no dark current"),
        ({"defects": {"pixels": [{"row": 3, "col": 4}]}}, "defects.pixels.1.kind", "missing"),
        (
            {"defects": {"pixels": [{"row": 3, "col": 4, "kind": "cold"}]}},
            "defects.pixels.1.kind",
            None,
        ),
        (
            {"defects": {"pixels": 2 * [{"row": 3, "col": 4, "kind": "dead"}]}},
            "defects",
            "listed 2 times",
        ),
        (
            {"defects": {"pixels": [{"row": 1, "col": 4, "kind": "dead"}]}},
            None,
            "beside the sensor",
        ),
    ],
)
def test_a_wrong_field_is_named(tmp_path: Path, changes: dict, field: str | None, said: str | None):
    with pytest.raises(UserError, match=said) as caught:
        load_sensor(written(tmp_path, **changes))
    assert caught.value.field == field
    assert caught.value.allowed


@pytest.mark.parametrize(("kind", "value"), [("dead", 1.0), ("hot", None), ("stuck", None)])
def test_a_defect_has_a_value_where_it_needs_one(kind: str, value: float | None):
    with pytest.raises(ValidationError, match=f"a {kind} pixel has"):
        DefectPixel(row=1, col=2, kind=kind, value=value)

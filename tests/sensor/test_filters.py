"""Filters in front of the sensor or the lens: their product with the QE, and wrong files."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from changes import sensor_file
from optics.made import bank, sensor
from scipy.interpolate import BarycentricInterpolator

from gpusim.camera import load_camera
from gpusim.errors import UserError
from gpusim.optics.spectral_basis import LIGHT_M_S, PLANCK_J_S, spectral_weights
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.filters_model import Filter, passed
from gpusim.sensor.load import PRESETS, load_sensor

GRID = [400.0, 650.0, 655.0, 700.0]
NAN = float("nan")
FLAT = {"wavelengths_nm": [400, 700], "transmission": [1, 1]}
CUT = [1.0, 1.0, 0.0, 0.0]


def written(tmp_path: Path, *filters: dict) -> Path:
    """Write the preset with filters."""
    return sensor_file(tmp_path, filters=list(filters))


def csv(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "cut.csv"
    file.write_text(text)
    return file


def test_electrons_are_the_papers_integral_with_the_filter():
    """N_c = integral (lambda / h c) EQE E A dlambda, with E = L Omega T and the filter's share."""
    lens, cut = bank(), Filter(name="cut", wavelengths_nm=GRID, transmission=CUT)
    camera = sensor(filters=[cut])
    radiance = np.linspace(1e-3, 2e-3, 61)
    # What the lens passes lies on a parabola in 1 / lambda through its three wavelengths.
    passes = BarycentricInterpolator(
        1e3 / lens.wavelengths_nm, lens.projected_solid_angle_sr * lens.transmission
    )
    irradiance = radiance * passes(1e3 / WAVELENGTHS_NM)
    open_qe = sensor().qe
    expected = [
        np.trapezoid(
            WAVELENGTHS_NM
            * 1e-9
            / (PLANCK_J_S * LIGHT_M_S)
            * open_qe[name]
            * np.where(WAVELENGTHS_NM <= 650, 1.0, 0.0)
            * irradiance
            * (1.55e-6) ** 2,
            WAVELENGTHS_NM,
        )
        for name in camera.channels
    ]
    found = spectral_weights(lens, camera).sum(axis=1) @ radiance
    assert np.abs(found / expected - 1).max() < 1e-12  # sums of 61 products in float64


def test_filters_multiply():
    half = Filter(name="half", wavelengths_nm=[300, 800], transmission=[0.5, 0.5])
    slope = Filter(name="slope", wavelengths_nm=[400, 700], transmission=[0.2, 0.8])
    assert passed([half, slope]) == pytest.approx(0.5 * np.linspace(0.2, 0.8, 61), abs=1e-15)
    assert (passed([]) == 1).all()


def test_no_filter_changes_no_bit():
    before, measured = sensor().qe, sensor().quantum_efficiency
    for name, curve in before.items():
        expected = np.interp(WAVELENGTHS_NM, measured.wavelengths_nm, measured.channels[name])
        assert np.array_equal(curve, expected)


def test_a_filter_is_read_from_a_table_beside_the_sensor(tmp_path: Path):
    csv(tmp_path, "# an infra-red cut\n400, 1\n650, 1  # edge\n655, 0\n\n700, 0\n")
    (found,) = load_sensor(written(tmp_path, {"file": "cut.csv"})).filters
    assert (found.name, found.wavelengths_nm, found.transmission) == (
        "cut",
        tuple(GRID),
        tuple(CUT),
    )


def test_filters_in_front_of_the_lens_count_as_well(tmp_path: Path):
    csv(tmp_path, "400, 0.5\n700, 0.5\n")
    file = tmp_path / "camera.yaml"
    data = yaml.safe_load((PRESETS.parent / "cameras" / "demo.yaml").read_text())
    file.write_text(yaml.safe_dump(data | {"filters": [{"name": "grey", "file": "cut.csv"}]}))
    found = load_camera(file).sensor.qe["G"]
    assert np.array_equal(found, 0.5 * load_camera("demo").sensor.qe["G"])


@pytest.mark.parametrize(
    ("entry", "field", "said"),
    [
        (
            {"wavelengths_nm": [400, 700], "transmission": [0.5, -0.1]},
            "filters.1.transmission.2",
            "0",
        ),
        ({"wavelengths_nm": [400, 650], "transmission": [1, 1]}, "filters.1", "400 to 700 nm"),
        ({"wavelengths_nm": [700, 400], "transmission": [1, 1]}, "filters.1", "more than"),
        ({"wavelengths_nm": [400, 700], "transmission": [1]}, "filters.1", "2, as wavelengths"),
        (
            {"wavelengths_nm": [400, 700], "transmission": [1, float("nan")]},
            "filters.1.transmission",
            "",
        ),
        (FLAT | {"colour": 3}, "filters.1.colour", "transmission"),
        ({"file": "cut.csv", "transmission": [1]}, "filters.1", "one or the other"),
    ],
)
def test_a_wrong_filter_is_refused(tmp_path: Path, entry: dict, field: str, said: str):
    csv(tmp_path, "400, 1\n700, 1\n")
    file = written(tmp_path, {"name": "cut", **entry})
    with pytest.raises(UserError) as error:
        load_sensor(file)
    assert error.value.file == file
    assert error.value.field.startswith(field)
    assert said in (error.value.allowed or "")


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("400, 1\n550, -0.1\n700, 1\n", "line 2"),
        ("400, 1\n550, nan\n", "line 2"),
        ("nm, T\n400, 1\n", "line 1"),
        ("400, 1, 2\n", "line 1"),
    ],
)
def test_a_wrong_line_of_a_table_is_named(tmp_path: Path, text: str, field: str):
    table = csv(tmp_path, text)
    with pytest.raises(UserError) as error:
        load_sensor(written(tmp_path, {"name": "cut", "file": "cut.csv"}))
    assert (error.value.file, error.value.field) == (table, field)


def test_a_missing_table_is_named(tmp_path: Path):
    with pytest.raises(UserError, match="cannot be read") as error:
        load_sensor(written(tmp_path, {"file": "none.csv"}))
    assert error.value.file == tmp_path / "none.csv"


def test_more_than_all_light_is_warned_of_by_name(tmp_path: Path):
    file = written(
        tmp_path, {"name": "laser", "wavelengths_nm": [400, 700], "transmission": [1, 1.2]}
    )
    with pytest.warns(UserWarning, match="filter laser exceeds 1: 1.2"):
        load_sensor(file)

"""The sensor model: the preset's figures, regions, and a clear screen for each wrong field."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from changes import sensor_file
from command_line import assert_refused, gpusim
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gpusim.cli import app
from gpusim.config.mistakes import user_error
from gpusim.errors import UserError
from gpusim.scene.spectra import WAVELENGTHS_NM, illuminant
from gpusim.sensor.adc_model import ColumnOffset
from gpusim.sensor.load import load_sensor, presets
from gpusim.sensor.noise_model import DefectPixel, Defects
from gpusim.sensor.sensor import Sensor


@pytest.fixture
def sensor() -> Sensor:
    return load_sensor("imx477")


# --- presets ---


def test_there_are_presets():
    assert "imx477" in presets()


@pytest.mark.parametrize("name", presets())
def test_every_figure_of_a_preset_has_a_source(name: str):
    sensor = load_sensor(name)
    own = {"name", "serial_number", "first_row", "first_col", "sources"}
    assert set(sensor.sources) == sensor.model_fields_set - own
    assert all(sensor.sources.values())


def test_the_imx477_is_the_published_one(sensor: Sensor):
    assert (sensor.rows, sensor.cols, sensor.pixel_pitch_um) == (3040, 4056, 1.55)
    assert (sensor.bit_depth, sensor.black_level_dn, sensor.max_dn) == (12, 256, 4095)
    assert sensor.site_channels() == ("B", "G", "G", "R")
    assert sensor.channels == ("R", "G", "B")
    assert sensor.period == (2, 2)
    # The full well fills the converter, and little more: 256 + 0.47 * 8180 = 4101
    full = sensor.black_level_dn + sensor.system_gain_dn_per_e * sensor.full_well_e
    assert 4095 <= full < 4110


def test_the_white_balance_is_that_of_the_camera(sensor: Sensor):
    """Grey under D50: R/G 0.342, B/G 0.687 (libcamera's calibration at 5000 K)."""
    electrons = {
        name: np.sum(curve * illuminant("D50") * WAVELENGTHS_NM)
        for name, curve in sensor.qe.items()
    }
    # Peaks have 3 digits, 0.0005 / 0.256, and curves 4; below 400 and above 700 nm lies < 1e-3.
    assert abs(electrons["R"] / electrons["G"] - 0.342) < 0.342 * 4e-3
    assert abs(electrons["B"] / electrons["G"] - 0.687) < 0.687 * 4e-3


def test_the_curves_are_the_measured_ones_per_photon(sensor: Sensor):
    import colour  # here: it takes 1 s

    measured = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]
    inside = np.isin(measured.wavelengths, WAVELENGTHS_NM)
    for name, curve in zip("RGB", measured.values.T, strict=True):
        per_photon = (curve / measured.wavelengths)[inside]
        expected = per_photon / per_photon.max() * sensor.qe[name].max()
        assert np.abs(sensor.qe[name] - expected).max() <= 0.51e-4  # four decimals in the file


# --- derived values ---


def test_quantum_efficiency_is_interpolated_onto_the_grid(tmp_path: Path):
    grid = [390.0, 500.0, 710.0]
    channels = {"R": [0.0, 0.5, 0.29], "G": [0.1, 0.1, 0.1], "B": [0.2, 0.0, 0.0]}
    file = sensor_file(tmp_path, quantum_efficiency={"wavelengths_nm": grid, "channels": channels})
    qe = load_sensor(file).qe
    assert qe["R"].shape == WAVELENGTHS_NM.shape
    assert qe["R"][WAVELENGTHS_NM == 445.0] == pytest.approx(0.25, abs=1e-15)
    assert qe["R"][WAVELENGTHS_NM == 700.0] == pytest.approx(0.30, abs=1e-15)
    with pytest.raises(ValueError, match="read-only"):
        qe["R"][0] = 1


def test_a_copy_with_other_curves_works_its_own_out():
    sensor = load_sensor("imx477")
    assert sensor.qe["G"].max() == 0.563  # kept from now on
    flat = sensor.quantum_efficiency.model_copy(
        update={"channels": dict.fromkeys("RGB", [0.25] * 61)}
    )
    copy = sensor.model_copy(update={"quantum_efficiency": flat})
    assert copy.qe["G"].max() == 0.25 and sensor.qe["G"].max() == 0.563


def test_a_monochrome_sensor_has_one_site(tmp_path: Path):
    curves = {"wavelengths_nm": [400, 700], "channels": {"W": [0.5, 0.5]}}
    file = sensor_file(tmp_path, cfa={"pattern": [["W"]]}, quantum_efficiency=curves)
    sensor = load_sensor(file)
    assert (sensor.period, sensor.site_channels(), sensor.channels) == ((1, 1), ("W",), ("W",))


def test_unlike_photosites_of_one_colour_are_channels_of_their_own(tmp_path: Path):
    flat = {"R": 0.3, "Gr": 0.5, "Gb": 0.4, "B": 0.2}
    curves = {
        "wavelengths_nm": [400, 700],
        "channels": {name: [value, value] for name, value in flat.items()},
    }
    pattern = {"pattern": [["B", "Gb"], ["Gr", "R"]]}
    sensor = load_sensor(sensor_file(tmp_path, cfa=pattern, quantum_efficiency=curves))
    assert sensor.channels == ("R", "Gb", "Gr", "B")
    assert sensor.site_channels() == ("B", "Gb", "Gr", "R")
    assert sensor.cfa.letters == [["B", "G"], ["G", "R"]]
    assert {name: curve[7] for name, curve in sensor.colour_qe.items()} == pytest.approx(
        {"R": 0.3, "G": 0.45, "B": 0.2}
    )


def test_dark_current_doubles(sensor: Sensor):
    assert sensor.dark_current_at(25) == 1.0
    assert sensor.dark_current_at(25 + 5.9) == pytest.approx(2.0, rel=1e-12)
    assert sensor.dark_current_at(25 - 11.8) == pytest.approx(0.25, rel=1e-12)


@pytest.mark.parametrize("temperature_c", [-273.15, -300, float("nan"), float("inf")])
def test_a_temperature_that_is_none_is_refused(sensor: Sensor, temperature_c: float):
    with pytest.raises(UserError, match="not a temperature") as caught:
        sensor.dark_current_at(temperature_c)
    assert caught.value.field == "temperature_c"


def test_a_region_is_central_and_keeps_the_phase(sensor: Sensor):
    region = sensor.roi(1520, 2028)
    assert (region.rows, region.cols, region.first_row, region.first_col) == (1520, 2028, 760, 1014)
    odd = sensor.roi(1517, 2027)
    assert (odd.first_row, odd.first_col) == (760, 1014)  # 761.5 and 1014.5, down to whole patterns
    inner = region.roi(1000, 28)
    assert (inner.first_row, inner.first_col) == (760 + 260, 1014 + 1000)
    assert sensor.roi(3040, 4056) == sensor


@pytest.mark.parametrize(
    ("rows", "cols", "field"), [(0, 5, "rows"), (3041, 5, "rows"), (5, 4057, "cols")]
)
def test_a_region_that_does_not_fit_is_refused(sensor: Sensor, rows: int, cols: int, field: str):
    with pytest.raises(UserError, match="does not fit") as caught:
        sensor.roi(rows, cols)
    assert caught.value.field == field


# --- wrong files ---


GREEN_AT_415_NM = ("quantum_efficiency", "channels", "G", 3)


@pytest.mark.parametrize(
    ("path", "value", "field", "allowed"),
    [
        (("cfa", "pattern"), [["R", "G"], ["G", "X"]], "cfa.pattern", "R, G, B, C, M, Y, W"),
        (("cfa", "pattern"), [["R", "G"], ["G"]], "cfa.pattern", "equal length"),
        (("cfa", "pattern"), [], "cfa.pattern", "equal length"),
        (("cfa", "pattern"), [["R", "G"], ["G", "W"]], "cfa.pattern", "same channels"),
        (("full_well_e",), 0, "full_well_e", "greater than 0"),
        (("full_well_e",), 1e9, "full_well_e", "less than or equal to 10000000"),
        (("bit_depth",), 0, "bit_depth", "greater than or equal to 1"),
        (("bit_depth",), 40, "bit_depth", "less than or equal to 16"),
        (("bit_depth",), 12.5, "bit_depth", "a whole number"),
        (("system_gain_dn_per_e",), -1, "system_gain_dn_per_e", "greater than 0"),
        (("system_gain_dn_per_e",), float("nan"), "system_gain_dn_per_e", "finite"),
        (("pixel_pitch_um",), float("inf"), "pixel_pitch_um", "finite"),
        (("prnu_percent",), float("nan"), "prnu_percent", "finite"),
        (("fill_factor",), 1.2, "fill_factor", "less than or equal to 1"),
        (("reference_temperature_c",), -300, "reference_temperature_c", "greater than -273.15"),
        (("black_level_dn",), 4095, "black_level_dn", "below 4095"),
        (("rows",), "many", "rows", "a whole number"),
        (("serial_number",), 2**64, "serial_number", "less than"),
        (
            ("quantum_efficiency", "channels", "G", 3),
            -0.1,
            "quantum_efficiency.channels.G.4",
            "greater than or equal to 0",
        ),
        (
            ("quantum_efficiency", "channels", "G", 3),
            float("nan"),
            "quantum_efficiency.channels.G.4",
            "finite",
        ),
        (
            ("quantum_efficiency", "channels", "G"),
            [0.1],
            "quantum_efficiency",
            "61, as wavelengths",
        ),
        (("quantum_efficiency", "wavelengths_nm", 0), 402, "quantum_efficiency", "400 to 700 nm"),
        (("quantum_efficiency", "wavelengths_nm", 9), 440, "quantum_efficiency", "each more"),
        (
            ("quantum_efficiency", "channels", "G"),
            [0.0] * 61,
            "quantum_efficiency.channels.G",
            "above 0 between 400 and 700 nm",
        ),
        (("gain",), 3, "gain", "system_gain_dn_per_e"),
        (("cfa", "phase"), 3, "cfa.phase", "pattern"),
        (("cfa",), 7, "cfa", None),
        (("sources", "gain"), "me", "sources", "fields of this file"),
    ],
)
def test_a_wrong_field_is_named_with_what_is_allowed(tmp_path: Path, path, value, field, allowed):
    file = sensor_file(tmp_path, (path, value))
    with pytest.raises(UserError) as caught:
        load_sensor(file)
    assert (caught.value.file, caught.value.field) == (file, field)
    assert len(caught.value.screen().splitlines()) <= 5
    assert allowed is None or allowed in caught.value.allowed


def test_the_value_is_shown(tmp_path: Path):
    with pytest.raises(UserError) as caught:
        load_sensor(sensor_file(tmp_path, bit_depth=40))
    assert caught.value.value == 40


def test_a_quantum_efficiency_over_one_warns_by_name(tmp_path: Path):
    file = sensor_file(tmp_path, (GREEN_AT_415_NM, 1.2))
    with pytest.warns(UserWarning, match="of G exceeds 1: 1.2 at 415 nm"):
        assert load_sensor(file).qe["G"].max() == 1.2


def test_a_quantum_efficiency_of_one_does_not_warn(tmp_path: Path):
    file = sensor_file(tmp_path, (GREEN_AT_415_NM, 1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_sensor(file)


@pytest.mark.parametrize(
    ("path", "near"),
    [
        (("full_well",), "full_well_e"),
        (("System_gain_dn_per_e",), "system_gain_dn_per_e"),
        (("cfa", "patern"), "pattern"),
        (("quantum_efficiency", "wavelength_nm"), "wavelengths_nm"),
    ],
)
def test_an_unknown_field_is_told_the_nearest_name(tmp_path: Path, path, near: str):
    with pytest.raises(UserError, match=f"perhaps {near} is meant"):
        load_sensor(sensor_file(tmp_path, (path, 3)))


def test_a_name_like_no_other_is_told_nothing(tmp_path: Path):
    with pytest.raises(UserError) as caught:
        load_sensor(sensor_file(tmp_path, xyzzy=3))
    assert caught.value.problem == "unknown field"


class Inner(BaseModel):
    """A part of a file."""

    model_config = ConfigDict(extra="forbid")
    depth_e: float = Field(gt=0)


class Outer(BaseModel):
    """A file."""

    model_config = ConfigDict(extra="forbid")
    one: Inner | None = None
    many: list[Inner] = []


@pytest.mark.parametrize(
    ("data", "field", "words"),
    [
        ({"one": {"dept_e": 3, "depth_e": 1}}, "one.dept_e", "perhaps depth_e is meant"),
        ({"many": [{"dept_e": 3, "depth_e": 1}]}, "many.1.dept_e", "perhaps depth_e is meant"),
        ({"one": {}}, "one.depth_e", "all of depth_e"),
        ({"one": [1]}, "one", "of depth_e"),
        ({"many": [{"depth_e": -1}]}, "many.1.depth_e", "greater than 0 (electrons)"),
    ],
)
def test_fields_of_parts_are_named_like_others(data, field: str, words: str):
    with pytest.raises(ValidationError) as found:
        Outer.model_validate(data)
    error = user_error(found.value, Outer, Path("sensor.yaml"))
    assert error.field == field and words in error.screen()


def test_a_mistake_in_a_sensor_file_is_one_screen(tmp_path: Path):
    """What the command line prints: problem, file, field, value, allowed."""
    file = sensor_file(tmp_path, reference_temperature_c=-300)
    camera = tmp_path / "camera.yaml"
    camera.write_text("title: a\nlens: {mtf: diffraction-limited}\nsensor: {preset: sensor.yaml}\n")
    ran = gpusim("render", camera, "grey", "--out", tmp_path / "out", "--dry-run")
    assert_refused(ran, file, "reference_temperature_c", "-300", "absolute zero is -273.15")


def test_a_warning_of_the_command_line_is_one_line(capsys):
    app._show_warning(UserWarning("the quantum efficiency of G exceeds 1"), UserWarning, "x.py", 3)
    app._show_warning(DeprecationWarning("a name will go"), DeprecationWarning, "library.py", 3)
    assert capsys.readouterr().err == "warning: the quantum efficiency of G exceeds 1\n"


def test_a_missing_field_is_named(tmp_path: Path):
    with pytest.raises(UserError, match="a field is missing") as caught:
        load_sensor(sensor_file(tmp_path, rows=...))
    assert caught.value.field == "rows"
    assert "full_well_e" in caught.value.allowed and "sources" not in caught.value.allowed


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"rows: [1", "not YAML"),
        (b"\xff\xfe\x00", "cannot be read"),
        (b"- 1", "no fields with values"),
        (b"", "no fields with values"),
        (b"IMX477", "no fields with values"),
        (None, "cannot be read"),
    ],
)
def test_a_file_that_is_no_sensor_is_refused(tmp_path: Path, content: bytes | None, problem: str):
    file = tmp_path / "sensor.yaml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(UserError, match=problem) as caught:
        load_sensor(file)
    assert caught.value.file == file


def test_an_unknown_preset_is_refused_with_the_known_ones():
    with pytest.raises(UserError, match="no sensor of that name") as caught:
        load_sensor("imx999")
    assert "imx477" in caught.value.allowed


def test_the_pattern_of_a_part_begins_where_the_part_does():
    sensor = load_sensor("imx477")
    assert sensor.cfa.pattern == (("B", "G"), ("G", "R"))
    for row, col, first in ((0, 0, "BGGR"), (1, 0, "GRBG"), (0, 3, "GBRG"), (5, 7, "RGGB")):
        part = sensor.cut(row, col)
        assert "".join(part.site_channels()) == first
        assert part.model_copy(update={"cfa": sensor.cfa}) == sensor


def test_a_region_keeps_of_the_chips_lists_what_it_reads():
    """So that it can be copied, written and read again: what lies beyond contradicts its size."""
    whole = load_sensor("imx477")
    pixels = [DefectPixel(row=row, col=col, kind="dead") for row, col in ((0, 0), (1500, 2000))]
    offsets = np.arange(whole.cols) / 100
    listed = {
        "defects": Defects(pixels=pixels, dead_fraction=1e-3),
        "column_offset": ColumnOffset(offsets_dn=offsets.tolist()),
    }
    part = whole.model_copy(update=listed).roi(480, 640)
    assert [(one.row, one.col) for one in part.defects.pixels] == [(1500, 2000)]
    assert part.defects.dead_fraction == 1e-3
    assert part.column_offset.offsets_dn == tuple(offsets[: part.first_col + 640])
    assert Sensor.model_validate_json(part.model_dump_json()) == part
    assert part.model_copy(update={"dsnu_e": 1.0}).defects is part.defects

"""Sensor files of the Speos exporter: equations with numbers worked out by hand, and mistakes.

Covered: every key of the documentation and its unit; the quantum efficiency as a product of three
spectra; two greens; the trap of silicon counted twice; a spectrum in the wrong unit; unknown,
missing and wrong keys and spectra; what the file does not say.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from formats.speos_files import MONO, spectrum, written

from gpusim.errors import UserError
from gpusim.formats import speos
from gpusim.sensor.sensor import Sensor


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    spectrum(tmp_path / "qe.spectrum", {350: 40, 500: 80, 750: 30})
    spectrum(tmp_path / "flat.spectrum", {300: 100, 1100: 100})
    spectrum(tmp_path / "cut.spectrum", {380: 0.9, 600: 0.9, 720: 0.3})
    for name, value in (("red", 30), ("green", 50), ("green2", 46), ("blue", 40)):
        spectrum(tmp_path / f"{name}.spectrum", {380: value, 720: value})
    return tmp_path


def read(file: Path, **given: object) -> Sensor:
    return speos.read_speos(file).sensor(given)


BAYER = ("EMVA Data", "Bayer Matrix")
RGGB = {
    "Type": "RGGB",
    "00 spectrum": "red.spectrum",
    "01 spectrum": "green.spectrum",
    "10 spectrum": "green.spectrum",
    "11 spectrum": "blue.spectrum",
}
CONSTANT = (("EMVA Data", "Quantum Efficiency", "Filename"), "flat.spectrum")


def test_every_key_finds_its_field(folder: Path):
    sensor = read(written(folder))
    assert (sensor.name, sensor.cols, sensor.rows) == ("camera", 640, 480)
    assert (sensor.pixel_pitch_um, sensor.bit_depth) == (3.75, 12)
    assert (sensor.system_gain_dn_per_e, sensor.temporal_dark_noise_e) == (0.25, 6.0)
    assert (sensor.dark_current_e_per_s, sensor.dsnu_e, sensor.prnu_percent) == (3.0, 1.5, 0.8)
    assert sensor.cfa.pattern == (("W",),)
    # eta AST DR = 0.8 x 10 photons x 10^(60/20)
    assert sensor.full_well_e == pytest.approx(8000)
    assert sensor.qe["W"].max() == pytest.approx(0.8)
    assert at(sensor, "W", 600.0) == pytest.approx(0.60)  # 80 % - 100/250 of 50 %


def at(sensor: Sensor, channel: str, wavelength_nm: float) -> float:
    curves = sensor.quantum_efficiency
    return float(np.interp(wavelength_nm, curves.wavelengths_nm, curves.channels[channel]))


@pytest.mark.parametrize(
    ("key", "value", "field", "expected"),
    [
        ("System Gain", {"Value": 4.0, "Unit": "e-/DN"}, "system_gain_dn_per_e", 0.25),
        ("System Gain", {"Value": 0.5, "Unit": "DN/e-"}, "system_gain_dn_per_e", 0.5),
        ("Temporal Dark Noise", {"Value": 1.5, "Unit": "DN"}, "temporal_dark_noise_e", 6.0),
        ("Temporal Dark Noise", {"Value": 1.5}, "temporal_dark_noise_e", 1.5),
        ("Dark Current", {"Value": 2, "Unit": "DN/s"}, "dark_current_e_per_s", 8.0),
        ("DR", {"Value": 10, "Unit": "bit"}, "full_well_e", 0.8 * 10 * 1024),
        ("DR", {"Value": 500, "Unit": "1"}, "full_well_e", 0.8 * 10 * 500),
        ("AST", {"Value": 7, "Unit": "e-"}, "full_well_e", 7 * 1000),
        (
            "Spatial Non Uniformity",
            {"DSNU": {"Value": 2, "Unit": "DN"}, "PRNU": 1},
            "dsnu_e",
            8.0,
        ),
    ],
)
def test_units_are_converted(folder: Path, key: str, value, field: str, expected: float):
    sensor = read(written(folder, (("EMVA Data", key), value)))
    assert getattr(sensor, field) == pytest.approx(expected, rel=1e-12)


def test_three_spectra_are_multiplied(folder: Path):
    file = written(
        folder,
        CONSTANT,
        (BAYER, RGGB),
        (("EMVA Data", "IR & UV Filter"), {"Filename": "cut.spectrum", "Unit": "0 to 1"}),
    )
    sensor = read(file)
    assert sensor.cfa.pattern == (("R", "G"), ("G", "B"))
    # At 660 nm the cut passes 0.6: half way from 0.9 to 0.3.
    for channel, filtered in (("R", 0.30), ("G", 0.50), ("B", 0.40)):
        assert at(sensor, channel, 500) == pytest.approx(filtered * 0.9, rel=1e-5)
        assert at(sensor, channel, 660) == pytest.approx(filtered * 0.6, rel=1e-5)
    # AST and DR are of the best channel: 0.45 x 10 x 1000
    assert sensor.full_well_e == pytest.approx(4500)


def test_two_unlike_greens_are_two_channels(folder: Path):
    file = written(folder, CONSTANT, (BAYER, {**RGGB, "10 spectrum": "green2.spectrum"}))
    sensor = read(file)
    assert sensor.cfa.pattern == (("R", "Gr"), ("Gb", "B"))
    assert (at(sensor, "Gr", 500), at(sensor, "Gb", 500)) == (0.5, 0.46)


def test_silicon_counted_twice_is_warned_of(folder: Path):
    with pytest.warns(UserWarning, match="constant 100 %"):
        made = speos.read_speos(written(folder, (BAYER, RGGB)))
    assert "right only where" in made.sources["quantum_efficiency"]


def test_a_constant_quantum_efficiency_does_not_warn(folder: Path, recwarn):
    made = speos.read_speos(written(folder, CONSTANT, (BAYER, RGGB)))
    assert not recwarn.list and "right only" not in made.sources["quantum_efficiency"]


def test_what_the_file_does_not_say_is_assumed_and_says_so(folder: Path):
    file = written(
        folder,
        (("EMVA Data", "AST"), ...),
        (("EMVA Data", "Dark Current"), ...),
        (("EMVA Data", "Spatial Non Uniformity"), ...),
    )
    made = speos.read_speos(file)
    sensor = made.sensor({})
    assert sensor.full_well_e == 4095 / 0.25
    assert (sensor.dark_current_e_per_s, sensor.dsnu_e, sensor.prnu_percent) == (0, 0, 0)
    for field in ("full_well_e", "dark_current_e_per_s", "dsnu_e", "prnu_percent"):
        assert sensor.sources[field].startswith("assumed")
    assert made.unused == ["EMVA Data.DR: AST and DR say the saturation together"]


def test_auto_is_left_to_the_user(folder: Path):
    file = written(folder, (("Properties", "Resolution"), {"H": "Auto", "V": "Auto"}))
    with pytest.raises(UserError) as caught:
        read(file)
    assert caught.value.allowed.endswith("--set rows=... --set cols=...")
    sensor = read(file, rows=100, cols=200)
    assert (sensor.rows, sensor.cols, sensor.sources["rows"]) == (100, 200, "given by hand")


def test_names_of_windows_are_found_beside_the_file(folder: Path):
    changed = (("EMVA Data", "Quantum Efficiency", "Filename"), "c:\\sensors\\qe.spectrum")
    assert read(written(folder, changed)) == read(written(folder))


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("EMVA Data", "Gain"), 3, ("unknown key", "gain", "system gain")),
        (("Noise",), {}, ("unknown key", "noise", "emva data")),
        (("EMVA Data", "System Gain"), ..., ("missing", "system gain")),
        (("EMVA Data", "Quantum Efficiency"), ..., ("missing", "quantum efficiency")),
        (("Properties",), ..., ("missing", "properties")),
        (("EMVA Data", "System Gain"), 0, ("not a gain", "above 0")),
        (("EMVA Data", "System Gain"), "high", ("not a number", "high")),
        (("EMVA Data", "System Gain"), {"Value": 1, "Unit": "e-"}, ("unknown unit", "DN/e-")),
        (("EMVA Data", "DR"), {"Value": 1, "Unit": "stops"}, ("unknown unit", "dB")),
        (("EMVA Data", "Dark Current"), float("nan"), ("not a number", "nan")),
        (("EMVA Data", "Dark Current"), -3.0, ("dark_current_e_per_s", "-3")),
        (("EMVA Data", "Bayer Matrix", "Type"), "RGBX", ("four letters", "RGBX")),
        (("EMVA Data", "Bayer Matrix", "Type"), "RGGB", ("missing", "00 spectrum")),
        (("Properties", "Bits depth"), 40, ("no such depth", "40", "8, 10, 12, 14, 16")),
        (("Properties", "Pixel Size"), {"H": 3, "V": 4}, ("not square", "3 um x 4 um")),
        (("EMVA Data", "Quantum Efficiency", "Filename"), "no.spectrum", ("not there", "no.")),
        (("EMVA Data", "Quantum Efficiency", "Unit"), "0 to 1", ("perhaps per cent", "80")),
        (("EMVA Data",), [1], ("no keys", "emva data")),
    ],
)
def test_a_mistake_is_one_screen(folder: Path, path, value, words):
    file = written(folder, (path, value))
    with pytest.raises(UserError) as caught:
        read(file)
    screen = caught.value.screen()
    assert len(screen.splitlines()) <= 5
    for word in words:
        assert word.lower() in screen.lower()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("header\n3\n400 50\n700 60\n", ("not complete", "3, as the file says")),
        ("header only\n", ("not complete", "one or more")),
        ("400 50\n500 -2\n700 50\n", ("at 500 nm", "-2")),
        ("400 50\n500 nan\n700 50\n", ("at 500 nm", "nan")),
        ("400 50\n400 60\n700 50\n", ("do not rise",)),
        ("400 50\n500 60 70\n", ("no sample", "line 2")),
        ("400 0.5\n700 0.6\n", ("hardly in per cent", "0.6")),
        ("450 50\n700 60\n", ("end too soon", "400 to 700 nm")),
    ],
)
def test_a_wrong_spectrum_is_one_screen(folder: Path, text: str, words):
    (folder / "qe.spectrum").write_text(text)
    with pytest.raises(UserError) as caught:
        read(written(folder))
    for word in words:
        assert word in caught.value.screen()


def test_the_exporter_is_told_from_a_sensor_file(folder: Path):
    assert speos.is_speos(MONO)
    assert not speos.is_speos({"name": "a", "rows": 3}) and not speos.is_speos([1])

"""ISETCam's sensors: volts to electrons and DN with numbers worked out by hand, and mistakes.

Covered: every equation, from JSON and from a .mat file; the analogue gain as a divisor, whose other
direction is planted and found; both names of a parameter; what has no counterpart is listed;
unknown, missing, wrong and contradictory parameters.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from formats.isetcam_files import STRUCT, WAVE, check, read, written

from gpusim.errors import UserError
from gpusim.formats import isetcam_sensor as isetcam
from gpusim.sensor.load import load_sensor


@pytest.mark.parametrize("kind", [".json", ".mat"])
def test_the_equations_give_what_they_give_by_hand(tmp_path: Path, kind: str):
    check(read(written(tmp_path, kind=kind)))


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("system_gain_dn_per_e", lambda g, swing, bits, a: g * a * 2**bits / swing),
        ("black_level_dn", lambda o, swing, bits, a: o * a * 2**bits / swing),
        ("system_gain_dn_per_e", lambda g, swing, bits, a: g / a * (2**bits - 1) / swing),
    ],
)
def test_a_planted_error_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name, wrong):
    """The gain as a factor, the offset beside it, a converter of one code less."""
    monkeypatch.setattr(isetcam, name, wrong)
    with pytest.raises(AssertionError):
        check(read(written(tmp_path)))


def test_a_smaller_gain_makes_the_signal_larger(tmp_path: Path):
    one = read(written(tmp_path, (("analogGain",), 1.0)))
    half = read(written(tmp_path, (("analogGain",), 0.5)))
    assert half.system_gain_dn_per_e == 2 * one.system_gain_dn_per_e
    assert half.full_well_e == one.full_well_e


def test_the_preset_of_the_imx363_is_what_its_model_gives(tmp_path: Path):
    """Swing 1023 x 0.44875 mV, 6000 e-, ISO 55: 1024 codes there to 1023 here, 1e-3."""
    swing = 1023 * 0.44875e-3
    file = written(
        tmp_path,
        (("rows",), 3024),
        (("cols",), 4032),
        (("analogGain",), 55 / 55),
        (("analogOffset",), 64 * 0.44875e-3),
        (("quantization",), {"method": "10 bit", "bits": []}),
        (("sigmaGainFPN",), 0.7),
        (("sigmaOffsetFPN",), 0.0),
        (
            ("pixel",),
            {"width": 1.4e-6, "height": 1.4e-6, "fill factor": 1.0, "well capacity": 6000},
        ),
        (("pixel", "voltageSwing"), swing),
        (("pixel", "read noise electrons"), 5),
        (("pixel", "dark voltage"), 0.0),
    )
    found, preset = read(file), load_sensor("imx363")
    for field in ("system_gain_dn_per_e", "black_level_dn"):
        assert getattr(found, field) == pytest.approx(getattr(preset, field), rel=1.1e-3)
    for field in (
        *("rows", "cols", "pixel_pitch_um", "fill_factor", "cfa", "bit_depth", "full_well_e"),
        *("temporal_dark_noise_e", "dark_current_e_per_s", "dsnu_e", "prnu_percent"),
    ):
        assert getattr(found, field) == getattr(preset, field), field


def test_names_of_sensor_set_are_known(tmp_path: Path):
    file = tmp_path / "flat.json"
    flat = {
        **{key: STRUCT[key] for key in ("name", "rows", "cols")},
        "Analog Gain": 0.5,
        "analog offset": 0.02,
        "PRNU level": 1.2,
        "dsnu level": 0.0006,
        "quantization method": "12 bit",
        "pattern": [[1, 2], [2, 3]],
        "wave": WAVE,
        "filter spectra": STRUCT["color"]["filterSpectra"],
        "filter names": ["r", "g", "b"],
        "infrared filter": STRUCT["color"]["irFilter"],
        "pd spectral QE": STRUCT["pixel"]["spectralQE"],
        "pixel width": 2e-6,
        "pixel height": 2e-6,
        "pixel fill factor": 0.6,
        "pixel conversion gain": 1e-4,
        "pixel voltage swing": 0.8,
        "pixel read noise": 0.0004,
        "pixel dark voltage": 0.002,
    }
    file.write_text(json.dumps(flat))
    check(read(file))


def test_what_has_no_counterpart_is_listed(tmp_path: Path):
    made = isetcam.read_isetcam(written(tmp_path, (("data",), {"volts": [[0.1]], "dv": []})))
    listed = {text.partition(":")[0] for text in made.unused}
    assert listed == {"type", "integrationTime", "data.volts"}  # an empty value says nothing
    assert made.sensor({}).sources["reference_temperature_c"].startswith("assumed")


def test_a_monochrome_sensor_has_one_channel(tmp_path: Path):
    file = written(
        tmp_path,
        (("cfa",), ...),
        (("color",), {"filterSpectra": [0.5, 0.6, 0.7, 0.8], "filterNames": "w"}),
    )
    sensor = read(file)
    assert sensor.cfa.pattern == (("W",),)
    assert sensor.quantum_efficiency.channels["W"] == pytest.approx([0.45, 0.54, 0.56, 0.64])


def test_filters_of_one_colour_are_channels_of_their_own(tmp_path: Path):
    spectra = [[*row, row[1] / 2] for row in STRUCT["color"]["filterSpectra"]]
    file = written(
        tmp_path,
        (("cfa", "pattern"), [[1, 2], [4, 3]]),
        (("color", "filterSpectra"), spectra),
        (("color", "filterNames"), ["r", "gr", "b", "gb"]),
    )
    sensor = read(file)
    assert sensor.cfa.pattern == (("R", "Gr"), ("Gb", "B"))


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("pixel", "voltageSwing"), ..., ("missing", "voltage swing", "pixelvoltageswing")),
        (("pixel", "conversionGain"), ..., ("missing", "conversion gain")),
        (("rows",), ..., ("missing", "rows")),
        (("spectrum",), ..., ("missing", "wave")),
        (("analogGain",), 0, ("wrong", "analog gain", "above 0")),
        (("analogGain",), -2, ("wrong", "analog gain", "-2")),
        (("pixel", "readNoise"), "low", ("wrong", "read noise", "low")),
        (("pixel", "darkVoltage"), -1, ("wrong", "dark voltage", "-1")),
        (("gain",), 3, ("unknown parameter", "gain", "analoggain")),
        (("pixel", "wellCapacity"), 9000, ("contradict", "9000", "8000")),
        (("quantization",), {"method": "analog"}, ("no converter", "analog", "10 bit")),
        (("pixel", "height"), 3e-6, ("not square", "2 x 3 um")),
        (("cfa", "pattern"), [[1, 4], [2, 3]], ("not there", "1 to 3")),
        (("color", "filterNames"), ["r", "g"], ("needs a name", "3")),
        (("color", "filterNames"), ["r", "g", "x"], ("unknown filter colour", "R, G, B")),
        (("color", "irFilter"), [1, 2], ("wrong", "infrared", "4 wavelengths")),
        (("color", "filterSpectra"), [["a"]], ("wrong", "filters")),
        (("spectrum", "wave"), [420, 500, 600, 700], ("end too soon",)),
    ],
)
def test_a_mistake_is_one_screen(tmp_path: Path, path, value, words):
    file = written(tmp_path, (path, value))
    with pytest.raises(UserError) as caught:
        read(file)
    screen = caught.value.screen()
    assert len(screen.splitlines()) <= 5
    for word in words:
        assert word in screen


def test_two_statements_that_differ_are_refused(tmp_path: Path):
    file = written(tmp_path, (("pixel voltage swing",), 0.9))
    with pytest.raises(UserError, match="contradict"):
        read(file)


@pytest.mark.parametrize("content", [b"", b"[1, 2]", b"{"])
def test_what_is_no_sensor_is_refused(tmp_path: Path, content: bytes):
    for name in ("a.json", "a.mat"):
        file = tmp_path / name
        file.write_bytes(content)
        with pytest.raises(UserError) as caught:
            read(file)
        assert caught.value.file == file

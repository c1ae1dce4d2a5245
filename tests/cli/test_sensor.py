"""``gpusim sensor``: what it shows, what it converts and writes, and how it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from changes import sensor_file
from command_line import assert_refused, gpusim
from formats import isetcam_files, speos_files

from gpusim.sensor.load import load_sensor, presets


def test_without_a_name_it_lists_the_sensors():
    ran = gpusim("sensor")
    assert ran.code == 0, ran.err
    for name in presets():
        (line,) = [line for line in ran.out.splitlines() if line.split()[:1] == [name]]
        sensor = load_sensor(name)
        assert f"{sensor.cols} x {sensor.rows}" in line and sensor.name in line


@pytest.mark.parametrize("name", presets())
def test_a_data_sheet_shows_each_figure_with_its_source(name: str):
    ran = gpusim("sensor", name)
    assert ran.code == 0, ran.err
    sensor = load_sensor(name)
    first = {line.split()[0]: line for line in ran.out.splitlines() if line[1:2] != " "}
    for field, source in sensor.sources.items():
        assert source.split()[0] in first[field]
    assert f"{sensor.system_gain_dn_per_e:g} DN per electron" in first["system_gain_dn_per_e"]
    assert "sigma_d" in first["temporal_dark_noise_e"]
    peak = max(sensor.quantum_efficiency.channels[sensor.channels[0]])
    assert f"{sensor.channels[0]} {peak:.3f} at" in ran.out


@pytest.mark.parametrize("name", presets())
def test_a_sensor_that_is_written_is_the_one_that_was_read(tmp_path: Path, name: str):
    file = tmp_path / "copy.yaml"
    assert gpusim("sensor", name, "--out", file).code == 0
    assert load_sensor(file) == load_sensor(name)
    again = tmp_path / "again.yaml"
    assert gpusim("sensor", file, "--out", again).code == 0
    assert again.read_text().splitlines()[1:] == file.read_text().splitlines()[1:]


def test_a_copy_elsewhere_finds_the_files_of_the_original(tmp_path: Path, monkeypatch):
    masked = sensor_file(tmp_path, rows=6, cols=8, masks={"gain": "gain.npy"})
    np.save(tmp_path / "gain.npy", np.full((6, 8), 0.9, np.float32))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    ran = gpusim("sensor", masked.name, "--out", "elsewhere/copy.yaml")
    assert ran.code == 0, ran.err
    copied = load_sensor(tmp_path / "elsewhere" / "copy.yaml")
    assert copied == load_sensor(masked)


def test_a_sensor_of_the_exporter_is_converted(tmp_path: Path):
    speos_files.spectrum(tmp_path / "qe.spectrum", {350: 40, 500: 80, 750: 30})
    source = speos_files.written(tmp_path, (("Properties", "Resolution", "H"), "Auto"))
    file = tmp_path / "sensor.yaml"
    assert_refused(gpusim("sensor", source, "--out", file), "cols", "--set cols=...")
    assert not file.exists()
    ran = gpusim("sensor", source, "--set", "cols=800", "--out", file)
    assert ran.code == 0, ran.err
    assert "eta AST DR" in ran.out and "assumed: the file has no aperture" in ran.out
    sensor = load_sensor(file)
    assert (sensor.cols, sensor.rows, sensor.full_well_e) == (800, 480, pytest.approx(8000))
    assert sensor.sources["cols"] == "given by hand"


@pytest.mark.parametrize("kind", [".json", ".mat"])
def test_a_sensor_of_isetcam_is_converted(tmp_path: Path, kind: str):
    file = tmp_path / "out.yaml"
    ran = gpusim("sensor", isetcam_files.written(tmp_path, kind=kind), "--out", file)
    assert ran.code == 0, ran.err
    assert "not used: integrationTime: the exposure time is the capture's" in ran.out
    assert "a divisor" in ran.out
    isetcam_files.check(load_sensor(file))
    assert yaml.safe_load(file.read_text())["sources"]["veiling_glare"].startswith("assumed")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("imx999",), ("imx999", *presets())),
        (("missing.yaml",), ("missing.yaml", "cannot be read")),
        (("missing.mat",), ("missing.mat", "cannot be read")),
        (("imx477", "--set", "full_well_e"), ("--set", "full_well_e", "FIELD=VALUE")),
        (("imx477", "--set", "full_well_e=0"), ("full_well_e", "greater than 0")),
        (("imx477", "--set", "full_well=3"), ("unknown field", "perhaps full_well_e")),
        (("imx477", "--out", "sensor.txt"), ("--out", "sensor.txt", ".yaml or .yml")),
        (("--out", "sensor.yaml"), ("SENSOR", "imx477")),
        (("--set", "rows=3"), ("SENSOR", "imx477")),
    ],
)
def test_a_mistake_is_one_screen(arguments: tuple[str, ...], words: tuple[str, ...]):
    ran = gpusim("sensor", *arguments)
    assert ran.code == 2 and "Traceback" not in ran.err
    for word in words:
        assert word in ran.err


def test_a_warning_is_one_line(tmp_path: Path):
    green_at_415_nm = ("quantum_efficiency", "channels", "G", 3)
    ran = gpusim("sensor", sensor_file(tmp_path, (green_at_415_nm, 1.2)))
    assert ran.code == 0
    assert ran.err == "warning: the quantum efficiency of G exceeds 1: 1.2 at 415 nm\n"

"""The command line: what it answers, what it writes, and how it refuses."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import ROOT, assert_refused, gpusim, process
from PIL import Image

from gpusim.cli import devices as cli_devices
from gpusim.cli import files
from gpusim.errors import UserError
from gpusim.scene import make_scene
from gpusim.scene.colorimetry import encode_srgb
from gpusim.scene.exr import read_exr, units_of, write_exr
from gpusim.scene.spectral_exr import write_spectral_exr

COMMANDS = (
    "render",
    "chart",
    "lens",
    "sensor",
    "develop",
    "pareto",
    "measure",
    "stress",
    "devices",
    "cameras",
    "charts",
)

BARE_S = 0.12  # on an idle EPYC at 2 GHz


def test_help_answers_within_half_a_second():
    """Where Python and its parser of options start in BARE_S; in as many of those elsewhere."""
    bare, ours = [], []
    for _ in range(5):
        begin = time.perf_counter()
        subprocess.run([sys.executable, "-c", "import typer"], check=True)
        between = time.perf_counter()
        ran = process("--help")
        bare.append(between - begin)
        ours.append(time.perf_counter() - between)
        assert ran.code == 0, ran.err
        for command in COMMANDS:
            assert command in ran.out
    assert min(ours) < 0.5 * max(1.0, min(bare) / BARE_S)


@pytest.mark.parametrize("command", ["lens", "sensor"])
def test_a_name_too_long_for_a_file_is_one_screen(command: str):
    assert_refused(process(command, "x" * 300), f"field:   {command}", "allowed")


def test_help_imports_none_of_the_heavy_packages():
    look = "import sys; import gpusim.cli; print(*sys.modules)"
    ran = subprocess.run(
        [sys.executable, "-c", look], cwd=ROOT, capture_output=True, text=True, check=True
    )
    loaded = set(ran.stdout.split())
    assert "typer" in loaded
    assert not loaded & {"numpy", "scipy", "wgpu", "pydantic", "xarray", "matplotlib"}


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_has_help(command: str):
    ran = gpusim(command, "--help")
    assert ran.code == 0
    assert "Usage" in ran.out


@pytest.mark.parametrize(
    "arguments",
    [
        ("render", "demo", "demo", "--out", "x", "--certify", "-1"),
        ("render", "demo", "demo", "--out", "x", "--seed", "-1"),
        ("render", "demo", "demo", "--out", "x", "--tile-size", "0"),
        ("render", "demo", "demo", "--out", "x", "--colour"),
        ("chart", "demo"),
    ],
)
def test_wrong_usage_exits_with_2_and_without_a_traceback(arguments: tuple[str, ...]):
    ran = gpusim(*arguments)
    assert ran.code == 2
    assert "Usage" in ran.err
    assert "Traceback" not in ran.err


@pytest.mark.parametrize("command", [("render", "demo", "demo"), ("batch", "sweep.yaml")])
def test_files_need_a_folder(command: tuple[str, ...]):
    assert_refused(gpusim(*command), "--out", "--dry-run")


def test_no_command_shows_the_help():
    assert "Usage" in gpusim().out


def test_an_interrupt_exits_with_130_and_without_a_traceback(monkeypatch: pytest.MonkeyPatch):
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli_devices, "devices", interrupted)
    ran = gpusim("devices")
    assert ran.code == 130
    assert "Traceback" not in ran.err


# devices


def test_devices_names_the_adapter_and_its_limits(device):
    ran = gpusim("devices")
    assert ran.code == 0
    assert device.report()["adapter"] in ran.out
    assert "max-buffer-size" in ran.out


def test_no_adapter_is_one_screen_that_says_what_to_install(tmp_path: Path):
    # With no driver on its list the Vulkan loader finds no adapter.
    no_drivers = tmp_path / "none.json"
    ran = process("devices", VK_DRIVER_FILES=no_drivers, VK_ICD_FILENAMES=no_drivers)
    assert_refused(ran, "adapter", "mesa-vulkan-drivers")


# chart


def test_chart_draws_the_same_scene_as_picture_and_as_radiance(tmp_path: Path):
    for name in ("c.png", "c.exr"):
        assert gpusim("chart", "dots", "--out", tmp_path / name).code == 0
    picture = np.asarray(Image.open(tmp_path / "c.png"))
    radiance = np.moveaxis(read_exr(tmp_path / "c.exr").rgb, 0, -1)
    # The same float32 numbers go into both files.
    np.testing.assert_array_equal(picture, np.round(255 * encode_srgb(radiance)))
    assert np.unique(picture).size > 2


def test_a_chart_as_a_spectral_exr_is_read_again_as_the_same_radiance(tmp_path: Path):
    file = tmp_path / "c.exr"
    ran = gpusim("chart", "colorchecker", "--out", file, "--bands", "400:700:50")
    assert ran.code == 0, ran.err
    nm = np.arange(400.0, 701.0, 50.0)
    chart, again = make_scene("colorchecker"), make_scene(file)
    there = again.on(nm)
    radiance = np.einsum("mrc,mk->rck", again.source.planes.astype(float), there.spectra)
    # Each material fills some pixel. Its spectrum is rounded to float32, summed and divided over 16
    # sub-samples: 17 roundings of 2^-24 at most.
    found = radiance[::7, ::7].reshape(-1, nm.size)
    for spectrum in chart.on(nm).spectra:
        assert np.abs(found / spectrum - 1).max(axis=1).min() < 17 * 2**-24
    assert units_of(file) == "W m^-2 sr^-1 nm^-1"
    assert_refused(gpusim("chart", "grey", "--out", "c.png", "--bands", "400,500"), ".exr")


@pytest.mark.parametrize("name", ["photograph.exr", "photograph.png", "cube.exr"])
def test_a_picture_as_a_spectral_exr_is_read_again_as_the_same_radiance(tmp_path: Path, name: str):
    rng = np.random.default_rng(3)
    picture, given = tmp_path / name, []
    if name == "cube.exr":
        nm = np.array([430.0, 555.5, 690.0])
        write_spectral_exr(picture, rng.uniform(0, 2, (5, 7, 3)), nm, "W m^-2 sr^-1 nm^-1")
    elif name == "photograph.exr":
        nm = np.arange(400.0, 701.0, 20.0)
        write_exr(picture, {"RGB": rng.uniform(0, 2, (5, 7, 3))}, 120.0)
    else:
        nm = np.arange(400.0, 701.0, 20.0)
        Image.fromarray(rng.integers(0, 255, (5, 7, 3), np.uint8)).save(picture)
        given = ["--transfer", "srgb", "--upsampling", "jakob-2019", "--luminance", "80"]
    options = {"transfer": "srgb", "upsampling": "jakob-2019", "luminance_cd_m2": 80.0}
    scene = make_scene(picture, **(options if given else {}))
    file = tmp_path / "again.exr"
    ran = gpusim("chart", picture, "--out", file, "--bands", ",".join(map(str, nm)), *given)
    assert ran.code == 0, ran.err
    again = make_scene(file)
    before, after = (
        np.einsum("mrc,mk->rck", one.source.planes.astype(float), one.on(nm).spectra)
        for one in (scene, again)
    )
    # A sum of up to 8 coefficients times spectra, each rounded to float32: 9 roundings of 2^-24.
    np.testing.assert_allclose(after, before, rtol=9 * 2**-24)
    assert units_of(file) == "W m^-2 sr^-1 nm^-1"
    assert_refused(gpusim("chart", picture, "--out", tmp_path / "c.png"), "NAME", "--bands")


def test_bands_beyond_what_is_known_of_a_scene_are_refused(tmp_path: Path):
    given = "--out", tmp_path / "c.exr", "--bands", "400:1000:100"
    ran = gpusim("chart", "colorchecker", *given)
    assert_refused(ran, "--bands", "400 to 1000 nm", "730 nm")
    assert not list(tmp_path.iterdir())


def test_an_unknown_chart_is_refused(tmp_path: Path):
    ran = gpusim("chart", "gray", "--out", tmp_path / "c.png")
    assert_refused(ran, "NAME", "gray", "demo", "colorchecker")
    assert not list(tmp_path.iterdir())


def test_an_output_file_of_another_kind_is_refused(tmp_path: Path):
    assert_refused(gpusim("chart", "grey", "--out", tmp_path / "c.jpg"), "--out", "c.jpg", ".png")


# develop


def test_what_is_no_raw_file_is_refused(tmp_path: Path):
    picture = tmp_path / "picture.png"
    assert_refused(
        gpusim("develop", tmp_path / "none.dng", "--out", picture), tmp_path / "none.dng"
    )
    (tmp_path / "text.dng").write_text("no raw file")
    assert_refused(
        gpusim("develop", tmp_path / "text.dng", "--out", picture), tmp_path / "text.dng"
    )
    assert not picture.exists()


# files


def test_files_move_up_only_when_all_went_well(tmp_path: Path):
    (tmp_path / "a").write_text("old")
    with pytest.raises(ZeroDivisionError), files.staging(tmp_path) as folder:
        (folder / "a").write_text("new")
        raise ZeroDivisionError
    assert [file.name for file in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_text() == "old"
    with files.staging(tmp_path) as folder:
        (folder / "a").write_text("new")
        assert (tmp_path / "a").read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_text() == "new"


def test_a_full_disk_is_one_screen(tmp_path: Path):
    with pytest.raises(UserError, match="No space left"), files.staging(tmp_path):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("arguments", "code"), [(("charts",), 0), (("sensor", "imx47"), 2)])
def test_a_command_whose_output_is_closed_ends_as_ever(arguments: tuple[str, ...], code: int):
    words = [sys.executable, "-m", "gpusim", *arguments]
    ran = subprocess.run(
        ["sh", "-c", 'exec "$@" >&- 2>&-', "sh", *words],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert ran.returncode == code


def test_other_failures_of_the_system_are_not_hidden(tmp_path: Path):
    with pytest.raises(FileNotFoundError), files.staging(tmp_path):
        (tmp_path / "missing").read_text()

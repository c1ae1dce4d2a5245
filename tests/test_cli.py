"""The command line: what it answers, what it writes, and how it refuses."""

from __future__ import annotations

import errno
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gpusim.cli import files, main
from gpusim.errors import UserError
from gpusim.scene.colorimetry import encode_srgb
from gpusim.scene.exr import read_exr


@dataclass
class Ran:
    """What a command left behind."""

    code: int
    out: str
    err: str


@pytest.fixture
def gpusim(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Ran]:
    """Return a function that runs the command line in this process."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: object) -> Ran:
        monkeypatch.setattr(sys, "argv", ["gpusim", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            main()
        captured = capsys.readouterr()
        return Ran(left.value.code, captured.out, captured.err)

    return run


def assert_refused(ran: Ran, *words: str) -> None:
    """Check that the command ended with one screen that has all `words`, and no traceback."""
    assert ran.code == 2, ran
    assert ran.out == ""
    assert "Traceback" not in ran.err
    assert len(ran.err.strip().splitlines()) <= 8, "more than a screen"
    for word in words:
        assert word in ran.err


def process(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run the command line as a user does."""
    command = [sys.executable, "-m", "gpusim.cli", *arguments]
    environment = {"PYTHONPATH": str(Path(__file__).parent.parent), "PATH": "/usr/bin:/bin"}
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )


def test_help_answers_within_half_a_second(tmp_path: Path):
    times_s = []
    for _ in range(3):
        begin = time.perf_counter()
        ran = process("--help", cwd=tmp_path)
        times_s.append(time.perf_counter() - begin)
        assert ran.returncode == 0, ran.stderr
        for command in ("render", "chart", "lens", "develop", "devices"):
            assert command in ran.stdout
    assert min(times_s) < 0.5  # 0.14 s on an idle machine


def test_help_imports_none_of_the_heavy_packages(tmp_path: Path):
    look = "import sys; import gpusim.cli; print(*sys.modules)"
    environment = {"PYTHONPATH": str(Path(__file__).parent.parent)}
    ran = subprocess.run(
        [sys.executable, "-c", look], env=environment, capture_output=True, text=True, check=True
    )
    loaded = set(ran.stdout.split())
    assert "typer" in loaded
    assert not loaded & {"numpy", "scipy", "wgpu", "pydantic", "xarray", "matplotlib"}


@pytest.mark.parametrize("command", ["render", "chart", "lens", "develop", "devices"])
def test_each_command_has_help(gpusim, command: str):
    ran = gpusim(command, "--help")
    assert ran.code == 0
    assert "Usage" in ran.out


@pytest.mark.parametrize(
    "arguments",
    [
        ("render", "demo", "demo"),
        ("render", "demo", "demo", "--out", "x", "--certify", "-1"),
        ("render", "demo", "demo", "--out", "x", "--seed", "-1"),
        ("render", "demo", "demo", "--out", "x", "--tile-size", "0"),
        ("render", "demo", "demo", "--out", "x", "--colour"),
        ("chart", "demo"),
        ("paint", "demo"),
    ],
)
def test_wrong_usage_exits_with_2_and_without_a_traceback(gpusim, arguments: tuple[str, ...]):
    ran = gpusim(*arguments)
    assert ran.code == 2
    assert "Usage" in ran.err
    assert "Traceback" not in ran.err


def test_no_command_shows_the_help(gpusim):
    assert "Usage" in gpusim().out


def test_an_interrupt_exits_with_130_and_without_a_traceback(gpusim, monkeypatch):
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("gpusim.cli.devices.devices", interrupted)
    ran = gpusim("devices")
    assert ran.code == 130
    assert "Traceback" not in ran.err


# devices


def test_devices_names_the_adapter_and_its_limits(gpusim, device):
    ran = gpusim("devices")
    assert ran.code == 0
    report = device.report()
    assert report["adapter"] in ran.out
    assert "max-buffer-size" in ran.out


def test_no_adapter_is_one_screen_that_says_what_to_install(tmp_path: Path):
    # With no driver on its list the Vulkan loader finds no adapter.
    command = [sys.executable, "-m", "gpusim.cli", "devices"]
    environment = {
        "PYTHONPATH": str(Path(__file__).parent.parent),
        "VK_DRIVER_FILES": str(tmp_path / "none.json"),
        "VK_ICD_FILENAMES": str(tmp_path / "none.json"),
    }
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert_refused(Ran(ran.returncode, ran.stdout, ran.stderr), "adapter", "mesa-vulkan-drivers")


# chart


def test_chart_draws_the_same_scene_as_picture_and_as_radiance(gpusim, tmp_path: Path):
    for name in ("c.png", "c.exr"):
        assert gpusim("chart", "dots", "--out", tmp_path / name).code == 0
    picture = np.asarray(Image.open(tmp_path / "c.png"))
    radiance = np.moveaxis(read_exr(tmp_path / "c.exr").rgb, 0, -1)
    # The same float32 numbers go into both files.
    np.testing.assert_array_equal(picture, np.round(255 * encode_srgb(radiance)))
    assert np.unique(picture).size > 2


def test_an_unknown_chart_is_refused(gpusim, tmp_path: Path):
    ran = gpusim("chart", "gray", "--out", tmp_path / "c.png")
    assert_refused(ran, "NAME", "gray", "demo", "colorchecker")
    assert not list(tmp_path.iterdir())


def test_an_output_file_of_another_kind_is_refused(gpusim, tmp_path: Path):
    assert_refused(gpusim("chart", "grey", "--out", tmp_path / "c.jpg"), "--out", "c.jpg", ".png")


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


def test_other_failures_of_the_system_are_not_hidden(tmp_path: Path):
    with pytest.raises(FileNotFoundError), files.staging(tmp_path):
        (tmp_path / "missing").read_text()

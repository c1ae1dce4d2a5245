"""The command line helps: lists, nearest names, dotted settings, plain terminals."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import assert_refused, gpusim, process
from fake_capture import fake_capture
from typer.main import get_command

from gpusim import __version__
from gpusim.camera import load_camera, presets
from gpusim.cli import render
from gpusim.cli.app import app
from gpusim.errors import UserError
from gpusim.scene.charts import CHARTS
from gpusim.sensor.load import load_sensor


def test_the_version_is_told():
    assert gpusim("--version").out == f"gpusim {__version__}\n"


def test_what_there_is_is_listed():
    cameras, charts = gpusim("cameras"), gpusim("charts")
    assert cameras.code == charts.code == 0
    assert all(name in cameras.out for name in presets())
    assert all(name in charts.out for name in CHARTS)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("render", "deno", "demo"), ["perhaps demo is meant", "CAMERA"]),
        (("render", "imx477", "demo"), ["imx477 is a sensor; cameras with it: demo, mtf-only"]),
        (("render", "imx249-mono", "demo"), ["imx249-mono is a sensor; cameras with it: machine"]),
        (("render", "tessar", "demo"), ["tessar is a lens; no camera has it"]),
        (("render", "demo", "slanted"), ["perhaps slanted-edge is meant"]),
        (("render", "demo", "demo", "--sensor", "imx47"), ["perhaps imx477 is meant"]),
        (("render", "demo", "demo", "--f-number", "-2"), ["--f-number\n", "greater than 0"]),
        (("render", "demo", "demo", "--f-number", "0.1"), ["--f-number\n", ">= 2"]),
        (("render", "demo", "demo", "--focus-shift", "nan"), ["--focus-shift\n", "finite"]),
        (("render", "mtf-only", "demo", "--f-number", "4"), ["f_number", "prescription"]),
    ],
)
def test_a_wrong_name_is_told_the_nearest_one(tmp_path: Path, arguments, words):
    assert_refused(gpusim(*arguments, "--out", tmp_path, "--dry-run"), *words)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("render", "demo", "none.exr", "--dry-run"), ["no such scene", "spectral"]),
        (
            ("render", "demo", "none.yaml", "--dry-run"),
            ["the chart cannot be read", "a file of YAML"],
        ),
        (("develop", "none.dng"), ["no such raw", "LibRaw"]),
        (("batch", "none.yaml"), ["the sweep file cannot be read", "a file of YAML"]),
        (
            ("tolerance", "demo", "--budget", "none.yaml"),
            ["the tolerance budget", "a file of YAML"],
        ),
        (("sensor", "imx477", "--set", "rows=abc"), ["allowed: a whole number\n"]),
    ],
)
def test_what_is_not_there_is_told_with_what_may_be(tmp_path: Path, arguments, words):
    out = [] if arguments[0] == "sensor" else ["--out", tmp_path / "out.png"]
    ran = gpusim(*arguments, *out)
    assert_refused(ran, "allowed:", *words)
    assert "unable to parse" not in ran.err


def test_other_commands_tell_it_too(tmp_path: Path):
    assert_refused(gpusim("sensor", "IMX363x"), "perhaps imx363 is meant")
    assert_refused(gpusim("lens", "tesar"), "perhaps tessar is meant")
    assert_refused(gpusim("chart", "gray", "--out", tmp_path / "a.png"), "perhaps grey is meant")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("rendr", "demo", "demo"), ["perhaps render is meant", "value:   rendr"]),
        (("validate", "kodack"), ["perhaps kodak is meant", "gpusim validate\n", "samsung"]),
        (("measure", "sfrr", "a.png"), ["perhaps sfr is meant", "gpusim measure\n", "distortion"]),
        (("measure", "paint"), ["no such command\n", "noise"]),
    ],
)
def test_a_wrong_command_is_told_the_nearest_one(arguments, words):
    assert_refused(gpusim(*arguments), "error: no such command", "allowed:", *words)


def commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield every command's words, and what typer made of it."""
    for name, one in group.commands.items():
        if hasattr(one, "commands"):
            yield from commands(one, (*path, name))
        else:
            yield (*path, name), one


@pytest.mark.parametrize(("words", "command"), list(commands(get_command(app))))
def test_a_mistyped_option_is_told_the_nearest_one(words: tuple[str, ...], command: Any):
    """The longest one, without its last letter but one."""
    options = [name for one in command.params for name in one.opts if name.startswith("--")]
    right = max(options, key=len, default="--help")
    assert_refused(gpusim(*words, right[:-2] + right[-1]), "No such option", right)


def test_a_camera_takes_another_stop_focus_and_sensor():
    changed = load_camera("demo", {"f_number": 5.6, "focus_shift_um": 3.0}, "imx249-mono")
    assert changed.lens.f_number == 5.6 and changed.lens.focus_shift_um == 3.0
    assert changed.sensor == load_sensor("imx249-mono")
    plain = load_camera("demo")
    assert changed.lens.title == plain.lens.title and changed.sensor != plain.sensor
    with pytest.raises(UserError, match="wrong"):
        load_camera("mtf-only", {"f_number": 5.6})


@pytest.mark.parametrize(
    ("settings", "pattern"),
    [
        (("cfa.pattern=RGGB",), ["RG", "GB"]),
        (("cfa=GRBG",), ["GR", "BG"]),
        (("cfa.pattern=[[R, G], [G, B]]",), ["RG", "GB"]),
    ],
)
def test_a_part_of_a_field_is_set_by_its_dotted_name(tmp_path: Path, settings, pattern):
    options = [word for one in settings for word in ("--set", one)]
    out = tmp_path / "mine.yaml"
    assert gpusim("sensor", "imx477", *options, "--out", out).code == 0
    sensor = load_sensor(out)
    assert ["".join(row) for row in sensor.cfa.pattern] == pattern
    assert sensor.rows == load_sensor("imx477").rows


def test_two_settings_of_one_part_are_both_kept(tmp_path: Path):
    out = tmp_path / "mine.yaml"
    both = ("--set", "lines.row_noise_e=0.5", "--set", "lines.dsnu_row_e=0.25")
    assert gpusim("sensor", "imx477", *both, "--out", out).code == 0
    lines = load_sensor(out).lines
    assert (lines.row_noise_e, lines.dsnu_row_e) == (0.5, 0.25)


def test_a_render_prints_json_or_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    def take(camera: object, scene: object, **given: Any) -> object:
        return fake_capture(tolerance=2e-3)

    monkeypatch.setattr(render, "take", take)
    ran = gpusim("render", "demo", "demo", "--out", tmp_path, "--json")
    assert ran.code == 0, ran.err
    assert json.loads(ran.out) == json.loads((tmp_path / "report.json").read_text())
    ran = gpusim("render", "demo", "demo", "--out", tmp_path, "--quiet")
    assert (ran.code, ran.out, ran.err) == (0, "", "")


def test_a_terminal_without_letters_and_a_full_disk_are_no_traceback():
    ran = process("cameras", PYTHONIOENCODING="ascii", LC_ALL="C")
    assert ran.code == 0 and "demo" in ran.out
    ran = process("lens", "nichts-\u00e4\u4e2d", PYTHONIOENCODING="ascii", LC_ALL="C.UTF-8")
    assert ran.code == 2 and "Traceback" not in ran.err and "nichts-\\xe4" in ran.err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("arguments", [("charts",), ("--version",)])
def test_a_full_disk_behind_the_output_is_one_clear_error(arguments):
    import subprocess
    import sys

    from command_line import ROOT

    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "gpusim", *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
    assert done.returncode == 2
    assert done.stderr.startswith("error: the output cannot be written")
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("temperature", ["5000", "-274", "inf", "nan"])
def test_no_sensor_is_so_hot_or_cold(tmp_path: Path, temperature: str):
    ran = gpusim("render", "demo", "demo", "--out", tmp_path, "--temperature", temperature)
    assert_refused(ran, "not a temperature", "200 degrees")

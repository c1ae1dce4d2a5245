"""gpusim render: what it writes and shows, and how it refuses bad input."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import re
from collections.abc import Callable, Iterator
from html import escape
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import OpenEXR
import pytest
import rawpy
import tifffile
import yaml
from command_line import Ran, assert_refused, gpusim, process
from fake_capture import COLS, ROWS, fake_capture
from formats.test_ready import arrays
from optics import made
from PIL import Image

from gpusim.cli import render
from gpusim.errors import UserError
from gpusim.isp.develop import develop
from gpusim.isp.settings import Settings
from gpusim.plan import Accuracy, Plan
from gpusim.plan.costs import LAVAPIPE, content_of
from gpusim.render import renderer
from gpusim.render.planning import Planning
from gpusim.report.facts import _plan
from gpusim.scene.exr import write_exr
from gpusim.sensor.load import load_sensor

FILES = ["raw.dng", "developed.png", "report.json", "report.html"]

CAMERA = """
title: a camera
lens: {prescription: double-gauss, focal_length_mm: 8.3, f_number: 2.8}
sensor: {preset: imx477, rows: 96, cols: 128}
"""


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Put a capture made by hand in place of the render; return what it was asked for."""
    options: dict[str, Any] = {}

    def take(camera: object, scene: object, **given: Any) -> object:
        options.update(given)
        return fake_capture(keep=given["keep"], tolerance=2e-3)  # more than its error

    monkeypatch.setattr(render, "take", take)
    return options


def shot(out: Path, *arguments: object) -> Ran:
    return gpusim("render", "demo", "demo", "--out", out, *arguments)


def test_a_report_plans_the_next_render_as_its_own(asked: dict[str, Any], tmp_path: Path):
    report = tmp_path / "report.json"
    ns = {name: 3.0 + number for number, name in enumerate(LAVAPIPE.ns)}
    costs = dataclasses.replace(LAVAPIPE, source="another day", ns=ns)
    report.write_text(json.dumps({"costs": content_of(costs)}))
    assert shot(tmp_path / "out", "--plan", report).code == 0
    assert asked["costs"] == costs
    assert_refused(shot(tmp_path / "b", "--plan", tmp_path / "none.json"), "cannot be read")


# what it writes


def test_the_files_hold_the_capture(asked: dict[str, Any], tmp_path: Path):
    capture = fake_capture(keep=("electrons", "rate"))
    ran = shot(tmp_path / "new" / "out", "--keep", "electrons, rate")
    assert ran.code == 0, ran.err
    out = tmp_path / "new" / "out"
    assert {file.name for file in out.iterdir()} == {*FILES, "electrons.exr", "rate.exr"}
    with rawpy.imread(str(out / "raw.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, capture.raw)
    picture = np.asarray(Image.open(out / "developed.png"))
    np.testing.assert_array_equal(picture, develop(out / "raw.dng").picture)
    for name in ("electrons", "rate"):
        file = OpenEXR.File(str(out / f"{name}.exr"))
        assert file.header()["units"] == {"electrons": "e-", "rate": "e-/s"}[name]
        plane = file.channels()["Y"].pixels
        assert plane.dtype == np.float32
        np.testing.assert_array_equal(plane, getattr(capture, name))
    report = json.loads((out / "report.json").read_text())
    assert report["files"] == [*FILES, "electrons.exr", "rate.exr"]
    assert report["command"][:4] == ["gpusim", "render", "demo", "demo"]
    assert "</html>" in (out / "report.html").read_text()


def with_filters(monkeypatch: pytest.MonkeyPatch, pattern: list[str]) -> Any:
    """Put a capture through other filters in place of the render; return it."""
    plain = fake_capture(tolerance=2e-3)
    sensor, efficiency = plain.camera.sensor, plain.camera.sensor.quantum_efficiency
    sites = [list(row) for row in pattern]
    used = {one for row in sites for one in row}
    curves = {one: efficiency.channels.get(one, efficiency.channels["G"]) for one in used}
    sensor = sensor.model_copy(
        update={
            "cfa": sensor.cfa.model_copy(update={"pattern": sites}),
            "quantum_efficiency": efficiency.model_copy(update={"channels": curves}),
        }
    )
    camera = dataclasses.replace(plain.camera, sensor=sensor)
    white = dict.fromkeys(used, 1000.0)
    changed = dataclasses.replace(plain, camera=camera, white_e=white)
    monkeypatch.setattr(render, "take", lambda camera, scene, **given: changed)
    return changed


def test_filters_that_no_dng_has_are_written_as_tiff(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Six colours: the raw numbers with all that is known of them, and a picture."""
    capture = with_filters(monkeypatch, ["RGB", "CMY"])
    ran = shot(tmp_path, "--ev", 0.5)
    assert ran.code == 0, ran.err
    assert {file.name for file in tmp_path.iterdir()} == {"raw.tif", *FILES} - {"raw.dng"}
    with tifffile.TiffFile(tmp_path / "raw.tif") as file:
        page = file.pages.first
        np.testing.assert_array_equal(page.asarray(), capture.raw)
        assert page.tags["ExifTag"].value["ExposureTime"] == (1, 60)
        assert page.tags["Make"].value == "gpusim"
    picture = np.asarray(Image.open(tmp_path / "developed.png"))
    assert picture.shape == (ROWS, COLS, 3)
    np.testing.assert_array_equal(picture, develop(tmp_path / "raw.tif").picture)
    assert json.loads((tmp_path / "report.json").read_text())["files"][0] == "raw.tif"


def test_quad_bayer_has_its_bayer_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with_filters(monkeypatch, ["RRGG", "RRGG", "GGBB", "GGBB"])
    ran = shot(tmp_path)
    assert ran.code == 0, ran.err
    more = ["remosaiced.dng", "binned.dng", "binned.png"]
    assert {file.name for file in tmp_path.iterdir()} == {*FILES, *more}
    assert json.loads((tmp_path / "report.json").read_text())["files"] == [*FILES, *more]
    for name, shape in (("developed", (ROWS, COLS, 3)), ("binned", (ROWS // 2, COLS // 2, 3))):
        assert np.asarray(Image.open(tmp_path / f"{name}.png")).shape == shape
    picture = np.asarray(Image.open(tmp_path / "developed.png"))
    np.testing.assert_array_equal(picture, develop(tmp_path / "remosaiced.dng").picture)
    ran = gpusim("develop", tmp_path / "raw.dng", "--binned", "--out", tmp_path / "again.png")
    assert ran.code == 0, ran.err
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "binned.png").read_bytes()


def test_stops_are_in_the_picture_and_in_the_raw(asked: dict[str, Any], tmp_path: Path):
    assert shot(tmp_path / "a").code == 0
    assert shot(tmp_path / "b", "--ev", "-1.5").code == 0
    plain, darker = (
        np.asarray(Image.open(tmp_path / name / "developed.png")) for name in ("a", "b")
    )
    np.testing.assert_array_equal(
        darker, develop(tmp_path / "a" / "raw.dng", Settings(ev=-1.5)).picture
    )
    assert np.all(darker <= plain) and np.mean(darker < plain) > 0.5
    again = gpusim("develop", tmp_path / "b" / "raw.dng", "--ev", 1.5, "--out", tmp_path / "c.png")
    assert again.code == 0, again.err
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "c.png")), plain)
    assert_refused(shot(tmp_path, "--ev", "nan"), "--ev", "-20 to 20")


def test_the_iso_speed_chooses_the_gain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    taken = []

    def take(camera: Any, scene: object, **given: Any) -> object:
        taken.append(camera.sensor)
        return dataclasses.replace(fake_capture(tolerance=2e-3), camera=camera)

    monkeypatch.setattr(render, "take", take)
    ran = shot(tmp_path, "--iso", 1600)
    assert ran.code == 0, ran.err
    assert (taken[0].analogue_gain, taken[0].temporal_dark_noise_e) == (16, 1.5)
    with tifffile.TiffFile(tmp_path / "raw.dng") as file:
        assert file.pages.first.tags["ExifTag"].value["ISOSpeedRatings"] == 1600
    assert json.loads((tmp_path / "report.json").read_text())["capture"]["iso"] == 1600
    assert_refused(shot(tmp_path, "--iso", 150), "150", "100, 200, 400")
    assert_refused(shot(tmp_path, "--iso", 100, "--gain", 1), "--iso")
    ran = gpusim("render", "arvr", "demo", "--out", tmp_path, "--iso", 100)
    assert_refused(ran, "lists no speeds")


def test_what_share_is_saturated_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    plain = fake_capture(tolerance=2e-3)
    raw = np.full((ROWS, COLS), 1000, np.uint16)
    raw[:12] = 4095
    monkeypatch.setattr(
        render, "take", lambda camera, scene, **given: dataclasses.replace(plain, raw=raw)
    )
    ran = shot(tmp_path)
    assert "Saturated: 25 % of the pixels" in ran.out
    assert "Saturated: 25 % of the pixels" in (tmp_path / "report.html").read_text()
    assert json.loads((tmp_path / "report.json").read_text())["capture"]["saturated_share"] == 0.25
    raw[:12] = 4094
    assert "No pixel is saturated" in shot(tmp_path).out


def test_develop_gives_the_picture_again(asked: dict[str, Any], tmp_path: Path):
    assert shot(tmp_path).code == 0
    ran = gpusim("develop", tmp_path / "raw.dng", "--out", tmp_path / "again.png")
    assert ran.code == 0, ran.err
    again, first = (np.array(Image.open(tmp_path / f"{n}.png")) for n in ("again", "developed"))
    assert np.array_equal(again, first)


def test_the_options_reach_the_chain(asked: dict[str, Any], tmp_path: Path):
    given = ("--exposure", "1/250", "--seed", 11, "--frame", 2, "--tile-size", 512)
    ran = shot(tmp_path, *given, "--tolerance", 1e-2, "--certify", 5, "--keep", "rate")
    assert ran.code == 0, ran.err
    assert (asked["exposure_s"], asked["seed"], asked["frame"]) == (1 / 250, 11, 2)
    assert asked["temperature_c"] is None
    assert shot(tmp_path, "--temperature", -20.5).code == 0
    assert asked["temperature_c"] == -20.5
    assert shot(tmp_path, *given, "--tolerance", 1e-2, "--certify", 5, "--keep", "rate").code == 0
    assert (asked["tile_px"], asked["keep"]) == (512, ("rate",))
    assert asked["accuracy"] == Accuracy(1e-2, 5)
    assert shot(tmp_path, "--tolerance", "0.1sigma").code == 0
    assert asked["accuracy"] == Accuracy(0.1, None, "sigma")
    assert asked["noise"] is True
    assert asked["method"] is None
    assert shot(tmp_path, "--no-noise", "--method", "modes").code == 0
    assert asked["noise"] is False and asked["method"] == "modes"


def test_a_dry_run_shows_the_plan_and_writes_nothing(
    asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(render, "adapter_costs", lambda device, **more: LAVAPIPE)
    camera = made.StubCamera(made.bank(), made.sensor(96, 128))
    monkeypatch.setattr(render, "load_camera", lambda *named: camera)
    monkeypatch.chdir(tmp_path)
    ran = gpusim("render", "demo", "demo", "--no-noise", "--dry-run")
    assert ran.code == 0, ran.err
    assert not asked and not list(tmp_path.iterdir())
    assert max(map(len, ran.out.splitlines())) <= 100
    words = " ".join(ran.out.split())
    for shown in ("run paint", "skip noise", "noise is switched off", "chosen ", "too dear"):
        assert shown in words
    assert LAVAPIPE.source in words


@pytest.mark.parametrize(
    ("sensor", "tolerance"),
    [(made.sensor, "3e-2"), (made.monochrome, "as good as 1 ms allows")],
)
def test_a_dry_run_plans_as_the_render_does(
    sensor: Callable[..., object],
    tolerance: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    """What the dry run puts into words, as JSON: that of the render's report, times and all."""
    monkeypatch.setattr(render, "adapter_costs", lambda device, **more: LAVAPIPE)
    monkeypatch.setattr(renderer, "adapter_costs", lambda device, **more: LAVAPIPE)
    alike = SimpleNamespace(title="Gaussians", model_dump=dict, history=())
    camera = made.StubCamera(made.bank(), sensor(32, 48), lens=alike)
    monkeypatch.setattr(render, "load_camera", lambda *named: camera)
    # No plan takes 1 ms: the loosest tolerance is what is left, and is told.
    given = ("render", "demo", "slanted-edge", "--tolerance", tolerance, "--certify", 0)
    given += ("--best-effort",)
    done = gpusim(*given, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    monkeypatch.setattr(Plan, "text", lambda plan: json.dumps(_plan(plan)))
    dry = gpusim(*given, "--out", tmp_path / "dry", "--dry-run")
    planned, end = json.JSONDecoder().raw_decode(dry.out)
    assert planned == report["plan"]
    assert ("planned for" in dry.out[end:]) == tolerance.startswith("as good")


def test_the_memory_and_the_rectangle_reach_the_chain(asked: dict[str, Any], tmp_path: Path):
    ran = shot(tmp_path, "--memory", "512MiB", "--tile", "10, 20,30,40")
    assert ran.code == 0, ran.err
    assert (asked["memory_bytes"], asked["tile"]) == (512 << 20, (10, 20, 30, 40))
    assert asked["folder"].parent.parent == tmp_path  # beside the files that are being made
    assert not list(tmp_path.glob(".gpusim-*")) and not list(tmp_path.glob("planes-*"))
    assert "123 MiB" in ran.out and "1024 MiB" in ran.out
    assert shot(tmp_path).code == 0
    assert asked["memory_bytes"] is asked["tile"] is None


@pytest.mark.parametrize(
    ("text", "nbytes"),
    [("512MiB", 2**29), ("1.5 GiB", 3 * 2**29), ("800mb", 800 * 10**6), ("2GB", 2 * 10**9)],
)
def test_a_memory_is_a_number_and_a_unit(text: str, nbytes: int):
    assert render.bytes_of(text) == nbytes


@pytest.mark.parametrize(
    ("x", "y", "first"), [(33, 21, "RGGB"), (34, 21, "GRBG"), (33, 20, "GBRG")]
)
def test_the_files_of_a_rectangle_have_its_filter_pattern(
    asked: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    x: int,
    y: int,
    first: str,
):
    rect = (y, x, ROWS, COLS)
    part = dataclasses.replace(fake_capture(tolerance=2e-3), rect=rect)
    monkeypatch.setattr(render, "take", lambda *_, **__: part)
    ran = shot(tmp_path, "--tile", f"{x},{y},{COLS},{ROWS}")
    assert ran.code == 0, ran.err
    with rawpy.imread(str(tmp_path / "raw.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, part.raw)
        names = raw.color_desc.decode()
        assert "".join(names[site] for site in raw.raw_pattern.flat) == first
    report = json.loads((tmp_path / "report.json").read_text())
    assert [report["capture"][key] for key in ("first_col", "first_row")] == [x, y]
    page = (tmp_path / "report.html").read_text()
    assert f"at ({x}, {y}) of a larger frame" in page
    # Smaller than a crop, it is shown once, and not as the centre of the frame.
    assert page.count("<figcaption>Middle: from row 0, column 0") == 1
    assert "<figcaption>Centre" not in page and "<figcaption>Its corner" not in page
    assert "planned, frame" in ran.out


def test_the_screen_shows_adapter_stages_certificate_and_files(
    asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(render, "take", lambda camera, scene, **given: fake_capture())
    out = shot(tmp_path).out
    for words in (
        "a GPU, a driver, Vulkan",
        "250 ms",
        "left out  the scene is a <chart> & needs none",
        "RMS error 1.4e-03 of the local signal (0.01 sigma of the noise)",
        "worst of 2 probes 2.0e-03 of the local signal (0.014 sigma of the noise)",
        "at row 40, column 60",
        "2.0e-04",  # predicted error and time of rows, beside what was measured
        "1 s",
        "convolved by fft & <whole> PSFs",
        "not fft, <4> samples: too dear: 3.25 s against 1.75 s",
        "BEYOND the tolerance of 0.001",
        "not met: total RMS 1.5e-03, allowed 1.0e-03: 5.0e-04 too much, 1.5 times what is allowed",
        *(str(tmp_path / name) for name in FILES),
    ):
        assert words in out, words


def test_the_exit_code_says_whether_the_certificate_is_met(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Total RMS 1.5e-3, worst 2.2e-3: 0 within 2e-3, 1 beyond 1e-3 and 1e-4; files all the same."""
    for tolerance, code, missed in ((2e-3, 0, []), (1e-3, 1, ["RMS"]), (1e-4, 1, ["RMS", "worst"])):
        taken = fake_capture(tolerance=tolerance)
        monkeypatch.setattr(render, "take", lambda *_, taken=taken, **__: taken)
        ran = shot(tmp_path / str(tolerance))
        assert (ran.code, ran.err) == (code, "")
        assert {file.name for file in (tmp_path / str(tolerance)).iterdir()} == set(FILES)
        lines = [line for line in ran.out.splitlines() if line.startswith("not met: total")]
        assert [line.split()[3] for line in lines] == missed
    assert "worst probe 2.2e-03, allowed 1.0e-03: 1.2e-03 too much, 2.2 times" in ran.out
    monkeypatch.setattr(render, "take", lambda *_, **__: fake_capture(certified=False))
    assert shot(tmp_path / "none").code == 0


def test_a_best_effort_is_shown_on_the_screen_and_in_the_report(
    asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    assert shot(tmp_path, "--best-effort").code == 0
    assert asked["accuracy"].best_effort is True
    assert shot(tmp_path).code == 0
    assert asked["accuracy"].best_effort is False
    taken = fake_capture()
    taken.plan.shortfall = "planned for <0.004> in place of 0.001: the alias"
    monkeypatch.setattr(render, "take", lambda *_, **__: taken)
    ran = shot(tmp_path, "--best-effort")
    assert ran.code == 1  # the certificate is about the tolerance that was asked for
    assert "best effort: planned for <0.004> in place of 0.001: the alias" in ran.out
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["plan"]["shortfall"] == taken.plan.shortfall
    assert "planned for &lt;0.004&gt; in place" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("traced", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_tolerance_that_cannot_be_met_is_refused_before_the_render(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, traced: bool
):
    """PSFs of 0.35 um alias before filters of 12.4 um, of which eight samples are 1.6 um apart.

    And so do those of a traced lens at f/2.8 before filters of 7.8 um.
    """
    monkeypatch.setattr(render, "adapter_costs", lambda device, **more: LAVAPIPE)
    monkeypatch.setattr(renderer, "adapter_costs", lambda device, **more: LAVAPIPE)
    file = tmp_path / "camera.yaml"
    file.write_text(CAMERA.replace("imx477, rows: 96, cols: 128", "kodak-vga, rows: 32, cols: 48"))
    if not traced:
        large = made.sensor(32, 48).model_copy(update={"pixel_pitch_um": 12.4})
        alike = {"coma_um": 0.0, "falloff": 0.0, "distortion": 0.0, "lateral": (0.0, 0.0, 0.0)}
        lens = SimpleNamespace(title="Gaussians", model_dump=dict, history=())
        camera = made.StubCamera(made.bank(sigma_um=3 * (0.35,), **alike), large, lens=lens)
        monkeypatch.setattr(render, "load_camera", lambda *named: camera)
    given = ("render", file, "slanted-edge", "--out", tmp_path / "out", "--certify", 8)
    refused = gpusim(*given, "--tolerance", 1e-4)
    assert_refused(refused, "cannot be met", "alias of edges", "0.0001", "--best-effort")
    dry = gpusim(*given, "--tolerance", 1e-4, "--dry-run")
    assert_refused(dry, *refused.err.splitlines())
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())
    named = refused.err.split("allowed:")[1].split()[0]
    shown = gpusim(*given, "--tolerance", 1e-4, "--dry-run", "--best-effort")
    assert shown.code == 0 and f"planned for {named}" in " ".join(shown.out.split())
    effort = gpusim(*given, "--tolerance", 1e-4, "--best-effort")
    assert effort.code == 1, effort  # the picture is there, its error is more than was asked for
    assert "not met: total RMS" in effort.out and f"best effort: planned for {named}" in effort.out
    assert (tmp_path / "out" / "report.json").exists()
    assert gpusim(*given, "--tolerance", named, "--dry-run").code == 0


def test_a_failure_leaves_earlier_files_as_they_were(
    asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    assert shot(tmp_path).code == 0
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}

    def fails(*_: object) -> None:
        raise UserError("it failed half way")

    # The report comes last: the DNG and the picture are written by then.
    monkeypatch.setattr(render.report, "page", fails)
    assert_refused(shot(tmp_path, "--seed", 8), "it failed half way")
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


# how it refuses


@pytest.mark.parametrize(
    "text", ["1/0", "abc", "0", "-1", "-1/60", "nan", "inf", "1/inf", "", "1/60 s", "1//2"]
)
def test_a_wrong_exposure_is_refused(tmp_path: Path, text: str):
    assert_refused(shot(tmp_path, f"--exposure={text}"), "--exposure", text, "1/60")


@pytest.mark.parametrize("text", ["-273.15", "-300", "nan"])
def test_a_temperature_below_absolute_zero_is_refused(tmp_path: Path, text: str):
    refused = shot(tmp_path, f"--temperature={text}")
    assert_refused(refused, "--temperature\n", "-273.15")


@pytest.mark.parametrize(
    ("text", "seconds"), [("1/60", 1 / 60), ("0.01", 0.01), ("2", 2.0), ("1e-4", 1e-4)]
)
def test_an_exposure_is_a_number_or_a_fraction(text: str, seconds: float):
    assert render.exposure_seconds(text) == seconds


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--tolerance", "-0.001", ("tolerance", "-0.001")),
        ("--tolerance", "nan", ("tolerance", "nan")),
        ("--tolerance", "0.1 sigmas", ("tolerance", "0.1 sigmas", "0.001sigma to 10sigma")),
        ("--gain", "3", ("gain", "3", "1")),
        ("--gain", "nan", ("gain", "nan", "1")),
        ("--method", "magic", ("method", "magic", "fft, direct, modes")),
        ("--luminance", "0", ("luminance", "0", "above 0")),
        ("--luminance", "-5", ("luminance", "-5", "above 0")),
        ("--keep", "electrons,volts", ("--keep", "volts", "electrons, rate")),
        ("--tile", "1,2,3", ("--tile", "1,2,3", "x,y,width,height")),
        ("--tile", "1,2,3,4,5", ("--tile", "x,y,width,height")),
        ("--tile", "1,2,-3,4", ("--tile", "-3", "x,y,width,height")),
        ("--tile", "a,b,c,d", ("--tile", "x,y,width,height")),
        ("--memory", "512", ("--memory", "512", "512MiB")),
        ("--memory", "0MiB", ("--memory", "512MiB")),
        ("--memory", "-1GiB", ("--memory", "512MiB")),
        ("--memory", "lots", ("--memory", "lots", "512MiB")),
    ],
)
def test_a_wrong_option_is_refused(
    asked: dict[str, Any], tmp_path: Path, option: str, value: str, words: tuple[str, ...]
):
    assert_refused(shot(tmp_path, f"{option}={value}"), *words)
    assert not asked and not list(tmp_path.iterdir())  # before the lens is traced


def test_a_folder_that_cannot_be_written_is_refused_before_the_work(
    asked: dict[str, Any], tmp_path: Path
):
    file = tmp_path / "file"
    file.write_text("")
    for folder in (file, file / "below", Path("/proc/gpusim")):
        assert_refused(shot(folder), "--out", folder, "a folder that you may write to")
    assert not asked


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("title: a camera", "title: [x"), ("YAML",)),
        (("f_number: 2.8", "f_nummer: 2.8"), ("lens.f_nummer",)),
        (("rows: 96", "rows: -96"), ("sensor.rows", "-96")),
        (("rows: 96", "rows: 96000"), ("rows", "96000")),
        (("imx477", "imx4711"), ("imx4711", "imx477")),
        (("double-gauss", "triple-gauss"), ("triple-gauss", "double-gauss")),
        (("f_number: 2.8", "f_number: 0.7"), ("f_number", "0.7")),
    ],
)
def test_a_wrong_camera_file_is_refused(
    tmp_path: Path, change: tuple[str, str], words: tuple[str, ...]
):
    file = tmp_path / "camera.yaml"
    assert change[0] in CAMERA
    file.write_text(CAMERA.replace(*change))
    assert_refused(gpusim("render", file, "demo", "--out", tmp_path / "out"), *words)
    assert not (tmp_path / "out").exists()


def test_a_rectangle_outside_the_frame_and_too_little_memory_are_refused(tmp_path: Path):
    file = tmp_path / "camera.yaml"
    file.write_text(CAMERA)
    given = ("render", file, "demo", "--out", tmp_path / "out", "--tolerance", 0.02)
    for tile in ("100,0,29,10", "0,90,1,7", "0,0,0,5"):
        assert_refused(gpusim(*given, "--tile", tile), "tile", "within 128 x 96")
    assert_refused(gpusim(*given, "--memory", "1MB"), "memory", "at least")
    assert list((tmp_path / "out").iterdir()) == []


def test_an_unknown_or_missing_camera_is_refused(tmp_path: Path):
    out = tmp_path / "out"
    assert_refused(
        gpusim("render", "none-such", "demo", "--out", out), "CAMERA", "none-such", "demo"
    )
    missing = tmp_path / "none.yaml"
    assert_refused(gpusim("render", missing, "demo", "--out", out), missing)


def test_a_wrong_scene_is_refused(tmp_path: Path):
    def refused(scene: object, *words: object) -> None:
        assert_refused(gpusim("render", "demo", scene, "--out", tmp_path / "out"), *words)

    refused("chessboard", "scene", "chessboard", "colorchecker")
    refused(tmp_path / "none.exr", tmp_path / "none.exr")
    corrupt = tmp_path / "corrupt.exr"
    corrupt.write_bytes(b"no picture")
    refused(corrupt, corrupt)
    for name, value in (("nan.exr", np.nan), ("infinite.exr", np.inf)):
        picture = np.ones((4, 5, 3), np.float32)
        picture[1, 2, 0] = value
        write_exr(tmp_path / name, {"RGB": picture})
        refused(tmp_path / name, tmp_path / name, "channel R", "row 1, column 2")


def test_a_sensor_beyond_the_image_circle_is_flagged(tmp_path: Path):
    # The corner lies 248 um from the axis, the last PSF of the bank 162 um.
    held = arrays(made.bank(size=16))
    text = {name: held.pop(name) for name in ("title", "source")}
    np.savez(tmp_path / "lens.npz", **held)
    (tmp_path / "lens.yaml").write_text(yaml.safe_dump(text | {"exit_pupil_mm": 20.0}))
    file = tmp_path / "camera.yaml"
    lens, size = "lens: {bank: lens.npz}", "rows: 192, cols: 256"
    file.write_text(f"title: a camera\n{lens}\nsensor: {{preset: imx477, {size}}}\n")
    tile = ("--tile", "0,0,64,48", "--certify", "0", "--tolerance", "1e-2")
    ran = gpusim("render", file, "grey", "--out", tmp_path / "out", *tile)
    assert ran.code == 0, ran.err
    facts = json.loads((tmp_path / "out" / "report.json").read_text())
    (stage,) = [one for one in facts["plan"]["stages"] if one["name"] == "image circle"]
    assert "beyond the image circle" in stage["reason"] and stage["runs"]
    share = float(re.search(r"([0-9.]+)% of its pixels are black", stage["reason"])[1])
    rows, cols, pitch = 192, 256, 1.55
    row, col = np.ogrid[:rows, :cols]
    off_um = np.hypot(row + 0.5 - rows / 2, col + 0.5 - cols / 2) * pitch
    radius_um = np.quantile(off_um, 1 - share / 100)
    assert 160 < radius_um < 164
    assert "warning: the sensor reaches beyond" in " ".join(ran.out.split())
    assert escape(stage["reason"]) in (tmp_path / "out" / "report.html").read_text()


def test_an_unknown_adapter_is_refused(tmp_path: Path):
    ran = process("render", "demo", "demo", "--out", tmp_path, "--adapter", "abacus")
    assert_refused(ran, "adapter", "abacus")


def test_a_sensor_of_one_pixel_is_rendered(tmp_path: Path):
    camera = {"title": "one", "lens": {"mtf": "diffraction-limited"}}
    camera["sensor"] = {"preset": "imx249-mono", "rows": 1, "cols": 1}
    (tmp_path / "one.yaml").write_text(yaml.safe_dump(camera))
    out = tmp_path / "out"
    ran = gpusim(
        "render", tmp_path / "one.yaml", "grey", "--out", out, "--certify", 1, "--no-noise"
    )
    assert ran.code == 0, ran.err
    facts = json.loads((out / "report.json").read_text())
    assert facts["certificate"]["met"] and facts["files"][0] == "raw.dng"
    raw = tifffile.imread(out / "raw.dng")
    assert raw.shape == (1, 1) and raw[0, 0] > load_sensor("imx249-mono").black_level_dn


def test_a_dry_run_tells_that_it_plans(monkeypatch: pytest.MonkeyPatch):
    told: list[str] = []

    @contextlib.contextmanager
    def bars(shown: bool = True) -> Iterator[Callable[[str, int, int], None]]:
        yield lambda phase, done, total: told.append(phase)
        told.append("no bar")

    monkeypatch.setattr(render.screen, "progress_bar", bars)
    planned = SimpleNamespace(text=lambda: told.append("planned") or "the plan")
    monkeypatch.setattr(Planning, "plan", lambda self, method: planned)
    assert gpusim("render", "mtf-only", "grey", "--dry-run").out == "the plan\n"
    assert told[-3:] == ["plan", "planned", "no bar"]

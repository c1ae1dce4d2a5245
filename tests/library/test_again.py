"""Raws made again of the JSON file beside them, by whatever command they came from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import Ran, assert_refused, gpusim

import gpusim as gs
from gpusim.errors import UserError
from gpusim.library.again import made_raw
from gpusim.render.recipe import exact, given
from gpusim.scene.exr import write_exr

CAMERAS = {
    "traced": "lens: {prescription: double-gauss, focal_length_mm: 8.3, max_field_deg: 14.3}\n"
    "sensor: {preset: imx477, rows: 40, cols: 56}\n",
    "ccd": "lens: {mtf: diffraction-limited}\nsensor: {preset: kodak-vga, rows: 30, cols: 40}\n",
    "table": "lens: {mtf: diffraction-limited}\nsensor: {preset: imx477, rows: 30, cols: 44}\n",
}
PLAIN = ("--tolerance", "1e-2", "--certify", 0, "-q")


def camera(folder: Path, name: str) -> Path:
    path = folder / "camera.yaml"
    path.write_text(f"title: a camera\n{CAMERAS[name]}")
    return path


def again(recipe: Path, out: Path, *more: str) -> Ran:
    return gpusim("render", "--from", recipe, "--out", out, *more)


def changed(recipe: Path, change) -> Path:
    """Write a recipe with something changed beside it."""
    content = json.loads(recipe.read_text())
    change(content)
    path = recipe.with_name("changed.json")
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("name", "options"),
    [
        pytest.param(
            "traced",
            ("--exposure", "1/30", "--ev", 0.5, "--f-number", 4),
            marks=pytest.mark.slow,
        ),
        ("table", ("--tile", "8,6,30,20", "--tolerance", "0.5sigma", "--temperature", 40)),
        ("ccd", ("--no-noise", "--illuminant", "A")),
        ("table", ("--method", "direct", "--luminance", 1000, "--frame", 3)),
    ],
)
def test_a_render_is_made_again_byte_for_byte(tmp_path: Path, name: str, options: tuple):
    made = camera(tmp_path, name)
    ran = gpusim("render", made, "colorchecker", "--out", tmp_path / "a", *PLAIN, *options)
    assert ran.code == 0, ran.err
    made.unlink()  # the report holds all of it
    ran = again(tmp_path / "a" / "report.json", tmp_path / "b")
    assert ran.code == 0, ran
    assert "raw.dng is the same, byte for byte" in ran.out
    first, second = ((tmp_path / one / "raw.dng").read_bytes() for one in "ab")
    assert first == second
    # And again, of what lies beside the second.
    assert again(tmp_path / "b" / "raw.json", tmp_path / "c", "-q").code == 0
    assert (tmp_path / "c" / "raw.dng").read_bytes() == first


def test_a_picture_is_found_from_another_folder(tmp_path: Path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    rgb = np.random.default_rng(1).uniform(0, 1, (3, 30, 44)).astype(np.float32)
    write_exr(Path("picture.exr"), dict(zip("RGB", rgb, strict=True)))
    write_exr(Path("light.exr"), {"Y": np.linspace(1, 2, 12, dtype=np.float32).reshape(3, 4)})
    made = camera(tmp_path, "table")
    uneven = ("--illumination", "light.exr")
    ran = gpusim("render", made, "picture.exr", "--out", "../a", *PLAIN, *uneven)
    assert ran.code == 0, ran.err
    monkeypatch.chdir(tmp_path)
    assert again(Path("a/report.json"), tmp_path / "b").code == 0
    # The picture is another now: that is told, and the raw is another.
    write_exr(Path("here/picture.exr"), dict(zip("RGB", 0.5 * rgb, strict=True)))
    ran = again(Path("a/report.json"), tmp_path / "b")
    assert ran.code == 1
    assert "the scene is not that of then" in ran.out
    assert "raw.dng is NOT the one of then" in ran.out


def test_what_changed_is_told(tmp_path: Path):
    made = camera(tmp_path, "table")
    assert gpusim("render", made, "grey", "--out", tmp_path / "a", *PLAIN).code == 0

    def older(content):
        by = content["recipe"]["light"]["made_by"]
        by |= {"shaders": "0", "plan": "0", "numpy": "1.0", "adapter": "another"}

    ran = again(changed(tmp_path / "a" / "report.json", older), tmp_path / "b")
    assert ran.code == 0
    for said in (
        "the shaders are not those of then",
        "the plan is not that of then",
        "numpy: 1.0 then",
        "adapter: another then",
        "the same, byte for byte",
    ):
        assert said in ran.out

    def other_seed(content):
        content["recipe"]["seed"] += 1

    ran = again(changed(tmp_path / "a" / "report.json", other_seed), tmp_path / "b")
    assert ran.code == 1
    assert "NOT the one of then" in ran.out


def test_frames_of_bursts_and_batches_are_made_again(tmp_path: Path):
    made = camera(tmp_path, "table")
    burst = ("--frames", 3, "--exposure", "1/100,1/50", "--iso", "100,200", "--format", "dng")
    ran = gpusim("burst", made, "colorchecker", "--out", tmp_path / "burst", *PLAIN, *burst)
    assert ran.code == 0, ran.err
    sweep = tmp_path / "sweep.yaml"
    sweep.write_text(
        f"camera: {made}\nscenes: [colorchecker]\ntolerance: 1e-2\nprobes: 0\n"
        "axes: {exposure_s: [0.01, 0.02], sensor.temporal_dark_noise_e: [1.5, 9.0], seed: [5]}\n"
    )
    assert gpusim("batch", sweep, "--out", tmp_path / "batch", "-q").code == 0
    for folder, name in (("burst", "frame-0002"), ("batch", "frame-000003")):
        recipe = tmp_path / folder / f"{name}.json"
        ran = again(recipe, tmp_path / "b")
        assert ran.code == 0, ran
        expected = recipe.with_suffix(".dng").read_bytes()
        assert (tmp_path / "b" / f"{name}.dng").read_bytes() == expected


def test_a_frame_that_is_saved_is_made_again(tmp_path: Path):
    small = gs.Camera.load(camera(tmp_path, "table"))
    light = gs.expose(small, gs.Scene.load("colorchecker"), 1e-2, probes=0)
    light.capture(1 / 50, iso=200, seed=3, frame=2).save(tmp_path / "a.dng", ev=1.5)
    ran = again(tmp_path / "a.json", tmp_path / "b")
    assert ran.code == 0, ran
    first = (tmp_path / "a.dng").read_bytes()
    assert (tmp_path / "b" / "a.dng").read_bytes() == first
    # The light's file holds its recipe: a frame of it, read again, has the same.
    light.save(tmp_path / "light.npz")
    gs.Light.load(tmp_path / "light.npz").capture(1 / 60).save(tmp_path / "c.TIFF")
    assert again(tmp_path / "c.json", tmp_path / "d").code == 0


@pytest.mark.parametrize("suffix", [".npz", ".exr"])
def test_a_render_of_an_irradiance_is_made_again(tmp_path: Path, suffix: str):
    made, file = camera(tmp_path, "table"), tmp_path / f"e{suffix}"
    lines = np.arange(400.0, 701.0, 100.0)
    values = np.random.default_rng(2).uniform(0, 1e-3, (30, 44, 4)).astype(np.float32)
    gs.Irradiance(values, lines).save(file)
    options = "--exposure", "1/200", "--iso", 200, "--seed", 4, "--ev", 0.5
    ran = gpusim("render", made, file, "--out", tmp_path / "a", *options)
    assert ran.code == 0, ran.err
    made.unlink()
    ran = again(tmp_path / "a" / "capture.json", tmp_path / "b")
    assert ran.code == 0, ran
    first = (tmp_path / "a" / "raw.dng").read_bytes()
    assert (tmp_path / "b" / "raw.dng").read_bytes() == first
    assert again(tmp_path / "b" / "raw.json", tmp_path / "c", "-q").code == 0
    # Another irradiance in the same file is told.
    gs.Irradiance(values / 2, lines).save(file)
    ran = again(tmp_path / "a" / "capture.json", tmp_path / "b")
    assert ran.code == 1
    assert "the irradiance is not that of then" in ran.out
    file.unlink()
    assert_refused(again(tmp_path / "a" / "capture.json", tmp_path / "b"), "no such irradiance")


def test_what_was_an_array_is_refused(tmp_path: Path):
    small = gs.Camera.load(camera(tmp_path, "table"))
    light = gs.expose(small, gs.Scene.from_rgb(np.full((30, 44, 3), 0.2)), 1e-2, probes=0)
    light.capture().save(tmp_path / "a.dng")
    with pytest.raises(UserError, match="scene was made in Python"):
        made_raw(tmp_path / "a.json")
    given = gs.Irradiance(np.full((30, 44, 2), 1e-4), np.array([450.0, 650.0]))
    given.light(small.sensor).capture(0.01).save(tmp_path / "b.dng")
    with pytest.raises(UserError, match="irradiance was made in Python"):
        made_raw(tmp_path / "b.json")


# All fields of a raw's recipe but those of its light.
WHOLE = {
    **{"format": "gpusim recipe 1", "tile": None, "sensor": None, "exposure_s": 0.01, "seed": 1},
    **{"frame": 0, "temperature_c": None, "noise": True, "ev": 0.0, "sha256": ""},
    **{"taken": "2026-01-01T00:00:00+00:00", "raw": "a.dng"},
}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{}", "no recipe"),
        ("[1]", "no recipe"),
        ("not JSON", "JSON"),
        ('{"recipe": {"format": "gpusim recipe 1", "light": {}}}', "fields are missing"),
        (json.dumps({"recipe": WHOLE | {"light": {}}}), "camera, scene, tolerance"),
        (json.dumps({"recipe": WHOLE | {"light": "none.json"}}), "none.json"),
        (json.dumps({"recipe": WHOLE | {"light": {}, "raw": "../a.dng"}}), "../a.dng"),
        (json.dumps({"recipe": WHOLE | {"light": {}, "raw": "a.png"}}), "a.png"),
        (None, "cannot be read"),
    ],
)
def test_what_is_no_recipe_is_refused(tmp_path: Path, content: str | None, words: str):
    path = tmp_path / "a.json"
    if content is not None:
        path.write_text(content)
    assert_refused(again(path, tmp_path / "b"), words)


def test_other_options_and_nothing_at_all_are_refused(tmp_path: Path):
    assert_refused(again(tmp_path / "a.json", tmp_path, "--seed", 3), "--seed", "--from")
    assert_refused(again(tmp_path / "a.json", tmp_path, "demo"), "camera", "--from")
    assert_refused(gpusim("render", "--out", tmp_path), "CAMERA", "--from")
    assert_refused(gpusim("render", "demo", "--out", tmp_path), "SCENE")


def test_what_is_infinite_survives():
    value = {"a": [1.5, float("inf"), {"b": (-float("inf"), "text", None, True)}]}
    assert given(json.loads(json.dumps(exact(value), allow_nan=False))) == {
        "a": [1.5, float("inf"), {"b": [-float("inf"), "text", None, True]}]
    }

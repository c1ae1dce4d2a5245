"""gpusim irradiance, and renders of what it wrote."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import assert_refused, gpusim
from PIL import Image

import gpusim as gs
from gpusim.isp.rawfile import read_raw


@pytest.fixture(scope="module")
def camera(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("camera") / "camera.yaml"
    path.write_text(
        "title: a camera\nlens: {mtf: diffraction-limited}\n"
        "sensor: {preset: imx477, rows: 18, cols: 24}\n"
    )
    return path


def test_an_irradiance_is_written_and_read_by_the_sensor(tmp_path: Path, camera: Path):
    file = tmp_path / "e.npz"
    given = ("--bands", "450:650:100", "--tolerance", "1e-2", "-q")
    ran = gpusim("irradiance", camera, "colorchecker", "--out", file, *given)
    assert ran.code == 0, ran.err
    found = gs.Irradiance.load(file)
    assert found.values.shape == (18, 24, 3)
    picture = np.asarray(Image.open(tmp_path / "e.png"))
    assert picture.shape == (18, 24, 3) and picture.max() == 255
    shot = ("--exposure", "1/50", "--seed", 3, "--ev", 1)
    ran = gpusim("render", camera, file, "--out", tmp_path / "out", *shot)
    assert ran.code == 0, ran.err
    assert "24 x 18 pixels, 1/50 s" in ran.out
    names = {one.name for one in (tmp_path / "out").iterdir()}
    assert names == {"raw.dng", "developed.png", "capture.json"}
    facts = json.loads((tmp_path / "out" / "capture.json").read_text())
    sensor = gs.Camera.load(camera).sensor
    expected = found.light(sensor).capture(1 / 50, seed=3).raw
    assert facts["mean_dn"] == pytest.approx(expected.mean())
    # The same as an EXR, which has no bit less: the same raw.
    found.save(tmp_path / "e.exr")
    ran = gpusim("render", camera, tmp_path / "e.exr", "--out", tmp_path / "exr", *shot)
    assert ran.code == 0, ran.err
    first, second = (read_raw(tmp_path / name / "raw.dng") for name in ("out", "exr"))
    np.testing.assert_array_equal(first.signal_dn, second.signal_dn)


def test_channels_without_a_filter_array(tmp_path: Path, camera: Path):
    file = tmp_path / "c.npz"
    given = ("--channels", "--tolerance", "1e-2")
    ran = gpusim("irradiance", camera, "grey", "--out", file, *given)
    assert ran.code == 0, ran.err
    assert "3 images of 24 x 18 pixels" in ran.out and "electrons/s" in ran.out
    with np.load(file) as arrays:
        assert arrays["electrons_per_s"].shape == (18, 24, 3)
        assert list(arrays["channels"]) == list(gs.Camera.load(camera).sensor.channels)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--bands", "400"), "rise"),
        (("--bands", "400:700"), "--bands"),
        (("--bands", "400:700:0"), "--bands"),
        (("--bands", "401,500"), "multiples of 5 nm"),
        (("--out", "a.txt"), ".npz"),
    ],
)
def test_what_is_wrong_is_refused(tmp_path: Path, camera: Path, given: tuple, words: str):
    out = () if "--out" in given else ("--out", tmp_path / "a.npz")
    assert_refused(gpusim("irradiance", camera, "grey", *out, *given), words)


def test_options_of_the_optics_are_refused_with_an_irradiance(tmp_path: Path, camera: Path):
    given = ("render", camera, "e.npz", "--out", tmp_path)
    assert_refused(gpusim(*given, "--tolerance", "1e-2"), "--tolerance", "irradiance")
    assert_refused(gpusim(*given), "e.npz", "no such irradiance")

"""gpusim develop on the command line: engines, options, the settings beside the picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
import yaml
from command_line import assert_refused, gpusim
from PIL import Image

from gpusim.isp.dng import write_dng
from gpusim.sensor.load import load_sensor


@pytest.fixture(scope="module")
def raw(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("raw") / "raw.dng"
    sensor = load_sensor("imx477")
    light = np.linspace(256, 3000, 64 * 96).reshape(64, 96)
    frame = (light + np.random.default_rng(2).normal(0, 5, light.shape)).astype(np.uint16)
    white = {"R": 2000.0, "G": 4000.0, "B": 2500.0}
    write_dng(path, frame, sensor, white_e=white, exposure_s=0.01)
    return path


def picture(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path)).astype(int)


def test_settings_saved_beside_a_picture_make_it_again(tmp_path: Path, raw: Path):
    given = ["--demosaic", "malvar", "--white-balance", "D50", "--space", "p3", "--ev", 0.5]
    ran = gpusim("develop", raw, "--out", tmp_path / "a.png", *given, "--defects")
    assert ran.code == 0
    assert "left out  shading: the file says nothing of the lens's" in ran.out
    saved = yaml.safe_load((tmp_path / "a.yaml").read_text())
    assert saved["demosaic"] == "malvar"
    assert saved["defects"] is True
    ran = gpusim("develop", raw, "--out", tmp_path / "b.png", "--settings", tmp_path / "a.yaml")
    assert ran.code == 0
    assert np.array_equal(picture(tmp_path / "a.png"), picture(tmp_path / "b.png"))
    ran = gpusim(
        "develop", raw, "--out", tmp_path / "c.png", "--settings", tmp_path / "a.yaml", "--ev", 1
    )
    assert picture(tmp_path / "c.png").mean() > picture(tmp_path / "a.png").mean() + 5


def test_both_engines_show_the_same(tmp_path: Path, raw: Path):
    for engine in ("libraw", "gpusim"):
        ran = gpusim("develop", raw, "--out", tmp_path / f"{engine}.png", "--engine", engine)
        assert ran.code == 0
    ours, theirs = picture(tmp_path / "gpusim.png"), picture(tmp_path / "libraw.png")
    # The white is between A's and daylight's: the matrices differ there, LibRaw has D65's.
    assert np.abs(ours.mean(axis=(0, 1)) - theirs.mean(axis=(0, 1))).max() < 4
    assert not (tmp_path / "libraw.yaml").exists()


def test_a_tiff_has_sixteen_bits(tmp_path: Path, raw: Path):
    ran = gpusim("develop", raw, "--out", tmp_path / "a.tif", "--space", "linear")
    assert ran.code == 0
    found = tifffile.imread(tmp_path / "a.tif")
    assert found.dtype == np.uint16
    assert len(np.unique(found)) > 1000


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--engine", "adobe"], ("--engine", "adobe", "gpusim, libraw")),
        (["--engine", "libraw", "--demosaic", "malvar"], ("--demosaic", "--engine gpusim")),
        (["--demosaic", "amaze"], ("--demosaic", "amaze")),
        (["--white-balance", "sunny"], ("--white-balance", "sunny", "grey-world")),
        (["--space", "p3", "--ev", "77"], ("--ev", "77")),
        (["--settings", "none.yaml"], ("none.yaml",)),
        (["--white-balance", "patch:0,0,999,9"], ("patch:0,0,999,9", "beyond the frame")),
    ],
)
def test_what_is_wrong_is_refused(tmp_path: Path, raw: Path, given: list, words: tuple):
    out = tmp_path / "a.png"
    assert_refused(gpusim("develop", raw, "--out", out, *given), *words)
    assert not list(tmp_path.iterdir())

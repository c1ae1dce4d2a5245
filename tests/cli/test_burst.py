"""``gpusim burst``: files, exit codes, mistakes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from gpusim.cli.app import app
from gpusim.errors import UserError
from gpusim.scene.exr import units_of

CAMERA = {
    "title": "small",
    "lens": {"mtf": "diffraction-limited"},
    "sensor": {"preset": "imx477", "rows": 48, "cols": 64},
}
FAST = ["--tolerance", "1e-2", "--certify", "8", "--frames", "4", "--seed", "3"]


@pytest.fixture
def camera(tmp_path: Path) -> str:
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump(CAMERA))
    return str(path)


def run(*words: str):
    return CliRunner().invoke(app, ["burst", *words])


def test_a_bracket_is_written_as_arrays_with_its_truth(camera: str, tmp_path: Path):
    out = tmp_path / "out"
    done = run(
        camera, "colorchecker", "--out", str(out), "--exposure", "1/240,1/60", "--truth", *FAST
    )
    assert done.exit_code == 0, done.output
    held = np.load(out / "burst.npz")
    assert held["raw"].shape == held["truth_dn"].shape == (4, 48, 64)
    assert held["exposure_s"] == pytest.approx([1 / 240, 1 / 60] * 2)
    # Means of 3072 pixels: the noise averages out to a fraction of a code.
    assert held["raw"].mean((1, 2)) == pytest.approx(held["truth_dn"].mean((1, 2)), abs=1.0)
    facts = json.loads((out / "burst.json").read_text())
    assert facts["certificate"]["met"] and len(facts["frames"]) == 4
    assert (out / "frames.jpg").stat().st_size > 1000
    assert "met" in done.output and "4 frames of 64 x 48" in done.output


def test_frames_are_written_one_by_one(camera: str, tmp_path: Path):
    out = tmp_path / "out"
    done = run(camera, "colorchecker", "--out", str(out), "--format", "dng", "--truth", "-q", *FAST)
    assert done.exit_code == 0 and done.output == ""
    assert units_of(out / "truth-0003.exr") == "DN"
    assert sorted(path.name for path in out.glob("*.dng")) == [
        f"frame-{number:04d}.dng" for number in range(4)
    ]


@pytest.mark.parametrize(
    "words, field",
    [
        (["--frames", "0"], "--frames"),
        (["--format", "gif"], "--format"),
        (["--exposure", "1/60,x"], "--exposure"),
        (["--iso", "100,fast"], "--iso"),
        (["--iso", "123"], "iso"),
        (["--temperature", "-300"], "temperature_c"),
    ],
)
def test_mistakes_are_told_before_the_work(
    camera: str, tmp_path: Path, words: list[str], field: str
):
    done = run(camera, "colorchecker", "--out", str(tmp_path / "out"), *words)
    assert isinstance(done.exception, UserError) and done.exception.field == field
    assert not (tmp_path / "out").exists()

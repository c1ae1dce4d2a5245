"""``gpusim measure all``: what a picture shows is measured, the rest left out with its reason."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import gpusim


def edge(rows: int = 120, cols: int = 160) -> np.ndarray:
    """Return a dark slanted bar on grey, blurred by a pixel."""
    y, x = np.mgrid[:rows, :cols] + 0.5
    away = np.abs((x - cols / 2) + 0.1 * (y - rows / 2)) - 30
    return (0.1 + 0.4 / (1 + np.exp(-away / 0.5))).astype(np.float32)


def even(rows: int = 120, cols: int = 160) -> np.ndarray:
    """Return a field that falls off towards its corners."""
    y, x = np.mgrid[:rows, :cols]
    away = np.hypot(y - rows / 2, x - cols / 2) / 100
    return (0.5 * (1 - 0.2 * away**2)).astype(np.float32)


@pytest.mark.parametrize(
    ("picture", "shown", "missing"), [(edge(), "sfr", "glare"), (even(), "shading", "colour")]
)
def test_a_picture_is_measured_by_what_it_shows(tmp_path, picture, shown, missing):
    np.save(tmp_path / "picture.npy", picture)
    done = gpusim("measure", "all", tmp_path / "picture.npy", "--out", tmp_path / "out")
    assert done.code == 0, done.err
    facts = json.loads((tmp_path / "out" / "all.json").read_text())
    assert [name for name in facts if name != "left_out"] == [shown]
    page = (tmp_path / "out" / "all.html").read_text()
    assert f'<section id="{shown}">' in page and page.count("<h1>") == page.count("<body>") == 1
    assert f'<section id="{missing}">' not in page
    own = json.loads((tmp_path / "out" / f"{shown}.json").read_text())
    assert facts[shown] == own
    assert str(tmp_path / "out" / "all.html") in done.out.replace("\n", "")
    if shown == "sfr":
        assert set(facts["left_out"]) == {"distortion", "colour", "snr"}


def test_what_is_no_picture_is_told_once(tmp_path):
    (tmp_path / "text.png").write_text("no picture")
    done = gpusim("measure", "all", tmp_path / "text.png", "--out", tmp_path / "out")
    assert done.code == 2 and done.err.count("cannot be read") == 1
    assert not (tmp_path / "out").exists()


def test_nothing_that_can_be_measured_is_exit_code_1(tmp_path):
    np.save(tmp_path / "dark.npy", np.zeros((120, 160), np.float32))
    done = gpusim("measure", "all", tmp_path / "dark.npy", "--out", tmp_path / "out")
    assert done.code == 1
    assert len(json.loads((tmp_path / "out" / "all.json").read_text())["left_out"]) == 6

"""``gpusim measure all``: what a picture shows is measured, the rest left out with its reason."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import assert_refused, gpusim


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


@pytest.mark.slow
def test_a_rendered_chart_of_several_things_is_measured_by_all_of_them(tmp_path):
    """Edges, ColorChecker, density wedge and dots on 640 x 480 pixels."""
    out = tmp_path / "shot"
    taken = gpusim("render", "mtf-only", "demo", "--tolerance", "1e-2", "--out", out)
    assert taken.code == 0, taken.err
    done = gpusim("measure", "all", out / "raw.dng", "--out", tmp_path / "all")
    assert done.code == 0, done.err
    facts = json.loads((tmp_path / "all" / "all.json").read_text())
    # Greys of 19 pixels, a quarter of them a channel's, are too few for a noise.
    assert facts.pop("left_out").keys() == {"snr"}
    assert facts.keys() == {"sfr", "distortion", "colour"}
    assert len({one["edge"] for one in facts["sfr"]["edges"]}) >= 9  # dark squares, of four each
    assert facts["distortion"]["kind"] == "dots"
    # The lens has none: four uncertainties.
    assert all(abs(one["value"]) < 4 * one["u"] for one in facts["distortion"]["lgd_percent"])
    page = (tmp_path / "all" / "all.html").read_text()
    assert all(f'<section id="{name}">' in page for name in facts)


def test_sinusoids_and_dead_leaves_are_measured_where_they_are_named(tmp_path):
    rng, (y, x) = np.random.default_rng(3), np.mgrid[:160, :260] + 0.5
    picture = 0.5 + 0.3 * np.cos(2 * np.pi * 0.2 * x)
    for radius in rng.uniform(2, 12, 3000):
        at = rng.uniform((100, 0), (260, 160))
        picture[(np.hypot(x - at[0], y - at[1]) < radius) & (x > 100)] = rng.uniform(0.1, 0.9)
    np.save(tmp_path / "picture.npy", picture)
    asked = ("measure", "all", tmp_path / "picture.npy", "--out", tmp_path / "out")
    done = gpusim(*asked, "--wave", "4,4,60,80", "--texture", "112,6,144,148")
    assert done.code == 0, done.err
    facts = json.loads((tmp_path / "out" / "all.json").read_text())
    (wave,) = facts["spectra"]["waves"]
    assert wave["frequency_cy_px"]["value"] == pytest.approx(0.2, abs=1e-6)
    assert facts["texture"]["channels"][0]["mtf50"] is not None
    assert {"spectra", "texture"}.isdisjoint(facts["left_out"])
    assert_refused(gpusim(*asked, "--wave", "4,4"), "--wave")


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

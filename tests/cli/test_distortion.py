"""``gpusim measure distortion``: files, lateral colour, refusals."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from command_line import assert_refused, gpusim
from metrics.lattices import SIZE, checks, picture, ratio

K = (0.12,)


@pytest.fixture(scope="module")
def chart(tmp_path_factory):
    """Return an array of a checkerboard in three colours, red magnified by a thousandth."""
    file = tmp_path_factory.mktemp("distortion") / "checks.npy"
    green = picture(checks, K)
    np.save(file, np.stack([picture(checks, K, grow=1.001), green, green], axis=-1))
    return file


def test_distortion_and_lateral_colour_are_measured_and_written(chart):
    out = chart.parent / "out"
    ran = gpusim("measure", "distortion", chart, "--out", out)
    assert ran.code == 0, ran.err
    assert "3rd order" in ran.out and "lateral colour R" in ran.out
    facts = json.loads((out / "distortion.json").read_text())
    for one in facts["lgd_percent"]:
        assert one["value"] == pytest.approx(100 / ratio(one["radius"], K) - 100, abs=0.01)
    red, blue = facts["lateral_colour"]
    assert red["slope_px"] == pytest.approx(np.hypot(*SIZE) / 2 * 1e-3, rel=0.02)
    assert blue["rms_px"] < 1e-4  # where a round moves a corner less, it is the last
    rows = list(csv.reader((out / "distortion.csv").open()))
    assert len(rows) == facts["marks"] + 1
    assert (out / "distortion.png").stat().st_size > 20_000
    assert "Local geometric distortion" in (out / "distortion.html").read_text()


def test_another_centre_is_another_distortion(chart):
    ran = gpusim("measure", "distortion", chart, "--channel", "G", "--centre", "200,150", "--json")
    facts = json.loads(ran.out)
    assert facts["centre_px"] == [200, 150]
    assert facts["lateral_colour"] == []
    assert facts["models"]["3rd order"]["rms_px"] > 0.05


@pytest.mark.parametrize(
    ("options", "words"),
    [(("--centre", "1,2,3"), ("--centre", "1,2,3")), (("--channel", "X"), ("--channel", "X"))],
)
def test_mistakes_are_named(chart, options, words):
    assert_refused(gpusim("measure", "distortion", chart, *options), *words)


def test_a_picture_without_a_lattice_is_refused(tmp_path):
    np.save(tmp_path / "noise.npy", np.random.default_rng(1).normal(size=(90, 90)))
    assert_refused(gpusim("measure", "distortion", tmp_path / "noise.npy"), "no lattice", "rows")

"""``gpusim measure colour``: files, options, refusals."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from command_line import assert_refused, gpusim
from metrics.colour_charts import chart
from metrics.test_colour import SRGB, true_xyz


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """Return a picture of the chart as an sRGB camera sees it, blue 8 % too weak."""
    file = tmp_path_factory.mktemp("colour") / "chart.npy"
    np.save(file, chart(0.8 * true_xyz() @ np.linalg.inv(SRGB).T * (1, 1, 0.92)))
    return file


def test_colours_are_measured_and_written(picture):
    out = picture.parent / "out"
    ran = gpusim("measure", "colour", picture, "--out", out)
    assert ran.code == 0, ran.err
    assert "dark skin" in ran.out and "white point" in ran.out
    facts = json.loads((out / "colour.json").read_text())
    summary = facts["summary"]
    assert summary["as_is"]["mean_delta_e_2000"] > 1 > summary["through_matrix"]["mean_delta_e_76"]
    assert len(list(csv.reader((out / "colour.csv").open()))) == 25
    assert (out / "colour.png").stat().st_size > 20_000
    assert "Differences from the chart" in (out / "colour.html").read_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--corners", "1,2,3"), ("--corners", "eight numbers")),
        (("--illuminant", "D5"), ("D5",)),
        (("--corners", "-9,0,9,0,9,9,0,9"), ("leave the picture",)),
    ],
)
def test_mistakes_are_named(picture, options, words):
    assert_refused(gpusim("measure", "colour", picture, *options), *words)

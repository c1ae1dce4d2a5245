"""``gpusim measure sfr``: edges sought and given, files, refusals."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from command_line import assert_refused, gpusim
from metrics.edges import edge
from PIL import Image


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """Return a PNG of two edges of MTF50 0.2 and 0.3 cycles/px, side by side, and its folder."""
    at = tmp_path_factory.mktemp("sfr")
    second = 1.0 - edge(0.3, 8.0, side=120)  # as bright as the first one where they meet
    light = np.concatenate([edge(0.2, 5.0, side=120), second], axis=1)
    codes = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    Image.fromarray((65535 * codes).round().astype(np.uint16)).save(at / "edges.png")
    return at


def test_edges_are_found_measured_and_written(picture):
    out = picture / "out"
    ran = gpusim("measure", "sfr", picture / "edges.png", "--out", out)
    assert ran.code == 0, ran.err
    assert "MTF50" in ran.out
    facts = json.loads((out / "sfr.json").read_text())
    found = sorted(one["figures"]["mtf50"]["value"] for one in facts["edges"])
    # Codes of 16 bits are 1.5e-5 of the scale; the sRGB curve is undone exactly.
    assert found == pytest.approx([0.2, 0.3], rel=1e-3)
    assert {one["nearer_to"] for one in facts["edges"]} == {"vertical"}
    rows = list(csv.reader((out / "sfr.csv").open()))
    assert rows[0][0] == "cycles_per_px"
    assert float(rows[1][1]) == 1.0
    assert (out / "sfr.png").stat().st_size > 20_000
    assert "<svg" not in (out / "sfr.html").read_text()[:200]
    assert "MTF50" in (out / "sfr.html").read_text()


def test_a_given_region_pitch_and_f_number_give_lp_mm_and_q(picture):
    ran = gpusim(
        "measure", "sfr", picture / "edges.png", "--roi", "20,10,80,100", "--pitch-um", 5,
        "--f-number", 4, "--json",
    )  # fmt: skip
    (one,) = json.loads(ran.out)["edges"]
    assert one["mtf50_lp_mm"] == pytest.approx(40.0, rel=1e-3)
    assert 0 < one["area_ratio"] < 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--roi", "1,2,3"), ("--roi", "1,2,3")),
        (("--roi", "0,0,900,50"), ("roi", "240 x 120")),
        (("--channel", "X"), ("--channel", "X", "Y")),
    ],
)
def test_mistakes_are_named(picture, options, words):
    assert_refused(gpusim("measure", "sfr", picture / "edges.png", *options), *words)


def test_a_picture_without_an_edge_is_refused(tmp_path):
    Image.fromarray(np.full((90, 90), 128, np.uint8)).save(tmp_path / "grey.png")
    assert_refused(gpusim("measure", "sfr", tmp_path / "grey.png"), "No slanted edge", "--roi")

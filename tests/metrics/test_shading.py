"""Shading: blocks of a known fall-off, colours, a filter array, files, refusals."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from command_line import assert_refused, gpusim

from gpusim.errors import UserError
from gpusim.metrics.picture import Plane
from gpusim.metrics.shading import BLOCKS, measure_shading

OPEN = (-np.inf, np.inf)
ROWS, COLS = 15 * 8, 21 * 8


def field(fall=0.3):
    """Return 1 - fall (u^2 + v^2) / 2 + fall (2 u + v) / 10, u and v from -1 to 1 at the sides."""
    v, u = np.mgrid[:ROWS, :COLS] + 0.5
    u, v = 2 * u / COLS - 1, 2 * v / ROWS - 1
    return 0.5 * (1 - fall * (u**2 + v**2) / 2 + fall * (2 * u + v) / 10)


def true_blocks(fall=0.3):
    """Return the same at blocks: the mean of a square over n samples is that of its moments."""
    parts, lines = [], []
    for count, size in zip(BLOCKS, (ROWS, COLS), strict=True):
        step = size // count
        middle = (2 * np.arange(count) + 1) / count - 1
        lines.append(middle)
        parts.append(middle**2 + (step**2 - 1) / 12 * (2 / size) ** 2)
    blocks = 1 - fall * (parts[0][:, None] + parts[1]) / 2
    blocks += fall * (lines[0][:, None] + 2 * lines[1]) / 10
    return blocks / blocks[BLOCKS[0] // 2, BLOCKS[1] // 2]


def test_blocks_are_those_of_the_closed_form():
    found = measure_shading(Plane(field(), None, OPEN), "Y")
    assert found.relative == pytest.approx(true_blocks(), rel=1e-12)
    (a, b), (c, d) = true_blocks()[np.ix_((0, -1), (0, -1))]
    assert found.corners == pytest.approx((a, b, c, d), rel=1e-12)
    assert found.unevenness == pytest.approx(1 - a / true_blocks().max(), rel=1e-12)
    assert not found.clipped


def test_a_blocks_uncertainty_is_its_spread():
    values = 0.5 + 0.02 * np.random.default_rng(2).normal(size=(ROWS, COLS))
    found = measure_shading(Plane(values, None, OPEN), "Y")
    # 314 blocks over one middle that they share: their spread is u / sqrt(2), to 4 %; u itself is
    # known to 9 % from 64 pixels.
    assert found.relative.std() == pytest.approx(found.u / np.sqrt(2), rel=0.3)


def test_a_filter_arrays_photosites_are_measured_where_they_lie():
    values = field(0.0)
    rows, cols = np.indices(values.shape)
    values[(rows % 2 != 0) | (cols % 2 != 1)] = -5.0  # other filters: none of it may be seen
    sites = np.array([[False, True], [False, False]])
    found = measure_shading(Plane(values, sites, (0.0, 1.0)), "R")
    assert found.relative == pytest.approx(np.ones(BLOCKS), rel=1e-12)
    assert found.u < 1e-6
    assert not found.clipped


def test_small_and_dark_pictures_are_refused():
    with pytest.raises(UserError, match="too small"):
        measure_shading(Plane(np.ones((50, 50)), None, OPEN), "Y")
    with pytest.raises(UserError, match="dark"):
        measure_shading(Plane(np.zeros((ROWS, COLS)), None, OPEN), "Y")


def test_the_command_writes_its_files(tmp_path):
    picture = np.stack([field(0.4), field(0.3), field(0.3)], axis=-1)
    np.save(tmp_path / "flat.npy", picture)
    out = tmp_path / "out"
    ran = gpusim("measure", "shading", tmp_path / "flat.npy", "--out", out)
    assert ran.code == 0, ran.err
    assert "R/G" in ran.out
    facts = json.loads((out / "shading.json").read_text())
    red, blue = facts["colour_shading"]
    lowest = (true_blocks(0.4) / true_blocks(0.3)).min()
    assert red["lowest_percent"] == pytest.approx(100 * lowest - 100, abs=1e-9)
    assert blue["lowest_percent"] == pytest.approx(0, abs=1e-9)
    assert len(list(csv.reader((out / "shading.csv").open()))) == 15 * 21 + 1
    assert (out / "shading.png").stat().st_size > 20_000
    assert "Colour shading" in (out / "shading.html").read_text()
    assert_refused(gpusim("measure", "shading", tmp_path / "none.npy"), "cannot be read")

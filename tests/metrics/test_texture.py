"""Texture MTF: dead leaves drawn by hand, of a known MTF; noise; a filter array; refusals."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import assert_refused, gpusim
from scipy.ndimage import gaussian_filter

from gpusim.cli.texture import CHART
from gpusim.errors import UserError
from gpusim.metrics.picture import Plane
from gpusim.metrics.texture import covariance, measure_texture

OPEN = (-np.inf, np.inf)
SIDE, OVER, RADII, SIGMA = 384, 3, (3.0, 30.0), 0.8
BOX = (0, 0, SIDE, SIDE)
NOISE = 20.0


@cache
def leaves() -> np.ndarray:
    """Return discs of random grey, the front ones first, until all is covered; OVER times finer."""
    rng = np.random.default_rng(11)
    size = SIDE * OVER
    low, high = (radius * OVER for radius in RADII)
    out, left = np.full((size, size), np.nan), size**2
    while left:
        # A density of r^-3: its integral turned around.
        radius = (low**-2 - rng.random() * (low**-2 - high**-2)) ** -0.5
        x, y = rng.uniform(-high, size + high, 2)
        rows, cols = (
            slice(max(int(at - radius), 0), min(int(at + radius) + 2, size)) for at in (y, x)
        )
        if rows.start >= rows.stop or cols.start >= cols.stop:
            continue
        part = out[rows, cols]
        down, across = np.mgrid[rows, cols]
        seen = np.isnan(part) & ((across - x) ** 2 + (down - y) ** 2 < radius**2)
        part[seen] = rng.random()
        left -= np.count_nonzero(seen)
    return out


@cache
def picture() -> np.ndarray:
    """Return them blurred and seen by square pixels: 1000 DN at most."""
    blurred = gaussian_filter(leaves(), SIGMA * OVER)
    return 1000 * blurred.reshape(SIDE, OVER, SIDE, OVER).mean(axis=(1, 3))


def true(frequency: np.ndarray) -> np.ndarray:
    """Return the MTF of blur and pixel, this one's mean over directions."""
    turn = np.linspace(0, np.pi / 2, 60)[:, None]
    pixel = np.sinc(frequency * np.cos(turn)) * np.sinc(frequency * np.sin(turn))
    return np.exp(-2 * (np.pi * SIGMA * frequency) ** 2) * np.sqrt(np.mean(pixel**2, axis=0))


def plane(seed: int | None = None) -> Plane:
    noise = 0 if seed is None else np.random.default_rng(seed).normal(0, NOISE, (SIDE, SIDE))
    return Plane(picture() + noise, None, OPEN)


def far(found, least: float = 0.03) -> np.ndarray:
    """Return by how many uncertainties the MTF is off, to 0.4 cycles/pixel."""
    at = (found.frequency > least) & (found.frequency < 0.4)
    return (found.mtf[at] - true(found.frequency[at])) / found.u[at]


def test_the_covariance_is_that_of_the_leaves_drawn():
    grey = leaves() - leaves().mean()
    for apart_px in (1, 3, 8, 20):
        shift = apart_px * OVER
        both = [grey[:, shift:] * grey[:, :-shift], grey[shift:] * grey[:-shift]]
        found = np.mean([one.mean() for one in both]) / grey.var()
        # The largest leaves are some fifty to a picture: what is seen of it varies as much.
        assert covariance(np.array([float(apart_px)]), RADII)[0] == pytest.approx(found, abs=0.05)
    assert covariance(np.array([0.0, 60.0, 500.0]), RADII).tolist() == [1.0, 0.0, 0.0]


def test_the_mtf_is_that_of_blur_and_pixel():
    found = measure_texture(plane(), "Y", BOX, RADII)
    # Two uncertainties in the mean of bins that share one scale, four at worst.
    assert np.mean(far(found) ** 2) < 2**2 and np.abs(far(found)).max() < 4
    at = (found.frequency > 0.1) & (found.frequency < 0.4)
    assert np.abs(found.mtf[at] - true(found.frequency[at])).max() < 0.08  # u: 0.053
    # There u is 0.04, and the MTF falls by 3 a cycle/pixel: 0.013 of 0.22 cycles/pixel.
    fine = np.linspace(0, 0.5, 2001)
    assert found.mtf50 == pytest.approx(np.interp(-0.5, -true(fine), fine), rel=0.06)
    # Other leaves than those of the picture are seen to be others.
    wrong = measure_texture(plane(), "Y", BOX, (0.8, 30.0))
    assert np.abs(far(wrong)).max() > 6


def test_a_second_picture_or_an_even_patch_takes_the_noise_off():
    clean = measure_texture(plane(), "Y", BOX, RADII)
    noisy = measure_texture(plane(1), "Y", BOX, RADII)
    at = (clean.frequency > 0.1) & (clean.frequency < 0.4)
    assert (noisy.mtf - clean.mtf)[at][-1] > 0.1 and noisy.noise == "not taken off"
    # Noise of 400 beside a signal of 63 at 0.4 cycles/pixel, where its MTF is 0.1: 1e-2 is left of
    # it in the mean of a ring and nine tiles, four times as much at worst; with a patch's own more.
    by_second = measure_texture(plane(1), "Y", BOX, RADII, second=plane(2))
    assert np.abs(by_second.mtf - clean.mtf)[at].max() < 0.04
    grain = np.random.default_rng(3).normal(500, NOISE, (SIDE, SIDE))
    beside = Plane(np.hstack([plane(1).values, grain]), None, OPEN)
    by_patch = measure_texture(beside, "Y", BOX, RADII, even=(SIDE, 0, SIDE, SIDE))
    # What is left at high frequencies is the difference of two powers.
    assert np.abs(by_patch.mtf - clean.mtf)[at].max() < 0.06
    assert (by_second.noise, by_patch.noise) == ("by the second picture", "by an even patch")


@pytest.mark.parametrize("corner", [(0, 0), (1, 0), (0, 1), (1, 1)])
def test_a_filter_array_is_read_a_site_of_each_period(corner: tuple[int, int]):
    """Wherever the region begins: at every second photosite the frequencies go half as far."""
    sites = np.array([[False, True], [False, False]])
    values = np.where(np.tile(sites, (SIDE // 2, SIDE // 2)), picture(), 1e6)
    x, y = corner
    found = measure_texture(Plane(values, sites, OPEN), "G", (x, y, SIDE - 2, SIDE - 2), RADII)
    assert found.frequency[-1] < 0.25
    at = (found.frequency > 0.05) & (found.frequency < 0.15)
    assert (
        np.abs(found.mtf[at] - true(found.frequency[at])).max() < 0.12
    )  # u: 0.05, of all bins as one


def test_leaves_that_are_not_named_are_those_of_the_chart():
    chart = yaml.safe_load(Path("gpusim/data/charts/dead-leaves.yaml").read_text())
    assert list(CHART) == chart["pattern"]["radii"]


def test_what_cannot_be_measured_is_refused():
    for given, field in (
        ({"box": (10, 0, SIDE, SIDE)}, "--roi"),
        ({"box": (0, 0, 60, 200)}, "--roi"),
        ({"radii_px": (5.0, 5.0)}, "--leaves"),
        ({"radii_px": (np.nan, 5.0)}, "--leaves"),
        ({"radii_px": (1.0, np.inf)}, "--leaves"),
        ({"even": (0, 0, 20, 20)}, "--noise"),
    ):
        whole = {"plane": plane(), "channel": "Y", "box": BOX, "radii_px": RADII} | given
        with pytest.raises(UserError) as caught:
            measure_texture(**whole)
        assert caught.value.field == field
    flat = Plane(np.random.default_rng(1).normal(500, 5, (SIDE, SIDE)), None, OPEN)
    other = Plane(np.random.default_rng(2).normal(500, 5, (SIDE, SIDE)), None, OPEN)
    with pytest.raises(UserError, match="no texture"):
        measure_texture(flat, "Y", BOX, RADII, second=other)


def test_the_command_writes_its_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("one.npy", plane(1).values)
    np.save("two.npy", plane(2).values)
    ran = gpusim(
        "measure", "texture", "one.npy", "--second", "two.npy", "--leaves", "3,30",
        "--roi", "0,0,384,384", "--out", "texture",
    )  # fmt: skip
    assert ran.code == 0, ran
    facts = json.loads((tmp_path / "texture/texture.json").read_text())
    assert 0.2 < facts["channels"][0]["mtf50"] < 0.25 and facts["leaves_px"] == [3.0, 30.0]
    assert {one.suffix for one in (tmp_path / "texture").iterdir()} == {
        ".json", ".csv", ".html", ".png",
    }  # fmt: skip
    np.save("small.npy", np.ones((100, 100)))
    for given, word in (
        (("--second", "small.npy"), "--second"),
        (("--second", "two.npy", "--noise", "0,0,99,99"), "--noise"),
        (("--leaves", "4"), "--leaves"),
    ):
        assert_refused(gpusim("measure", "texture", "one.npy", *given), word)

"""How large charts stand in the scene: against magnification and angles, to the rendered frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.camera import load_camera
from gpusim.errors import UserError
from gpusim.lens.projection import ANGULAR
from gpusim.lens.system import conjugates
from gpusim.scene.chart_file import read_chart
from gpusim.scene.framing import Height
from gpusim.scene.make import make_scene
from gpusim.scene.patterns import Frame

SQUARE = """
title: a square
unit: mm
fills: {paper: 0.9}
background: 0.05
shapes: [{shape: rectangle, size: [60, 40], fill: paper}]
"""
FAR = Frame(400, 1.5, 1000.0, principal_mm=8.0)


@pytest.fixture
def near():
    return load_camera("demo", {"object_distance_m": 0.6})


def test_a_size_at_a_distance_is_magnified_as_the_lens_does(near):
    half = Height(100.0, "mm").half_heights(near.frame) * near.frame.half_height_um
    # The pupil's distance to the object times the angle is the object; 8 digits of both.
    assert half == pytest.approx(1e3 * abs(conjugates(near.lens).magnification) * 50, rel=1e-8)


def test_an_angle_lies_at_the_principal_distance_times_its_tangent():
    assert Height(40.0, "deg").half_heights(FAR) == pytest.approx(8 * math.tan(math.radians(20)))
    by_angle = Height(200.0, "deg").half_heights(FAR, ANGULAR)
    assert by_angle == pytest.approx(8 * math.radians(100))


def test_a_chart_in_mm_stands_as_large_as_it_is(near, tmp_path):
    path = tmp_path / "square.yaml"
    path.write_text(SQUARE)
    (square,) = read_chart(path, near.frame).source.primitives
    scale = 1e3 * abs(conjugates(near.lens).magnification) / near.frame.half_height_um
    assert square.half_h == pytest.approx(20 * scale, rel=1e-8)
    assert square.half_w == pytest.approx(30 * scale, rel=1e-8)
    # What fills the height, if the file says it, is as large as one says in its place.
    path.write_text(SQUARE + "height: 80\n")
    (half,) = read_chart(path, near.frame).source.primitives
    assert half.half_h == pytest.approx(0.5)
    (again,) = read_chart(path, near.frame, Height(80.0, "mm")).source.primitives
    assert again.half_h == pytest.approx(square.half_h, rel=1e-8)


def test_a_rendered_chart_spans_its_angle(tmp_path):
    camera = gs.Camera.load("mtf-only")
    path = tmp_path / "square.yaml"
    path.write_text(SQUARE + "height: 40\n")
    scene = make_scene(path, frame=camera.frame, chart_height="2deg")
    light = gs.expose(camera, scene, 1e-2, probes=0, tile=(240, 140, 160, 200))
    rows = light.rates.mean(axis=(0, 2))
    level = (rows - rows.min()) / np.ptp(rows)
    # Two rows of photosites to a row of the pattern; symmetric edges: the sum is the width.
    high = 2 * level.sum()
    expected = 2e3 * camera.frame.principal_mm * math.tan(math.radians(1)) / 1.55
    assert high == pytest.approx(expected, abs=0.02 * expected)


@pytest.mark.parametrize("text", ["", "850", "850 cm", "-3mm", "0deg", "360deg", "1e3mm", "nanmm"])
def test_what_is_no_height_is_refused(text):
    with pytest.raises(UserError, match="height"):
        Height.parse(text)


@pytest.mark.parametrize(
    ("scene", "frame", "height", "word"),
    [
        ("grey", None, "40deg", "camera"),
        ("colorchecker", FAR, "850mm", "angle"),
        ("colorchecker", FAR, "175deg", "170"),
        ("sinusoid", FAR, "40deg", "unit"),
        ("picture.png", FAR, "40deg", "chart"),
    ],
)
def test_heights_that_mean_nothing_are_refused(scene, frame, height, word):
    with pytest.raises(UserError) as caught:
        make_scene(scene, frame=frame, chart_height=height, transfer=None)
    assert word in caught.value.allowed


def test_a_size_needs_an_object_and_a_flat_chart(near):
    with pytest.raises(UserError, match="height"):
        Height(80.0, "mm").half_heights(near.frame, ANGULAR)
    with pytest.raises(UserError, match="height"):
        Height(80.0, "mm").half_heights(replace(near.frame, object_mm=None))

"""Charts from YAML: what shapes become, how lengths scale, how fills look, what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from harness import assert_close

from gpusim.errors import UserError
from gpusim.scene import Disc, Polygon, Rect, make_scene
from gpusim.scene.chart_file import read_chart
from gpusim.scene.patterns import Frame, spline_response
from gpusim.scene.preview import chart_rgb
from gpusim.scene.spectra import WAVELENGTHS_NM, colorchecker, luminance_cd_m2


@pytest.fixture
def written(tmp_path: Path):
    """Return a function that writes a chart of a text's shapes and returns its file."""

    def write(text: str, head: str = "title: t\nbackground: 0.5\n") -> Path:
        file = tmp_path / "chart.yaml"
        file.write_text(head + text)
        return file

    return write


def area(shape: Rect | Disc | Polygon) -> float:
    if isinstance(shape, Disc):
        return math.pi * shape.radius**2
    x, y = shape.corners().T
    return abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2


SHAPES = {
    "{shape: rectangle, at: [0.1, 0], size: [0.4, 0.2], angle_deg: 30, fill: 0.1}": (1, 0.08),
    "{shape: disc, at: [0.1, 0], diameter: 0.4, fill: 0.1}": (1, math.pi * 0.04),
    "{shape: polygon, corners: [[0, 0], [1, 0], [0, 1]], fill: 0.1}": (1, 0.5),
    "{shape: polygon, corners: [[0, 0], [0, 1], [1, 0]], fill: 0.1}": (1, 0.5),
    # An arrow that is not convex: a triangle less a smaller one.
    "{shape: polygon, corners: [[0, 0], [1, 1], [0, 0.5], [-1, 1]], fill: 0.1}": (2, 0.5),
    "{shape: edge, size: [0.4, 0.2], angle_deg: 5, fills: [0.1, 0.2]}": (2, 0.08),
    "{shape: edge, size: [0.4, 0.2], angle_deg: -85, fills: [0.1, 0.2]}": (2, 0.08),
    "{shape: grating, size: [1, 0.5], period: 0.2, angle_deg: 20, fill: 0.1}": (5, 5 * 0.1 * 0.5),
    "{shape: checkerboard, squares: [5, 3], side: 0.1, angle_deg: 7, fill: 0.1}": (8, 0.08),
    "{shape: patches, pitch: 0.2, patch: 0.1, rows: [[0.1, red], [0.2, 0.3]]}": (4, 0.04),
    # The carrier reaches half a gap beyond the pitch: 0.5 square.
    "{shape: patches, pitch: 0.2, patch: 0.1, carrier: 0.05, rows: [[0.1, red], [0.2, 0.3]]}": (
        5,
        0.04 + 0.5**2,
    ),
    "{shape: grid, pitch: [0.2, 0.3], count: [4, 3], of: {shape: disc, diameter: 0.1, fill: 0}}": (
        12,
        12 * math.pi * 0.05**2,
    ),
}


@pytest.mark.parametrize(("text", "expected"), SHAPES.items())
def test_shapes_become_primitives_of_the_right_area(written, text, expected):
    chart = read_chart(written(f"shapes:\n- {text}\n")).source
    assert len(chart.primitives) == expected[0]
    assert sum(map(area, chart.primitives)) == pytest.approx(expected[1], rel=1e-9)


def test_a_star_has_half_of_its_ring(written):
    star = "{shape: star, sectors: 36, diameter: 1.8, inner_diameter: 0.2, fill: 0.1}"
    chart = read_chart(written(f"shapes: [{star}]\n")).source
    ring = math.pi * (0.9**2 - 0.1**2)
    # Chords of 1.7 degrees on the rim and of 5 at the inner end: 1.4e-4 and 1.3e-3 x 1/81 less.
    assert sum(map(area, chart.primitives)) == pytest.approx(ring / 2, rel=2e-4)
    turn = np.radians(2.5 + 5 * np.arange(72))
    found = chart.material_at(0.5 * np.cos(turn), 0.5 * np.sin(turn))
    assert (found == np.tile([1, 0], 36)).all()  # dark sectors and bright ones in turn


def test_an_edge_is_where_it_should_be(written):
    edge = "{shape: edge, at: [0.3, -0.1], size: [0.4, 0.4], angle_deg: 10, fills: [0.1, 0.9]}"
    laid = read_chart(written(f"shapes: [{edge}]\n"))
    t = np.linspace(-0.15, 0.15, 7)
    normal = np.array([math.cos(math.radians(10)), math.sin(math.radians(10))])
    for side, value in ((-1e-6, 0.1), (1e-6, 0.9)):
        x = 0.3 - t * normal[1] + side * normal[0]
        y = -0.1 + t * normal[0] + side * normal[1]
        fills = laid.source.material_at(x, y)
        assert [laid.fills[one].value for one in fills] == [value] * 7


def test_a_grid_leaves_out_what_comes_too_near(written):
    text = (
        "shapes:\n- {shape: rectangle, size: [0.3, 0.3], fill: 0.1}\n"
        "- {shape: grid, pitch: [0.2, 0.2], count: [5, 5], clear: 0.04,\n"
        "   of: {shape: disc, diameter: 0.1, fill: 0.1}}\n"
    )
    discs = [p for p in read_chart(written(text)).source.primitives if isinstance(p, Disc)]
    # Those at 0.2 stay 0.2 - 0.15 - 0.05 = 0 clear of the square; those at its corners 0.02.
    assert len(discs) == 25 - 9
    assert read_chart(written(text)).source.gap >= 0.04


def test_lengths_have_units(written):
    text = "shapes: [{shape: disc, at: [30, -20], diameter: 10, fill: 0.1}]\n"
    head = "title: t\nbackground: 0.5\nunit: mm\nheight: 200\n"
    disc = read_chart(written(text, head)).source.primitives[0]
    assert_close(np.array([disc.cx, disc.cy, disc.radius]), np.array([0.3, -0.2, 0.05]), atol=1e-12)
    head = "title: t\nbackground: 0.5\nunit: pixels\n"
    disc = read_chart(written(text, head), Frame(480, 4 / 3)).source.primitives[0]
    assert disc.cx == pytest.approx(30 / 240)
    head += "height: 960\n"  # the chart's own, whatever the sensor's
    disc = read_chart(written(text, head), Frame(480, 4 / 3)).source.primitives[0]
    assert disc.cx == pytest.approx(30 / 480)


def test_fills_are_reflectances_lamps_and_patches(written, tmp_path):
    (tmp_path / "leaf.csv").write_text("nm, reflectance\n400, 0.1  # blue\n700, 0.4\n")
    disc = "- {{shape: disc, at: [{x}, 0], diameter: 0.1, fill: {fill}}}\n"
    fills = ("{density: 1}", "lamp", "dark skin", "{patch: red}", "{spectrum: leaf.csv}")
    text = "fills: {lamp: {luminance_cd_m2: 3000}}\nshapes:\n"
    text += "".join(disc.format(x=0.2 * k, fill=fill) for k, fill in enumerate(fills))
    file = written(text)
    scene = make_scene(file, luminance_cd_m2=100.0, illuminant="A")
    found = scene.spectra / scene.white
    expected = [
        np.full(61, 0.5),
        np.full(61, 0.1),
        np.full(61, 30.0),
        colorchecker()["dark skin"],
        colorchecker()["red"],
        np.interp(WAVELENGTHS_NM, [400, 700], [0.1, 0.4]),
    ]
    assert_close(found, np.stack(expected), rtol=1e-12)
    assert luminance_cd_m2(scene.spectra[2]) == pytest.approx(3000)
    assert any(known[1:] == (400.0, 700.0) for known in scene.known)


WRONG = {
    "shapes: [{shape: dics, diameter: 1, fill: 0.1}]": ("shapes.1.shape", "perhaps disc"),
    "shapes: [{shape: disc, diamter: 1, fill: 0.1}]": ("shapes.1.diamter", "perhaps diameter"),
    "shapes: [{shape: disc, diameter: -1, fill: 0.1}]": ("shapes.1.diameter", "greater than 0"),
    "shapes: [{shape: disc, diameter: 1, fill: 3}]": ("shapes.1.fill", "0 to 2"),
    "shapes: [{shape: disc, diameter: 1, fill: blau}]": ("shapes.1.fill", "perhaps blue"),
    "shapes: [{shape: disc, diameter: 1, fill: {densty: 1}}]": ("shapes.1.fill", "density"),
    "shapes: [{shape: disc, diameter: .nan, fill: 0.1}]": ("shapes.1.diameter", "finite"),
    "shapes: [3]": ("shapes.1", "dictionary"),
    "shapes: []\npattern: {pattern: sinusoid}": ("shapes, pattern", "one of them"),
    "unit: mm\nshapes: []": ("height", "mm, above 0"),
    "pattern: {pattern: sinus, period: 1, fills: [0, 1]}": ("pattern.pattern", "perhaps sinusoid"),
    "pattern: {pattern: sinusoid, period: 1e-4, fills: [0, 1]}": ("pattern", "samples"),
    "height: 1e6\npattern: {pattern: sinusoid, period: 1e-320, fills: [0, 1]}": (
        "pattern",
        "samples",
    ),
    "pattern: {pattern: sinusoid, fills: [0, 1]}": ("pattern.period", "period"),
    "shapes: [{shape: grid, pitch: [1, 1], count: [2, 2], of: {shape: disc}}]": (
        "shapes.1.of.diameter, fill",
        "diameter, fill",
    ),
    "shapes: [{shape: checkerboard, squares: [999, 999], side: 1, fill: 0}]": ("shapes.1", "6,000"),
    "shapes: [{shape: polygon, corners: [[0, 0], [1, 1], [1, 0], [0, 1]], fill: 0}]": (
        "shapes.1",
        "crosses itself",
    ),
    "shapes:\n- {shape: disc, diameter: 1, fill: 0}\n"
    "- {shape: disc, at: [1, 0], diameter: 2, fill: 1}": (
        "shapes",
        "primitives 0 and 1 cross",
    ),
}


@pytest.mark.parametrize(("text", "told"), WRONG.items(), ids=range(len(WRONG)))
def test_mistakes_name_file_field_and_what_is_allowed(written, text, told):
    file = written(text)
    with pytest.raises(UserError) as caught:
        read_chart(file)
    assert caught.value.file == file
    assert caught.value.field == told[0]
    assert told[1] in str(caught.value)


def pattern(written, text: str, **frame) -> np.ndarray:
    """Return a pattern from 0 to 1, on one sample a pixel unless it says otherwise."""
    file = written(f"pattern: {{{text}}}\n", "title: t\nunit: pixels\nbackground: 0.5\n")
    drawn = make_scene(file, frame=Frame(**{"rows": 64, "aspect": 1.5} | frame)).source
    assert len(drawn.planes) == 1  # greys are one spectrum
    return drawn.planes[0]


def test_a_wave_has_its_period_direction_and_phase(written):
    plane = pattern(
        written,
        "pattern: sinusoid, period: 8, angle_deg: 30, phase_deg: 90, samples: 64, fills: [0, 1]",
    )
    rows, cols = plane.shape
    assert rows == 68 and cols == 102  # 6 % more than the sensor, in whole samples about the middle
    y, x = np.mgrid[:rows, :cols] + 0.5 - np.array([rows, cols])[:, None, None] / 2
    along = x * math.cos(math.pi / 6) + y * math.sin(math.pi / 6)
    kept = spline_response(math.cos(math.pi / 6) / 8) * spline_response(math.sin(math.pi / 6) / 8)
    expected = 0.5 - 0.5 * np.sin(2 * np.pi * along / 8) / kept
    assert_close(plane, expected, atol=1e-6)  # float32


def test_a_pattern_covers_more_than_the_sensor_at_its_scale(written):
    file = written(
        "pattern: {pattern: sinusoid, period: 8, fills: [0, 1]}\n",
        "title: t\nunit: pixels\nbackground: 0.5\n",
    )
    scene = make_scene(file, frame=Frame(64, 1.5, 64 * 2.0 / 2))
    placed = scene.source.placed(96.0, 64.0, 0.0)
    assert placed.pitch_um == pytest.approx(1.0)  # two samples to a pixel of 2 um
    assert "2 to a pixel" in scene.notes[0]
    # The wave has 16 samples a period: its first image lies at 15/16 cycle a sample.
    assert "an image of 2e-05 of its amplitude, 1.88 cycles a pixel" in scene.notes[0]


@pytest.mark.parametrize("cycles", [0.05, 0.125, 0.25, 0.33])
def test_the_spline_keeps_what_waves_are_divided_by(cycles: float):
    from scipy.interpolate import make_interp_spline

    at = np.arange(-60, 61)
    spline = make_interp_spline(at, np.cos(2 * np.pi * cycles * at), k=3)
    fine = np.linspace(-20, 20, 40 * 64, endpoint=False)  # whole periods but for 0.33's third
    wave = np.cos(2 * np.pi * cycles * fine)
    kept = np.sum(spline(fine) * wave) / np.sum(wave**2)
    assert kept == pytest.approx(spline_response(cycles), abs=3e-3)


def test_a_sweep_and_a_zone_plate_have_their_frequencies(written):
    sweep = pattern(written, "pattern: sweep, periods: [32, 4], width: 96, fills: [0, 1]", rows=512)
    # Rising through the middle: half a cycle's length is half the local period there.
    line = sweep[len(sweep) // 2] - 0.5
    place = (np.arange(line.size) + 0.5 - line.size / 2) / 2
    zero = place[:-1][np.diff(np.sign(line)) != 0]
    for at in (-40.0, 0.0, 40.0):
        k = np.searchsorted(zero, at)
        local = 2 * (zero[k] - zero[k - 1])
        expected = 32 * (4 / 32) ** ((zero[k] + zero[k - 1]) / 2 / 96 + 0.5)
        # Zeros are found to a sample, half a pixel, and the period changes on the way.
        assert local == pytest.approx(expected, abs=1.5)
    rings = pattern(written, "pattern: zone-plate, radius: 200, period: 8, fills: [0, 1]", rows=512)
    line = rings[len(rings) // 2, rings.shape[1] // 2 :]
    radius = (np.arange(line.size) + 0.5) / 2
    inside = radius < 180
    # Two samples to a pixel, of a wave of radius / 1600 cycles in one.
    wave = np.cos(np.pi * (radius**2 + 0.0625) / 1600) / spline_response(radius / 3200)
    expected = 0.5 + 0.5 * wave
    assert_close(line[inside], expected[inside], atol=1e-5)
    assert_close(line[radius > 200], np.full((radius > 200).sum(), 0.5), atol=1e-6)


def test_a_sinusoidal_star_has_its_cycles(written):
    star = pattern(
        written,
        "pattern: sine-star, cycles: 12, diameter: 56, inner_diameter: 16, fills: [0, 1]",
        rows=256,
    )
    from scipy.ndimage import map_coordinates

    turn = 2 * np.pi * np.arange(512) / 512
    middle = np.array(star.shape) / 2 - 0.5
    ring = map_coordinates(
        star, [middle[0] + 40 * np.sin(turn), middle[1] + 40 * np.cos(turn)], order=3
    )
    spectrum = np.abs(np.fft.rfft(ring)) / 256
    assert spectrum[12] == pytest.approx(0.5, abs=5e-3)
    assert np.delete(spectrum, [0, 12]).max() < 5e-3


def test_dead_leaves_are_the_same_each_time_and_of_all_greys(written):
    text = "pattern: dead-leaves, radii: [2, 40], seed: {}, fills: [0.1, 0.9]"
    first, again, other = (pattern(written, text.format(seed), rows=256) for seed in (1, 1, 2))
    assert_close(first, again, atol=0)
    assert np.abs(first - other).mean() > 0.1
    assert 0.1 <= first.min() < 0.12 and 0.88 < first.max() <= 0.9
    # Uniform greys: mean 0.5, deviation 0.8 / sqrt(12) = 0.23, of some hundred large leaves.
    assert first.mean() == pytest.approx(0.5, abs=0.1)
    assert first.std() == pytest.approx(0.23, abs=0.05)
    # Edges are drawn through a sample: most samples have a leaf's own grey, so that medians differ
    # from neighbours' only at edges.
    assert np.mean(np.abs(np.diff(first, axis=1)) < 1e-6) > 0.7


def test_points_are_held_as_highlights(written):
    text = "pattern: points, count: [3, 2], pitch: [20, 20], fills: [0.001, {luminance_cd_m2: 3e8}]"
    plane = pattern(written, text)
    y, x = np.nonzero(plane > 1)
    assert len(y) == 6
    at = (np.stack([x, y], axis=1) + 0.5 - np.array(plane.shape[::-1]) / 2) / 2
    expected = np.array([(c, r) for r in (-10, 10) for c in (-20, 0, 20)])
    assert np.abs(at - expected).max() <= 0.25 + 1e-9  # half a sample
    assert plane.max() / plane.min() == pytest.approx(1e9, rel=1e-6)
    file = written(f"pattern: {{{text}}}\n", "title: t\nunit: pixels\nbackground: 0.5\n")
    assert len(make_scene(file).source.split.rows) == 6


def test_a_drawn_chart_can_be_looked_at():
    rgb = chart_rgb(make_scene("sine-star"), 152)
    assert rgb.shape == (152, 203, 3)
    # Means of whole waves: midway between 5 and 80 %.
    assert rgb[:, :, 1].mean() == pytest.approx(0.425, abs=0.01)
    assert rgb[76, 101, 1] == pytest.approx(0.425, abs=1e-3)  # the open middle

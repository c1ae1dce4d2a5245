"""What each chart of the project holds and where."""

import math

import numpy as np
import pytest
from harness import assert_close

from gpusim.scene import Chart, Disc, Rect, make_scene
from gpusim.scene.charts import CHARTS, HALF_WIDTH, load_chart
from gpusim.scene.spectra import (
    WAVELENGTHS_NM,
    colorchecker,
    illuminant,
    luminance_cd_m2,
    patch_reflectance,
)

PIXEL = 2 / 1520  # in half-heights, on the demonstration sensor
DRAWN = ("dead-leaves", "points", "sine-star", "sinusoid", "sweep", "zone-plate")
OUTLINED = [name for name in CHARTS if name not in DRAWN]
HALF_DIAGONAL = math.hypot(HALF_WIDTH, 1)


def laid(name: str) -> tuple[Chart, np.ndarray]:
    """Return a chart and the reflectances (M, 61) of its materials."""
    found = load_chart(name)
    return found.source, found.reflectances(WAVELENGTHS_NM)


def squares(chart) -> list[Rect]:
    return [p for p in chart.primitives if isinstance(p, Rect) and p.angle_rad != 0]


@pytest.mark.parametrize(
    "name", ["demo", "colorchecker", "colorchecker-sg", "slanted-edge", "dots", "grey"]
)
def test_outlines_are_at_least_four_pixels_apart(name):
    assert laid(name)[0].gap >= 4 * PIXEL


def test_the_sg_has_its_ten_rows_of_fourteen():
    chart, reflectances = laid("colorchecker-sg")
    patches = [p for p in chart.primitives if chart.materials[p.material].startswith("SG ")]
    places = [(p.cy, p.cx) for p in patches]
    assert places == sorted(places)
    names = [chart.materials[p.material] for p in patches]
    assert names == [f"SG {col}{row}" for row in range(1, 11) for col in "ABCDEFGHIJKLMN"]
    for p, name in zip(patches, names, strict=True):
        assert_close(reflectances[p.material], patch_reflectance(name), atol=0)


@pytest.mark.parametrize("name", OUTLINED)
def test_every_material_is_used_and_is_a_reflectance(name):
    chart, reflectances = laid(name)
    assert reflectances.shape == (len(chart.materials), 61)
    assert {chart.background, *(p.material for p in chart.primitives)} == set(
        range(len(chart.materials))
    )
    assert reflectances.min() > 0
    assert reflectances.max() <= 1


@pytest.mark.parametrize("name", ["demo", "colorchecker"])
def test_the_24_patches_lie_in_reading_order_six_to_a_row(name):
    chart, reflectances = laid(name)
    patches = [p for p in chart.primitives if chart.materials[p.material] in colorchecker()]
    assert [chart.materials[p.material] for p in patches] == list(colorchecker())
    for p, reflectance in zip(patches, colorchecker().values(), strict=True):
        assert chart.material_at(p.cx, p.cy) == p.material
        assert_close(reflectances[p.material], reflectance.copy(), atol=0)
    x = np.array([p.cx for p in patches]).reshape(4, 6)
    y = np.array([p.cy for p in patches]).reshape(4, 6)
    assert (np.diff(x, axis=1) > 0).all()
    assert (np.diff(y, axis=0) > 0).all()
    assert np.ptp(x, axis=0).max() < 1e-12  # equal but for rounding of numbers below 2
    assert np.ptp(y, axis=1).max() < 1e-12


@pytest.mark.parametrize(("name", "contrast"), [("demo", 4.0), ("slanted-edge", 16.0)])
def test_slanted_edges_are_on_axis_at_half_field_and_in_the_corners(name, contrast):
    chart, reflectances = laid(name)
    fields = []
    for square in squares(chart):
        assert square.angle_rad == pytest.approx(math.radians(5), rel=1e-12)
        assert square.half_w == square.half_h >= 50 * PIXEL  # edges 100 pixels long
        bright, dark = reflectances[chart.background], reflectances[square.material]
        # Flat spectra, quotients of numbers that decimals give exactly to a rounding.
        assert_close(bright / dark, np.full(61, contrast), rtol=1e-15)
        around = square.corners() * 1.0
        # 40 pixels of background inside the frame on all sides, for the region of interest.
        assert np.abs(around[:, 0]).max() <= HALF_WIDTH - 40 * PIXEL
        assert np.abs(around[:, 1]).max() <= 1 - 40 * PIXEL
        fields.append(math.hypot(square.cx, square.cy) / HALF_DIAGONAL)
    fields.sort()
    assert fields[0] == 0
    assert fields[1:5] == pytest.approx([0.5] * 4)
    assert min(fields[5:]) > 0.85
    assert len(fields) == 9


def test_the_wedge_falls_by_half_stops_from_left_to_right():
    chart, reflectances = laid("demo")
    row = [p for p in chart.primitives if isinstance(p, Rect) and p.cy == -0.83][1:]
    density = -np.log10([reflectances[p.material].mean() for p in row])
    assert len(row) == 12
    assert_close(np.diff(density), np.full(11, 0.15), atol=1e-12)
    assert (np.diff([p.cx for p in row]) > 0).all()


@pytest.mark.parametrize("name", ["demo", "dots"])
def test_dots_are_a_grid_of_whole_dots_that_leaves_no_hole(name):
    chart, _ = laid(name)
    dots = [p for p in chart.primitives if isinstance(p, Disc)]
    pitch = 2 / 23
    cells = np.array([[p.cx, p.cy] for p in dots]) / pitch
    assert_close(cells, np.round(cells), atol=1e-9)
    assert {p.radius for p in dots} == {0.0105}
    assert dots[0].radius >= 6 * PIXEL
    # None is cut by the upper or lower edge of the field.
    assert np.abs(np.abs(cells[:, 1] * pitch) - 1).min() > dots[0].radius
    x, y = np.meshgrid(np.linspace(-HALF_WIDTH, HALF_WIDTH, 161), np.linspace(-1, 1, 121))
    away = np.min([p.distance(x, y) for p in chart.primitives], axis=0)
    # A free point lies within half a diagonal of four grid points; where the one to its side is
    # taken by another element, that is as near as its clearance.
    assert away.max() <= pitch


@pytest.mark.parametrize("name", ["slanted-edge", "dots", "grey"])
def test_charts_without_colour_are_shades_of_one_spectrum(name):
    scene = make_scene(name, illuminant="FL2")
    shape = scene.spectra / scene.white
    assert_close(shape, np.repeat(shape[:, :1], 61, axis=1).copy(), rtol=1e-14)


def test_spectra_are_reflectance_times_the_illuminant_at_the_luminance_asked_for():
    scene = make_scene("demo", luminance_cd_m2=120.0, illuminant="A")
    _, reflectances = laid("demo")
    lamp = illuminant("A")
    scale = 120.0 / luminance_cd_m2(lamp)
    assert_close(scene.spectra, reflectances * lamp * scale, rtol=1e-14)
    assert_close(scene.white, lamp * scale, rtol=1e-14)
    assert scene.illuminant == "A"
    assert scene.white_luminance_cd_m2 == pytest.approx(120.0, rel=1e-13)


def test_grey_has_18_percent_of_the_default_white():
    scene = make_scene("grey")
    assert_close(luminance_cd_m2(scene.spectra), np.array([54.0]), rtol=1e-13)
    assert scene.source.primitives == ()

"""Veiling glare, against sums of its own over a denser grid."""

import numpy as np
import pytest
from harness import assert_close
from optics.made import bank, monochrome, scene, sensor

from gpusim.optics.flare import SIDE, veiling_glare
from gpusim.reference.fields import Heights
from gpusim.scene.chart import Rect
from gpusim.scene.raster import Raster

WEIGHTS = np.random.default_rng(8).uniform(1, 9, (2, 3, 3))  # planes, channels, wavelengths
COEFFICIENTS = np.array([[1.0, 0.0], [0.25, 0.5]])


def illumination(lens, camera, side=700):
    """Return points (um), and the relative illumination (L, side, side) at them."""
    line = (np.arange(side) + 0.5) / side - 0.5
    pitch = camera.pixel_pitch_um
    x, y = np.meshgrid(line * camera.cols * pitch, line * camera.rows * pitch)
    points = np.stack([x, y], axis=-1).reshape(-1, 2)
    light = sum(
        lens.relative_illumination[field][:, None] * share
        for field, _, share in Heights(lens).shares(points)
    )
    return x, y, light.reshape(-1, *x.shape)


def test_an_even_scene_gives_its_share_of_the_mean_signal_to_every_site():
    lens, camera = bank(), sensor(veiling_glare=0.03)
    found = veiling_glare(lens, camera, scene().source.placed(74.4), WEIGHTS, COEFFICIENTS)
    mean = illumination(lens, camera)[2].mean(axis=(1, 2))
    by_channel = 0.03 * np.einsum("j,jcl,l->c", COEFFICIENTS[0], WEIGHTS, mean)
    # Midpoint sums of a smooth function on 256 points a side: errors of 1/(24 * 256^2) of its
    # change.
    expected = by_channel[[2, 1, 1, 0]]  # B G / G R; channels are R, G, B
    assert_close(found, expected, rtol=1e-5)


def test_a_chart_counts_by_area():
    lens = bank(falloff=0.0, distortion=0.0)
    camera = monochrome(veiling_glare=0.5)
    # The right half of the field, and beyond it.
    chart = scene((Rect(5.0, 0.0, 5.0, 5.0, 0.0, 1),)).source.placed(74.4)
    found = veiling_glare(lens, camera, chart, WEIGHTS[:, :1], COEFFICIENTS)
    halves = 0.5 * np.einsum("mj,jcl->cm", COEFFICIENTS, WEIGHTS[:, :1]).sum() / 2
    assert_close(found, np.array([halves]), rtol=1e-12)  # SIDE is even: the edge is between points
    assert SIDE % 2 == 0


def test_stripes_that_repeat_with_the_grid_count_by_area():
    lens, camera = bank(falloff=0.0, distortion=0.0), monochrome(96, 128, veiling_glare=0.5)
    cell = 2 * 128 / 96 / SIDE  # half-heights
    # Stripes of 1.9 cells, one in each four: the middles of two cells lie in each.
    stripes = tuple(
        Rect((4 * k + 2) * cell - 128 / 96, 0.0, 0.95 * cell, 2.0, 0.0, 1) for k in range(SIDE // 4)
    )
    half_um = 48 * camera.pixel_pitch_um
    given = lens, camera, scene(stripes).source.placed(half_um), WEIGHTS[:, :1]
    dark, light = np.einsum("mj,jcl->m", COEFFICIENTS, WEIGHTS[:, :1])
    expected = 0.5 * (dark + 1.9 / 4 * (light - dark))
    # In 2 x 64 columns of 256 cells a point lies in the stripe with the chance 0.95: a binomial
    # count, of which 4 standard deviations are allowed. The middles of cells would be 40 off.
    chance = np.sqrt(128 * 256 * 0.95 * 0.05) / SIDE**2 * abs(light - dark) * 0.5
    assert_close(veiling_glare(*given, COEFFICIENTS), np.array([expected]), atol=4 * chance)


def test_beyond_the_image_circle_there_is_no_light():
    lens = bank(falloff=0.0, distortion=0.0, circle_um=80.0, lateral=(0.0, 0.0, 0.0))
    camera = monochrome(100, 100, veiling_glare=1.0)  # a square of 155 um, a circle of 80 um radius
    found = veiling_glare(lens, camera, scene().source, WEIGHTS[:, :1], COEFFICIENTS)
    x, y, _ = illumination(lens, camera, 2000)
    inside = np.mean(np.hypot(x, y) <= 80)
    expected = np.einsum("j,jcl->c", COEFFICIENTS[0], WEIGHTS[:, :1]) * inside
    # The circle's length counted in points: four arcs of 0.3 rad, 96 um in a field of 256 x 0.6 um.
    assert_close(found, expected, rtol=2e-3)


@pytest.mark.parametrize("distortion", [0.0, -0.05])
def test_a_raster_counts_by_its_samples(distortion: float):
    lens, camera = bank(distortion=distortion), sensor(veiling_glare=0.02)
    half_um = (128 * 0.775, 96 * 0.775)
    planes = np.random.default_rng(2).uniform(0, 1, (2, 6, 8)).astype(np.float32)
    placed = Raster(planes).placed(*half_um, 0.775)
    found = veiling_glare(lens, camera, placed, WEIGHTS, COEFFICIENTS)
    x, y, light = illumination(lens, camera)
    radius = np.hypot(x, y)
    stretch = lens.ideal_from_real(radius)[0] / radius
    col = np.floor((x * stretch + half_um[0]) / (2 * half_um[0]) * 8).clip(0, 7).astype(int)
    row = np.floor((y * stretch + half_um[1]) / (2 * half_um[1]) * 6).clip(0, 5).astype(int)
    seen = np.einsum("mj,myx->jyx", COEFFICIENTS, planes[:, row, col].astype(float))
    mean = np.einsum("jyx,lyx,jcl->c", seen, light, WEIGHTS) / x.size
    # 14 inner borders of cells, each crossing 256 points that may fall on either side: at most 1 %
    # of the field is counted a point off, by half the mean or less, and it averages out.
    assert_close(found, 0.02 * mean[[2, 1, 1, 0]], rtol=5e-3)


def test_highlights_count_by_their_area():
    """The sun between the points of the grid, off the axis, where the lens lets less light pass."""
    lens, camera = bank(distortion=-0.05, falloff=0.4), sensor(veiling_glare=0.02)
    half_um = (128 * 0.775, 96 * 0.775)
    planes = np.zeros((2, 96, 128), np.float32)
    planes[:, 60:63, 30:34] = 1.0
    dark = Raster(planes.copy()).placed(*half_um, 0.775)
    planes[:, 20, 100] = 1e9, 2e9
    placed = Raster(planes).placed(*half_um, 0.775)
    assert len(placed.highlights) == 1 and len(dark.highlights) == 0
    added = veiling_glare(lens, camera, placed, WEIGHTS, COEFFICIENTS)
    added -= veiling_glare(lens, camera, dark, WEIGHTS, COEFFICIENTS)
    ideal = (np.array([100.5, 20.5]) - [64, 48]) * 1.55
    height = np.hypot(*ideal)
    low, real, high = (lens.real_from_ideal(height + d)[0] for d in (-0.1, 0.0, 0.1))
    area = 1.55**2 * real / height * (high - low) / 0.2
    light = sum(
        lens.relative_illumination[field] * share
        for field, _, share in Heights(lens).shares(np.array([[float(real), 0.0]]))
    )
    colour = np.array([1e9, 2e9]) @ COEFFICIENTS
    mean = np.einsum("j,jcl,l->c", colour, WEIGHTS, light) * area / (1.55**2 * 96 * 128)
    assert_close(added, 0.02 * mean[[2, 1, 1, 0]], rtol=1e-5)

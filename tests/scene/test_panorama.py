"""Panoramas lie by angle: what stands at a direction is seen there, as bright as it is."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.errors import UserError
from gpusim.scene.make import make_scene
from gpusim.scene.panorama import by_angle
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene

ROWS = 180


def directions(rows=ROWS):
    """Return the unit vectors (right, down, ahead) of an equirectangular panorama's samples."""
    longitude = 2 * np.pi * ((np.arange(2 * rows) + 0.5) / (2 * rows) - 0.5)
    latitude = np.pi * ((np.arange(rows) + 0.5) / rows - 0.5)
    longitude, latitude = np.meshgrid(longitude, latitude)
    cos = np.cos(latitude)
    return cos * np.sin(longitude), np.sin(latitude), cos * np.cos(longitude)


def seen_at(azimuth, theta, rows=ROWS):
    """Return the sample (row, col) of the angular raster nearest to a direction, rad."""
    at = rows * (1 + theta * np.array([np.sin(azimuth), np.cos(azimuth)]) / np.pi) - 0.5
    return tuple(np.round(at).astype(int))


@pytest.mark.parametrize(
    "pole", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.0, -0.8), (0.48, 0.8, 0.36)]
)
def test_a_smooth_world_is_seen_at_its_directions(pole):
    def world(right, down, ahead):
        return 1.5 + pole[0] * right + pole[1] * down + pole[2] * ahead

    found = by_angle(world(*directions())[None])[0]
    at = np.pi * ((np.arange(2 * ROWS) + 0.5) / ROWS - 1)
    right, down = np.meshgrid(at, at)
    theta, azimuth = np.hypot(right, down), np.arctan2(down, right)
    sin = np.sin(theta)
    truth = world(sin * np.cos(azimuth), sin * np.sin(azimuth), np.cos(theta))
    inside = theta < np.pi * (1 - 2 / ROWS)
    # Linear between samples of s = 1 degree: s^2 / 8 both ways. The mean over an arc of
    # s / cos(latitude) takes s^2 / 24 / cos(latitude) off what goes round with the longitude, at
    # the row by the pole s / 12; linear between two such rows and all around, as much again.
    step = np.pi / ROWS
    cos = np.maximum(np.hypot(sin * np.cos(azimuth), np.cos(theta)), step / 2)
    error = np.abs(found - truth)
    assert error[inside & (cos > 0.5)].max() < step**2 / 4 + step**2 / 12
    assert error[inside].max() < step / 6
    assert not found[theta > np.pi].any()


def test_a_world_that_is_even_stays_so():
    found = by_angle(np.full((2, 16, 32), 3.0, np.float32))
    at = np.pi * ((np.arange(32) + 0.5) / 16 - 1)
    inside = np.hypot(*np.meshgrid(at, at)) <= np.pi
    np.testing.assert_allclose(found[:, inside], 3.0, rtol=1e-6)


def test_light_near_a_pole_is_not_missed():
    # One sample in the third row from the top: at 87.5 degrees up, an arc of 0.04 degrees. Its
    # solid angle is in the raster, wherever its samples fall.
    rows = 180
    down = directions(rows)[1]
    at = np.pi * ((np.arange(2 * rows) + 0.5) / rows - 1)
    theta = np.hypot(*np.meshgrid(at, at))
    solid = np.sinc(theta / np.pi) * (np.pi / rows) ** 2
    ratios = []
    for col in range(0, 2 * rows, 9):
        panorama = np.zeros((1, rows, 2 * rows))
        panorama[0, 2, col] = 1.0
        found = by_angle(panorama)[0]
        there = np.cos(np.arcsin(down[2, col])) * (np.pi / rows) ** 2
        assert found.min() >= 0
        ratios.append(np.sum(found * solid) / there)
    # On a grid as coarse as the sample is wide it counts more or less by where it falls.
    assert min(ratios) > 0.3 and max(ratios) < 2
    assert np.mean(ratios) == pytest.approx(1, rel=0.1)


def test_up_is_up_and_right_is_right():
    panorama = np.zeros((1, ROWS, 2 * ROWS))
    panorama[0, ROWS // 2 - 31 : ROWS // 2 - 29] = 1.0  # a band 30 degrees up
    found = by_angle(panorama)[0]
    assert found[seen_at(-np.pi / 2, np.radians(30))] > 0.4
    assert found[seen_at(np.pi / 2, np.radians(30))] == 0
    panorama = np.zeros((1, ROWS, 2 * ROWS))
    panorama[0, :, 3 * ROWS // 2 - 1 : 3 * ROWS // 2 + 1] = 1.0  # a meridian 90 degrees right
    found = by_angle(panorama)[0]
    assert found[seen_at(0.0, np.pi / 2)] > 0.4
    assert found[seen_at(np.pi, np.pi / 2)] == 0


def test_what_is_no_panorama_is_refused():
    with pytest.raises(UserError, match="no panorama"):
        by_angle(np.ones((1, 10, 19)))
    with pytest.raises(UserError, match="a chart is no panorama"):
        make_scene("demo", projection="equirectangular")


def test_it_is_as_large_as_the_lens_makes_it():
    source = Raster(np.ones((3, 4, 4), np.float32), half_efl=(np.pi, np.pi))
    light = np.ones(61)
    before = Scene("world", np.ones((3, 61)), source, "D65", light).before(2.0)
    assert before.source.half_um == pytest.approx((2000 * np.pi, 2000 * np.pi))
    assert before.before(3.0) is before

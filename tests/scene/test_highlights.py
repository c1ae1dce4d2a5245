"""Bright outliers: which samples they are, what is left of them, and that no light is lost."""

import numpy as np
import pytest
from harness import assert_close

from gpusim.scene import highlights
from gpusim.scene.highlights import OUTLIER, split_outliers
from gpusim.scene.raster import Raster

RNG = np.random.default_rng(14)


def room(rows: int = 20, cols: int = 30) -> np.ndarray:
    """Return two planes around 1."""
    return RNG.uniform(0.5, 1.5, (2, rows, cols)).astype(np.float32)


def test_a_scene_without_outliers_stays_as_it_is():
    planes = room()
    split = split_outliers(planes)
    assert split.planes is planes
    assert len(split.rows) == len(split.cols) == len(split.excess) == 0


def test_outliers_are_measured_by_the_median_of_what_is_lit():
    planes = np.full((1, 9, 9), 2.0, np.float32)
    planes[:, :, 5:] = 0.0  # less than half of the samples are black
    planes[0, 2, 3] = 2 * OUTLIER
    planes[0, 4, 1] = np.nextafter(np.float32(2 * OUTLIER), np.float32(np.inf))
    split = split_outliers(planes)
    assert (split.rows.tolist(), split.cols.tolist()) == ([4], [1])
    assert split.limit == 2 * OUTLIER


def test_any_plane_makes_an_outlier_and_all_planes_give_it_up():
    planes = room()
    planes[:, 7, 9] = 1e9, 3.0
    split = split_outliers(planes)
    assert len(split.rows) == 1
    around = planes[:, 6:9, 8:11].reshape(2, 9)
    rest = split.planes[:, 7, 9]
    # What a neighbour holds, of all its planes, as long as the sample had as much.
    assert any(np.array_equal(rest, np.minimum(one, [1e9, 3.0])) for one in around.T[[0, 1, 2, 3]])
    assert split.excess.min() >= 0


def test_no_light_is_lost_and_other_samples_are_not_touched():
    planes = room()
    y, x = np.mgrid[:20, :30]
    sun = (y - 8) ** 2 + (x - 11) ** 2 <= 25
    planes[:, sun] = 1e9
    planes[1, 19, 29] = 7e5  # in the corner
    split = split_outliers(planes)
    found = split.planes.astype(float)
    assert found.max() < 2
    found[:, split.rows, split.cols] += split.excess.T
    assert_close(found, planes, rtol=2.0**-24)
    mask = sun.copy()
    mask[19, 29] = True
    assert_close(split.planes[:, ~mask], planes[:, ~mask].copy(), atol=0)
    assert np.array_equal(np.argwhere(mask), np.stack([split.rows, split.cols], axis=1))
    assert planes.max() == np.float32(1e9)  # the scene itself is not changed


def test_of_many_the_brightest_are_taken(monkeypatch):
    monkeypatch.setattr(highlights, "FEW", 10)
    planes = np.ones((1, 30, 30), np.float32)
    planes[0, :5] = OUTLIER * RNG.uniform(1.1, 50, (5, 30))
    split = split_outliers(planes)
    assert len(split.rows) == 10
    assert split.planes[0].max() == pytest.approx(split.limit, rel=1e-6)
    assert (split.excess[:, 0] + 60 * OUTLIER > split.limit).all()


def test_the_dazzling_are_taken_up_to_the_most(monkeypatch):
    monkeypatch.setattr(highlights, "FEW", 10)
    planes = np.ones((1, 30, 30), np.float32)
    planes[0, :5] = 600.0
    planes[0, 10:12] = RNG.uniform(1e6, 1e9, (2, 30))
    assert len(split_outliers(planes).rows) == 60
    monkeypatch.setattr(highlights, "MOST", 25)
    split = split_outliers(planes)
    assert len(split.rows) == 25
    assert np.sort(planes[0, split.rows, split.cols]) == pytest.approx(
        np.sort(planes[0, 10:12].ravel())[-25:], rel=1e-7
    )


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (3, 5)])
@pytest.mark.parametrize("value", [0.0, 1.0, 1e30])
def test_even_scenes_of_any_size_have_no_outliers(shape, value):
    planes = np.full((3, *shape), value, np.float32)
    assert split_outliers(planes).planes is planes


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (2, 3)])
def test_one_bright_sample_in_a_small_scene(shape):
    planes = np.ones((1, *shape), np.float32)
    planes[0, -1, -1] = 1e9
    split = split_outliers(planes)
    assert split.excess.tolist() == [[1e9 - 1]]
    assert_close(split.planes, np.ones((1, *shape)), atol=0)


@pytest.mark.parametrize("min_pitch_um", [1.0, 37.0])
def test_highlights_lie_where_their_samples_do_whatever_the_grid(min_pitch_um: float):
    planes = room(30, 40)
    planes[0, 3, 5] = planes[1, 29, 39] = 1e6
    source = Raster(planes)
    placed = source.placed(400.0, 300.0, min_pitch_um)
    assert (placed.planes.shape == planes.shape) == (min_pitch_um == 1.0)
    assert placed.planes.max() < 2
    expected = [[-400 + 20 * 5.5, -300 + 20 * 3.5], [390, 290]]
    assert_close(placed.highlights.centre_um, np.array(expected), atol=1e-9)
    assert placed.highlights.size_um == pytest.approx(20.0, rel=1e-12)
    assert "2 samples brighter than" in placed.note
    assert len(Raster(room()).placed(400.0, 300.0, 1.0).highlights) == 0


def test_lone_outliers_have_none_next_to_them():
    planes = np.full((2, 20, 30), 2.0, np.float32)
    planes[1] = 0.0
    planes[0, 3, 4] = 1e6
    planes[1, 9, 9] = 5e6
    planes[0, 15, 20:22] = planes[0, 16, 22] = 7e6  # by their sides and corners
    # The brightest plane counts; the median of what surrounds them is 2.
    assert split_outliers(planes).lone == pytest.approx((1e6 + 5e6) / 600 / 2, rel=1e-5)
    assert split_outliers(planes[:, :14, :8]).lone == pytest.approx(1e6 / 112 / 2, rel=1e-5)
    assert split_outliers(np.ones((1, 4, 4), np.float32)).lone == 0.0

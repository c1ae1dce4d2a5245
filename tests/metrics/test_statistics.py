"""Variances of frames, split into parts, and whether their uncertainties are what they say."""

import numpy as np
import pytest
from metrics.made import Camera
from scipy.stats import chi2, norm

from gpusim.metrics.statistics import Accumulator, pooled, split

LEVEL = 1e-4  # of each test; the seeds are fixed
PARTS = ("total", "pixel", "row", "column")


def images(count, shape=(40, 30), pixel=1.0, row=0.0, column=0.0, law="normal"):
    rng = np.random.default_rng(11)
    for _ in range(count):
        noise = {
            "normal": rng.standard_normal,
            # of unit variance, kurtosis 9
            "heavy": lambda size: rng.laplace(size=size) / 2**0.5,
        }[law](shape)
        rows, cols = rng.standard_normal((shape[0], 1)), rng.standard_normal(shape[1])
        yield pixel * noise + row * rows + column * cols


@pytest.mark.parametrize(
    ("pixel", "row", "column", "law"),
    [
        (1.0, 0.0, 0.0, "normal"),
        (1.0, 0.0, 0.0, "heavy"),
        (2.0, 0.5, 0.0, "normal"),
        (1.0, 0.3, 0.8, "normal"),
    ],
)
def test_the_parts_have_no_bias_and_the_spread_that_they_state(pixel, row, column, law):
    count = 300
    found = [split(one) for one in images(count, pixel=pixel, row=row, column=column, law=law)]
    planted = {"pixel": pixel**2, "row": row**2, "column": column**2}
    planted["total"] = sum(planted.values())
    low, high = chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], count - 1) / (count - 1)
    for name in PARTS:
        values = np.array([getattr(one, name) for one in found])
        stated = np.mean([getattr(one, f"{name}_u2") for one in found])
        spread = values.std(ddof=1)
        assert abs(values.mean() - planted[name]) < norm.isf(LEVEL / 2) * spread / count**0.5
        # The stated variance is itself an estimate: a tenth for its own error, and that the laws
        # of variances are skewed.
        assert 0.9 * low < spread**2 / stated < 1.1 * high, name


def test_a_row_pattern_is_no_column_pattern():
    image = np.add.outer(np.arange(30.0), np.zeros(20))
    found = split(image)
    assert found.column == pytest.approx(0, abs=1e-9)
    assert found.pixel == pytest.approx(0, abs=1e-9)
    assert found.row == pytest.approx(np.var(np.arange(30.0), ddof=1))


def test_the_fixed_pattern_cancels_in_the_temporal_variance():
    camera = Camera(response=0.2, offset_e=30.0, current_e_per_s=0.0)
    site = camera.level(2000.0, frames=8).sites[0]
    planted = camera.gain**2 * (4.0**2 + 0.55 * 2000) + 1 / 12
    assert abs(site.temporal.total - planted) < norm.isf(LEVEL / 2) * site.temporal.total_u2**0.5


def test_the_temporal_noise_left_in_the_average_is_subtracted():
    """The average of 4 frames without any pattern still varies by a quarter of the noise."""
    camera = Camera(response=0.0, offset_e=0.0)
    site = camera.level(2000.0, frames=4).sites[0]
    assert abs(site.spatial.total) < norm.isf(LEVEL / 2) * site.spatial.total_u2**0.5
    left = split(site.average).total
    assert left > 10 * site.spatial.total_u2**0.5


def test_sites_of_a_pattern_are_kept_apart():
    rng = np.random.default_rng(3)
    statistics = Accumulator((2, 2))
    base = np.tile([[100.0, 200.0], [300.0, 400.0]], (20, 20))
    for _ in range(4):
        statistics.add(rng.poisson(base).astype(np.uint16))
    sites = statistics.sites()
    assert [round(site.mean, -1) for site in sites] == [100, 200, 300, 400]
    for site in sites:
        assert abs(site.temporal.total / site.mean - 1) < 0.3
        assert abs(site.spatial.total) < 4 * site.spatial.total_u2**0.5
    assert sites[0].shape == (20, 20)


def test_pooling_independent_sites_halves_the_pixel_variance_of_two():
    one, two = (split(image) for image in images(2))
    both = pooled([one, two])
    assert both.pixel == pytest.approx((one.pixel + two.pixel) / 2)
    assert both.pixel_u2 == pytest.approx((one.pixel_u2 + two.pixel_u2) / 4)
    # Rows may be the same rows: nothing is gained by taking them twice.
    assert both.row_u2 >= min(one.row_u2, two.row_u2)


def test_a_pair_holds_no_average():
    site = Camera().level(100.0).sites[0]
    assert site.average is None
    assert site.covariance is None

"""Distortion: corners, dots and LGD against closed forms; lateral colour; refusals."""

from __future__ import annotations

import numpy as np
import pytest
from metrics.lattices import checks, dots, picture, ratio, to_chart, true_place

from gpusim.errors import UserError
from gpusim.metrics.distortion import measure_distortion
from gpusim.metrics.picture import Plane

OPEN = (-np.inf, np.inf)
STRAIGHT, BARREL, STRONG, PINCUSHION = (), (0.1,), (0.25, 0.06), (-0.05,)


def measured(values, sites=None):
    return measure_distortion({"Y": Plane(values, sites, OPEN)})


def errors(found, k):
    """Return how far the marks lie from where the chart's own map has them, px."""
    chart = np.rint(to_chart(found.marks.x, found.marks.y, k)).T
    true = np.array([true_place(tuple(cell), k) for cell in chart])
    return np.hypot(found.marks.x - true[:, 0], found.marks.y - true[:, 1])


def lgd_errors(found, k):
    r = np.linspace(0.05, found.radius.max(), 30)
    return np.abs(found.fits["chosen"].lgd(r) - (1 / ratio(r, k) - 1))


@pytest.mark.parametrize("k", [STRAIGHT, BARREL, STRONG, PINCUSHION])
def test_corners_and_lgd_are_those_of_the_closed_form(k):
    found = measured(picture(checks, k))
    # The bar of the corners is 0.02 px; the bend of edges under the weight stays below.
    assert errors(found, k).max() < 0.02
    # At most a smooth part of those errors: 0.005 px over 200 px.
    assert lgd_errors(found, k).max() < 5e-5
    assert found.left_out == 0
    assert len(found.cell) > 150
    # Neighbours in the count are neighbours in the chart.
    chart = np.rint(to_chart(found.marks.x, found.marks.y, k)).T
    assert np.array_equal(chart - chart[0], found.cell - found.cell[0])


def test_dots_are_centroids():
    straight = measured(picture(dots))
    assert straight.marks.kind == "dots"
    # Where no distortion bends the dots, only the samples' own grid is left.
    assert errors(straight, STRAIGHT).max() < 1e-3
    found = measured(picture(dots, BARREL))
    # A dot of radius R under a map with second derivative m'' has its centroid off by m'' R^2 / 8 a
    # direction: 3 k r / corner^2 ... 7e-4/px * 27 px^2, 0.02 px at the corner.
    assert errors(found, BARREL).max() < 0.02
    assert lgd_errors(found, BARREL).max() < 1e-4


def test_dots_are_found_beside_brighter_things():
    values = 0.25 * picture(dots)  # dots 0.2 deep
    values[:60, :90] = 1.9
    assert len(measured(values).cell) > 120


def test_noise_moves_corners_by_what_its_law_says():
    k = BARREL
    noise = 0.01 * np.random.default_rng(4).normal(size=picture(checks, k).shape)
    found = measured(picture(checks, k) + noise)
    # The slope's noise is n / (sqrt(8 pi) w^2) under a Gaussian weight w, and the saddle's twist
    # that of the blurred corner, 0.8 * 2 / (pi (w^2 + 0.9^2)) or a little less; w = 2.6 px: 0.013
    # each way, 0.018 px together.
    rms = np.sqrt(np.mean(errors(found, k) ** 2))
    assert 0.008 < rms < 0.025
    r = np.linspace(0.05, found.radius.max(), 30)
    # k = 4 standard uncertainties, for 30 correlated places.
    assert np.all(lgd_errors(found, k) < 4 * found.fits["chosen"].u_lgd(r) + 5e-5)


def test_a_filter_arrays_photosites_are_measured_where_they_lie():
    values = picture(checks, BARREL)
    rows, cols = np.indices(values.shape)
    sites = np.array([[False, True], [False, False]])
    values[(rows % 2 != 0) | (cols % 2 != 1)] = -5.0  # other filters: none of it may be seen
    found = measured(values, sites)
    # A quarter of the samples, 2 px apart, under a weight of 2.6 px: its own aliases, exp(-2 (pi *
    # 2.6 / 2)^2), are nothing, those of edges 0.9 px soft, exp(-2 (pi 0.9 / 2)^2) = 2 % of them.
    assert errors(found, BARREL).max() < 0.05


def test_models_that_are_not_the_lenss_miss_it():
    fits = measured(picture(checks, STRONG)).fits
    assert fits["5th order"].coefficients == pytest.approx(STRONG, abs=2e-3)
    assert fits["5th order"].rms_px < 0.01
    assert fits["3rd order"].rms_px > 10 * fits["5th order"].rms_px
    assert fits["tangent"].rms_px > 10 * fits["5th order"].rms_px


@pytest.mark.parametrize("k", [BARREL, PINCUSHION])
def test_the_tangent_model_is_found_for_barrel_and_pincushion(k):
    tangent = measured(picture(checks, k)).fits["tangent"]
    # tan(a r) / a = r + a^2 r^3 / 3 + ...: s is three times k_1, but for the next term.
    assert tangent.coefficients[0] == pytest.approx(3 * k[0], rel=0.25)


def test_lateral_colour_is_the_channels_own_magnification():
    planes = {
        name: Plane(picture(checks, BARREL, grow), None, OPEN)
        for name, grow in (("R", 1.0008), ("G", 1.0), ("B", 0.9995))
    }
    found = measure_distortion(planes)
    assert found.reference == "G"
    for one, grow in zip(found.shifts, (1.0008, 0.9995), strict=True):
        # A picture magnified by m has r_u (r_d) = m (undistorted); d r_d = (m - 1) r_u / r_u'.
        r = found.radius
        shift = (grow - 1) * r * ratio(r, BARREL) / (1 + 3 * BARREL[0] * r**2) * found.corner_px
        assert np.abs(one.radial_px - shift).max() < 2e-3
        assert abs(one.largest_px) == pytest.approx(np.abs(shift).max(), abs=2e-3)


def test_a_mark_of_something_else_is_left_out():
    values = picture(checks)
    turned = np.roll(values[60:90, 60:90], (1, 1), (0, 1))
    values[60:90, 60:90] = turned
    found = measured(values)
    assert found.left_out >= 1
    assert errors(found, STRAIGHT).max() < 0.1


def test_pictures_without_a_lattice_are_refused():
    noise = np.random.default_rng(1).normal(size=(120, 120))
    for values in (noise, np.full((120, 120), 0.5), picture(checks)[:60, :60]):
        with pytest.raises(UserError) as caught:
            measured(values)
        assert "no lattice" in caught.value.screen()

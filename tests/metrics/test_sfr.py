"""Slanted edges: SFR, place and angle against closed forms, their uncertainty, refusals."""

from __future__ import annotations

import doctest

import numpy as np
import pytest
from metrics.edges import edge, mtf, profile, sigma_of
from scipy.special import ndtr
from scipy.stats import binom, chi2

from gpusim.errors import UserError
from gpusim.metrics import sfr as module
from gpusim.metrics.edge import Line, find_line, samples_of
from gpusim.metrics.picture import Plane
from gpusim.metrics.regions import find_regions
from gpusim.metrics.sfr import measure_sfr
from gpusim.scene import make_scene
from gpusim.scene.preview import chart_rgb

WHOLE = (0, 0, 80, 80)
# From a slight slant to nearly 45 degrees, and tangents of 1/4, 1/2, 2/3 and 3/4, at which all
# distances fall on a few places.
ANGLES_DEG = (2.0, 5.0, 14.036, 26.565, 33.69, 36.87, 43.0)
SHARPNESS = (0.05, 0.2, 0.45)  # MTF50, cycles/px


@pytest.mark.parametrize("mtf50", SHARPNESS)
@pytest.mark.parametrize("angle", ANGLES_DEG)
def test_the_sfr_is_that_of_the_closed_form(mtf50, angle):
    if mtf(mtf50, 1e-6, angle) < 0.5:
        pytest.skip("a pixel's own aperture is less sharp")
    found = measure_sfr(edge(mtf50, angle, off_px=0.3), WHOLE)
    f = found.frequency_cy_px[found.frequency_cy_px <= 0.6]
    # A cubic spline through knots 0.25 px apart misses (0.25 f)^4 * 0.6 of the response at f (de
    # Boor 1978, XII): 3e-4 at 0.6. The line of an edge as sharp as its pixels lies within 1e-3
    # degrees of its place, 7e-4 px at the region's ends, which is less.
    assert np.abs(found.sfr[: len(f)] - mtf(f, sigma_of(mtf50, angle), angle)).max() < 4e-4
    assert found.falls_to(0.5).value == pytest.approx(mtf50, rel=3e-4)
    beyond = found.frequency_cy_px[len(f) :]
    truth = mtf(beyond, sigma_of(mtf50, angle), angle)
    # The spline's share rises to 4 % at 2 cycles/px of what is there. At tangents of 1/2 and 3/4
    # distances lie 0.447 and 0.2 px apart, about as far as knots: what is beyond 1 cycle/px, 0.02
    # at most, is then not told from the rest.
    over = truth[beyond > 1].max()
    most = 4e-4 + 0.6 * (beyond / 4) ** 4 * np.maximum(truth, over)
    if angle in (26.565, 36.87):
        most = most + over
    assert beyond[-1] == 2.0 and (np.abs(found.sfr[len(f) :] - truth) < most).all()
    assert found.line.angle_deg == pytest.approx(angle, abs=2e-3)


@pytest.mark.parametrize("off", [-0.37, 0.0, 0.21])
def test_the_place_of_an_edge_is_found_to_a_thousandth_of_a_pixel(off):
    found = measure_sfr(edge(0.3, 5.0, off_px=off), WHOLE)
    x, y = found.line.place_px
    assert (x, y) == pytest.approx((40 + off, 40.0), abs=1e-3)


def test_edges_nearer_to_the_horizontal_and_dark_on_the_other_side_say_the_same():
    upright = edge(0.25, 7.0, off_px=0.2)
    found = measure_sfr(upright, WHOLE)
    for other in (upright.T, upright[:, ::-1], 1 - upright):
        again = measure_sfr(other, WHOLE)
        assert again.falls_to(0.5).value == pytest.approx(found.falls_to(0.5).value, rel=1e-6)
        assert abs(again.line.angle_deg) == pytest.approx(7.0, abs=1e-3)
    assert measure_sfr(upright.T, WHOLE).line.turned


def test_a_filter_arrays_photosites_are_measured_where_they_lie():
    picture = edge(0.2, 5.0)
    sites = np.array([[False, True], [True, False]])
    rows, cols = np.indices(picture.shape)
    picture[(rows + cols) % 2 == 0] = -5.0  # other filters: none of it may be seen
    found = measure_sfr(picture, (3, 2, 71, 72), sites=sites)
    assert found.falls_to(0.5).value == pytest.approx(0.2, rel=1e-3)
    assert found.line.place_px == pytest.approx((39.84, 38.0), abs=0.02)  # x there: 2 tan(5 deg)


def test_few_rows_of_one_colour_bear_a_line_and_nothing_more():
    """Half of 20 rows are that colour's, fewer than bear a bend."""
    sites = np.array([[False, True], [False, False]])
    line = find_line(samples_of(edge(0.3, 5.0, side=20), (0, 0, 20, 20), sites))
    assert line.x_of_y.degree() == 1
    # A step of two pixels leaves out what a centroid needs of so sharp an edge: a tenth of a pixel.
    assert line.x_of_y(10.0) == pytest.approx(10.0, abs=0.1)


def test_a_curved_edge_is_as_sharp_as_a_straight_one():
    """An edge x = p(y) that bends by a pixel and a half, sampled along its own normal."""
    y, x = np.mgrid[:120, :80] + 0.5
    at = (y - 60) / 60
    across = x - 40 - 6 * at - 1.5 * (at**2 - 1 / 3)
    slope = (6 + 3 * at) / 60
    distance = across / np.sqrt(1 + slope**2)
    angle = 5.71
    picture = profile(distance, sigma_of(0.2, angle), angle)
    found = measure_sfr(picture, (0, 0, 80, 120))
    # Each row sees the pixel's aperture at its own slant, 2.9 to 8.5 degrees, of which the middle's
    # is taken: sinc(f cos) sinc(f sin) differs by 2e-3 of the response at 0.2 cycles/px.
    assert found.falls_to(0.5).value == pytest.approx(0.2, rel=2e-3)
    assert found.line.x_of_y.degree() > 1


# Tests of a statistic fail for one right program in 1000.
CHANCE = (0.0005, 0.9995)


def noisy_edges(mtf50: float, angle: float, noise: float, runs: int):
    """Yield noisy pictures of an edge; the noise's variance is in proportion to the signal."""
    clean = edge(mtf50, angle, side=64)
    rng = np.random.default_rng(11)
    for _ in range(runs):
        yield clean + rng.normal(size=clean.shape) * noise * np.sqrt(clean / clean.max())


def sigmas_of(line: Line, angle: float) -> tuple[float, float]:
    """Return how far place and angle are off, in their stated uncertainties."""
    return (line.place_px[0] - 32) / line.u_px, (line.angle_deg - angle) / line.u_angle_deg


def assert_stated(sigmas: np.ndarray) -> None:
    """Assert that errors (runs, quantities) scatter by their stated uncertainties.

    Sums of squares of normal errors in their standard deviations follow chi-square's law.
    """
    squares = (sigmas**2).sum(axis=0)
    low, high = chi2.ppf(CHANCE, len(sigmas))
    assert ((low < squares) & (squares < high)).all(), np.sqrt(squares / len(sigmas))


def assert_of_noisy_edges(mtf50: float, angle: float, noise: float, runs: int) -> None:
    """Assert that intervals of 95 % hold MTF50 at that rate, and place and angle are as stated."""
    held, errors, sigmas = 0, [], []
    for picture in noisy_edges(mtf50, angle, noise, runs):
        found = measure_sfr(picture, (0, 0, 64, 64))
        half = found.falls_to(0.5)
        held += abs(half.value - mtf50) < 1.96 * half.u
        errors.append(half.value / mtf50 - 1)
        sigmas.append(sigmas_of(found.line, angle))
    low, high = binom.ppf(CHANCE, runs, 0.95)
    assert low <= held <= high
    assert abs(np.mean(errors)) < 3e-3  # the mean of 60 errors of 0.6 % has 8e-4
    assert_stated(np.array(sigmas))


def test_the_stated_intervals_hold_the_truth_at_their_rate():
    assert_of_noisy_edges(0.25, 5.0, 0.02, 60)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mtf50", "angle", "noise"),
    [(0.25, 5, 0.02), (0.1, 8, 0.02), (0.4, 30, 0.01), (0.05, 15, 0.01)],
)
def test_the_stated_intervals_hold_the_truth_at_their_rate_of_many(mtf50, angle, noise):
    assert_of_noisy_edges(mtf50, angle, noise, 400)


@pytest.mark.parametrize(("mtf50", "angle", "noise"), [(0.1, 8, 0.02), (0.05, 15, 0.01)])
def test_places_and_angles_of_wide_edges_are_as_uncertain_as_stated(mtf50, angle, noise):
    """An edge that its windows cut draws them along: errors grow by 1.25 and 2.2."""
    lines = [find_line(samples_of(one, (0, 0, 64, 64))) for one in
             noisy_edges(mtf50, angle, noise, 40)]  # fmt: skip
    assert_stated(np.array([sigmas_of(line, angle) for line in lines]))


def test_noise_widens_the_uncertainty_in_proportion():
    clean = edge(0.25, 5.0)
    noise = np.random.default_rng(3).normal(size=clean.shape)
    small, large = (measure_sfr(clean + s * noise, WHOLE).falls_to(0.5).u for s in (0.002, 0.008))
    assert large / small == pytest.approx(4.0, rel=0.15)  # but for what bends at the larger one


def refused(picture, region, **options) -> str:
    with pytest.raises(UserError) as caught:
        measure_sfr(picture, region, **options)
    return caught.value.screen()


def test_regions_that_cannot_be_measured_are_refused_with_the_reason():
    clean = edge(0.25, 5.0)
    assert "too small" in refused(clean, (0, 0, 12, 80))
    assert "leaves the picture" in refused(clean, (40, 0, 80, 80))
    assert "clipped" in refused(np.minimum(clean, 0.8), WHOLE, clip=(0.0, 0.8))
    noise = np.random.default_rng(5).normal(size=(80, 80))
    assert "no edge" in refused(noise, WHOLE)
    assert "no edge" in refused(np.full((80, 80), 0.5), WHOLE)
    assert "along the pixels" in refused(edge(0.25, 0.3), WHOLE)
    assert "roi" in refused(clean, (60, 0, 20, 80))


def test_quality_is_one_of_a_diffraction_limited_response():
    found = measure_sfr(edge(0.25, 5.0), WHOLE)
    f = found.frequency_cy_px
    at = np.clip(f / 0.8, 0, 1)
    limit = 2 / np.pi * (np.arccos(at) - at * np.sqrt(1 - at**2))
    ideal = module.Sfr(**{**vars(found), "sfr": limit})
    assert ideal.quality(0.8) == pytest.approx(1.0, abs=1e-12)
    assert ideal.quality(1.6) < 1.0


def test_sharpening_raises_mtf50_and_leaves_mtf50p_of_the_peak():
    clean = edge(0.2, 5.0)
    sharpened = clean + 1.5 * (clean - (np.roll(clean, 2, 1) + np.roll(clean, -2, 1)) / 2)
    found = measure_sfr(sharpened[:, 4:-4], (0, 0, 72, 80))
    assert found.sfr.max() > 1.2
    assert found.falls_to(0.5).value > found.falls_to(0.5, of_peak=True).value > 0.2


def test_peaks_of_noise_beyond_nyquist_are_none_of_mtf50p():
    found = measure_sfr(edge(0.25, 5.0), WHOLE)
    noisy = module.Sfr(
        **{**vars(found), "sfr": np.where(found.frequency_cy_px > 1.4, 1.3, found.sfr)}
    )
    assert noisy.falls_to(0.5, of_peak=True) == found.falls_to(0.5, of_peak=True)


def test_the_examples_in_the_docstrings_run():
    assert doctest.testmod(module).failed == 0


def test_a_bent_blurred_edge_is_followed_on_one_colour_of_a_filter_array():
    """Coma, seen by every second photosite: centroids of rows err by more than the bend."""
    y, x = np.mgrid[:96, :96] + 0.5
    up = y - 48
    across = (x - 48.3 + 0.07 * up + 5e-5 * up**2) / np.hypot(1, 0.07 + 1e-4 * up)

    def esf(distance):
        return 0.6 * ndtr(distance / 1.2) + 0.4 * ndtr((distance - 3) / 4)

    sites = np.array([[False, False], [False, True]])
    found = measure_sfr(esf(across), (0, 0, 96, 96), sites=sites)
    bend = found.line.x_of_y.deriv(2)(48.0)
    assert bend == pytest.approx(-1e-4, rel=0.05)
    # Where it lies as a whole is the centroids' word: an edge spread function may be shifted.
    near = np.abs(found.distance_px) < 12
    off = found.distance_px[near]
    missed = [np.abs(found.esf[near] - esf(off - shift)).max() for shift in np.linspace(-2, 2, 801)]
    assert min(missed) < 2e-3


def test_the_eight_edges_of_a_slanted_star_are_found():
    drawn = chart_rgb(make_scene("e-sfr"), 1080)[..., 1]
    rows, cols = drawn.shape
    star = drawn[rows // 2 - 180 : rows // 2 + 180, cols // 2 - 180 : cols // 2 + 180]
    found = find_regions(Plane(star, None, (-np.inf, np.inf)))
    # Means of 4 x 4 samples put an edge to within 1/8 px, evenly: 0.07 px a row, and so the slope
    # of 125 rows, the shortest, to 0.07 sqrt(12 / 125**3) = 1.7e-4 rad. Three are 0.03 degrees.
    angles = sorted(abs(one.found.line.angle_deg) for one in found)
    assert angles == pytest.approx([5.0] * 4 + [40.0] * 4, abs=0.03)
    assert len({one.box for one in found}) == 8

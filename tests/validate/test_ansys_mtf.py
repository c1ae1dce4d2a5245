"""The Ansys report's sharpness: its closed forms, and its bars with errors planted.

Pictures are drawn from predicted line spreads in place of renders; renders are compared in
``test_ansys.py``, behind the marker ``slow``.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from ansys_findings import READING, F, even, measured_of, noise_of, sharp
from scipy.special import j0, j1
from wrong_sfr import PLANTED

from gpusim.camera import Camera
from gpusim.validate import ansys_models, ansys_mtf, ansys_noise, ansys_pixel, ansys_square
from gpusim.validate.ansys_electrons import past_rim
from gpusim.validate.ansys_targets import chart, half_um
from gpusim.validate.edges import compare, predicted_lsf, region_of

RIM_UM, WAVE_UM = 940.0, 1.0


@pytest.fixture(scope="module")
def sensor():
    return ansys_mtf.cropped(READING)


@pytest.fixture(scope="module")
def camera(sensor):
    return Camera(lens=READING.lens, sensor=sensor, title="")


@pytest.fixture(scope="module")
def predictor(sensor):
    return ansys_square.predictor_of(READING.lens, sensor, ansys_mtf.reach_px(READING))


def test_the_noise_of_an_edge_is_that_of_the_closed_form():
    assert all(bar.held for bar in ansys_noise.bars_of("noise", [noise_of(40)]))


def test_the_closed_form_is_the_uncertainty_that_an_edge_states():
    """The other way to it: from the pixels' own residuals, by the code that measures."""
    noise = noise_of(40)
    stated = np.sqrt(np.mean([one.u_sfr**2 for one in measured_of(40)], axis=0))
    # Where the response is ten standard deviations, noise turns its phase by a tenth, and by
    # as much its part along the phase; the squares of residuals vary, of the 1000 pixels that
    # matter in 40 frames, by 1 / sqrt(2 x 40 x 1000) = 0.4 %.
    at = np.flatnonzero(noise.clean > 10 * noise.expected)[1:]  # at 0 there is no noise
    np.testing.assert_allclose(stated[at] / noise.expected[at], 1.0, atol=0.1)


@pytest.mark.parametrize(("factor", "lost"), [(0.6, [True, True]), (1.15, [False, True])])
def test_noise_of_another_size_is_seen(factor, lost):
    """A little more hides in the intervals of single frequencies, but not of all together."""
    bars = ansys_noise.bars_of("noise", [noise_of(20, factor)])
    assert [not bar.held for bar in bars] == lost


def test_where_the_response_vanishes_nothing_is_judged():
    noise = noise_of(20)
    flat = replace(noise, clean=np.where(F > 0.4, 0.0, 1.0))
    assert F[flat.judged].max() <= 0.4
    own = flat.covariance[np.ix_(flat.judged, flat.judged)]
    size = flat.expected[flat.judged]
    apart = np.abs(np.diag(own / np.outer(size, size), 1))
    assert (apart < ansys_noise.CORRELATED).all()


def test_the_pixel_has_the_published_efficiency_along_the_normal(sensor):
    own = ansys_pixel.angular(sensor)
    nm = ansys_pixel.MAPPED_NM
    np.testing.assert_allclose(own.qe_at(nm)["W"], sensor.qe_at(nm)["W"], rtol=1e-12)
    optical = np.array(own.eqe_map.channels["W"].oe)
    internal = np.array(own.eqe_map.channels["W"].iqe)
    assert 0 <= optical.min() and optical.max() < 1 and internal.max() < 1
    assert (np.diff(optical.mean(axis=(0, 2))) <= 0).all()  # less, the farther from the normal


def test_the_coating_is_that_of_a_quarter_wave(monkeypatch):
    """Born & Wolf 1999, eq. 1.6.61: R = ((n1 n3 - n2^2) / (n1 n3 + n2^2))^2."""
    monkeypatch.setattr(ansys_pixel, "silicon", lambda nm: 4.0 + 0j)
    at_nm = 4 * ansys_pixel.NITRIDE * ansys_pixel.COATING_NM
    first, layer = ansys_pixel.RESIN, ansys_pixel.NITRIDE
    coating = ((first * 4 - layer**2) / (first * 4 + layer**2)) ** 2
    lens = ((1 - first) / (1 + first)) ** 2
    found = ansys_pixel.into_silicon(at_nm, np.zeros(1))
    assert found[0] == pytest.approx((1 - coating) * (1 - lens), rel=1e-12)


def test_light_passes_the_opening_until_the_spot_meets_its_side():
    shift = (ansys_pixel.OPENING - ansys_pixel.SPOT) / 2 / ansys_pixel.DEPTH
    inside = math.sin(math.atan(shift))
    theta = np.arcsin(ansys_pixel.RESIN * inside * np.array([0.99, 1.2]))
    whole, cut = ansys_pixel.opening(theta, np.zeros(1))[:, 0]
    assert whole == 1.0 and 0.9 > cut > 0.8  # a fifth of 0.15 of the pitch, of a spot of 0.3


def test_the_charts_square_is_where_it_is_predicted(camera):
    square = next(one for one in chart(camera.frame).source.primitives if one.cx == one.cy == 0)
    half_height_um = camera.sensor.rows / 2 * camera.sensor.pixel_pitch_um
    assert square.half_w * half_height_um == pytest.approx(half_um(camera.frame), rel=1e-9)
    # 33.5 in at 0.6 m, of which the square has 0.225. The entrance pupil lies 1.6 mm within the
    # lens, and its focal length at the reference wavelength is 0.02 % more: 0.3 %.
    expected = 1061 * 0.225 * 33.5 * 25.4 / 600
    assert 2 * half_um(camera.frame) == pytest.approx(expected, rel=4e-3)


def drawn(camera, predictor, number, seen=None):
    """Return an edge of the square as a predictor's line spread and another sensor show it."""
    sensor = camera.sensor
    place, target = ansys_square.edge_of(number, camera, predictor)
    left, top, width, height = region_of(place, target.axis, sensor)
    y, x = np.mgrid[top : top + height, left : left + width] + 0.5
    fine = np.arange(-60.0, 60.0, 1 / 32)
    band = ansys_square.band_of(sensor)
    lsf, normal = predicted_lsf(
        place, target, band, sensor=seen or sensor, predictor=predictor, distance_px=fine
    )
    rise = np.cumsum(lsf) / lsf.sum()
    way = (x - sensor.cols / 2 - place.x) * normal[0] + (y - sensor.rows / 2 - place.y) * normal[1]
    return place, target, band, 1 + np.interp(way, fine + 1 / 64, rise)


@pytest.mark.parametrize("number", [1, 3])
def test_edges_as_predicted_are_found_so(camera, sensor, predictor, number):
    place, target, band, picture = drawn(camera, predictor, number)
    found = compare(place, target, band, picture, sensor=sensor, predictor=predictor)
    assert found.mtf_error < 0.002 and abs(found.error_px) < 0.002
    alone = ansys_square.predicted_mtf(number, camera, predictor)
    # Windows of 32 px here and of what the region holds there.
    np.testing.assert_allclose(alone, found.predicted_mtf, rtol=0, atol=1e-3)


@pytest.mark.parametrize(("kind", "name", "planted"), PLANTED, ids=["derivative", "window"])
def test_a_wrong_sfr_loses_the_bar(camera, sensor, predictor, monkeypatch, kind, name, planted):
    sound, given = sharp(), drawn(camera, predictor, 3)
    monkeypatch.setattr(kind, name, planted)
    found = compare(*given, sensor=sensor, predictor=predictor)
    bars = replace(sound, found={("electrons", 3): found}).bars()
    (lost,) = [bar.name for bar in bars if not bar.held]
    assert lost.startswith("SFR of ROI")


def test_a_wrong_aperture_and_a_wrong_focus_are_seen(camera, sensor, predictor):
    smaller = sensor.model_copy(update={"fill_factor": 0.9})
    given = drawn(camera, predictor, 3, smaller)
    found = compare(*given, sensor=sensor, predictor=predictor)
    assert found.mtf_error > ansys_mtf.SFR_BAR
    moved = ansys_square.predictor_of(
        READING.lens.defocused(15.0), sensor, ansys_mtf.reach_px(READING)
    )
    *others, picture = drawn(camera, predictor, 3)
    found = compare(*others, picture, sensor=sensor, predictor=moved)
    assert found.mtf_error > ansys_mtf.SFR_BAR


def test_simpler_models_lie_where_optics_puts_them(camera, sensor, predictor):
    place, target = ansys_square.edge_of(3, camera, predictor)
    square = SimpleNamespace(sensor=sensor, predictor=predictor, edges={3: (place, target)})
    found = ansys_models.models_of(square, READING.lens)
    assert all(curve[0] == pytest.approx(1, abs=1e-6) for curve in found.values())
    # No lens passes more than the diffraction limit (Goodman 2005, sec. 6.4.3); 0.002 for the
    # working f-number, which is that of the axis.
    assert (found["lens"] <= found["diffraction limit"] + 0.002).all()
    assert (found["lens and pixel"] <= found["lens"] + 1e-12).all()


@pytest.mark.parametrize(
    ("planted", "value"),
    [("sfr", 0.011), ("noise", 1.15), ("focus", 1.05), ("rms", 5.5e-4)],
)
def test_each_planted_error_breaks_its_bar(planted, value):
    names = {"sfr": "SFR of ROI", "noise": "sigma of SFR", "focus": "loss by focus",
             "rms": "certificates of"}  # fmt: skip
    assert all(bar.held for bar in sharp().bars())
    (lost,) = [bar.name for bar in sharp(**{planted: value}).bars() if not bar.held]
    assert lost.startswith(names[planted])


def test_electrons_that_equation_1_does_not_have_are_seen():
    assert all(bar.held for bar in even().bars())
    assert [bar.held for bar in even(off=-1.1e-3).bars()] == [False, True]
    assert [bar.held for bar in even(rms=5.5e-4).bars()] == [True, False]


@pytest.mark.parametrize("half", [(0.17, 0.17), (0.1, 0.17), (0.15, 0.12)])
@pytest.mark.parametrize("away_um", [0.0, 500.0, 800.0])
def test_light_is_bent_over_the_rim_as_an_elliptic_pupil_does(half, away_um):
    """Airy's encircled energy along each direction, scaled to the ellipse: exact, with fringes."""
    a, b = half
    phi = 2 * math.pi * (np.arange(4000) + 0.5) / 4000
    along, across = np.cos(phi) / a, np.sin(phi) / b  # um of the image for each of the circle's
    square = along**2 + across**2
    middle = away_um * along / square
    to_rim = np.sqrt((RIM_UM**2 - away_um**2) / square + middle**2) - middle
    argument = 2 * math.pi / WAVE_UM * to_rim
    exact = float(np.mean(j0(argument) ** 2 + j1(argument) ** 2))
    # The fringes that the mean leaves out: half of the argument's inverse at the nearest rim, 88.
    assert past_rim(half, away_um, RIM_UM, WAVE_UM) == pytest.approx(exact, rel=6e-3)


def test_at_f_2_the_stand_in_is_stopped_by_its_glass_or_has_large_spots():
    own, stopped, larger = ansys_models.opened(READING.lens)
    assert own.f_number == pytest.approx(2.88, abs=0.01)  # the pupil's rim is cut into cells
    assert stopped.f_number > 2.4 and larger.f_number == pytest.approx(2.0, abs=0.01)
    # Spherical aberration grows as the third power of the aperture, 3.0 times here, or faster.
    assert larger.spot_um > 3 * own.spot_um


def test_q_is_the_papers_equation():
    # 2 lambda N / p: 2 x 0.55 um x 2.88 / 3.959 um.
    assert sharp().q == pytest.approx(0.8001, abs=1e-4)

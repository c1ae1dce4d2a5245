"""Quantum efficiency by angle over the field: closed forms, sides, micro-lenses, and kernels."""

import numpy as np
import pytest
from optics.angled import (
    EXIT_MM,
    LINES,
    angled,
    curve,
    eqe_map,
    following,
    leaning_pixel,
    lens,
    plane_lens,
    round_pixel,
    unlike,
)
from optics.made import BLUE, FLAT, RED, bank, sensor

from gpusim.errors import UserError
from gpusim.optics.angular import AngularResponse
from gpusim.optics.images import field_images
from gpusim.optics.kernels import field_kernels
from gpusim.optics.sampling import sampled_kernels
from gpusim.optics.spectral_basis import camera_basis, spectral_weights
from gpusim.psf.places import Heights
from gpusim.reference.angle import NODES, MeanQe
from gpusim.scene.spectra import WAVELENGTHS_NM

ONE = round_pixel()
LENS = lens(falloff=0.0)
GREEN = int(np.abs(WAVELENGTHS_NM - 550).argmin())  # one of the map's wavelengths


def at_green(response: AngularResponse, number: int, azimuth: int = 0) -> np.ndarray:
    """Return the mean quantum efficiency of each channel at 550 nm, which the bank holds."""
    return response.qe(number)[azimuth, :, 1, GREEN]


def test_a_power_of_the_cosine_has_the_mean_of_the_closed_form():
    """Over a disc of half width s about sine b: <cos^4> = <(1 - |a|^2)^2>, a = b + r.

    Over the disc <r^2> = s^2 / 2, <r^4> = s^4 / 3 and <(b . r)^2> = b^2 s^2 / 4, so that
    <|a|^2> = b^2 + s^2 / 2 and <|a|^4> = b^4 + 2 b^2 s^2 + s^4 / 3.
    """
    response = AngularResponse(LENS, angled(eqe_map(W=ONE), pattern=[["W"]]))
    assert not response.turning
    for number in range(4):
        s2 = LENS.projected_solid_angle_sr[1] / np.pi
        b2 = LENS.chief[number, 1, 0] ** 2
        expected = 1 - 2 * (b2 + s2 / 2) + b2**2 + 2 * b2 * s2 + s2**2 / 3
        found = at_green(response, number)[0] / curve("W", WAVELENGTHS_NM[GREEN])
        # The map's steps of 2 degrees: (0.035)^2 / 8 times second derivatives of 4; the squares of
        # the cone: (0.36 / 24)^2 / 24 times 8.
        assert found == pytest.approx(expected, abs=6e-4 + 1e-4)


def test_quantum_efficiency_falls_towards_the_periphery():
    response = AngularResponse(LENS, angled(unlike(0.0)))
    found = np.array([at_green(response, number) for number in range(4)])
    assert (np.diff(found, axis=0) < 0).all()
    # Blue falls with cos^5 and red with cos^3.
    red, _, _, blue = (found[-1] / found[0]).tolist()
    chief = np.sqrt(1 - LENS.chief[-1, 1, 0] ** 2)
    assert red == pytest.approx(chief**3, rel=0.02)
    assert blue == pytest.approx(chief**5, rel=0.02)


def test_greens_separate_with_the_side_of_the_field_and_swap_on_the_other():
    camera = angled(unlike())
    response = AngularResponse(LENS, camera)
    assert camera.channels == ("R", "Gb", "Gr", "B")
    right, left, down = (at_green(response, 3, azimuth) for azimuth in (0, 36, 18))
    gb, gr = camera.channels.index("Gb"), camera.channels.index("Gr")
    # What is (1 + lean) cos^2 against (1 - lean) cos^2, with lean = 0.5 sin theta cos phi.
    x, y, share = LENS.cone[3, 1].astype(float).T
    lean = 0.5 * np.sum(share * (1 - x * x - y * y) * x) / np.sum(share * (1 - x * x - y * y))
    # Straight lines over 15 degrees lose (0.26)^2 / 12 of a cosine.
    assert (right[gr] - right[gb]) / (right[gr] + right[gb]) == pytest.approx(lean, rel=0.01)
    # By the symmetry of the pixels, to rounding: the cone is symmetric too.
    assert left[gr] == pytest.approx(right[gb], rel=1e-6)
    assert left[gb] == pytest.approx(right[gr], rel=1e-6)
    assert down[gr] == pytest.approx(down[gb], rel=1e-6)
    axis = at_green(response, 0)
    assert axis[gr] == pytest.approx(axis[gb], rel=1e-6)
    # As the lens without an axis sees it.
    other = AngularResponse(plane_lens(falloff=0.0), camera)
    assert not other.turning
    column = {x: at_green(other, 4 * 9 + x) for x in (0, 8)}
    assert column[8][gr] == pytest.approx(right[gr], rel=1e-4)
    assert column[0][gr] == pytest.approx(right[gb], rel=1e-4)


def test_symmetric_pixels_do_not_separate():
    camera = angled(eqe_map(R=ONE, Gr=ONE, Gb=ONE, B=ONE))
    response = AngularResponse(LENS, camera)
    for number in range(4):
        found = at_green(response, number)
        assert found[1] == found[2]


def test_micro_lenses_that_follow_the_lens_restore_the_middle():
    found = unlike()
    plain, shifted = (
        AngularResponse(LENS, angled(found, micro_lens=one)) for one in (None, following(LENS))
    )
    middle = at_green(plain, 0)
    for azimuth in (0, 7, 36):
        # The cone is the same, in other squares of it.
        assert at_green(shifted, 3, azimuth) == pytest.approx(middle, rel=2e-4)
    assert np.abs(at_green(plain, 3) / middle - 1).max() > 0.1
    on_plane = AngularResponse(plane_lens(falloff=0.0), angled(found, micro_lens=following(LENS)))
    assert at_green(on_plane, 4 * 9) == pytest.approx(middle, rel=2e-4)


def test_electrons_are_the_papers_integral_over_the_cone():
    """N_c = integral (lambda / h c) <EQE_c>(lambda) E(lambda) A dlambda on the axis."""
    flat = eqe_map(W=lambda line, theta, phi: np.cos(np.radians(theta)) ** 2)
    camera = angled(flat, pattern=[["W"]])
    factor = 1 - LENS.projected_solid_angle_sr / (2 * np.pi)  # <cos^2> = 1 - s^2 / 2
    alone = np.interp(WAVELENGTHS_NM, LINES, curve("W", LINES))
    expected = spectral_weights(LENS, camera, alone[None, None]) * factor[:, None]
    # The map's steps, (0.035)^2 / 8 times second derivatives of 2, and the cone's squares.
    assert spectral_weights(LENS, camera) == pytest.approx(expected, rel=4e-4)


@pytest.mark.parametrize("made", [lens, plane_lens])
@pytest.mark.parametrize("shift", [False, True])
def test_the_reference_finds_the_same_means(made, shift):
    found = made()
    micro_lens = following(lens()) if shift else None
    camera = angled(unlike(), micro_lens=micro_lens)
    response, truth = AngularResponse(found, camera), MeanQe(found, camera, WAVELENGTHS_NM)
    assert response.turning == truth.turns == (made is lens)
    for number in (0, 3, 13) if made is plane_lens else (0, 2, 3):
        for node in (0, 5, 50) if truth.turns else (0,):
            # Sums of 576 products in float64.
            expected = np.moveaxis(truth.mean(number, node), -1, 0)
            np.testing.assert_allclose(response.qe(number)[node], expected, atol=1e-12)
    assert NODES == 72


def test_kernels_hold_what_the_mean_says_at_every_place():
    camera, found = angled(unlike()), lens()
    basis = camera_basis(
        found, camera, np.stack([FLAT, RED, BLUE]), 1e-4, np.arange(3), place_error=1e-5
    )
    images, places = field_images(found, basis.rates, 1e9, elsewhere=basis.elsewhere)
    count = len(found.field_deg)
    assert len(images) > count
    assert places.probes == (0, count - 1)
    assert len(images[places.main]) == count
    kernels = field_kernels(images, places, 0.5, 0.5, np.ones(images.shape[-2:]))
    for x, y in ((0.0, 0.0), (90.0, 0.0), (-60.0, 80.0), (20.0, -130.0)):
        sums = sampled_kernels(kernels, x, y, 0.5, 60, planes=len(basis.spectra)).sum(axis=(2, 3))
        expected = basis.elsewhere.at(x, y).sum(axis=2)
        # The terms' 1e-5, float32 sums of the images, and what the low pass and the splines leave.
        np.testing.assert_allclose(sums, expected, atol=2e-4 * np.abs(expected).max())


def test_a_pixel_that_answers_alike_from_all_sides_has_one_term():
    camera, found = angled(eqe_map(R=ONE, Gr=ONE, Gb=ONE, B=ONE)), lens()
    basis = camera_basis(found, camera, np.stack([FLAT, RED]), 1e-3, np.arange(2), place_error=1e-5)
    images, places = field_images(found, basis.rates, 1e9, elsewhere=basis.elsewhere)
    assert len(images) == len(found.field_deg) + 1  # and one beyond the axis
    assert isinstance(places, Heights)


def test_planes_keep_apart_what_any_place_tells_apart():
    """A red that turns yellow off the axis sees a difference that nothing on the axis sees."""

    def turning(line, theta, phi):
        return np.where(theta > 5, np.exp(-0.5 * ((line - 560) / 60) ** 2), 1.0)

    found = lens(sigma_um=(1.0,), lateral=(0.0,))
    spectra = np.stack([FLAT, RED, BLUE])
    planes = {}
    for name, shape in (("even", ONE), ("turning", turning)):
        camera = angled(eqe_map(W=shape), pattern=[["W"]])
        basis = camera_basis(found, camera, spectra, 1e-4, np.arange(3), place_error=1e-5)
        planes[name] = basis.coefficients.shape[1]
    assert planes["even"] == 1
    assert planes["turning"] > 1


def test_a_sensor_without_angles_does_nothing_more(monkeypatch):
    """Not one bit changes, and no mean is taken."""
    monkeypatch.setattr(AngularResponse, "__init__", None)
    found = lens()
    plain = bank()
    spectra = np.stack([FLAT, RED, BLUE])
    with_rays, without = (
        camera_basis(one, sensor(), spectra, 1e-3, np.arange(3), place_error=1e-5)
        for one in (found, plain)
    )
    assert with_rays.elsewhere is None
    assert np.array_equal(with_rays.weights, without.weights)
    pairs = [field_images(one, without.rates, 1e9)[0] for one in (found, plain)]
    assert np.array_equal(*pairs)


def test_a_lens_without_rays_is_refused():
    with pytest.raises(UserError) as error:
        spectral_weights(bank(), angled(unlike()))
    assert error.value.field == "exit_pupil_mm"


def test_a_map_that_ends_before_the_light_is_refused():
    short = eqe_map(theta=np.array([0.0, 10.0, 20.0]), W=ONE)
    response = AngularResponse(LENS, angled(short, pattern=[["W"]]))
    with pytest.raises(UserError) as error:
        response.qe(3)
    assert error.value.field == "theta_deg"
    chief = np.degrees(np.arcsin(LENS.chief[3, 1, 0]))
    assert float(error.value.allowed.split()[2]) > chief
    assert response.qe(0) is response.qe(0)
    # Micro-lenses bring it back.
    shifted = angled(short, pattern=[["W"]], micro_lens=following(LENS))
    assert AngularResponse(LENS, shifted).qe(3).shape == (1, 1, 3, 61)


def test_the_chief_ray_of_the_made_lens_is_that_of_its_exit_pupil():
    height_mm = 1e-3 * LENS.real_height_um[3, 1]
    assert LENS.chief[3, 1, 0] == pytest.approx(np.sin(np.arctan(height_mm / EXIT_MM)))
    assert leaning_pixel(0.0)(550.0, 0.0, 0.0) == 1


def test_beyond_the_sensor_the_map_goes_on_as_it_ends():
    """Nodes lie there, and nothing that a pixel sees."""
    found = lens(falloff=0.0, fields=8)
    edge = np.degrees(np.arcsin(found.chief[4, 1, 0] + 0.19))  # the cone's half width is 0.18
    short = eqe_map(theta=np.linspace(0, edge, 12), W=ONE)
    camera = angled(short, 48, 64, pattern=[["W"]])
    response, truth = AngularResponse(found, camera), MeanQe(found, camera, WAVELENGTHS_NM)
    assert max(response.seen) < 5
    assert response.qe(7)[0, 0, 1, GREEN] > 0.5 * response.qe(4)[0, 0, 1, GREEN]
    expected = np.moveaxis(truth.mean(7, 0), -1, 0)
    np.testing.assert_allclose(response.qe(7)[0], expected, atol=1e-12)

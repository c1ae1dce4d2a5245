"""The rays that arrive: against the lens's own real rays, and in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from optics.made import bank as gaussians

from gpusim.errors import UserError
from gpusim.lens.samples import sample_field, sample_rays
from gpusim.lens.system import build
from gpusim.lens.wavefront import pupils
from gpusim.psf.bank import Bank
from gpusim.psf.compute import compute_bank
from gpusim.psf.compute_plane import compute_plane_bank
from gpusim.psf.cone import CELLS, cone_of, with_exit_pupil
from gpusim.psf.plane_bank import PlaneBank

LINES = [450.0, 550.0]


@pytest.fixture(scope="module")
def bank(demo_lens):
    return compute_bank(demo_lens, LINES, [0.0, 7.0, 14.0], size=32)


def mean(cone: np.ndarray, power: int) -> np.ndarray:
    """Return the mean of cos(theta)^power over cones."""
    cosine2 = 1 - cone[..., 0].astype(float) ** 2 - cone[..., 1].astype(float) ** 2
    return np.sum(cone[..., 2] * cosine2 ** (power / 2), axis=-1)


def test_a_disc_of_directions_has_the_mean_of_the_closed_form():
    """Over a disc of half width s about the normal, mean cos^4 = (1 - (1 - s^2)^3) / (3 s^2)."""
    x, y = 0.3 * (np.arange(100) + 0.5) / 100, 0.3 * (2 * (np.arange(200) + 0.5) / 200 - 1)
    cone = cone_of(x, y, (np.hypot(x[:, None], y) < 0.3).astype(float), True)
    expected = (1 - (1 - 0.09) ** 3) / (3 * 0.09)
    # (0.6 / 24)^2 / 24 times the sum of second derivatives, 8 at most; the rim of the squares.
    assert mean(cone, 4) == pytest.approx(expected, abs=(0.6 / CELLS) ** 2 / 24 * 8 + 1e-3 * 0.09)
    assert cone[:, 2].sum() == pytest.approx(1, abs=1e-6)


def test_shares_stay_with_their_directions():
    x, y = np.linspace(-0.1, 0.1, 50), np.linspace(0.0, 0.2, 60)
    light = np.add.outer(x + 0.1, 3 * y)
    cone = cone_of(x, y, light, False)
    for number, moment in enumerate((x[:, None], y)):
        expected = (light * moment).sum() / light.sum()
        assert np.sum(cone[:, number] * cone[:, 2]) == pytest.approx(expected, abs=1e-7)


def test_the_chief_ray_is_the_lens_s(bank, demo_lens):
    system = build(demo_lens)
    index = system.index(np.array(LINES))
    for field, angle in enumerate(bank.field_deg):
        rays = sample_rays(system, index, np.radians(angle), np.zeros(1), np.zeros(1))
        # The launch plane is aimed at 1e-9 of the stop.
        np.testing.assert_allclose(bank.chief[field, :, 0], rays.chief_direction[:, 1], atol=1e-8)
    assert not bank.chief[..., 1].any()
    # Light goes outwards: the exit pupil lies before the image.
    assert (np.diff(bank.chief[:, 0, 0]) > 0.05).all()


def test_the_cone_is_the_vignetted_pupil(bank, demo_lens):
    """Mean, widths and cos^4 of the device's rays are those of rays traced in float64."""
    system = build(demo_lens)
    index = system.index(np.array(LINES))
    for field, angle in enumerate(bank.field_deg):
        samples = sample_field(system, index, np.radians(angle))
        for line, pupil in enumerate(pupils(samples, np.array(LINES), 128.0, 512)):
            cone = bank.cone[field, line].astype(float)
            weight = pupil.arriving / pupil.arriving.sum()
            expected = [(weight * pupil.beta).sum(), (weight * pupil.beta**2).sum()]
            found = [np.sum(cone[:, 2] * cone[:, 0] ** n) for n in (1, 2)]
            # A rim of nodes, 2 of 128 across, known to a tenth of its width.
            np.testing.assert_allclose(found, expected, atol=1e-3 * 0.18)
            fourth = (1 - pupil.alpha[:, None] ** 2 - pupil.beta**2) ** 2
            # Error of the squares: (0.36 / 24)^2 / 24 times second derivatives of 8 at most.
            assert mean(cone, 4) == pytest.approx((weight * fourth).sum(), abs=1e-4)
            assert abs(np.sum(cone[:, 2] * cone[:, 1])) < 1e-8  # mirrored


def test_an_apodised_stop_weighs_the_cone(demo_lens, bank):
    apodised = demo_lens.model_copy(update={"gaussian_apodisation": 1.0})
    found = compute_bank(apodised, LINES, [0.0, 7.0], size=32)
    # With u = rho^2 even from 0 to 1, <u> = 1/2, and weighed by exp(-2 u): 0.3435.
    spread = [np.sum(one.cone[0, 0, :, 2] * one.cone[0, 0, :, 0] ** 2) for one in (bank, found)]
    assert spread[1] / spread[0] == pytest.approx(0.3435 / 0.5, rel=0.02)


def test_both_kinds_of_bank_have_the_same_rays(bank, demo_lens):
    edge = bank.field_deg[-1]
    plane = compute_plane_bank(demo_lens, LINES, [-edge, 0.0, edge], [-edge, 0.0, edge], size=32)
    for (row, col), (x, y) in {(1, 2): (1, 0), (1, 0): (-1, 0), (2, 1): (0, 1)}.items():
        rays, own = plane.rays(3 * row + col), bank.rays(2)
        np.testing.assert_allclose(rays.chief, own.chief[:, :1] * [x, y], atol=1e-8)
        np.testing.assert_allclose(rays.place_um, own.place_um[0] * np.array([x, y]), atol=1e-3)
        outwards = rays.cone[..., 0] * x + rays.cone[..., 1] * y
        np.testing.assert_allclose(
            np.sum(rays.cone[..., 2] * outwards, axis=-1),
            np.sum(own.cone[..., 2] * own.cone[..., 0], axis=-1),
            atol=1e-3 * 0.18,
        )
        np.testing.assert_allclose(mean(rays.cone, 4), mean(own.cone, 4), atol=1e-4)


def test_rays_are_kept_in_the_file(bank, tmp_path, demo_lens):
    bank.save(tmp_path / "bank.nc")
    again = Bank.load(tmp_path / "bank.nc")
    np.testing.assert_array_equal(again.cone, bank.cone)
    np.testing.assert_array_equal(again.chief, bank.chief)
    small = compute_plane_bank(demo_lens, [550.0], [0.0, 5.0], [0.0, 5.0], size=32)
    small.save(tmp_path / "plane.nc")
    np.testing.assert_array_equal(PlaneBank.load(tmp_path / "plane.nc").cone, small.cone)


def test_a_bank_without_rays_keeps_a_file_and_says_what_it_lacks(tmp_path):
    lens = gaussians()
    lens.save(tmp_path / "bank.nc")
    assert Bank.load(tmp_path / "bank.nc").cone is None
    with pytest.raises(UserError) as error:
        lens.rays(0)
    assert error.value.field == "exit_pupil_mm"


def test_an_exit_pupil_gives_the_rays_of_a_ready_made_bank():
    lens = with_exit_pupil(gaussians(falloff=0.0), 0.4)
    height_mm = 1e-3 * lens.real_height_um[-1, 1]
    expected = height_mm / np.hypot(height_mm, 0.4)
    rays = lens.rays(3)
    assert rays.chief[1] == pytest.approx([expected, 0.0], abs=1e-12)
    assert np.sum(rays.cone[1, :, 2] * rays.cone[1, :, 0]) == pytest.approx(expected, abs=1e-6)
    # A disc of projected solid angle s^2 pi has <x^2> = s^2 / 4.
    spread = np.sum(rays.cone[1, :, 2] * rays.cone[1, :, 1] ** 2)
    assert spread == pytest.approx(lens.projected_solid_angle_sr[1] / np.pi / 4, rel=0.005)
    telecentric = with_exit_pupil(replace(lens, chief=None, cone=None), np.inf)
    assert not telecentric.chief.any()

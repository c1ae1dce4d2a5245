"""Transfer functions against closed forms, and each way to them against the others."""

import dataclasses

import numpy as np
import pytest
from lens.made import disc_samples
from scipy.special import j1

from gpusim.errors import UserError
from gpusim.lens.samples import sample_field
from gpusim.lens.system import build
from gpusim.lens.wavefront import pupils
from gpusim.psf import otf
from gpusim.psf.psf import intensity

WAVELENGTH_NM = 550.0
WAVELENGTH_UM = 0.55


def disc(half_width=0.125, nodes=256, **kwargs):
    """Return the pupil of a perfect lens, f/4 unless told otherwise."""
    samples = disc_samples(half_width, **kwargs)
    return pupils(samples, np.array([WAVELENGTH_NM]), 64.0, nodes)[0]


def gaussian(size, pitch, sigma_eta, sigma_xi, at_xi=0.0):
    """Return a Gaussian PSF that is wider in one direction."""
    at = (np.arange(size) - size // 2) * pitch
    eta, xi = at[:, None], at[None] - at_xi
    psf = np.exp(-(eta**2) / (2 * sigma_eta**2) - xi**2 / (2 * sigma_xi**2))
    return psf / psf.sum()


# of a PSF


def test_airys_pattern_has_the_diffraction_mtf():
    f_number, size = 4.0, 1024
    pitch = WAVELENGTH_UM * f_number / 4
    at = (np.arange(size) - size // 2) * pitch
    v = np.pi * np.hypot(at[:, None], at[None]) / (WAVELENGTH_UM * f_number)
    airy = np.where(v == 0, 1.0, 2 * j1(v) / np.where(v == 0, 1.0, v)) ** 2
    airy *= np.pi / 4 / 4**2  # peak irradiance pi / (4 lambda^2 N^2) times a sample's area
    frequency = np.linspace(0, 1e3 / (WAVELENGTH_UM * f_number), 41)
    limit = otf.diffraction_mtf(frequency, WAVELENGTH_NM, f_number)
    outside = 1 - airy.sum()
    assert outside < 2 / np.pi / v[0, size // 2] * 1.01  # 2 / (pi v), Born & Wolf sec. 8.5.2
    for direction in otf.DIRECTIONS:
        # No frequency can miss more than the light outside the window.
        found = otf.otf(airy, pitch, frequency, direction)
        np.testing.assert_allclose(found, limit, rtol=0, atol=outside * (1 + 1e-9))


def test_a_gaussian_has_the_mtf_of_its_width_in_each_direction():
    sigma = {"sagittal": 1.0, "tangential": 2.5}  # um; narrow along eta, wide along xi
    psf = gaussian(128, 0.5, sigma["sagittal"], sigma["tangential"])
    frequency = np.linspace(0, 300, 31)
    for direction, width in sigma.items():
        exact = np.exp(-2 * (np.pi * width * frequency * 1e-3) ** 2)
        # Aliases: exp(-2 (pi sigma (1/pitch - nu))^2) = 4e-12 at most.
        found = otf.otf(psf, 0.5, frequency, direction)
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-11)
        other = np.exp(-2 * (np.pi * (3.5 - width) * frequency * 1e-3) ** 2)
        assert np.abs(found - other).max() > 0.3  # directions interchanged


def test_a_shifted_psf_changes_the_phase_only():
    frequency = np.linspace(0, 300, 31)
    still, moved = (gaussian(128, 0.5, 1.0, 2.0, at) for at in (0.0, 3.0))
    along = [otf.otf(psf, 0.5, frequency, "tangential") for psf in (still, moved)]
    shift = np.exp(-2e-3j * np.pi * frequency * 3.0)
    np.testing.assert_allclose(along[1], along[0] * shift, rtol=0, atol=1e-11)
    across = [otf.otf(psf, 0.5, frequency, "sagittal") for psf in (still, moved)]
    np.testing.assert_allclose(across[1], across[0], rtol=0, atol=1e-12)


def test_many_psfs_at_once_are_each_as_alone():
    stack = np.stack([gaussian(32, 0.5, 1.0, sigma) for sigma in (1.0, 2.0)])
    found = otf.otf(stack, 0.5, [50.0, 100.0], "tangential")
    assert found.shape == (2, 2)
    np.testing.assert_allclose(found[1], otf.otf(stack[1], 0.5, [50.0, 100.0], "tangential"))


def test_a_frequency_that_the_pitch_does_not_sample_is_refused():
    with pytest.raises(UserError) as caught:
        otf.otf(gaussian(32, 0.5, 1.0, 1.0), 0.5, [1000.1], "sagittal")
    assert "1000.1" in caught.value.screen()
    assert "up to 1000" in caught.value.screen()


# of a pupil


@pytest.mark.parametrize("f_number", [2.0, 2.8, 8.0])
@pytest.mark.parametrize("direction", otf.DIRECTIONS)
def test_a_perfect_pupil_has_the_diffraction_mtf(f_number, direction):
    cut_off = 1e3 / (WAVELENGTH_UM * f_number)
    frequency = np.linspace(0.01, 1.5, 60) * cut_off
    found = otf.pupil_otf(disc(0.5 / f_number), WAVELENGTH_NM, frequency, direction)
    limit = otf.diffraction_mtf(frequency, WAVELENGTH_NM, f_number)
    np.testing.assert_allclose(found, limit, rtol=0, atol=1e-3)
    at_zero = otf.pupil_otf(disc(0.5 / f_number), WAVELENGTH_NM, np.zeros(1), direction)
    assert at_zero[0] == pytest.approx(1, abs=3e-3)  # the rim's rounding, see line_spread


@pytest.mark.parametrize("direction", otf.DIRECTIONS)
def test_a_whole_pupil_is_as_its_half(direction):
    half = disc(opd=lambda a, b: 0.1 * b * b + 0.3 * a * a * b)
    whole = dataclasses.replace(
        half,
        alpha=np.concatenate([-half.alpha[::-1], half.alpha]),
        coverage=np.concatenate([half.coverage[::-1], half.coverage]),
        opd_mm=np.concatenate([half.opd_mm[::-1], half.opd_mm]),
        entering=np.concatenate([half.entering[::-1], half.entering]),
        half=False,
    )
    frequency = np.array([0.0, 40.0, 120.0])
    one, other = (
        otf.pupil_otf(pupil, WAVELENGTH_NM, frequency, direction) for pupil in (half, whole)
    )
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    one, other = (
        otf.through_focus(pupil, WAVELENGTH_NM, 40.0, direction, [0.0, 0.05])
        for pupil in (half, whole)
    )
    # Splines through one half end otherwise than through both, where nothing is lit.
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)


def test_astigmatism_blurs_the_direction_in_which_its_rays_spread():
    # W = c beta^2: rays land along xi alone, a line that lies radially. Lines across the radius
    # (tangential) are lost in it, radial lines are not.
    pupil = disc(opd=lambda a, b: 0.2 * b * b)
    frequency = np.array([40.0, 80.0, 120.0])
    limit = otf.diffraction_mtf(frequency, WAVELENGTH_NM, 4.0)
    sagittal = otf.pupil_otf(pupil, WAVELENGTH_NM, frequency, "sagittal")
    tangential = otf.pupil_otf(pupil, WAVELENGTH_NM, frequency, "tangential")
    np.testing.assert_allclose(sagittal, limit, rtol=0, atol=1e-3)
    assert (np.abs(tangential) < 0.25 * limit).all()
    # The PSF of the same pupil says the same.
    psf, outside = intensity(pupil, WAVELENGTH_NM, 512, 0.5)
    for direction, found in (("sagittal", sagittal), ("tangential", tangential)):
        np.testing.assert_allclose(
            found, otf.otf(psf, 0.5, frequency, direction), rtol=0, atol=outside
        )


def test_a_tilted_wavefront_turns_the_phase_by_where_its_rays_land():
    # W = -5 um beta: every ray lands at xi = +5 um.
    frequency = np.array([30.0, 100.0])
    still, moved = disc(), disc(opd=lambda a, b: -5e-3 * b)
    expected = np.exp(-2e-3j * np.pi * frequency * 5.0)
    found = [otf.pupil_otf(p, WAVELENGTH_NM, frequency, "tangential") for p in (still, moved)]
    # Between the multiples of 1 / period the line's cut tails count: measured 9e-6.
    np.testing.assert_allclose(found[1] / found[0], expected, rtol=0, atol=2e-5)


@pytest.mark.parametrize("field_deg", [0.0, 14.0])
@pytest.mark.parametrize("direction", otf.DIRECTIONS)
def test_the_otf_of_a_lens_is_that_of_its_psf(demo_lens, field_deg, direction):
    system = build(demo_lens)
    wavelengths = np.array([WAVELENGTH_NM])
    samples = sample_field(system, system.index(wavelengths), np.radians(field_deg))
    (pupil,) = pupils(samples, wavelengths, 256.0, 256)
    psf, outside = intensity(pupil, WAVELENGTH_NM, 512, 0.5)
    frequency = np.linspace(20, 900, 45)
    # Lines of 256 um: light outside them is too smooth for frequencies above 20 cycles/mm, where it
    # weighs 1 / (20 * 0.256) of its share or less.
    np.testing.assert_allclose(
        otf.pupil_otf(pupil, WAVELENGTH_NM, frequency, direction),
        otf.otf(psf, 0.5, frequency, direction),
        rtol=0,
        atol=outside / 5,
    )


# several wavelengths


def test_lateral_colour_lowers_the_tangential_mtf_by_a_cosine():
    # Two equal perfect images 2 d apart: cos(2 pi nu d).
    frequency = np.linspace(0, 200, 21)
    perfect = np.ones((2, 21), dtype=complex)
    found = otf.polychromatic(perfect, np.array([3.0, 3.0]), frequency, np.array([-1.5, 1.5]))
    np.testing.assert_allclose(found, np.cos(2e-3 * np.pi * frequency * 1.5), atol=1e-12)


def test_each_wavelength_weighs_with_its_light():
    otfs = np.array([[1.0, 0.9], [1.0, 0.3]], dtype=complex)
    found = otf.polychromatic(otfs, np.array([3.0, 1.0]), np.array([0.0, 50.0]))
    np.testing.assert_allclose(found, [1.0, (3 * 0.9 + 0.3) / 4], rtol=1e-14)


# through focus


@pytest.fixture(scope="module")
def corner(demo_lens):
    system = build(demo_lens)
    wavelengths = np.array([450.0, 550.0, 650.0])
    light = np.array([1.0, 2.0, 1.0])

    def at(dz_mm):
        moved = dataclasses.replace(system, image_z_mm=system.image_z_mm + dz_mm)
        return otf.field_pupils(
            moved, np.radians(14.0), wavelengths, light, reference=1, depth_mm=0.05
        )

    return at


@pytest.mark.parametrize("direction", otf.DIRECTIONS)
def test_a_shifted_image_plane_is_as_if_traced_again(corner, direction):
    frequency, dz = np.array([50.0, 100.0, 200.0]), 0.03
    here = corner(0.0)
    shifted = np.abs(here.otf(frequency, direction, dz))
    # Both fit the wavefront to 1e-4 waves, which turns phases by 6e-4 at most.
    np.testing.assert_allclose(
        np.abs(corner(dz).otf(frequency, direction)), shifted, rtol=0, atol=6e-4
    )
    assert np.abs(shifted - np.abs(here.otf(frequency, direction, -dz))).max() > 0.1  # wrong sign


@pytest.mark.parametrize("direction", otf.DIRECTIONS)
def test_a_coarse_autocorrelation_gives_the_same_through_focus(corner, direction):
    here, dz = corner(0.0), np.array([-0.05, -0.02, 0.0, 0.03])
    exact = [here.otf(np.array([100.0]), direction, z)[0] for z in dz]
    # Measured 7e-4 with 128 nodes: the rim's rounding.
    np.testing.assert_allclose(here.through_focus(100.0, direction, dz), exact, rtol=0, atol=1e-3)


def test_the_image_moves_along_its_ray_when_the_plane_is_shifted():
    # A perfect image around beta = 0.3: with the slope of that ray it stays centred.
    pupil = disc(0.02, beta_centre=0.3)
    slope, dz = 0.3 / np.sqrt(1 - 0.09), 0.02
    frequency = np.array([10.0])

    def phase(slope):
        refocused = otf.refocused(pupil, dz, slope)
        return np.angle(otf.pupil_otf(refocused, WAVELENGTH_NM, frequency, "tangential"))[0]

    expected = -2 * np.pi * frequency[0] * dz * slope
    # The pupil's mean of beta / gamma is that of its centre to half its curvature: 3e-4 of it.
    assert phase(0.0) == pytest.approx(expected, rel=1e-3)
    assert phase(slope) == pytest.approx(0, abs=1e-3 * abs(expected))

"""Wavefront, PSF and transfer function of real surfaces against closed forms.

The lens comes first: surfaces are traced, W is fitted and the PSF computed, with nothing put in by
hand. (test_psf.py has the PSFs of synthetic pupils.) The two functions under test are fixtures, so
that another path can be put through the same tests.
"""

from dataclasses import replace

import numpy as np
import pytest
from lens.made import lens, model
from scipy.integrate import quad, simpson
from scipy.special import j0, j1

from gpusim.formats.lens_file import load_prescription, presets
from gpusim.lens.samples import sample_field, sample_rays
from gpusim.lens.system import build, first_order
from gpusim.lens.wavefront import pupils
from gpusim.psf import otf
from gpusim.psf import psf as reference_psf

D_LINE = np.array([587.5618])
LAMBDA_UM = 0.5875618


@pytest.fixture
def pupil_of():
    """Return a function (system, field in deg, window in um, nodes) to the pupil at the d line."""

    def pupil(system, field_deg=0.0, window_um=64.0, nodes=512):
        samples = sample_field(system, system.index(D_LINE), np.radians(field_deg))
        return pupils(samples, D_LINE, window_um, nodes)[0]

    return pupil


@pytest.fixture
def psf_of():
    """Return a function (pupil, size, pitch in um) to the PSF at the d line."""

    def psf(pupil, size, pitch_um):
        return reference_psf.intensity(pupil, D_LINE[0], size, pitch_um)[0]

    return psf


def perfect_lens(f_number, f=20.0, n=1.5, **fields):
    """Return a lens that images the axis without error: plane, then a hyperboloid (Descartes).

    The diaphragm is the plane face, so that the aperture is what the beam in glass has: its
    marginal ray meets the hyperboloid at height h and leaves at sin theta' in closed form.
    """
    rows = [
        {"radius": np.inf, "thickness": 0.5 * f, **model(n)},
        {"radius": -(n - 1) * f, "conic": -n * n},
    ]
    return lens(rows, f_number=f_number, max_field_deg=1.0, **fields)


def sine_of_aperture(f_number, f=20.0, n=1.5):
    """Return sin theta' of the marginal ray of ``perfect_lens``.

    It leaves the hyperboloid z = -sag(h) towards the focus at f behind the vertex:
    tan theta' = h / (f + sag), with (1 - n^2) sag^2 - 2 (n - 1) f sag + h^2 = 0.
    """
    h = f / f_number / 2
    a, b = n * n - 1, (n - 1) * f
    sag = (-b + np.sqrt(b * b + a * h * h)) / a
    return h / np.hypot(h, f + sag)


def image_of(f_number, apodisation, r_um):
    """Return the PSF of ``perfect_lens``, its stop apodised: light per um^2 of unit power.

    The Hankel transform of the light that falls on the stop at heights h to h + dh, 2 h dh, which
    leaves at sines s(h) to s + ds: the amplitude is sqrt(h dh / (s ds)), of weight d(s^2) = 2 s ds,
    times what the stop passes. By Simpson's rule over h.
    """
    h = np.linspace(1e-6, 1, 4001)
    sine = sine_of_aperture(f_number / h)
    slope = np.gradient(sine, h, edge_order=2)
    passed = np.exp(-apodisation * h * h)
    light = simpson(passed**2 * 2 * h, x=h) * np.pi
    wave = j0(2 * np.pi / LAMBDA_UM * np.outer(r_um, sine)) * passed
    amplitude = simpson(wave * 2 * np.sqrt(h * sine * slope), x=h) * np.pi
    return amplitude**2 / (LAMBDA_UM**2 * light)


def amplitude_at(f_number, rho):
    """Return the amplitude that leaves ``perfect_lens`` at sines rho, over the greatest sine.

    Light that falls on heights h to h + dh, 2 h dh, leaves at sines s to s + ds: see `image_of`.
    """
    h = np.linspace(1e-6, 1, 4001)
    sine = sine_of_aperture(f_number / h)
    amplitude = np.sqrt(h / (sine * np.gradient(sine, h, edge_order=2)))
    return np.interp(rho, sine / sine[-1], amplitude, right=0.0)


def overlaps(f_number, share, passed=lambda rho: 1.0):
    """Return the transfer function of its pupil at shares of the cut-off, by sums over a square."""
    x = (np.arange(2000) + 0.5) / 1000 - 1

    def amplitude(shift):
        rho = np.hypot(x[:, None] + shift, x)
        return np.where(rho < 1, amplitude_at(f_number, rho) * passed(rho), 0.0)

    light = (amplitude(0.0) ** 2).sum()
    return np.array([(amplitude(one) * amplitude(-one)).sum() / light for one in share])


@pytest.mark.parametrize("f_number", [2.8, 4.0, 8.0])
def test_a_perfect_lens_gives_the_image_of_its_pupil(f_number, pupil_of, psf_of):
    system = build(perfect_lens(f_number))
    scale = LAMBDA_UM / (2 * sine_of_aperture(f_number))
    pitch, size = scale / 16, 256
    psf = psf_of(pupil_of(system, window_um=size * pitch), size, pitch)
    at = (np.arange(size) - 128) * pitch
    r = np.unique(np.hypot(at[:, None], at[None]))
    exact = np.interp(np.hypot(at[:, None], at[None]), r, image_of(f_number, 0.0, r))
    assert psf[128, 128] / pitch**2 == pytest.approx(exact.max(), rel=1e-3)
    np.testing.assert_allclose(psf / psf[128, 128], exact / exact.max(), rtol=0, atol=2e-4)
    # A pupil of even amplitude, Airy's, is seen to be another: the lens breaks the sine condition.
    v = np.pi * np.hypot(at[:, None], at[None]) / scale
    airy = np.where(v == 0, 1.0, 2 * j1(v) / np.where(v == 0, 1.0, v)) ** 2
    assert np.abs(psf / psf[128, 128] - airy).max() > 4e-4


def test_a_narrow_perfect_lens_gives_the_airy_pattern(pupil_of, psf_of):
    # At f/32 the sine condition holds to 4e-4.
    system, scale = build(perfect_lens(32.0)), LAMBDA_UM / (2 * sine_of_aperture(32.0))
    pitch, size = scale / 16, 256
    psf = psf_of(pupil_of(system, window_um=size * pitch), size, pitch)
    at = (np.arange(size) - 128) * pitch
    v = np.pi * np.hypot(at[:, None], at[None]) / scale
    airy = np.where(v == 0, 1.0, 2 * j1(v) / np.where(v == 0, 1.0, v)) ** 2
    np.testing.assert_allclose(psf / psf[128, 128], airy, rtol=0, atol=2e-4)
    # First zero: beside it the amplitude is straight, continued from both sides.
    line = np.sqrt(psf_of(pupil_of(system, window_um=4 * scale), 256, scale / 64)[128, 128:])
    low = int(np.argmin(line[: int(1.8 * 64)]))
    left = low - 1 + line[low - 1] / (line[low - 2] - line[low - 1])
    right = low + 1 - line[low + 1] / (line[low + 2] - line[low + 1])
    assert 0.5 * (left + right) / 64 == pytest.approx(1.2196699, rel=1e-3)


@pytest.mark.parametrize("f_number", [2.8, 4.0, 8.0])
def test_a_perfect_lens_has_the_transfer_function_of_its_pupil(f_number, pupil_of, psf_of):
    scale = LAMBDA_UM / (2 * sine_of_aperture(f_number))
    pitch, size = scale / 4, 512
    pupil = pupil_of(build(perfect_lens(f_number)), window_um=size * pitch, nodes=1024)
    otf = np.abs(np.fft.rfft2(psf_of(pupil, size, pitch))[0])
    nu = np.fft.rfftfreq(size, pitch) * scale  # in units of the cut-off
    inner = np.flatnonzero((nu > 0.03) & (nu < 0.97))[::12]  # the window cuts 0.3 % of the light
    np.testing.assert_allclose(otf[inner], overlaps(f_number, nu[inner]), rtol=0, atol=1e-3)


@pytest.mark.parametrize(("f_number", "apodisation"), [(2.8, 1.0), (8.0, 0.3), (8.0, 4.0)])
def test_an_apodised_stop_gives_its_hankel_transform(f_number, apodisation, pupil_of, psf_of):
    system = build(perfect_lens(f_number, gaussian_apodisation=apodisation))
    scale = LAMBDA_UM / (2 * sine_of_aperture(f_number))
    pitch, size = scale / 16, 256
    pupil = pupil_of(system, window_um=size * pitch)
    psf = psf_of(pupil, size, pitch) / pitch**2
    at = (np.arange(size) - 128) * pitch
    exact = image_of(f_number, apodisation, at)
    # As without: the rim's rounding.
    np.testing.assert_allclose(psf[128], exact, rtol=0, atol=2e-4 * exact.max())
    np.testing.assert_allclose(psf[:, 128], exact, rtol=0, atol=2e-4 * exact.max())
    assert psf[128, 128] == pytest.approx(exact[128], rel=2e-4)
    # Another filter, and none, are seen.
    for other in (apodisation + 0.1, 0.0):
        wrong = image_of(f_number, other, at)
        assert np.abs(wrong - exact).max() > 4e-4 * exact.max()


def test_a_stop_that_cuts_nothing_of_a_gaussian_gives_a_gaussian(pupil_of, psf_of):
    # exp(-9) = 1e-4 of the amplitude at the rim. Amplitude exp(-G (s / s0)^2) in the pupil, so
    # exp(-(pi s0 r / lambda)^2 / G) in the image, and its square; 2 pi s0^2 / (G lambda^2) at the
    # middle of unit power. The sine falls short of its slope on the axis, s0 = 1 / (2 N), by 1e-3
    # at the rim and by 1 / G of that where the light is.
    g, sine = 9.0, 1 / 40
    pupil = pupil_of(build(perfect_lens(20.0, gaussian_apodisation=g)), window_um=512)
    psf = psf_of(pupil, 256, 2.0)
    at = 2.0 * (np.arange(256) - 128.0)
    exact = np.exp(-2 * (np.pi * sine * at / LAMBDA_UM) ** 2 / g)
    peak = 2 * np.pi * sine**2 / (g * LAMBDA_UM**2)
    assert psf[128, 128] / 4 == pytest.approx(peak, rel=1e-3)
    np.testing.assert_allclose(psf[128] / 4, peak * exact, rtol=0, atol=1e-3 * peak)
    # No ring of Airy's, 1.7e-2 of the peak.
    assert psf[128, np.abs(at) > 50].max() < 1e-4 * peak
    # What passes: pi s0^2 times the mean of exp(-2 G rho^2).
    even = np.pi * sine**2
    assert pupil.projected_solid_angle_sr == pytest.approx(
        even * (1 - np.exp(-2 * g)) / (2 * g), rel=1e-3
    )


def test_an_apodised_lens_has_its_pupils_transfer_function(pupil_of, psf_of):
    # The OTF of the line spread and of the pupil's overlap are those of the PSF.
    system = build(perfect_lens(4.0, gaussian_apodisation=1.0))
    pupil = pupil_of(system, window_um=128.0)
    nu = np.array([50.0, 150.0, 300.0])
    found = otf.pupil_otf(pupil, D_LINE[0], nu, "sagittal").real
    share = nu * 1e-3 * LAMBDA_UM / (2 * sine_of_aperture(4.0))
    exact = overlaps(4.0, share, lambda rho: np.exp(-(rho**2)))
    # 2.5e-3 of the rim's cells (line_spread), where there is little light; the filter goes with the
    # height, which the sine follows to 6e-3.
    np.testing.assert_allclose(found, exact, rtol=0, atol=1.5e-3)
    for one, expected in zip(nu, exact, strict=True):
        still = np.zeros(1)
        overlap = otf.through_focus(pupil, D_LINE[0], one, "tangential", still)[0]
        assert abs(overlap - expected) < 1.5e-3
    even = pupil_of(build(perfect_lens(4.0)), window_um=128.0)
    assert np.abs(otf.pupil_otf(even, D_LINE[0], nu, "sagittal") - exact).max() > 0.05


def hopkins(s, w20_waves):
    """Return the OTF of a defocused circular pupil (Hopkins, Proc. R. Soc. A 231, 91, 1955).

    ``s`` is the frequency over the cut-off, ``w20_waves`` the defocus at the rim. Overlap of two
    discs 2 s apart, in which the difference of the two quadratic phases is linear.
    """

    def chord(x):
        return np.cos(8 * np.pi * w20_waves * s * x) * np.sqrt(1 - (x + s) ** 2)

    return 4 / np.pi * quad(chord, 0, 1 - s, epsabs=1e-10)[0]


@pytest.mark.parametrize("w20_waves", [0.25, 0.5, 1.0])
def test_defocus_gives_the_transfer_function_of_hopkins(w20_waves, pupil_of, psf_of):
    f_number = 8.0
    sine = sine_of_aperture(f_number)
    system = build(perfect_lens(f_number))
    # dz (1 - gamma) = dz sin^2 / 2 but for sin^2 / 4 = 1e-3 of it, 0.001 waves at the rim.
    shift_mm = 2 * w20_waves * LAMBDA_UM * 1e-3 / sine**2
    system = replace(system, image_z_mm=system.image_z_mm + shift_mm)
    scale = LAMBDA_UM / (2 * sine)
    pitch, size = scale / 4, 512
    psf = psf_of(pupil_of(system, window_um=size * pitch, nodes=1024), size, pitch)
    otf = np.fft.rfft2(np.fft.ifftshift(psf))[0]
    assert np.abs(otf.imag).max() < 1e-3  # the centre is the chief ray's point
    nu = np.fft.rfftfreq(size, pitch) * scale
    inner = (nu > 0.03) & (nu < 0.97)
    expected = [hopkins(s, w20_waves) for s in nu[inner]]
    # What the window cuts, 0.3 % of the light, and the 0.001 waves times 2 pi / 4.
    np.testing.assert_allclose(otf.real[inner], expected, rtol=0, atol=4e-3)
    # One wave turns the contrast over: the sign is tested too.
    assert w20_waves < 1 or min(expected) < -0.05


@pytest.mark.parametrize("w20_waves", [0.3, 1.5])
def test_defocus_darkens_the_centre_as_sinc_squared(w20_waves, pupil_of, psf_of):
    f_number = 8.0
    sine = sine_of_aperture(f_number)
    peaks = []
    for waves in (0.0, w20_waves):
        system = build(perfect_lens(f_number))
        shift_mm = waves * LAMBDA_UM * 1e-3 / (1 - np.sqrt(1 - sine**2))
        system = replace(system, image_z_mm=system.image_z_mm + shift_mm)
        peaks.append(psf_of(pupil_of(system), 64, 0.5)[32, 32])
    # Born & Wolf, sec. 8.8.2; the pupil's weight in gamma instead of sin^2 changes it by 1e-3.
    assert peaks[1] / peaks[0] == pytest.approx(np.sinc(w20_waves) ** 2, abs=2e-4)


def test_an_ellipsoid_images_a_distant_point_without_error(pupil_of):
    # Descartes: light from infinity enters glass through an ellipsoid of conic constant -1 / n^2
    # and meets at n R / (n - 1); a sphere about that point lets it out undeviated.
    n, radius, thickness = 1.6, 12.0, 9.0
    focus = n * radius / (n - 1)
    rows = [
        {"radius": radius, "conic": -1 / n**2, "thickness": thickness, **model(n)},
        {"radius": focus - thickness},
    ]
    system = build(lens(rows, f_number=1.5, max_field_deg=1.0))
    assert system.image_z_mm == pytest.approx(focus, rel=1e-13)
    pupil = pupil_of(system)
    assert np.abs(pupil.opd_mm[pupil.coverage > 0]).max() < 1e-9
    assert pupil.fit_residual_mm < 1e-12
    # A sphere in its place is worse by far.
    rows[0]["conic"] = 0.0
    bad = pupil_of(build(lens(rows, f_number=1.5, max_field_deg=1.0)))
    assert np.abs(bad.opd_mm[bad.coverage > 0]).max() > 1e-2


def test_spherical_aberration_of_a_sphere_tends_to_seidels_sum():
    # Collimated light in glass leaves through a sphere of radius -r: S_I = -A^2 h (u' / n' - u / n)
    # with A = -n h / r and u' = -(n - 1) h / r, so W = S_I / 8 = n^2 (n - 1) h^4 / (8 r^3)
    # (Welford 1986, ch. 8). Under-corrected light is ahead at the rim: less path, W < 0.
    n, r = 1.5, 25.0
    rows = [{"radius": np.inf, "thickness": 5.0, **model(n)}, {"radius": -r}]
    system = build(lens(rows, f_number=4.0))
    h = np.array([0.5, 1.0])
    rays = sample_rays(system, system.index(D_LINE), 0.0, np.zeros(2), h)
    ratio = rays.opd_mm[0] / (-(n**2) * (n - 1) * h**4 / (8 * r**3))
    # The next order is of (h / r)^2, here 1.6e-3 and four times less; what is left is of its
    # square, 3e-6, and rounding of 1e-15 mm in 6e-7 mm.
    assert ratio[1] == pytest.approx(1, abs=0.02)
    assert (4 * ratio[0] - ratio[1]) / 3 == pytest.approx(1, abs=2e-5)


@pytest.mark.parametrize("angle", [10.0, 25.0, 40.0])
def test_light_through_a_thin_lens_spreads_as_coddington_says(angle, pupil_of):
    # The stop at a thin lens: a narrow beam at theta meets the sagittal power
    # K = (n cos theta' - cos theta) / (n - 1) of that on axis and K / cos^2 theta tangentially. Its
    # width there is cos theta, so the solid angle is K^2 / cos theta, and projected K^2.
    n = 1.5
    rows = [{"radius": 100.0, "thickness": 1e-3, **model(n)}, {"radius": -100.0}]
    system = build(lens(rows, f_number=200.0, max_field_deg=45.0))
    theta = np.radians(angle)
    inside = np.sqrt(1 - (np.sin(theta) / n) ** 2)
    power = (n * inside - np.cos(theta)) / (n - 1)
    areas = [pupil_of(system, field).projected_solid_angle_sr for field in (0.0, angle)]
    # Beams of f/200 and a lens of 1e-5 f: both count for 1e-5.
    assert areas[1] / areas[0] == pytest.approx(power**2, rel=5e-5)


@pytest.mark.parametrize("angle", [10.0, 25.0, 40.0])
def test_a_ball_lens_darkens_as_cos_squared(angle, pupil_of):
    # Every beam meets the ball alike. The stop at its centre is foreshortened by cos theta, and the
    # cone is projected on the image plane under cos theta; the distance does not change.
    n, r = 1.5, 10.0
    rows = [
        {"radius": r, "thickness": r, **model(n)},
        {"radius": np.inf, "thickness": r, **model(n)},
        {"radius": -r},
    ]
    system = build(lens(rows, stop=2, f_number=200.0, max_field_deg=45.0))
    areas = [pupil_of(system, field).projected_solid_angle_sr for field in (0.0, angle)]
    expected = np.cos(np.radians(angle)) ** 2
    assert areas[1] / areas[0] == pytest.approx(expected, rel=5e-5)


@pytest.mark.parametrize("name", presets())
def test_chief_rays_near_the_axis_measure_the_focal_length(name):
    # In the paraxial focal plane y = f tan theta to first order; distortion and pupil aberration
    # are of theta^2 = 3e-6 and of order one for a fisheye.
    system = build(load_prescription(name).model_copy(update={"focus": "paraxial"}))
    reference = np.array([system.prescription.reference_nm])
    theta = np.radians(0.1)
    index = system.index(reference)
    chief = sample_rays(system, index, theta, np.zeros(1), np.zeros(1))
    efl = first_order(system.prescription).efl_mm
    assert chief.chief_y_mm[0] / np.tan(theta) == pytest.approx(efl, rel=5e-6)

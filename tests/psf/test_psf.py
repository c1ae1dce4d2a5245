"""PSFs against Airy's closed forms, and against the spot diagram of the same rays."""

import numpy as np
import pytest
from lens.made import disc_samples, lens, model
from scipy.special import j0, j1

from gpusim.formats.lens_file import load_prescription
from gpusim.lens.samples import sample_field
from gpusim.lens.system import build
from gpusim.lens.wavefront import pupils
from gpusim.psf.boundary_wave import rim_lost
from gpusim.psf.psf import folded_share, intensity
from gpusim.psf.wave import wave_of

WAVELENGTH_NM = 550.0
WAVELENGTH_UM = 0.55


def perfect(f_number, window_um, nodes=512, **kwargs):
    """Return the pupil of a perfect lens: a disc of radius sin(theta') = 1 / (2 N)."""
    samples = disc_samples(0.5 / f_number, **kwargs)
    return pupils(samples, np.array([WAVELENGTH_NM]), window_um, nodes)[0]


@pytest.mark.parametrize("f_number", [2.0, 2.8, 8.0])
def test_perfect_pupil_gives_the_airy_pattern(f_number):
    scale = WAVELENGTH_UM * f_number
    pitch, size = scale / 16, 256
    psf, _ = intensity(perfect(f_number, size * pitch), WAVELENGTH_NM, size, pitch)
    # Peak irradiance pi / (4 lambda^2 N^2) of unit power (Born & Wolf, sec. 8.5.2).
    peak = psf[128, 128] / pitch**2
    assert peak == pytest.approx(np.pi / (4 * scale**2), rel=1e-4)
    # The whole pattern, within the rim's rounding (see PUPIL_NODES): a share of the peak.
    at = (np.arange(size) - 128) * pitch
    v = np.pi * np.hypot(at[:, None], at[None]) / scale
    airy = np.where(v == 0, 1.0, 2 * j1(v) / np.where(v == 0, 1.0, v)) ** 2
    np.testing.assert_allclose(psf / psf[128, 128], airy, rtol=0, atol=1e-4)


@pytest.mark.parametrize("f_number", [2.0, 2.8, 8.0])
@pytest.mark.parametrize("direction", ["tangential", "sagittal"])
def test_first_zero_lies_at_1_22_lambda_n(f_number, direction):
    scale = WAVELENGTH_UM * f_number
    pitch, size = scale / 64, 256
    psf, _ = intensity(perfect(f_number, size * pitch), WAVELENGTH_NM, size, pitch)
    line = np.sqrt(psf[128, 128:] if direction == "tangential" else psf[128:, 128])
    low = int(np.argmin(line[: int(1.8 * 64)]))
    # Beside the zero the amplitude is straight: continue it from both sides.
    left = low - 1 + line[low - 1] / (line[low - 2] - line[low - 1])
    right = low + 1 - line[low + 1] / (line[low + 2] - line[low + 1])
    zero = 0.5 * (left + right) * pitch
    assert zero == pytest.approx(1.2196699 * scale, rel=1e-3)


@pytest.mark.parametrize("f_number", [2.0, 2.8, 8.0])
def test_mtf_of_a_perfect_pupil_is_the_diffraction_limit(f_number):
    scale = WAVELENGTH_UM * f_number
    pitch, size = scale / 4, 512
    psf, outside = intensity(perfect(f_number, size * pitch, 1024), WAVELENGTH_NM, size, pitch)
    otf = np.abs(np.fft.fft2(psf))
    for axis in (otf[0], otf[:, 0]):
        nu = np.fft.fftfreq(size, pitch)[: size // 2] * scale  # in units of the cut-off
        inner = (nu > 0.03) & (nu < 0.97)
        s = nu[inner]
        limit = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
        # Cutting the window takes 0.3 % of the light from frequencies near 0 and the cut-off;
        # between them what is left is below 1e-3.
        np.testing.assert_allclose(axis[: size // 2][inner], limit, rtol=0, atol=1e-3)
    assert otf[0, 0] == pytest.approx(1 - outside, abs=1e-12)


def test_energy_within_a_circle_is_rayleighs_closed_form():
    f_number = 4.0
    scale = WAVELENGTH_UM * f_number
    pitch, size = scale / 8, 256
    psf, outside = intensity(perfect(f_number, size * pitch, 1024), WAVELENGTH_NM, size, pitch)
    at = (np.arange(size) - 128) * pitch
    radius = np.hypot(at[:, None], at[None])
    for r in (3.24 * scale, 10.24 * scale):
        v = np.pi * r / scale
        # Rayleigh 1881 (Born & Wolf, sec. 8.5.2). At dark rings the jagged edge counts for little:
        # measured 2e-4 at most.
        assert psf[radius < r].sum() == pytest.approx(1 - j0(v) ** 2 - j1(v) ** 2, abs=5e-4)
    # The square of half-width 16 lambda N lies between its inner and outer circles.
    v = np.pi * scale * 16 / scale
    assert 2 / (np.pi * v * 2**0.5) < outside < 2 / (np.pi * v)


def test_a_tilted_wavefront_moves_the_psf_to_where_its_rays_land():
    # W = -10 um beta: every ray lands at xi = -dW / d beta = +10 um.
    pupil = perfect(4.0, 128, opd=lambda a, b: -10e-3 * b)
    psf, _ = intensity(pupil, WAVELENGTH_NM, 256, 0.5)
    assert np.unravel_index(np.argmax(psf), psf.shape) == (128, 128 + 20)


def test_coma_flares_to_the_side_where_its_rays_land():
    def image(sign):
        pupil = perfect(4.0, 128, opd=lambda a, b: sign * 0.15 * (a * a + b * b) * b)
        return intensity(pupil, WAVELENGTH_NM, 256, 0.5)[0]

    # Coma W = c r^2 b: rays land at xi = -c (a^2 + 3 b^2), all on the negative side for c > 0.
    plus, minus = image(1), image(-1)
    assert plus[:, :128].sum() > 0.7 * plus.sum()
    # The other sign mirrors it about xi = 0 (the first column, at -size / 2, has no mirror image).
    # The rim is followed on every fourth node, which do not mirror one another: 4e-9.
    np.testing.assert_allclose(plus[:, 1:], minus[:, :0:-1], rtol=0, atol=1e-8)


@pytest.mark.parametrize("stop", [1, 3])
def test_psf_and_spot_diagram_agree_in_centroid_and_in_the_side_of_the_flare(stop):
    # A singlet off axis: strong coma. Stop before or behind the lens, so both pupil orientations.
    rows = [
        {"radius": np.inf, "thickness": 1.0},
        {"radius": 5.0, "thickness": 1.0, **model(1.5)},
        {"radius": -60.0, "thickness": 1.0},
        {"radius": np.inf},
    ]
    if stop == 1:
        rows = rows[:3]
        rows[2].pop("thickness")
        number = 1
    else:
        rows = rows[1:]
        number = 3
    system = build(lens(rows, stop=number, f_number=5.0, max_field_deg=8.0, focus="best"))
    wavelengths = np.array([WAVELENGTH_NM])
    samples = sample_field(system, system.index(wavelengths), np.radians(8.0))
    (pupil,) = pupils(samples, wavelengths, 256, 512)
    psf, outside = intensity(pupil, WAVELENGTH_NM, 512, 0.5)
    slope = -np.gradient(1e3 * pupil.opd_mm, pupil.beta, axis=1)
    mean_landing = np.average(slope, weights=pupil.light)
    at = (np.arange(512) - 256) * 0.5
    column = psf.sum(axis=0) / psf.sum()
    centroid = float((column * at).sum())
    # The mean landing point is the centroid of the diffraction image too. The window cuts the
    # tails, which hold `outside`, at 128 um: unequal tails could move it by outside * 128 / 4.
    assert centroid == pytest.approx(mean_landing, abs=outside * 32)
    assert abs(mean_landing) > 10 * outside * 32
    # Traced rays, no fit: the flare is on the side of the ray that lands farthest out.
    rays = samples.landing_y_mm[samples.inside] * 1e3
    far = rays[np.argmax(np.abs(rays))]
    assert np.sign(far) == np.sign(mean_landing)
    beyond = 0.75 * abs(far)
    assert column[at * np.sign(far) > beyond].sum() > 3 * column[at * np.sign(far) < -beyond].sum()
    # Symmetric about the meridional plane.
    np.testing.assert_allclose(psf[1:], psf[:0:-1], rtol=0, atol=1e-15)


def test_folding_is_reported():
    assert folded_share(perfect(2.8, 128), WAVELENGTH_NM, 256, 0.5) == 0
    # Defocused until rays land up to 4 mm / (2 N) = 710 um away; copies come every 580 um.
    blurred = perfect(2.8, 128, opd=lambda a, b: 2.0 * (a * a + b * b))
    share = folded_share(blurred, WAVELENGTH_NM, 256, 0.5)
    assert 0.05 < share < 0.95


def test_more_pupil_nodes_change_nothing(demo_lens):
    system = build(demo_lens)
    wavelengths = np.array([400.0])
    samples = sample_field(system, system.index(wavelengths), np.radians(10.0))
    results = []
    for nodes in (512, 1024):
        (pupil,) = pupils(samples, wavelengths, 128, nodes)
        results.append(intensity(pupil, 400.0, 256, 0.5)[0])
    # The figure beside PUPIL_NODES.
    assert np.abs(results[0] - results[1]).max() < 4e-4 * results[1].max()


@pytest.mark.parametrize("f_number", [2.0, 2.8])
def test_light_that_the_rim_throws_is_not_dimmed_by_the_rims_cells(f_number):
    """Airy's pattern far out, in the mean over rings: Born & Wolf, sec. 8.5.2."""
    size, pitch, scale = 256, 0.5, WAVELENGTH_UM * f_number
    pupil = perfect(f_number, size * pitch)
    psf, _ = intensity(pupil, WAVELENGTH_NM, size, pitch)
    at = (np.arange(size) - size // 2) * pitch
    r = np.hypot(at[:, None], at)
    v = np.pi * np.maximum(r, 1e-9) / scale
    airy = (2 * j1(v) / v) ** 2 * np.pi * pitch**2 / (4 * scale**2)
    period = 1e-3 * WAVELENGTH_NM / (pupil.beta[1] - pupil.beta[0])
    dimmed = np.sinc(at[:, None] / period) ** 2 * np.sinc(at / period) ** 2
    for low, high in ((20, 40), (40, 64)):
        ring = (r >= low) & (r < high)
        found, planted = (np.sum(one[ring]) / airy[ring].sum() - 1 for one in (psf, airy * dimmed))
        # Copies interfere with the rim's light, and are taken to add up: 1.5e-3 at f/2.
        assert abs(found) < 2e-3
        # Without the factors the rim's light is dimmed by more.
        assert planted < -4e-3


def test_a_coarse_pupil_throws_as_much_as_a_fine_one_where_its_rays_land_far_off():
    """The rim of an aberrated pupil throws its light about where its own rays land."""
    system = build(load_prescription("double-gauss").scaled(25.0).stopped(2.8))
    samples = sample_field(system, system.index(np.array([WAVELENGTH_NM])), np.radians(10.0))
    size, pitch = 256, 0.5
    at = (np.arange(size) - size // 2) * pitch
    r = np.hypot(at[:, None], at)
    found, raw = [], []
    for nodes in (256, 2048):
        (pupil,) = pupils(samples, np.array([WAVELENGTH_NM]), 1.0, nodes)
        period = [1e-3 * WAVELENGTH_NM / (one[1] - one[0]) for one in (pupil.alpha, pupil.beta)]
        psf = intensity(pupil, WAVELENGTH_NM, size, pitch)[0]
        lost = rim_lost(wave_of(pupil, 4), 1e-3 * WAVELENGTH_NM, size, pitch, period)
        rings = [(r >= low) & (r < low + 12) for low in (24, 36, 48)]
        found.append(np.array([psf[ring].sum() for ring in rings]))
        raw.append(np.array([(psf - lost)[ring].sum() for ring in rings]))
    assert np.abs(found[0] / found[1] - 1).max() < 5e-3
    assert np.abs(raw[0] / raw[1] - 1).max() > 2e-2

"""Kernels at the PSF nodes: their band, cores and tails, against Gaussians in closed form."""

import numpy as np
import pytest
from harness import assert_close
from optics.made import at_lines, bank
from optics.whole import LENS, WEIGHTS, everything

from gpusim.optics import kernels as optics_kernels
from gpusim.optics.images import field_images
from gpusim.optics.kernel_spectra import aperture_spectra
from gpusim.optics.kernels import (
    BAND_EDGE,
    CUT_EDGE,
    SOFT_EDGE,
    FieldKernels,
    core_window,
    distances_um,
    field_kernels,
    low_pass,
    sharpening,
)
from gpusim.optics.sampling import sampled_kernels


def test_the_band_ends_at_nyquist():
    nyquist = 0.5 / 0.775
    f = np.array([0.0, BAND_EDGE, (1 + BAND_EDGE) / 2, 1.0, 1.3]) * nyquist
    assert_close(low_pass(f, 0.775), np.array([1, 1, 0.5, 0, 0]), atol=1e-12)


def sharp(kernels: FieldKernels, sampled: np.ndarray) -> np.ndarray:
    """Return sampled kernels (..., n, n) with the band of their sim grid."""
    if not kernels.ringing:
        return sampled
    n = sampled.shape[-1]
    f = np.fft.fftfreq(2 * n)
    spectra = np.fft.fft2(sampled, (2 * n, 2 * n)) * sharpening(np.hypot(f, f[:, None]))
    return np.fft.ifft2(spectra).real[..., :n, :n]


def test_kernels_that_end_softly_are_sharpened_to_the_band_of_the_grid():
    f = np.linspace(0.0, 0.6, 301)
    soft = low_pass(f, 1.0, SOFT_EDGE)
    # A quotient times its divisor: two roundings of at most 1.
    assert_close(soft * sharpening(f), low_pass(f, 1.0), atol=4 * 2.0**-53)
    # Both are raised cosines: next to the Nyquist frequency their squares are as their widths.
    most = ((1 - SOFT_EDGE) / (1 - BAND_EDGE)) ** 2
    assert sharpening(f).max() < most and sharpening(np.array([0.4999]))[0] > 0.99 * most


@pytest.mark.parametrize("ringing", [False, True])
def test_next_to_a_bright_edge_sharp_psfs_leave_the_dark_dark(monkeypatch, ringing: bool):
    """PSFs of 0.35 um, pixels of 4 um with two samples each: a line of pixels from the edge."""
    lens = bank(sigma_um=(0.35,) * 3, lateral=(0.0,) * 3, coma_um=0.0)
    images, places = field_images(lens, at_lines(lens, np.ones((1, 1, 3))), 1e9)
    if not ringing:  # the control: kernels that end sharply, and ring
        monkeypatch.setattr(optics_kernels, "SOFT_EDGE", BAND_EDGE)
    kernels = field_kernels(images, places, 0.5, 2.0, np.ones(images.shape[-2:]))
    assert kernels.ringing
    length, half = 256, 28
    across = sampled_kernels(kernels, 0.0, 0.0, 2.0, half, planes=1)[0, 0].sum(axis=0)
    held = np.zeros(length)
    held[np.arange(-half, half)] = across / across.sum()
    # An upright edge sees the frequencies across alone; the pixel is two samples wide.
    found = np.fft.fft(held) * aperture_spectra(length, 2.0, 0.0, 0.0, 0.0, ringing=True)[0]
    f = np.fft.fftfreq(length)
    psf = images[0, 0, 0].sum(axis=0).astype(float)
    at = 0.25 * (np.arange(len(psf)) - len(psf) // 2)  # sim samples
    transfer = np.cos(2 * np.pi * f[:, None] * at) @ psf / psf.sum()
    expected = transfer * low_pass(np.abs(f), 1.0) * np.sinc(2 * f)
    expected[length // 2] = 0.0
    away = np.abs(np.arange(length) - length // 2) - 64
    error = np.fft.ifft(np.fft.fft((away < 0).astype(float)) * (found - expected)).real
    # A raised cosine that falls over w of the Nyquist frequency rings at x samples with
    # 1 / (pi x (w^2 x^2 - 1)): beyond the 24 that are held lies 1 / (2 pi w^2 24^2) of the light
    # at most, 3e-4 where it falls over all of the band and 1.2e-2 over a seventh of it. Where edges
    # see it, next to the Nyquist frequency, the aperture passes (1 - f / Nyquist) / 2, hundredths.
    worst = np.abs(error[(away >= 2) & (away < 40)]).max()
    assert worst < 1e-5 if ringing else worst > 4e-4


def test_core_and_tail_make_the_whole():
    r = np.array([0.0, CUT_EDGE, (1 + CUT_EDGE) / 2, 1.0, 2.0]) * 6.0
    assert_close(core_window(r, 6.0), np.array([1, 1, 0.5, 0, 0]), atol=1e-12)
    images, places = field_images(LENS, at_lines(LENS, WEIGHTS), 1e9)
    core = core_window(distances_um(images.shape[-1], 0.5), 4.0)
    assert core[64, 64] == 1 and core[64, 64 + 8] == core[64 - 8, 64] == 0  # 8 x 0.5 um, centred
    assert core[64, 64 + 6] == pytest.approx(0.5)
    parts = [field_kernels(images, places, 0.5, 0.775, part) for part in (core, 1 - core)]
    sizes = [part.splines.shape[-1] for part in parts]
    assert sizes[0] < sizes[1]  # of the core, as many samples as it is wide
    assert [part.ringing for part in parts] == [False, True]  # the tail has a hole
    for height in (0.0, 40.0, 95.0):
        core, tail, whole = (
            sharp(
                kernels, sampled_kernels(kernels, 0.6 * height, 0.8 * height, 0.775, 40, planes=2)
            )
            for kernels in (*parts, everything(pitch_um=0.775))
        )
        # What rings beyond 16 um around the core comes in again on the other side: the band's edge,
        # 0.097 cycles/um wide, rings there with 1 / (2 pi 16 (2 pi 16 0.097)^2) = 1e-4 of what
        # the sharp end of the core, 0.1 of the peak in 4 um, holds at the band's end.
        # Sharpening makes up to 44 of a rounding of float32 in the tail's samples, both ways.
        assert_close(core + tail, whole, atol=(1e-5 + 2 * 44 * 2.0**-24) * whole.max())
        assert tail.max() > 0.01 * whole.max()


def test_a_coarse_band_takes_fewer_samples(monkeypatch: pytest.MonkeyPatch):
    """Every second or fourth sample makes the same kernels, if three remain to the sim grid's."""
    images, places = field_images(LENS, at_lines(LENS, WEIGHTS), 1e9)

    def made(ratio: float) -> tuple[float, np.ndarray]:
        pitch_um = 0.5 * ratio
        kernels = field_kernels(images, places, 0.5, pitch_um, np.ones(images.shape[-2:]))
        assert kernels.splines.shape[-1] * kernels.pitch_um >= 64.0
        return kernels.pitch_um, sampled_kernels(
            kernels, 30.0, 40.0, pitch_um, int(26 / pitch_um), planes=2
        )

    for ratio, pitch_um in ((5.9, 0.5), (6.1, 1.0), (12.3, 2.0)):
        few = made(ratio)
        with monkeypatch.context() as patch:
            patch.setattr(optics_kernels, "SAMPLES_WITHIN", 100.0)
            all_of_them = made(ratio)
        assert (few[0], all_of_them[0]) == (pitch_um, 0.5)
        # Quintic splines err by (f / (1 - f))^6 of a wave of f cycles a sample (Unser 1999): 4e-5
        # at the end of the band, 0.16, along each axis.
        assert_close(few[1], all_of_them[1], atol=1e-4 * few[1].max())


@pytest.mark.parametrize("skew_um", [0.0, 2.0])
def test_mirrored_places_have_mirrored_kernels(skew_um: float):
    """If the PSFs are symmetric; and the kernels say whether."""
    kernels = everything(bank(skew_um=skew_um), pitch_um=0.775)
    assert kernels.mirrored == (skew_um == 0.0)
    at = (50.0, 30.0)
    one = sampled_kernels(kernels, *at, 0.775, 24, planes=2)
    for axis, other in ((-1, (-50.0, 30.0)), (-2, (50.0, -30.0))):
        turned = np.roll(
            np.flip(sampled_kernels(kernels, *other, 0.775, 24, planes=2), axis), 1, axis
        )
        error = np.abs(turned - one).max() / one.max()
        assert (error < 1e-6) == (skew_um == 0.0) and (error > 0.01) == (skew_um > 0.0)


def test_a_sharp_psf_keeps_its_energy_at_every_azimuth():
    """Samples of 0.3875 um along the bank's axes meet what splines add at 2 cycles/um; 45 deg not.

    They meet it at 2.58 cycles/um, where a quintic spline has sinc(1.29)^6 / 0.55 = 1e-4 of the
    0.26 that a Gaussian of 0.45 um has at 0.58; along two axes and to both sides 1e-4. With a cubic
    one it would be sinc(1.29)^4 / 0.58 = 2.4e-3, and 2.5e-3 in all.
    """
    sharp = bank(sigma_um=(0.45,) * 3, coma_um=0.0, falloff=0.0, lateral=(0.0, 0.0, 0.0))
    kernels = everything(sharp, np.ones((1, 1, 3)), pitch_um=1.55 / 4)
    sums = [
        sampled_kernels(kernels, 80 * np.cos(a), 80 * np.sin(a), 1.55 / 4, 48, planes=1).sum()
        for a in np.radians([0, 4, 20, 45, 90])
    ]
    assert_close(np.array(sums), np.full(5, 3.0), rtol=2e-4)


def test_sharp_psfs_on_a_coarse_grid_keep_the_light_that_rings_beyond_it():
    """PSFs of 0.35 um on samples of 4.1 um within 41: what is sampled there alone is 5 % off."""
    lens = bank(sigma_um=(0.35,) * 3, lateral=(0.0,) * 3)
    images, places = field_images(lens, at_lines(lens, np.ones((1, 1, 3))), 1e9)
    kernels = field_kernels(images, places, 0.5, 4.1, np.ones(images.shape[-2:]))
    for x_um, y_um in ((0.0, 0.0), (40.0, 25.0), (-70.0, 60.0)):
        fields, weights, *_ = places.at(x_um, y_um)
        whole = np.asarray(weights) @ images[list(fields), 0, 0].sum(axis=(1, 2), dtype=float)
        found = sampled_kernels(kernels, x_um, y_um, 4.1, 10, planes=1)
        assert found.sum() == pytest.approx(whole, rel=2e-6)


def test_psfs_narrower_than_a_sample_are_held_as_far_as_they_ring():
    pitch_um, size = 30.0, 24
    images, places = field_images(LENS, at_lines(LENS, WEIGHTS), 1e9)
    found = field_kernels(images, places, 0.5, pitch_um, np.ones(images.shape[-2:]))
    held = sampled_kernels(found, 0.0, 0.0, pitch_um, size, planes=1)[0]
    # A point, of which the soft band is all that is left.
    f = np.fft.fftfreq(512, pitch_um)
    band = low_pass(np.hypot(f, f[:, None]), pitch_um, SOFT_EDGE)
    point = np.fft.fftshift(np.fft.ifft2(band).real)
    near = slice(256 - size + 1, 256 + size)
    truth = point[near, near] * images[0, 0].sum(axis=(1, 2))[:, None, None]
    # PSFs 1.15 um wide pass exp(-2 (pi 1.15 / 60)^2) = 0.993 at the band's end; what lies beyond
    # the samples, 1e-3 of the light, is added to what is there.
    assert found.ringing
    assert_close(held[:, 1:, 1:], truth, atol=0.006 * truth.max())

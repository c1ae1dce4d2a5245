"""Kernels at the PSF nodes: their band, cores and tails, against Gaussians in closed form."""

import numpy as np
import pytest
from harness import assert_close
from optics.made import at_lines, bank
from optics.whole import LENS, WEIGHTS, everything

from gpusim.optics import kernels as optics_kernels
from gpusim.optics.images import field_images
from gpusim.optics.kernels import (
    BAND_EDGE,
    CUT_EDGE,
    core_window,
    distances_um,
    field_kernels,
    low_pass,
)
from gpusim.optics.sampling import sampled_kernels


def test_the_band_ends_at_nyquist():
    nyquist = 0.5 / 0.775
    f = np.array([0.0, BAND_EDGE, (1 + BAND_EDGE) / 2, 1.0, 1.3]) * nyquist
    assert_close(low_pass(f, 0.775), np.array([1, 1, 0.5, 0, 0]), atol=1e-12)


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
    for height in (0.0, 40.0, 95.0):
        core, tail, whole = (
            sampled_kernels(kernels, 0.6 * height, 0.8 * height, 0.775, 40, 2)
            for kernels in (*parts, everything(pitch_um=0.775))
        )
        # What rings beyond 16 um around the core comes in again on the other side: the band's edge,
        # 0.097 cycles/um wide, rings there with 1 / (2 pi 16 (2 pi 16 0.097)^2) = 1e-4 of what
        # the sharp end of the core, 0.1 of the peak in 4 um, holds at the band's end.
        assert_close(core + tail, whole, atol=1e-5 * whole.max())
        assert tail.max() > 0.01 * whole.max()


def test_a_coarse_band_takes_fewer_samples(monkeypatch: pytest.MonkeyPatch):
    """Every second or fourth sample makes the same kernels, if three remain to the sim grid's."""
    images, places = field_images(LENS, at_lines(LENS, WEIGHTS), 1e9)

    def made(ratio: float) -> tuple[float, np.ndarray]:
        pitch_um = 0.5 * ratio
        kernels = field_kernels(images, places, 0.5, pitch_um, np.ones(images.shape[-2:]))
        assert kernels.splines.shape[-1] * kernels.pitch_um >= 64.0
        return kernels.pitch_um, sampled_kernels(
            kernels, 30.0, 40.0, pitch_um, int(26 / pitch_um), 2
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
    one = sampled_kernels(kernels, *at, 0.775, 24, 2)
    for axis, other in ((-1, (-50.0, 30.0)), (-2, (50.0, -30.0))):
        turned = np.roll(np.flip(sampled_kernels(kernels, *other, 0.775, 24, 2), axis), 1, axis)
        error = np.abs(turned - one).max() / one.max()
        assert (error < 1e-6) == (skew_um == 0.0) and (error > 0.01) == (skew_um > 0.0)


def test_a_sharp_psf_keeps_its_energy_at_every_azimuth():
    """Samples of 0.3875 um along the bank's axes meet what splines add at 2 cycles/um; 45 deg not.

    They meet it at 2.58 cycles/um, where a quintic spline has sinc(1.29)^6 / 0.55 = 1e-4 of the
    0.26 that a Gaussian of 0.45 um has at 0.58; along two axes and to both sides 1e-4. Of a cubic
    one it would be sinc(1.29)^4 / 0.58 = 2.4e-3, and 2.5e-3 in all.
    """
    sharp = bank(sigma_um=(0.45,) * 3, coma_um=0.0, falloff=0.0, lateral=(0.0, 0.0, 0.0))
    kernels = everything(sharp, np.ones((1, 1, 3)), pitch_um=1.55 / 4)
    sums = [
        sampled_kernels(kernels, 80 * np.cos(a), 80 * np.sin(a), 1.55 / 4, 48, 1).sum()
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
        found = sampled_kernels(kernels, x_um, y_um, 4.1, 10, 1)
        assert found.sum() == pytest.approx(whole, rel=2e-6)


def test_psfs_narrower_than_a_sample_are_held_as_far_as_they_ring():
    pitch_um, size = 30.0, 24
    images, places = field_images(LENS, at_lines(LENS, WEIGHTS), 1e9)
    found = field_kernels(images, places, 0.5, pitch_um, np.ones(images.shape[-2:]))
    held = sampled_kernels(found, 0.0, 0.0, pitch_um, size, 1)[0]
    # A point, of which the band is all that is left.
    f = np.fft.fftfreq(512, pitch_um)
    point = np.fft.fftshift(np.fft.ifft2(low_pass(np.hypot(f, f[:, None]), pitch_um)).real)
    near = slice(256 - size + 1, 256 + size)
    truth = point[near, near] * images[0, 0].sum(axis=(1, 2))[:, None, None]
    # PSFs 1.15 um wide pass exp(-2 (pi 1.15 / 60)^2) = 0.993 at the band's end; what lies beyond
    # the samples, 1e-3 of the light, is added to what is there.
    assert found.ringing
    assert_close(held[:, 1:, 1:], truth, atol=0.006 * truth.max())

"""Spectra of kernels and apertures: against Gaussians through a square."""

import numpy as np
from harness import assert_close
from optics.made import gaussian
from optics.whole import LENS, WEIGHTS, everything
from scipy.special import ndtr

from gpusim.optics.kernel_spectra import aperture_spectra, aperture_spectrum, kernel_spectra
from gpusim.optics.sampling import sampled_kernels


def test_the_aperture_is_an_average_over_a_square_at_the_pixels_centre():
    """Against erf: a Gaussian blob through the aperture, divided by the scene's Gaussian."""
    length, width, sigma, shift, blob = 64, 2.5, 0.8, 0.5, 3.0
    at = np.fft.fftfreq(length) * length
    line = gaussian(at, blob)
    found = np.fft.ifft(np.fft.fft(line) * aperture_spectrum(length, width, sigma, shift))
    narrow = np.sqrt(blob**2 - sigma**2)  # the scene's Gaussian divided out
    edges = (at + shift + width / 2) / narrow, (at + shift - width / 2) / narrow
    expected = (ndtr(edges[0]) - ndtr(edges[1])) / width
    # Periodic images 11 standard deviations away; above Nyquist exp(-2 pi^2 9 / 4): nothing.
    assert_close(found.real, expected, atol=1e-12)
    assert_close(found.imag, np.zeros(length), atol=1e-12)
    assert aperture_spectrum(length, width, sigma, shift)[length // 2] == 0


def unpacked(spectra: np.ndarray, length: int) -> np.ndarray:
    """Return [plane, kx, output, ky], kx = T/2 of zeros: ky = T/256 (p + 16 q) + g."""
    planes, _, fine, _, outputs = spectra.shape[:5]
    result = np.zeros((planes, length // 2 + 1, outputs, length), np.complex128)
    for kx, g, p, q in np.ndindex(length // 2, fine, 16, 16):
        ky = fine * (p + 16 * q) + g
        result[:, kx, :, ky] = spectra[:, kx // 8, g, p, :, q // 2, kx % 8, q % 2]
    return result


def test_spectra_give_each_output_at_its_pixel():
    length, blob = 512, (2.6, 3.4)
    at = np.arange(32) - 16.0
    sampled = np.empty((2, 2, 32, 32))
    for plane in range(2):
        for channel in range(2):
            offset = plane - 2 * channel
            sampled[plane, channel] = (1 + plane + 3 * channel) * np.outer(
                gaussian(at + 1, blob[1]), gaussian(at - offset, blob[0])
            )
    outputs = [(1, 0.5, -0.25), (0, 2.0, 0.0), (1, 0.0, 1.5)]
    spectra = kernel_spectra(sampled, length, 2.2, 0.7, outputs)
    assert spectra.shape == (2, 32, 2, 16, 3, 8, 8, 2) and spectra.dtype == np.complex64
    full = unpacked(spectra, length)
    narrow = np.sqrt(np.array(blob) ** 2 - 0.7**2)
    for plane in range(2):
        for place, (channel, shift_x, shift_y) in enumerate(outputs):
            image = np.fft.irfft2(full[plane, :, place].T, s=(length, length)) * length**2
            along = []
            for shift, centre, sd in (
                (shift_y, 16 - 1, narrow[1]),
                (shift_x, 16 + plane - 2 * channel, narrow[0]),
            ):
                away = (np.arange(length) + shift - centre + 32) % length - 32
                along.append((ndtr((away + 1.1) / sd) - ndtr((away - 1.1) / sd)) / 2.2)
            expected = (1 + plane + 3 * channel) * np.outer(*along)
            # The blobs are cut off 4 standard deviations out, where they are 3e-4 of their peak.
            assert_close(image, expected, atol=3e-4 * expected.max())


def test_the_constant_term_is_the_energy():
    kernels = everything(pitch_um=0.775)
    height = kernels.places.radius_um[1]
    sampled = sampled_kernels(kernels, height, 0.0, 0.775, 32, planes=2)
    spectra = kernel_spectra(sampled, 256, 2.0, 0.8, [(c, 0.5, 0.5) for c in range(3)])
    found = unpacked(spectra, 256)[:, 0, :, 0] * 256**2
    expected = np.einsum("jcl,l->jc", WEIGHTS, LENS.relative_illumination[1])
    assert_close(
        found.real, expected, rtol=1e-4
    )  # the kernel's own energy, see above, and complex64
    assert_close(found.imag, np.zeros((2, 3)), atol=1e-12 * expected.max())


def test_the_nyquist_terms_are_zero():
    sampled = np.random.default_rng(1).normal(size=(1, 1, 32, 32))
    full = unpacked(kernel_spectra(sampled, 256, 1.0, 0.8, [(0, 0.5, 0.5)]), 256)
    assert not full[..., 128].any() and full[:, 127].any() and full[..., 127].any()
    # Which is left out.
    assert not aperture_spectra(256, 1.0, 0.8, 0.5, 0.5, ringing=False)[128].any()

"""Kernels at the PSF nodes: against Gaussians in closed form."""

import numpy as np
import pytest
from harness import assert_close
from optics.made import at_lines, bank, gaussian, plane_bank
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

from gpusim.optics import kernels as optics_kernels
from gpusim.optics.kernels import (
    BAND_EDGE,
    CUT_EDGE,
    aperture_spectra,
    aperture_spectrum,
    core_window,
    distances_um,
    field_images,
    field_kernels,
    kernel_spectra,
    low_pass,
    node_kernels,
    sampled_kernels,
)

LENS = bank(skew_um=2.0)
WEIGHTS = np.random.default_rng(12).uniform(1, 5, (2, 3, 3))
# Rounding of a sum of 36 coefficients times weights, in float64: 36 roundings of the sum, 10 of
# each of two polynomials of degree 5, 3 of their product, with the coefficient and with the area;
# here and in SciPy. Coefficients are along each axis less than 3 times the samples of smooth PSFs.
F64_SPLINE = 2 * 59 * 9 * 2.0**-53


def everything(lens=LENS, weights=WEIGHTS, pitch_um=0.5, reach_um=1e9):
    """Return kernels with the whole PSF, up to the band of a sim grid."""
    images, places = field_images(lens, at_lines(lens, weights), reach_um)
    return field_kernels(images, places, 0.5, pitch_um, np.ones(images.shape[-2:]))


def centroid(kernel: np.ndarray) -> np.ndarray:
    """Return x, y of the centre of gravity, in samples from the source."""
    y, x = np.indices(kernel.shape) - kernel.shape[0] // 2
    return np.array([(x * kernel).sum(), (y * kernel).sum()]) / kernel.sum()


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


def test_images_hold_the_energy_of_their_weights():
    images, places = field_images(LENS, at_lines(LENS, WEIGHTS), 1e9)
    light = LENS.relative_illumination[[0, 1, 2, 3, 1]]
    expected = np.einsum("jcl,fl->fjc", WEIGHTS, light)
    assert_close(images.sum(axis=(3, 4)), expected, rtol=1e-6)  # PSFs sum to 1 in f32
    assert_close(places.radius_um, LENS.real_height_um[:, 1].copy(), atol=0)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_kernels_of_a_lens_without_an_axis_lie_as_they_are(place: int):
    """Their centres of gravity: a quarter of the light is displaced by coma, all by colour."""
    coma, prism = (1.6, -0.7), (2.0, 1.0)
    lens = plane_bank(coma_um=2.0, distortion=0.0, axial_coma_um=coma, prism_um=prism)
    weights = np.zeros((1, 1, 3))
    weights[..., place] = 1.0
    images, places = field_images(lens, at_lines(lens, weights), 1e9)
    kernels = field_kernels(images, places, 0.5, 0.5, np.ones(images.shape[-2:]))
    steps, colours = (-0.5, 0.0, 0.5), (-0.004, 0.0, 0.003)
    for x_um, y_um in ((0.0, 0.0), (70.0, 20.0), (-30.0, 61.0), (-80.0, -44.0)):
        at = np.array([x_um, y_um])
        kernel = sampled_kernels(kernels, x_um, y_um, 0.5, 40, 1)[0, 0]
        expected = 0.25 * (2.0 * at / 165.0 + coma)
        expected = expected + at * colours[place] + steps[place] * np.array(prism)
        # Bicubic in angle, of what is linear in its tangent, times light that goes with its square.
        # The ends of splines and windows (16 um): 1e-3 um.
        assert_close(0.5 * centroid(kernel), expected, atol=1.5e-3)
        light = 1 - 0.3 * (at @ at) / 165.0**2 * (1, 1.05, 1.1)[place]
        # Bicubic interpolation in angle errs on the square of the tangent by its fourth derivative,
        # 16, times 9 / 384 h^4 with h = 0.04 rad along x and y each: 2e-6 (1000 / 165)^2 of 0.33.
        # Sums in f32: 1e-6.
        assert kernel.sum() == pytest.approx(light, abs=3e-5)
        assert light < 0.95 or not at.any()


def test_images_stop_at_the_second_field_beyond_the_reach():
    radius_um = LENS.real_height_um[:, 1]
    for reach, fields in ((1.0, 3), (radius_um[1] + 1, 4), (radius_um[1] - 1, 3), (1e9, 4)):
        images, places = field_images(LENS, at_lines(LENS, WEIGHTS[:1, :1]), reach)
        found = places.radius_um
        assert len(images) == fields + 1  # and one beyond the axis
        assert len(found) == fields and (found[-2] >= reach or fields == 4)


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


@pytest.mark.parametrize("place", [0, 1, 2])
def test_lateral_colour_moves_the_psf_along_the_radius(place: int):
    weights = np.zeros((1, 1, 3))
    weights[..., place] = 1.0
    images, _ = field_images(LENS, at_lines(LENS, weights), 1e9)
    for field in range(4):
        at = np.arange(128) - 64
        moved = images[field, 0, 0]
        centre = np.array([(moved.sum(axis=0) * at).sum(), (moved.sum(axis=1) * at).sum()]) * 0.5
        centre /= moved.sum()
        shift = LENS.real_height_um[field, place] - LENS.real_height_um[field, 1]
        share = field / 3
        # A quarter of the light lies 3 um outwards and 2 um along the tangent at the rim; what the
        # window cuts off, 14 standard deviations away, and the f32 of the PSF are below 1e-5 um.
        assert_close(centre, np.array([0.75 * share + shift, 0.5 * share]), atol=1e-5)


def analytic(place: int, field: int, radial: np.ndarray, tangential: np.ndarray) -> np.ndarray:
    """Return the PSF of the test lens as a density, per um^2, centred on its own chief ray."""
    sigma, share = (0.95, 1.0, 1.15)[place], field / 3
    return 0.75 * gaussian(radial, sigma) * gaussian(tangential, sigma) + 0.25 * gaussian(
        radial - 3.0 * share, 1.2 * sigma
    ) * gaussian(tangential - 2.0 * share, 1.2 * sigma)


@pytest.mark.parametrize("azimuth_deg", [0, 30, 90, 180, 217, 270])
@pytest.mark.parametrize("field", [0, 1, 3])
def test_kernels_are_the_psf_turned_to_the_azimuth(azimuth_deg: int, field: int):
    """X right, y down: radial is away from the axis, tangential 90 deg clockwise of it."""
    kernels = everything(weights=np.array([[[1.0, 2.0, 0.5]]]), pitch_um=0.6)
    angle = np.radians(azimuth_deg)
    height = kernels.places.radius_um[field]
    outward = np.array([np.cos(angle), np.sin(angle)])
    found = sampled_kernels(kernels, *(height * outward), 0.6, 24, 1)[0, 0]
    if height == 0:
        outward = np.array([1.0, 0.0])
    y, x = (np.indices((48, 48)) - 24) * 0.6
    radial, tangential = x * outward[0] + y * outward[1], y * outward[0] - x * outward[1]
    expected = 0.36 * sum(
        weight
        * LENS.relative_illumination[field, place]
        * analytic(
            place,
            field,
            radial - (LENS.real_height_um[field, place] - height),
            tangential,
        )
        for place, weight in enumerate([1.0, 2.0, 0.5])
    )
    # Cubic splines through a Gaussian of 1.9 samples err by h^4 f'''' / 384 = 3 / (384 * 1.9^4) =
    # 6e-4 of the peak along each axis; the band's end takes exp(-2 pi^2 (0.95 * 0.71)^2) = 1e-4.
    assert_close(found, expected, atol=2e-3 * expected.max())


def test_splines_are_evaluated_as_scipy_does():
    """All planes and channels are evaluated at once, and the first planes only too; in float64."""
    kernels = everything(pitch_um=0.6)
    x_um, y_um = 40.0, -25.0
    fields, weights, cos, sin = kernels.places.at(x_um, y_um)
    half = 24  # 20.4 um along the diagonals, and the splines go on for 32
    y, x = (np.indices((2 * half, 2 * half)) - half) * 0.6 / kernels.pitch_um
    n = kernels.splines.shape[-1]
    where = np.stack([cos * y - sin * x, cos * x + sin * y]) + n // 2
    blend = np.tensordot(weights, kernels.splines[list(fields)].astype(float), axes=1)
    expected = np.zeros((2, 3, 2 * half, 2 * half))
    for index in np.ndindex(2, 3):
        expected[index] = map_coordinates(blend[index], where, order=5, prefilter=False)
    expected[..., 0, :] = expected[..., 0] = 0.0
    expected *= (0.6 / kernels.pitch_um) ** 2
    lacking = blend.sum(axis=(2, 3)) - expected.sum(axis=(2, 3))
    share = np.abs(expected)
    expected += (lacking / share.sum(axis=(2, 3)))[..., None, None] * share
    for planes in (1, 2):
        found = sampled_kernels(kernels, x_um, y_um, 0.6, half, planes)
        assert_close(found, expected[:planes], atol=F64_SPLINE * expected.max())


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


def test_a_quarter_turn_is_exact():
    kernels = everything(pitch_um=0.6)
    height = float(kernels.places.radius_um[2])
    right, down, left = (
        sampled_kernels(kernels, height * x, height * y, 0.6, 20, 2)
        for x, y in ((1, 0), (0, 1), (-1, 0))
    )
    # K_right[y, x] = h(radial x, tangential y); downwards the radius is y and the tangent -x.
    turned = np.rot90(right[..., 1:, 1:], -1, axes=(2, 3))
    rounding = 1e-9 * right.max()  # float64, but for cos(90 deg)
    assert_close(down[..., 1:, 1:], turned.copy(), atol=rounding)
    assert_close(left[..., 1:, 1:], right[..., :0:-1, :0:-1].copy(), atol=rounding)
    # Outwards: the displaced quarter of the light drags the centre of gravity along.
    assert centroid(right[0, 0])[0] > 0.5
    assert centroid(down[0, 0])[1] > 0.5
    assert centroid(left[0, 0])[0] < -0.5


def test_between_fields_kernels_are_interpolated_and_beyond_the_last_they_go_on_a_little():
    kernels = everything(pitch_um=0.6)
    radius = kernels.places.radius_um

    def at(height: float) -> np.ndarray:
        return sampled_kernels(kernels, height, 0.0, 0.6, 20, 2)

    # At the fields, and at the second beyond the axis: seen from there, turned by half a turn.
    fields = [at(-radius[1]), *(at(one) for one in radius)]
    nodes = np.array([-radius[1], *radius])
    for lower, first in ((0, 0), (1, 1), (2, 1)):
        height = 0.7 * radius[lower] + 0.3 * radius[lower + 1]
        near = slice(first, first + 4)
        # The cubic through four.
        shares = np.linalg.solve(np.vander(nodes[near] / 100).T, np.vander([height / 100], 4)[0])
        mixed = np.tensordot(shares, fields[near], axes=1)
        assert_close(at(height), mixed, atol=1e-6 * mixed.max())  # sums of float32 splines
    step = radius[-1] - radius[-2]
    onwards = 1.4 * at(radius[-1]) - 0.4 * at(radius[-2])
    assert_close(at(radius[-1] + 0.4 * step), onwards, atol=1e-6 * mixed.max())
    farthest = at(radius[-1] + step)
    assert_close(at(2 * radius[-1]), farthest, atol=1e-6 * mixed.max())
    assert np.abs(farthest - at(radius[-1])).max() > 0.01 * mixed.max()


def test_sampled_kernels_hold_the_energy():
    kernels = everything(pitch_um=0.6)
    expected = np.einsum("jcl,l->jc", WEIGHTS, LENS.relative_illumination[2])
    height = kernels.places.radius_um[2]
    found = sampled_kernels(kernels, 0.6 * height, -0.8 * height, 0.6, 24, 2)
    # Sums over samples of a band-limited kernel are its integral, but for what lies in its band
    # above 1/0.6 - 0.83 cycles/um: exp(-2 pi^2 (0.95 * 0.83)^2) = 5e-6; f32 of PSF and splines.
    assert_close(found.sum(axis=(2, 3)), expected, rtol=3e-5)
    assert sampled_kernels(kernels, 1.0, 1.0, 0.6, 24, 1).shape == (1, 3, 48, 48)


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
    sampled = sampled_kernels(kernels, height, 0.0, 0.775, 32, 2)
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
    assert not aperture_spectra(256, 1.0, 0.8, 0.5, 0.5)[128].any()  # which is left out


@pytest.mark.parametrize("axis", [0, 1])
def test_nodes_err_least_in_the_mean_square(axis: int):
    """On a parabola along one axis, h^2 / 6 off: sqrt(6) = 2.45 times less than through samples."""

    def value(x: float, y: float) -> float:
        return 3.0 + 0.5 * x - 0.2 * y + 2.0 * (x, y)[axis] ** 2

    def node(x: int, y: int) -> float:
        return float(node_kernels(lambda dx, dy: np.array(value(x + dx, y + dy))))

    nodes, weights = np.polynomial.legendre.leggauss(8)
    s, weights = (nodes + 1) / 2, weights / 2
    rms = {}
    for name, at in (("samples", value), ("nodes", node)):
        line = [at(*p) for p in (((4, 7), (5, 7)), ((4, 7), (4, 8)))[axis]]
        exact = [value(4 + t, 7) if axis == 0 else value(4, 7 + t) for t in s]
        error = (1 - s) * line[0] + s * line[1] - exact
        rms[name] = np.sqrt(np.sum(weights * error**2))
    assert rms["samples"] / rms["nodes"] == pytest.approx(np.sqrt(6), rel=1e-9)


def test_a_plane_over_the_field_needs_no_correction():
    found = node_kernels(lambda dx, dy: np.array([1.0 + 0.3 * dx, 2.0 - 0.7 * dy]))
    assert_close(found, np.array([1.0, 2.0]), atol=1e-12)

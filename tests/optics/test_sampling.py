"""Kernels at a place: against Gaussians in closed form, and the splines of SciPy."""

import numpy as np
import pytest
from harness import assert_close
from optics.made import at_lines, gaussian, plane_bank
from optics.whole import LENS, WEIGHTS, everything
from scipy.ndimage import map_coordinates

from gpusim.optics.images import field_images
from gpusim.optics.kernels import (
    field_kernels,
)
from gpusim.optics.sampling import node_kernels, sampled_kernels

# Rounding of a sum of 36 coefficients times weights, in float64: 36 roundings of the sum, 10 of
# each of two polynomials of degree 5, 3 of their product, with the coefficient and with the area;
# here and in SciPy. Coefficients are along each axis less than 3 times the samples of smooth PSFs.
F64_SPLINE = 2 * 59 * 9 * 2.0**-53


def centroid(kernel: np.ndarray) -> np.ndarray:
    """Return x, y of the centre of gravity, in samples from the source."""
    y, x = np.indices(kernel.shape) - kernel.shape[0] // 2
    return np.array([(x * kernel).sum(), (y * kernel).sum()]) / kernel.sum()


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
        kernel = sampled_kernels(kernels, x_um, y_um, 0.5, 40, planes=1)[0, 0]
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


def analytic(place: int, field: int, tangential: np.ndarray, sagittal: np.ndarray) -> np.ndarray:
    """Return the PSF of the test lens as a density, per um^2, centred on its own chief ray."""
    sigma, share = (0.95, 1.0, 1.15)[place], field / 3
    return 0.75 * gaussian(tangential, sigma) * gaussian(sagittal, sigma) + 0.25 * gaussian(
        tangential - 3.0 * share, 1.2 * sigma
    ) * gaussian(sagittal - 2.0 * share, 1.2 * sigma)


@pytest.mark.parametrize("azimuth_deg", [0, 30, 90, 180, 217, 270])
@pytest.mark.parametrize("field", [0, 1, 3])
def test_kernels_are_the_psf_turned_to_the_azimuth(azimuth_deg: int, field: int):
    """X right, y down: tangential is away from the axis, sagittal 90 deg clockwise of it."""
    kernels = everything(weights=np.array([[[1.0, 2.0, 0.5]]]), pitch_um=0.6)
    angle = np.radians(azimuth_deg)
    height = kernels.places.radius_um[field]
    outward = np.array([np.cos(angle), np.sin(angle)])
    found = sampled_kernels(kernels, *(height * outward), 0.6, 24, planes=1)[0, 0]
    if height == 0:
        outward = np.array([1.0, 0.0])
    y, x = (np.indices((48, 48)) - 24) * 0.6
    tangential, sagittal = x * outward[0] + y * outward[1], y * outward[0] - x * outward[1]
    expected = 0.36 * sum(
        weight
        * LENS.relative_illumination[field, place]
        * analytic(
            place,
            field,
            tangential - (LENS.real_height_um[field, place] - height),
            sagittal,
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
        found = sampled_kernels(kernels, x_um, y_um, 0.6, half, planes=planes)
        assert_close(found, expected[:planes], atol=F64_SPLINE * expected.max())


def test_a_quarter_turn_is_exact():
    kernels = everything(pitch_um=0.6)
    height = float(kernels.places.radius_um[2])
    right, down, left = (
        sampled_kernels(kernels, height * x, height * y, 0.6, 20, planes=2)
        for x, y in ((1, 0), (0, 1), (-1, 0))
    )
    # K_right[y, x] = h(tangential x, sagittal y); downwards the radius is y and across it -x.
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
        return sampled_kernels(kernels, height, 0.0, 0.6, 20, planes=2)

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
    found = sampled_kernels(kernels, 0.6 * height, -0.8 * height, 0.6, 24, planes=2)
    # Sums over samples of a band-limited kernel are its integral, but for what lies in its band
    # above 1/0.6 - 0.83 cycles/um: exp(-2 pi^2 (0.95 * 0.83)^2) = 5e-6; f32 of PSF and splines.
    assert_close(found.sum(axis=(2, 3)), expected, rtol=3e-5)
    assert sampled_kernels(kernels, 1.0, 1.0, 0.6, 24, planes=1).shape == (1, 3, 48, 48)


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

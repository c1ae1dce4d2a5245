"""The colour matrix against its definition."""

import numpy as np
import pytest
from harness import assert_close
from scipy.optimize import least_squares

from gpusim.isp.colour import LIGHT_SOURCE, colour_matrix, forward_matrix, response
from gpusim.scene.colorimetry import D50, adaptation
from gpusim.scene.spectra import (
    QUADRATURE_NM,
    WAVELENGTHS_NM,
    colorchecker,
    colour_matching,
    white_radiance,
    xyz,
)
from gpusim.sensor.load import load_sensor

ILLUMINANTS = ["A", "D50", "D65"]


@pytest.fixture(scope="module")
def camera() -> np.ndarray:
    return response(load_sensor("imx477").qe)


def test_response_counts_photons():
    flat = {channel: np.full(61, 0.5) for channel in "RGB"}
    curves = response(flat) / QUADRATURE_NM
    # Equal power at 600 nm has 600/500 as many photons as at 500 nm.
    at = {nm: int(np.flatnonzero(nm == WAVELENGTHS_NM)[0]) for nm in (500, 600)}
    assert_close(curves[:, at[600]] / curves[:, at[500]], np.full(3, 1.2), rtol=1e-15)


def test_response_is_in_the_order_rgb_and_takes_the_lens_in():
    qe = {channel: np.full(61, value) for channel, value in zip("BGR", (1, 2, 3), strict=True)}
    lens = np.linspace(0.2, 0.9, 61)
    clear, through = response(qe), response(qe, lens)
    assert_close(clear / clear[2], np.array([3.0, 2.0, 1.0])[:, None] * np.ones(61), rtol=1e-15)
    assert_close(through, clear * lens, rtol=1e-15)


@pytest.mark.parametrize("channels", ["RG", "RGBW", "CMY", "W"])
def test_every_filter_has_its_row(channels):
    """In the order in which files name them, and the white kept."""
    given = {name: np.linspace(0.2, 0.9, 61) ** n for n, name in enumerate(channels[::-1], 1)}
    curves = response(given)
    order = [given[name] for name in sorted(channels, key="RGBCMYW".index)]
    assert_close(curves / QUADRATURE_NM / WAVELENGTHS_NM, np.array(order), rtol=1e-14)
    white = white_radiance("D65", 1.0)
    seen = curves @ white
    assert_close(colour_matrix(curves, "D65") @ xyz(white), seen / seen.max(), rtol=1e-12)


@pytest.mark.parametrize("illuminant", ILLUMINANTS)
def test_white_is_kept_exactly(camera, illuminant):
    white = white_radiance(illuminant, 1.0)
    seen = camera @ white
    # Some tens of roundings in sums of positive terms.
    assert_close(colour_matrix(camera, illuminant) @ xyz(white), seen / seen.max(), rtol=1e-13)


@pytest.mark.parametrize("illuminant", ILLUMINANTS)
def test_a_colorimetric_camera_gets_its_own_matrix(illuminant):
    mix = np.array([[0.7, 0.2, -0.1], [-0.3, 1.3, 0.1], [0.05, -0.1, 0.8]])
    camera = mix @ (colour_matching() * QUADRATURE_NM)
    matrix = colour_matrix(camera, illuminant)
    # Exact but for rounding, through a least-squares problem of condition below 1e3.
    assert_close(matrix / matrix[1, 1], mix / mix[1, 1], atol=1e-11)


@pytest.mark.parametrize("illuminant", ILLUMINANTS)
def test_the_matrix_is_the_constrained_least_squares_solution(camera, illuminant):
    # Independently: for each row m of the matrix, minimise |X m - c|^2 subject to w . m = c_w, by
    # Lagrange's equations.
    white = white_radiance(illuminant, 1.0)
    seen = xyz(np.stack(list(colorchecker().values())) * white)
    counted = (np.stack(list(colorchecker().values())) * white) @ camera.T
    w, c_w = xyz(white), camera @ white
    system = np.zeros((4, 4))
    matrix = np.empty((3, 3))
    # Each coordinate in units of its white's, as in the definition.
    x = seen / w
    system[:3, :3] = 2 * x.T @ x
    system[:3, 3] = system[3, :3] = 1
    for row in range(3):
        target = counted[:, row] / c_w[row]
        matrix[row] = np.linalg.solve(system, [*(2 * x.T @ target), 1])[:3]
    expected = matrix * c_w[:, None] / w / c_w.max()
    # Normal equations square the condition, below 1e3 for 24 chromatic patches: 1e6 * 2^-52.
    assert_close(colour_matrix(camera, illuminant), expected, atol=1e-9)


def lab_error(forward: np.ndarray, camera: np.ndarray, illuminant: str) -> np.ndarray:
    """Return L*, a*, b* of the 24 patches by a ForwardMatrix, less the true ones; beside D50.

    By CIE 15, in terms of its limits (6/29)^3 and 4/29.
    """
    white = white_radiance(illuminant, 1.0)
    patches = np.stack(list(colorchecker().values())) * white
    true = xyz(patches) @ adaptation(xyz(white), D50).T
    values = []
    for share in (patches @ camera.T / (camera @ white) @ forward.T / D50, true / D50):
        low = share / (3 * (6 / 29) ** 2) + 4 / 29
        x, y, z = np.where(share > (6 / 29) ** 3, np.cbrt(share), low).T
        values.append(np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1))
    return values[0] - values[1]


@pytest.mark.parametrize("illuminant", ILLUMINANTS)
def test_the_forward_matrix_is_the_least_squares_solution_in_lab(camera, illuminant):
    forward = forward_matrix(camera, illuminant)
    assert_close(forward.sum(axis=1), D50, atol=1e-12)
    matrix = forward / D50[:, None]

    def error(free: np.ndarray) -> np.ndarray:
        pairs = free.reshape(3, 2)
        rows = np.column_stack([pairs, 1 - pairs.sum(axis=1)])
        return lab_error(D50[:, None] * rows, camera, illuminant).ravel()

    expected = least_squares(error, np.eye(3)[:, :2].ravel(), xtol=1e-14, ftol=1e-14, gtol=1e-10)
    assert expected.success
    # Where the slope is 0 the squares tell of the matrix to the root of rounding alone.
    assert np.sum(error(matrix[:, :2].ravel()) ** 2) <= 2 * expected.cost * (1 + 1e-9)
    assert_close(matrix[:, :2].ravel(), expected.x, atol=1e-6)


@pytest.mark.parametrize("illuminant", ILLUMINANTS)
def test_colours_differ_less_by_the_fit_in_lab(camera, illuminant):
    white = white_radiance(illuminant, 1.0)
    seen = camera @ white
    balanced = colour_matrix(camera, illuminant) / (seen / seen.max())[:, None]
    by_xyz, by_lab = (
        np.linalg.norm(lab_error(forward, camera, illuminant), axis=1)
        for forward in (
            adaptation(xyz(white), D50) @ np.linalg.inv(balanced),
            forward_matrix(camera, illuminant),
        )
    )
    print(
        f"{illuminant}: dE*ab mean {by_xyz.mean():.2f}, max {by_xyz.max():.2f} by XYZ; "
        f"{by_lab.mean():.2f}, {by_lab.max():.2f} by Lab"
    )
    assert by_lab.mean() <= by_xyz.mean()
    assert np.sum(by_lab**2) <= np.sum(by_xyz**2)


def test_the_forward_matrix_of_a_colorimetric_camera_is_its_inverse():
    mix = np.array([[0.7, 0.2, -0.1], [-0.3, 1.3, 0.1], [0.05, -0.1, 0.8]])
    camera = mix @ (colour_matching() * QUADRATURE_NM)
    white = white_radiance("A", 1.0)
    expected = adaptation(xyz(white), D50) @ np.linalg.inv(mix) * (mix @ xyz(white))
    # As the ColorMatrix that it begins at.
    assert_close(forward_matrix(camera, "A"), expected / expected.sum(axis=1)[1], atol=1e-11)


def test_four_colours_have_a_forward_matrix():
    curves = load_sensor("imx477").qe
    camera = response(curves | {"W": 0.4 * sum(curves.values())})
    forward = forward_matrix(camera, "D65")
    assert forward.shape == (3, 4)
    assert_close(forward.sum(axis=1), D50, atol=1e-12)
    # No worse than three of them: white adds up the others, and is no help.
    three = lab_error(forward_matrix(camera[:3], "D65"), camera[:3], "D65")
    four = lab_error(forward, camera, "D65")
    assert np.sum(four**2) == pytest.approx(np.sum(three**2), rel=1e-6)


def test_light_sources_are_exifs():
    assert LIGHT_SOURCE == {"A": 17, "D65": 21}  # Exif 2.3, tag LightSource

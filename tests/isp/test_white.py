"""Whites and colour matrices of a camera."""

import numpy as np
import pytest
from harness import assert_close

from gpusim.isp.colour import colour_matrix, response
from gpusim.isp.white import kelvin_of, matrix_at, neutral_of, to_picture, white_of
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, adaptation, rgb_to_xyz
from gpusim.scene.spectra import white_radiance, xyz
from gpusim.sensor.load import load_sensor

CAMERA = response(load_sensor("imx477").qe)
MATRICES = {2856.0: colour_matrix(CAMERA, "A"), 6504.0: colour_matrix(CAMERA, "D65")}


@pytest.mark.parametrize(("name", "kelvin"), [("A", 2856), ("D50", 5003), ("D65", 6504)])
def test_temperatures_are_those_of_the_illuminants(name: str, kelvin: float):
    # McCamy's formula to 2 K; over 400-700 nm the illuminants' own whites are off by as much.
    assert kelvin_of(xyz(white_radiance(name, 1.0))) == pytest.approx(kelvin, abs=12)


def test_matrices_are_mixed_by_the_reciprocal_temperature():
    one, two = np.eye(3), 3 * np.eye(3)
    given = {2000.0: one, 6000.0: two}
    assert_close(matrix_at(given, 3000.0), 2 * np.eye(3), atol=1e-12)
    assert_close(matrix_at(given, 1000.0), one.copy(), atol=1e-12)
    assert_close(matrix_at(given, 9000.0), two.copy(), atol=1e-12)
    assert matrix_at({5000.0: one}, 3000.0) is one


@pytest.mark.parametrize("name", ["A", "D50", "D55", "D65", "D75", "3500K"])
def test_a_white_is_found_again_from_what_the_camera_sees(name: str):
    white = xyz(white_radiance(name, 1.0))
    neutral = neutral_of(white, MATRICES)
    assert neutral.max() == 1
    assert_close(white_of(neutral, MATRICES), white / white[1], atol=1e-9)


@pytest.mark.parametrize("name", ["A", "D50", "D65"])
def test_a_colorimetric_camera_shows_colours_as_they_are(name: str):
    """One that sees XYZ: the picture is XYZ adapted to the space's white."""
    space = rgb_to_xyz(REC709_CHROMATICITIES)
    white = xyz(white_radiance(name, 1.0))
    neutral = white / white.max()
    found = to_picture(neutral, {5000.0: np.eye(3)}, REC709_CHROMATICITIES)
    expected = np.linalg.solve(space, adaptation(white, space.sum(axis=1)) * white)
    assert_close(found, expected, atol=1e-12)
    assert_close(found.sum(axis=1), np.ones(3), atol=1e-12)


def test_four_colours_have_a_way_back():
    rows = np.vstack([np.eye(3), [0.3, 0.5, 0.2]])
    neutral = np.array([0.9, 1.0, 1.0, 0.97])
    found = to_picture(neutral, {5000.0: rows}, REC709_CHROMATICITIES)
    assert found.shape == (3, 4)
    assert_close(found.sum(axis=1), np.ones(3), atol=1e-12)

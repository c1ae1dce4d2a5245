"""The chief-ray polynomial, against the bank's map taken the other way round."""

from dataclasses import replace

import numpy as np
import pytest
from harness import assert_close
from optics.made import bank, plane_bank, shader_terms

from gpusim.errors import UserError
from gpusim.optics.chief_ray import FIT_ERROR_UM, chief_ray_map
from gpusim.reference.chief_ray import chief_ray as twin


@pytest.mark.parametrize("distortion", [0.0, -0.02, 0.05])
def test_it_leads_from_the_real_to_the_ideal_plane(distortion: float):
    lens = bank(fields=12, distortion=distortion)
    chief_ray = chief_ray_map(lens)
    assert chief_ray.radius_um == lens.image_circle_um
    real = np.random.default_rng(1).uniform(0, lens.image_circle_um, 500)
    g = np.polynomial.Polynomial(chief_ray.coefficients)
    ideal = real * g((real / chief_ray.radius_um) ** 2)
    # Back on the real plane the error is multiplied by the slope, at most 1 + 3 x 5 %.
    assert_close(lens.real_from_ideal(ideal)[0], real, atol=1.15 * FIT_ERROR_UM)


def test_the_shaders_get_it_in_sim_samples():
    chief_ray = chief_ray_map(bank())
    params = chief_ray.params(0.5)
    assert_close(np.append(params["g_low"], params["g_high"]), chief_ray.coefficients, atol=0)
    samples = chief_ray.radius_um / 0.5
    assert params["inverse_radius2"] == pytest.approx(1 / samples**2, rel=1e-12)


def test_a_map_that_is_not_smooth_is_refused():
    lens = bank(fields=15)
    rough = lens.real_height_um + np.where(np.arange(15) % 2, 0.3, 0.0)[:, None]
    rough[0] = 0
    with pytest.raises(UserError, match="not smooth enough") as caught:
        chief_ray_map(replace(lens, real_height_um=rough))
    assert caught.value.field == "distortion" and "um height" in str(caught.value.value)


def test_of_a_lens_without_an_axis_the_shaders_get_a_polynomial_in_both_coordinates():
    lens = plane_bank(keystone=(0.06, 0.02), boresight_um=(5.0, -3.0))
    chief_ray = chief_ray_map(lens)
    assert chief_ray.degree == lens.plane_map.degree > 2
    params, terms = chief_ray.params(0.5), chief_ray.terms(0.5)
    assert_close(terms, shader_terms(lens.plane_map.ideal / 0.5), atol=0)
    assert_close(np.array(params["circle"]), np.array([10.0, -6.0]), atol=1e-9)
    samples = lens.image_circle_um / 0.5
    assert params["inverse_radius2"] == pytest.approx(1 / samples**2, rel=1e-12)
    # The host's map is that of the twin.
    real = np.random.default_rng(1).uniform(-90, 90, (300, 2))
    found = chief_ray.ideal_um(real)
    expected, jacobian = twin(real, lens.plane_map.ideal, chief_ray.radius_um, chief_ray.centre_um)
    assert_close(found, expected, atol=1e-9)
    # A double Jacobian's largest stretch, at these points and everywhere.
    norms = np.linalg.norm(jacobian, ord=2, axis=(1, 2))
    assert norms.max() <= chief_ray.stretch < 1.2 * norms.max()
    least = np.linalg.norm(jacobian, ord=-2, axis=(1, 2)).min()
    assert least / 1.2 < chief_ray.least_stretch <= least


def test_of_a_lens_with_an_axis_the_host_has_the_same_stretch_as_the_twin():
    chief_ray = chief_ray_map(bank(fields=12, distortion=-0.05))
    real = np.random.default_rng(2).uniform(-110, 110, (3000, 2))
    _, jacobian = twin(real, chief_ray.coefficients, chief_ray.radius_um)
    norms = np.linalg.norm(jacobian, ord=2, axis=(1, 2))
    assert norms.max() <= chief_ray.stretch * (1 + 1e-9) and chief_ray.stretch < 1.05 * norms.max()
    least = np.linalg.norm(jacobian, ord=-2, axis=(1, 2)).min()
    assert least / 1.05 < chief_ray.least_stretch <= least * (1 + 1e-9)

"""The chief-ray polynomial, against the bank's map taken the other way round."""

from dataclasses import replace

import numpy as np
import pytest
from harness import assert_close
from optics.made import bank

from gpusim.errors import UserError
from gpusim.optics.chief_ray import FIT_ERROR_UM, chief_ray_map


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

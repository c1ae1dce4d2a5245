"""What the readers of ready-made lenses share."""

import numpy as np
import pytest

from gpusim.errors import UserError
from gpusim.formats.assemble import odd_fit


@pytest.mark.parametrize("edge_deg", [14, 45, 60, 80])
def test_chief_rays_between_those_of_a_table(edge_deg):
    """A lens that follows the angle, of 5 mm: 15 heights of it give all others."""
    theta = np.radians(np.linspace(0, edge_deg, 15))
    between = np.radians(np.linspace(0, edge_deg, 141))
    function, misfit = odd_fit(5e3 * np.tan(theta), 5e3 * theta, 5.0, "a.yaml")
    assert misfit < 0.1
    # The series of atan(u) has its next term at u^13 / 13: least squares leave of it 2^-12 at the
    # edge, u = 1; in the angle itself the line is exact.
    bound_um = 5e3 / 13 / 2**12 if edge_deg <= 50 else 1e-8
    exact = 5e3 * between
    assert np.abs(function(5e3 * np.tan(between)) - exact).max() < bound_um


def test_a_misprint_in_a_table_is_found():
    ideal = np.linspace(0, 1000, 15)
    real = ideal * (1 - 0.02 * (ideal / 1000) ** 2)
    assert odd_fit(ideal, real, 5.0, "a.yaml")[1] < 1e-9
    real[7] += 5.0
    with pytest.raises(UserError, match="smooth curve"):
        odd_fit(ideal, real, 5.0, "a.yaml")

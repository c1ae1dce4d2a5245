"""Image height against field angle: through its nodes, between them, back again, and monotone."""

import numpy as np
import pytest

from gpusim.psf.field_map import FieldMap

# Closed forms of h(theta) / f, odd and rising to the angle beside them.
PROJECTIONS = {
    "rectilinear": (np.tan, 45.0),
    "stereographic": (lambda t: 2 * np.tan(t / 2), 110.0),
    "equidistant": (lambda t: t, 110.0),
    "equisolid": (lambda t: 2 * np.sin(t / 2), 110.0),
    "orthographic": (np.sin, 85.0),
}


@pytest.mark.parametrize("name", PROJECTIONS)
def test_the_map_of_a_known_projection_is_met_between_its_nodes_and_inverted(name):
    projection, edge_deg = PROJECTIONS[name]
    f_um = 2000.0
    theta = np.radians(np.linspace(0, edge_deg, 15))
    chief = FieldMap(theta, f_um * projection(theta), f_um)
    assert chief.wide == (edge_deg > 50)
    assert chief.folds_at is None
    at = np.linspace(0, theta[-1], 301)
    # In the last interval 8 points miss by 528 / 8! h^8 of the eighth derivative, which is largest
    # for 2 tan(t / 2), near 4 / (pi - t): 4 8! / 1.22^9 at 110 deg. With h = 0.137 that is 0.09 um.
    np.testing.assert_allclose(chief.height_um(at), f_um * projection(at), rtol=0, atol=0.1)
    back = chief.angle(chief.height_um(at))
    # 1e-9 um over the least slope, f cos(85 deg) = 170 um per rad.
    np.testing.assert_allclose(back, at, rtol=0, atol=1e-11)
    step = 1e-5
    inner = at[1:-1]
    slope = (chief.height_um(inner + step) - chief.height_um(inner - step)) / (2 * step)
    # Rounding of 4000 um, 5e-13, over the step; and the third derivative times step^2 / 6.
    np.testing.assert_allclose(chief.slope_um(inner), slope, rtol=0, atol=1e-6)


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_few_fields_give_a_map_too(count):
    theta = np.radians(np.linspace(0, 20, count))
    chief = FieldMap(theta, 1000 * np.sin(theta), 1000.0)
    np.testing.assert_allclose(chief.height_um(theta), 1000 * np.sin(theta), rtol=0, atol=1e-9)
    # The distortion, -t^3 / 2 at the edge, is 21 um; a straight line through it misses 8 um.
    middle = np.radians(np.linspace(0, 20, 41))
    miss = np.abs(chief.height_um(middle) - 1000 * np.sin(middle)).max()
    assert miss < {2: 9, 3: 0.5, 4: 0.02, 5: 1e-3}[count]


def test_a_fold_between_two_rising_nodes_is_found():
    # sin(theta) turns at 90 deg; the last two nodes, at 85 and 94 deg, still rise.
    theta = np.radians([0, 20, 40, 60, 75, 85, 94.0])
    assert np.sin(theta[-1]) > np.sin(theta[-2])
    folded = FieldMap(theta, 1000 * np.sin(theta), 1000.0)
    assert np.degrees(folded.folds_at) == pytest.approx(90, abs=1.5)  # nodes are 0.5 deg apart
    assert FieldMap(theta[:-1], 1000 * np.sin(theta[:-1]), 1000.0).folds_at is None

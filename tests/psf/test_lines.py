"""Between the wavelengths of a bank: closed forms, and the chief rays of a real lens."""

import numpy as np
import pytest

from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build
from gpusim.psf.lines import CUBIC, STRAIGHT, line_shares

LINES = np.linspace(400.0, 700.0, 13)
BETWEEN = np.linspace(400.0, 700.0, 121)


def test_shares_are_cardinal_and_sum_to_one():
    np.testing.assert_allclose(line_shares(LINES, CUBIC, LINES), np.eye(13), atol=1e-12)
    for degree in (CUBIC, STRAIGHT):
        for count in (1, 2, 3, 4, 13):
            lines = LINES[:count] if count < 13 else LINES
            shares = line_shares(lines, degree, np.append(BETWEEN, [350.0, 800.0]))
            assert shares.shape == (count, 123)
            np.testing.assert_allclose(shares.sum(axis=0), 1, atol=1e-12)
            # Beyond the first and the last line everything is as there.
            np.testing.assert_allclose(shares[:, -2:].T, np.eye(count)[[0, -1]], atol=1e-12)


@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_polynomials_in_the_inverse_wavelength_come_out_as_they_are(count):
    """They do so up to the degree that as many lines carry, and for no higher one."""
    lines = np.linspace(400.0, 700.0, count)
    x, at = 550 / lines, 550 / BETWEEN
    degree = min(count - 1, 3)
    found = (x**degree) @ line_shares(lines, CUBIC, BETWEEN)
    np.testing.assert_allclose(found, at**degree, atol=1e-12)
    higher = (x ** (degree + 1)) @ line_shares(lines, CUBIC, BETWEEN)
    assert np.abs(higher - at ** (degree + 1)).max() > 1e-4


def test_straight_lines_are_of_the_wavelength():
    found = (3 * LINES - 2) @ line_shares(LINES, STRAIGHT, BETWEEN)
    np.testing.assert_allclose(found, 3 * BETWEEN - 2, rtol=1e-12)


def test_splines_err_by_the_fourth_power_of_the_step():
    """Against exp(-3 (lambda / 550 nm)), and straight lines by the second."""

    def error(step_nm: float, degree: int) -> float:
        lines = np.arange(400.0, 701.0, step_nm)
        found = np.exp(-3 * lines / 550) @ line_shares(lines, degree, BETWEEN)
        return float(np.abs(found - np.exp(-3 * BETWEEN / 550)).max())

    # Not-a-knot ends converge a little slower than the middle.
    assert np.log2(error(25, CUBIC) / error(12.5, CUBIC)) == pytest.approx(4, abs=0.35)
    assert np.log2(error(25, STRAIGHT) / error(12.5, STRAIGHT)) == pytest.approx(2, abs=0.1)


def test_lateral_colour_of_a_lens_follows_its_rays(demo_lens):
    """The double Gauss at the edge of its field, rays traced every 2.5 nm."""
    system = build(demo_lens)
    edge = np.radians(demo_lens.max_field_deg)
    rays = sample_rays(system, system.index(BETWEEN), edge, np.zeros(1), np.zeros(1))
    chief_um = 1e3 * rays.chief_y_mm
    at_lines = chief_um[np.isin(BETWEEN, LINES)]
    errors = [
        np.abs(at_lines @ line_shares(LINES, degree, BETWEEN) - chief_um).max()
        for degree in (STRAIGHT, CUBIC)
    ]
    print(errors, np.ptp(chief_um))
    assert errors[0] > 3e-3  # measured
    assert errors[1] < errors[0] / 20

"""What is known of the error of a bank, as densely as it is sampled, and what it leaves."""

from dataclasses import replace

import numpy as np
import pytest

from gpusim.plan.density import MEAN, Density, LensShare, PlaneDensity


def given(error: float) -> Density:
    line = np.array([0.0, 100.0])
    return Density(
        field_deg=line,
        wavelengths_nm=np.array([550.0]),
        height_um=line,
        fields_error=np.array([error]),
        lines_um=line,
        lines_error=np.zeros(2),
        pupil_error=0.0,
        contrast=5.0,
        ratio=4.0,
    )


def test_what_is_expected_of_the_sensor_is_the_mean_square_over_its_area():
    """A cubic's error between its nodes, e (1 - 4 t^2) (9 - 4 t^2) / 9, over rings."""
    t = np.linspace(-0.5, 0.5, 10001)
    of_cubic = np.mean(((1 - 4 * t**2) * (9 - 4 * t**2) / 9) ** 2)
    assert given(6e-4).rms == pytest.approx(6e-4 * np.sqrt(of_cubic), rel=1e-3)
    assert given(6e-4).worst == 6e-4 and given(0.0).rms == 0
    rings = replace(
        given(0.0),
        height_um=np.array([0.0, 100.0, 200.0, 300.0]),
        fields_error=np.array([1e-4, 4e-4, 0.0]),  # beyond the sensor's corners: none
        pupil_error=2e-4,
    )
    expected = of_cubic * (1e-8 + 3 * 16e-8) / 4 + 4e-8
    assert rings.rms == pytest.approx(np.sqrt(expected), rel=1e-3)


def test_the_engine_gets_what_the_bank_leaves():
    class Beyond:
        beyond_energy = np.full((2, 1), 2e-5)
        halo = None
        rectilinear_circle_um = 300.0

    share = LensShare(given(6e-4), Beyond(), 250.0)
    # Half white, half black at a quarter: a mean of 5/8 over signals 1 and 1/4, squares averaged.
    window = 2e-5 * 0.625 * np.sqrt((1 + 16) / 2)
    assert share.window == pytest.approx(window)
    expected = np.sqrt((1e-3 - window) ** 2 - 6e-4**2) / 0.78
    assert share.left_of(1e-3) == pytest.approx(expected) and expected < 1e-3
    assert share.left_of(1e-2) == 1e-2
    assert share.excess(1e-3) == pytest.approx((6e-4 + window) / 8.5e-4)


def density(**changed):
    made = {
        "side_deg": np.linspace(-6, 6, 9),
        "wavelengths_nm": np.linspace(400, 700, 12),
        "fields_error": np.array([3e-4, 1e-4]),
        "lines_error": 1e-4,
        "pupil_error": 2e-5,
        "ratio": 16.0,
    }
    return PlaneDensity(**made | changed)


def test_a_density_says_what_it_errs_by():
    found = density()
    assert found.worst == pytest.approx(np.sqrt(3e-4**2 + 1e-4**2 + 2e-5**2))
    squares = MEAN * (3e-4**2 + 1e-4**2) / 2 + 1e-4**2 + 2e-5**2
    assert found.rms == pytest.approx(np.sqrt(squares))
    assert set(found.sampling) == {"wavelengths_nm", "field_x_deg", "field_y_deg"}
    assert "9 x 9 fields x 12 wavelengths" in found.text
    assert "9 x 9 fields" in found.why
    assert "rim" in density(pupil_error=1e-3).why


def test_the_engine_gets_what_a_bank_without_an_axis_leaves():
    share = LensShare(density(), None, 1.0)
    share.__dict__["window"] = 0.0
    assert share.left_of(1e-3) < 1e-3 / 0.78
    assert share.excess(1e-4) > 1 > share.excess(1e-3)
    assert share.stages[0].reason == density().text

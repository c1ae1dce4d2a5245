"""How densely the bank of a lens without an axis is sampled."""

import numpy as np
import pytest
from lens.made import lens, model
from optics.made import FLAT, monochrome, scene

from gpusim.errors import UserError
from gpusim.plan import Accuracy
from gpusim.psf import compute_plane, halo
from gpusim.psf.sampling import default_sides_deg
from gpusim.psf.spreads import even_lines_nm
from gpusim.psf.store import BANK_BYTES
from gpusim.render.plane_survey import (
    FEWEST,
    FIELDS_SHARE,
    LINES_SHARE,
    MOST,
    STEPS,
    _PlaneSurvey,
    plane_bank_density,
)
from gpusim.scene.chart import Rect

EDGE = scene((Rect(0.0, 0.0, 0.5, 0.5, 0.08, 1),), np.stack([FLAT, FLAT / 16]))
SENSOR = monochrome(2000, 2400)


def singlet():
    """Return a lens behind its stop whose second half is moved: f = 19 mm, f/8."""
    rows = [
        {"radius": np.inf, "thickness": 1.0},
        {"radius": 20.0, "thickness": 2.0, **model(1.5)},
        {"radius": -20.0},
    ]
    whole = lens(rows, f_number=8.0, max_field_deg=6.0, focus="best")
    return whole.with_element_moved(2, 3, decentre_mm=(0.2, 0.1), tilt_deg=(2.0, -3.0))


@pytest.fixture(scope="module")
def survey():
    return _PlaneSurvey(singlet(), SENSOR, EDGE, 20.0, None)


def test_cells_are_asked_towards_every_corner_as_far_as_the_sensor_sees(survey):
    axis, *corners, aside = survey.probes_deg
    assert not axis.any()
    assert {tuple(np.sign(one)) for one in corners} == {(1, 1), (1, -1), (-1, 1), (-1, -1)}
    # The sensor's corner is 1562 pixels of 1.55 um from its middle, 2.4 mm: 7 deg of f = 19 mm. The
    # field ends before, at 6.
    assert np.hypot(*np.transpose(corners)) == pytest.approx(0.9 * 6.0)
    assert 0 < np.hypot(*aside) < 4.0


def test_errors_between_fields_fall_as_those_of_cubics(survey):
    """Cubics err by the fourth power of the spacing: 5 x 5 against 9 x 9 fields, 16 times.

    The cells' middles are other places, where the lens is not quite the same: within a factor of 3.
    """
    few, many = (survey._in_cells(default_sides_deg(survey.lens, n)) for n in (5, 9))
    assert few.shape == (5,)
    assert 16 / 3 < few.max() / many.max() < 16 * 3


@pytest.mark.parametrize(
    ("at_nine", "allowed", "tried"),
    [(1e-4, 1e-3, [9]), (1.6e-2, 1e-3, [9, 17]), (1.0, 1e-6, [9, MOST])],
)
def test_fields_are_as_many_as_the_fourth_power_says(survey, monkeypatch, at_nine, allowed, tried):
    asked = []

    def cells(self, sides):
        asked.append(len(sides))
        return np.array([0.5, 1.0]) * at_nine * (8 / (len(sides) - 1)) ** 4

    monkeypatch.setattr(_PlaneSurvey, "_in_cells", cells)
    sides, errors = survey.refined(allowed)
    assert asked == tried
    assert len(sides) == tried[-1] and sides[0] == -6.0 and 0 in sides
    assert errors.max() <= allowed or len(sides) == MOST


def test_fields_that_miss_by_more_than_foretold_are_tried_again(survey, monkeypatch):
    """Where light sets in all at once no cubic follows: the error goes with the spacing alone."""
    asked = []

    def cells(self, sides):
        asked.append(len(sides))
        return np.array([1e-2 * 8 / (len(sides) - 1)])

    monkeypatch.setattr(_PlaneSurvey, "_in_cells", cells)
    _, errors = survey.refined(4e-3)
    assert asked[0] == FEWEST and len(asked) > 2
    assert errors[0] <= 4e-3


def test_a_tolerance_is_met_or_refused_with_the_nearest(monkeypatch):
    errors = {"lines_error": 4e-4, "pupil_error": 1e-5}
    for name, value in errors.items():
        monkeypatch.setattr(_PlaneSurvey, name, lambda self, value=value: value)
    monkeypatch.setattr(
        _PlaneSurvey,
        "_in_cells",
        lambda self, sides: np.array([1e-2 * (8 / (len(sides) - 1)) ** 4]),
    )
    given = singlet(), SENSOR, EDGE
    found = plane_bank_density(*given, Accuracy(1e-3))
    assert found.fields_error.max() <= FIELDS_SHARE * 1e-3
    assert found.lines_error <= LINES_SHARE * 1e-3
    assert found.worst <= 0.85e-3
    assert len(plane_bank_density(*given, Accuracy(3e-2)).side_deg) == FEWEST
    with pytest.raises(UserError, match="cannot be met") as caught:
        plane_bank_density(*given, Accuracy(1e-5))
    assert "27 x 27 fields" in caught.value.problem
    best = plane_bank_density(*given, Accuracy(1e-5, best_effort=True))
    assert len(best.side_deg) == MOST


def test_the_densest_bank_can_be_read_again():
    """Its PSFs and the levels of its halo, float32; else it would be traced for every render."""
    samples = compute_plane.SIZE**2 + halo.LEVELS * halo.SIZE**2
    lines = len(even_lines_nm(STEPS[-1]))
    assert 1.01 * 4 * MOST**2 * lines * samples < BANK_BYTES

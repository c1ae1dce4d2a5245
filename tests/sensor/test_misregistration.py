"""A shifted filter array: against areas worked out by hand, and what a Bayer pattern becomes."""

import numpy as np
import pytest
from changes import sensor_file

from gpusim.errors import UserError
from gpusim.sensor.cfa import PATTERNS
from gpusim.sensor.load import load_sensor
from gpusim.sensor.misregistration import mixed_pattern, shares_along

BAYER = [["R", "G"], ["G", "B"]]
SHIFT = ("cfa", "shift_px")


@pytest.mark.parametrize(
    ("shift", "side", "expected"),
    [
        (0.0, 1.0, {0: 1.0}),
        (0.25, 1.0, {-1: 0.25, 0: 0.75}),
        (-0.25, 1.0, {0: 0.75, 1: 0.25}),
        (1.0, 1.0, {-1: 1.0}),
        # An aperture of half a pixel sees its own filter alone, until the edge comes over it.
        (0.25, 0.5, {0: 1.0}),
        (0.375, 0.5, {-1: 0.25, 0: 0.75}),
        (0.5, 0.5, {-1: 0.5, 0: 0.5}),
    ],
)
def test_filters_share_the_aperture_by_area(shift: float, side: float, expected: dict):
    found = dict(shares_along(shift, -side / 2, side / 2))
    assert found == pytest.approx(expected, abs=1e-12)


SHIFT = ("cfa", "shift_px")


def test_a_bayer_pattern_gets_two_greens():
    """Shifted to the right by a quarter: each pixel sees a quarter of its left neighbour's."""
    names, mixtures = mixed_pattern(BAYER, (0.25, 0.0), 1.0)
    assert names == [["R", "G"], ["G2", "B"]]
    as_dicts = {name: dict(mixture) for name, mixture in mixtures.items()}
    assert as_dicts["R"] == pytest.approx({"R": 0.75, "G": 0.25})
    assert as_dicts["G"] == pytest.approx({"G": 0.75, "R": 0.25})  # in the red row
    assert as_dicts["G2"] == pytest.approx({"G": 0.75, "B": 0.25})  # in the blue row
    assert as_dicts["B"] == pytest.approx({"B": 0.75, "G": 0.25})


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("shift", [0.25, -0.25])
def test_longer_patterns_tell_which_way_they_are_shifted(axis: int, shift: float):
    """Planted: a pattern of two is the same whichever neighbour's filter a pixel sees."""
    line = ["R", "G", "B", "W"]
    pattern = [[one] for one in line] if axis else [line]
    names, mixtures = mixed_pattern(pattern, (0.0, shift) if axis else (shift, 0.0), 1.0)
    assert names == pattern
    for place, own in enumerate(line):
        # To the right, or down: the filter over the border is that of the pixel before.
        neighbour = line[(place - (1 if shift > 0 else -1)) % 4]
        assert dict(mixtures[own]) == pytest.approx({own: 0.75, neighbour: 0.25})


def test_both_ways_at_once_is_the_product_of_the_shares():
    _, mixtures = mixed_pattern(BAYER, (0.2, -0.1), 1.0)
    # The red pixel sees: 0.8 x 0.9 its own, 0.2 x 0.1 blue, the rest green.
    assert dict(mixtures["R"]) == pytest.approx({"R": 0.72, "B": 0.02, "G": 0.26})
    assert all(sum(dict(one).values()) == pytest.approx(1, abs=1e-12) for one in mixtures.values())


def test_a_pattern_of_one_filter_does_not_change():
    assert mixed_pattern([["W"]], (0.3, 0.4), 1.0) == ([["W"]], {"W": (("W", pytest.approx(1)),)})


def test_a_whole_pixel_moves_the_pattern():
    names, mixtures = mixed_pattern(BAYER, (1.0, 0.0), 1.0)
    seen = [[dict(mixtures[name]) for name in row] for row in names]
    assert seen == [[{"G": 1}, {"R": 1}], [{"B": 1}, {"G": 1}]]


def test_a_file_is_loaded_with_its_mixtures(tmp_path):
    plain = load_sensor("imx477")
    file = sensor_file(tmp_path, (SHIFT, [0.1, 0.0]))
    found = load_sensor(file)
    assert found.cfa.shift_px == (0, 0)  # it is in the channels now
    assert sorted(found.channels) == ["B", "G", "G2", "R"]
    # The fill factor of this sensor is 1, so the share is the shift.
    assert plain.fill_factor == 1
    first = found.cfa.pattern[0]
    left, right = plain.cfa.pattern[0]
    for name, own, other in ((first[0], left, right), (first[1], right, left)):
        expected = 0.9 * plain.qe[own] + 0.1 * plain.qe[other]
        np.testing.assert_allclose(found.qe[name], expected, rtol=1e-12)
    assert found.cfa.letters == plain.cfa.letters  # so that a DNG shows it as what it is
    greens = found.qe["G"] - found.qe["G2"]
    assert np.abs(greens).max() > 0.01


def test_names_of_patterns_say_clear_where_they_say_c(tmp_path):
    curves = load_sensor("imx477").quantum_efficiency
    measured = {
        "wavelengths_nm": curves.wavelengths_nm,
        "channels": {"R": curves.channels["R"], "W": curves.channels["G"]},
    }
    file = sensor_file(tmp_path, (("cfa", "pattern"), "RCCC"), quantum_efficiency=measured)
    assert load_sensor(file).cfa.pattern == (("R", "W"), ("W", "W"))
    assert {len(row) for rows in PATTERNS.values() for row in rows} == {1, 2, 4, 6}


@pytest.mark.parametrize(
    ("changes", "field", "allowed"),
    [
        ([(SHIFT, [1.5, 0])], "cfa.shift_px", "-1 to 1"),
        ([(("cfa", "pattern"), "RCCG")], "cfa.pattern", "RCCB"),
        (
            [(SHIFT, [0.1, 0]), (("crosstalk",), {"optical": {"R>G": [[0, 0, 0]]}})],
            "crosstalk",
            "no shift",
        ),
    ],
)
def test_mistakes_are_told_with_what_is_allowed(tmp_path, changes, field, allowed):
    with pytest.raises(UserError) as caught:
        load_sensor(sensor_file(tmp_path, *changes))
    assert caught.value.field == field and allowed in caught.value.allowed

"""Bars: what is computed decides."""

import math

import pytest

from gpusim.validate.bars import Bar


def test_the_largest_size_counts():
    bar = Bar.largest("position", [0.001, -0.03, 0.02], 0.02, "px")
    assert (bar.value, bar.held, bar.count) == (0.03, False, 3)
    assert Bar.largest("position", [0.001, -0.02], 0.02, "px").held


@pytest.mark.parametrize("errors", [[math.nan, 0.0], [0.0, math.nan], [math.inf]])
def test_what_is_no_number_holds_no_bar(errors):
    assert not Bar.largest("position", errors, 0.02, "px").held


def test_nothing_compared_is_a_mistake():
    with pytest.raises(ValueError, match="empty"):
        Bar.largest("position", [], 0.02, "px")

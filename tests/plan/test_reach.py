"""The nearest tolerance that can be met: named where one is refused, taken for best effort."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from gpusim.errors import UserError
from gpusim.plan.accuracy import Accuracy, rounded_up
from gpusim.plan.reach import STEPS, within_reach


@dataclass
class Attempt:
    """A plan whose error is a floor, whatever the tolerance."""

    tolerance: float
    excess: float
    why: str = "the floor cannot be less"


def floored(floor: float, tried: list[float] | None = None):
    def attempt(tolerance: float) -> Attempt:
        if tried is not None:
            tried.append(tolerance)
        return Attempt(tolerance, floor / tolerance)

    return attempt


def test_steps_have_two_digits_from_the_smallest_to_the_largest():
    assert STEPS[0] == 1e-5 and STEPS[-1] == 0.1 and STEPS == sorted(set(STEPS))
    assert all(float(f"{step:.1e}") == step for step in STEPS)
    assert len(STEPS) == 4 * 90 + 1


@pytest.mark.parametrize(
    ("value", "rounded"),
    [(0.00231, 0.0024), (0.0023, 0.0023), (9.91e-4, 1e-3), (1e-5, 1e-5), (31.2, 32.0), (1.0, 1.0)],
)
def test_two_digits_are_rounded_up(value: float, rounded: float):
    assert rounded_up(value) == rounded


def test_what_can_be_met_is_planned_once():
    tried: list[float] = []
    found, shortfall = within_reach(floored(1e-3, tried), Accuracy(1e-3), 1.0)
    assert (found.tolerance, shortfall, tried) == (1e-3, "", [1e-3])


@pytest.mark.parametrize("floor", [1.01e-5, 3.14e-3, 0.0999, 0.1])
def test_a_floor_is_found_by_planning_again_at_the_excess(floor: float):
    """The first step above it, in three plans: the one asked for, it, and the one below."""
    tried: list[float] = []
    with pytest.raises(UserError, match="cannot be met: the floor cannot be less") as caught:
        within_reach(floored(floor, tried), Accuracy(1e-5), 1.0)
    assert caught.value.value == "1e-05"
    assert caught.value.allowed == f"{rounded_up(floor):g} or more; or any, with --best-effort"
    assert len(tried) <= 3
    asked = Accuracy(1e-5, best_effort=True)
    found, shortfall = within_reach(floored(floor), asked, 1.0)
    assert found.tolerance == rounded_up(floor)
    assert f"planned for {rounded_up(floor):.2g} of the local signal in place of 1e-05" in shortfall


def test_nothing_is_planned_where_a_floor_is_known_to_be_missed():
    """What else is missed lies higher, or lower: found by planning where the floor is met."""
    for other, nearest in ((2e-4, 0.0031), (0.02, 0.02)):
        tried: list[float] = []
        with pytest.raises(UserError) as caught:
            given = floored(other, tried), Accuracy(1e-5), 1.0
            within_reach(*given, lambda tolerance: 3.1e-3 / tolerance)
        assert caught.value.allowed.startswith(f"{nearest:g} or more")
        assert all(one >= 3.1e-3 for one in tried[1:]) and len(tried) <= 3


@pytest.mark.parametrize("excess", [1.5, 500.0])
def test_an_error_that_goes_with_the_tolerance_is_sought_by_halves(excess: float):
    """Met from 0.0047 on; by the excess of the first, from 1.5e-4 or from 0.05."""

    def attempt(tolerance: float) -> Attempt:
        return Attempt(tolerance, excess if tolerance < 0.0047 else 0.5)

    found, _ = within_reach(attempt, Accuracy(1e-4, best_effort=True), 1.0)
    assert found.tolerance == 0.0047


def test_an_obstacle_that_a_looser_tolerance_removes_is_named():
    def attempt(tolerance: float) -> Attempt:
        if tolerance < 0.02:
            raise UserError("Too wide.", field="method", value="9 samples", allowed="8 samples")
        return Attempt(tolerance, 0.9)

    with pytest.raises(UserError, match=r"met: too wide \(9 samples; allowed: 8 sam") as caught:
        within_reach(attempt, Accuracy(1e-3), 1.0)
    assert caught.value.field == "tolerance" and caught.value.allowed.startswith("0.02 or more")
    found, shortfall = within_reach(attempt, Accuracy(1e-3, best_effort=True), 1.0)
    assert found.tolerance == 0.02 and "too wide" in shortfall


def test_an_obstacle_that_no_tolerance_removes_is_raised_as_it_is():
    obstacle = UserError("Too wide.", field="method")

    def attempt(tolerance: float) -> Attempt:
        raise obstacle

    for effort in (False, True):
        with pytest.raises(UserError) as caught:
            within_reach(attempt, Accuracy(1e-3, best_effort=effort), 1.0)
        assert caught.value is obstacle


def test_where_no_tolerance_is_met_best_effort_takes_the_least_bad_plan():
    with pytest.raises(UserError, match="cannot be met") as caught:
        within_reach(floored(0.3), Accuracy(1e-3), 1.0)
    assert caught.value.allowed.startswith("none that is in range")
    found, shortfall = within_reach(floored(0.3), Accuracy(1e-3, best_effort=True), 1.0)
    assert found.tolerance == 1e-3 and shortfall.startswith("no tolerance can be met")


def test_sigmas_are_named_in_sigmas():
    """A sigma is a fiftieth of the signal: a floor of 0.004 is a fifth of one."""
    with pytest.raises(UserError) as caught:
        within_reach(floored(0.004), Accuracy(0.1, unit="sigma"), 0.02)
    assert caught.value.value == "0.1 sigma" and caught.value.allowed.startswith("0.2 sigma or")
    found, _ = within_reach(floored(0.004), Accuracy(0.1, 8, "sigma", best_effort=True), 0.02)
    assert found.tolerance == 0.004
    # Beyond ten sigmas none can be asked for.
    with pytest.raises(UserError) as caught:
        within_reach(floored(0.05), Accuracy(0.1, unit="sigma"), 0.004)
    assert caught.value.allowed.startswith("none that is in range")


def test_less_than_float32_holds_is_planned_for_as_well_as_can_be():
    asked = Accuracy(1e-3, 8, "sigma", best_effort=True)
    assert asked.relative(1e7, 0.0, 1e7).tolerance == 1e-5
    found, shortfall = within_reach(floored(0.0), asked, asked.share(1e7, 0.0, 1e7))
    assert found.tolerance == 1e-5 and "in place of 3.2e-07: float32" in shortfall

"""The nearest tolerance that can be met: refused plans name it, best effort takes it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from typing import Protocol, TypeVar

from gpusim.errors import UserError
from gpusim.plan.accuracy import (
    BEST_EFFORT,
    FLOAT32,
    LARGEST,
    RANGES,
    SMALLEST,
    Accuracy,
    rounded_up,
)

# Tolerances of two digits, which are what a refusal names.
STEPS = [
    step
    for power in range(-6, -1)
    for digits in range(10, 100)
    if SMALLEST <= (step := float(f"{digits}e{power}")) <= LARGEST
]


class Attempt(Protocol):
    """What came of planning for one relative tolerance.

    Attributes
    ----------
    excess : float
        Predicted error over what the tolerance leaves to it, where that is largest: at most 1 where
        the tolerance is met.
    why : str
        What the largest is, and why it cannot be less.
    """

    excess: float
    why: str


Found = TypeVar("Found", bound=Attempt)


def within_reach(
    attempt: Callable[[float], Found],
    accuracy: Accuracy,
    share: float,
    floor: Callable[[float], float] | None = None,
) -> tuple[Found, str]:
    """Return the plan for a tolerance; for best effort, where it cannot be met, for the nearest.

    Parameters
    ----------
    attempt : callable
        Plans for a relative tolerance; raises a UserError where nothing can be done.
    accuracy : Accuracy
        What was asked for, in the user's unit.
    share : float
        Share of the signal that one unit of it is: see `Accuracy.share`.
    floor : callable, optional
        The excess at a relative tolerance, or less: known without planning. Where that is above 1,
        nothing is planned in search of the nearest.

    Returns
    -------
    found : Attempt
    shortfall : str
        Empty, or for which tolerance it is instead, and why.

    Raises
    ------
    UserError
        When the tolerance cannot be met and no best effort is asked for, with the nearest that can
        be; when nothing can be done at any.
    """
    wanted = accuracy.tolerance * share
    relative = min(max(wanted, SMALLEST), LARGEST)
    first, obstacle, guess = None, None, relative
    try:
        first = attempt(relative)
    except UserError as error:
        # This frame is one of the error's: error and frame would keep each other, and the plan.
        obstacle = error.with_traceback(None)
    else:
        if first.excess <= 1:
            # Less than the smallest is refused by `Accuracy.relative`, but for best effort.
            return first, _instead(relative, wanted, FLOAT32) if wanted < relative else ""
        guess = relative * first.excess
    steps = [step for step in STEPS if step > relative and (floor is None or floor(step) <= 1)]
    nearest, found = _nearest(attempt, steps, guess)
    named = None if nearest is None else rounded_up(nearest / share)  # in the user's unit
    if named is not None and named > RANGES[accuracy.unit][1]:
        named = None
    if found is None and first is None:
        raise obstacle  # no tolerance helps
    why = first.why if first is not None else _in_a_sentence(obstacle)
    if accuracy.best_effort:
        if found is None:
            return first, f"no tolerance can be met: {why}"
        return found, _instead(nearest, wanted, why)
    least = "none that is in range" if named is None else f"{accuracy.in_words(named)} or more"
    raise UserError(
        f"The tolerance cannot be met: {why}.",
        field="tolerance",
        value=accuracy.text,
        allowed=least + BEST_EFFORT,
    )


def _nearest(
    attempt: Callable[[float], Found], steps: list[float], guess: float
) -> tuple[float | None, Found | None]:
    """Return the smallest of some tolerances that is met, and its plan; None where none is.

    An error that does not follow the tolerance gives it at once: it is the first step above the
    guess. Else it is sought by halves.
    """
    plans: dict[float, Found] = {}

    def met(tolerance: float) -> bool:
        try:
            plan = attempt(tolerance)
        except UserError:
            return False
        if plan.excess <= 1:
            plans[tolerance] = plan
        return tolerance in plans

    if not steps:
        return None, None
    low, high = 0, len(steps) - 1
    at = bisect_left(steps, guess, 0, high)
    if met(steps[at]):
        high = at
        if at == 0 or not met(steps[at - 1]):
            low = at
    elif at == high or not met(steps[high]):
        return None, None
    else:
        low = at + 1
    nearest = steps[bisect_left(steps, True, low, high, key=met)]
    return nearest, plans[nearest]


def _instead(tolerance: float, wanted: float, why: str) -> str:
    """Say what a plan is made for, and why."""
    return f"planned for {tolerance:.2g} of the local signal in place of {wanted:.2g}: {why}"


def _in_a_sentence(obstacle: UserError) -> str:
    """Return an obstacle as a part of a sentence."""
    text = obstacle.problem.rstrip(".")
    text = text[0].lower() + text[1:]
    return f"{text} ({obstacle.value}; allowed: {obstacle.allowed})"

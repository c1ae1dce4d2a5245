"""The tightest tolerance whose plan fits a time."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable

from gpusim.errors import UserError
from gpusim.plan.accuracy import BEST_EFFORT, LARGEST, SMALLEST, Accuracy, rounded_up
from gpusim.plan.shares import WORST_TO_RMS
from gpusim.plan.stages import Plan

# Walked from the loosest on: plans for tight tolerances take long to make.
COARSE = (LARGEST, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, SMALLEST)
DIGITS = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)  # of what lies between


def predicted_parts(plan: Plan) -> dict[str, float]:
    """Return the planner's predicted errors by part, relative: RMS, and of cuts the bound."""
    of = {stage.name: stage.predicted_error or 0.0 for stage in plan.stages if stage.runs}
    # The planes' prediction is that of the worst spectrum in its weakest channel.
    planes = max(of.get("paint", 0.0), of.get("warp", 0.0)) / WORST_TO_RMS
    nodes = max(of.get(stage, 0.0) for stage in ("fft columns", "direct"))  # by method
    return {"planes": planes, "alias": of.get("fft rows", 0.0), "nodes": nodes}


def predicted_error(plan: Plan) -> float:
    """Return the predicted RMS error of a plan, relative: of the engine, the bank and its window.

    Independent parts add in the squares; light that is lost at the window adds to them.
    """
    of = {stage.name: stage.predicted_error or 0.0 for stage in plan.stages if stage.runs}
    return math.hypot(*predicted_parts(plan).values(), of.get("bank", 0.0)) + of.get("window", 0.0)


def first_frame_s(plan: Plan) -> float:
    """Return the predicted seconds of a first frame: kernels, light and read-out.

    Neither the tracing of the lens nor the planning itself counts, nor the light beyond the PSFs'
    window, which is rendered coarsely.
    """
    return plan.kernels_s + plan.predicted_s


def tightest(
    plan_for: Callable[[float], Plan], guess: Callable[[float], Plan], accuracy: Accuracy
) -> tuple[float, Plan]:
    """Return the tightest relative tolerance whose plan fits a time, and the plan.

    Parameters
    ----------
    plan_for : callable
        Plans for a relative tolerance; raises a UserError where it cannot be met.
    guess : callable
        The same at a small part of its cost, for a plan that takes about as long: where the search
        begins.
    accuracy : Accuracy
        With ``within_s``.

    Raises
    ------
    UserError
        The loosest tolerance cannot be met; or its plan takes longer, and no best effort is asked
        for: with the time that it takes.
    """
    loosest = plan_for(LARGEST)
    least_s = first_frame_s(loosest)
    if least_s > accuracy.within_s:
        if accuracy.best_effort:
            return LARGEST, loosest
        raise UserError(
            f"No plan is so fast: that for a tolerance of {LARGEST:g} is predicted to take "
            f"{least_s:.2g} s.",
            field="tolerance",
            value=accuracy.text,
            allowed=f"as good as {rounded_up(least_s):g} s allows, or longer{BEST_EFFORT}",
        )

    def fits(plans: Callable[[float], Plan], tolerance: float) -> Plan | None:
        try:
            plan = plans(tolerance)
        except UserError:  # it cannot be met, however long it may take
            return None
        return plan if first_frame_s(plan) <= accuracy.within_s else None

    begin = _tightest_of(lambda tolerance: fits(guess, tolerance) is not None)
    for tolerance in [step for step in _steps() if begin <= step < LARGEST]:
        if (plan := fits(plan_for, tolerance)) is not None:
            return tolerance, plan
    return LARGEST, loosest


def _tightest_of(fits: Callable[[float], bool]) -> float:
    """Return the tightest tolerance that fits, from the loosest on."""
    beyond = next((one for one in COARSE[1:] if not fits(one)), None)
    if beyond is None:
        return SMALLEST
    found = COARSE[COARSE.index(beyond) - 1]
    between = [one for one in _steps() if beyond < one < found]  # tightest first
    at = bisect_left(between, True, key=fits)
    return between[at] if at < len(between) else found


def _steps() -> list[float]:
    """Return the tolerances that are tried, tightest first."""
    found = {float(f"{digit}e{power}") for power in range(-5, -1) for digit in DIGITS}
    return sorted({*found, LARGEST})

"""The tightest tolerance that a time allows: found, planned for, refused where there is none."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from optics.made import bank, scene, sensor, shapes

from gpusim.camera import Camera
from gpusim.errors import UserError
from gpusim.library.expose import expose
from gpusim.plan import Accuracy, PlanStage, plan_optics
from gpusim.plan.deadline import first_frame_s, predicted_error, predicted_parts, tightest


def taking(seconds: float, tried: list[float] | None = None, floor: float = 0.0):
    """Return a planner whose plans take so long at a tolerance of 1, and as the root of others."""

    def plan_for(tolerance: float):
        if tried is not None:
            tried.append(tolerance)
        if tolerance < floor:
            raise UserError("cannot be met", field="tolerance", value=tolerance, allowed="more")
        return SimpleNamespace(kernels_s=0.0, predicted_s=seconds / math.sqrt(tolerance))

    return plan_for


def within(seconds: float, **other: object) -> Accuracy:
    return Accuracy.parse(f"as good as {seconds} s allows", 0, **other)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("as good as 0.4 s allows", 0.4),
        ("as good as 40 ms allows", 0.04),
        (" as good as 3s allows", 3.0),
    ],
)
def test_a_time_in_words(text: str, seconds: float):
    found = Accuracy.parse(text, 8)
    assert (found.within_s, found.probes, found.unit) == (seconds, 8, "relative")
    assert Accuracy.parse(found.text, 8) == found


@pytest.mark.parametrize(
    "text",
    ["as good as 0 s allows", "as good as -1 s allows", "as good as nan s allows",
     "as good as inf s allows", "as good as x s allows", "as good as 0.4 allows", "0.4 s"],
)  # fmt: skip
def test_other_times_are_refused(text: str):
    with pytest.raises(UserError) as caught:
        Accuracy.parse(text)
    assert caught.value.field == "tolerance"


def test_the_tightest_that_fits_is_found():
    """At 1/sqrt(t) seconds, 10 s allow 0.01 and no less."""
    tried: list[float] = []
    tolerance, plan = tightest(taking(1.0, tried), taking(1.0), within(10.0))
    assert tolerance == 0.01 and plan.predicted_s == pytest.approx(10.0)
    assert tried == [0.1, 0.01]  # what is dear is done once


def test_a_guess_that_is_too_fast_is_put_right():
    tolerance, plan = tightest(taking(1.0), taking(0.7), within(10.0))
    assert tolerance == 0.01 and plan.predicted_s <= 10.0


def test_what_cannot_be_met_is_no_plan_however_long_it_may_take():
    assert tightest(taking(1.0, floor=2.5e-3), taking(1.0), within(1e4))[0] == 2.5e-3
    tight = tightest(taking(1.0), taking(1.0), within(1e4))
    assert tight[0] == 1e-5


def test_where_no_plan_is_so_fast_the_time_of_the_fastest_is_named():
    with pytest.raises(UserError, match="No plan is so fast") as caught:
        tightest(taking(1.0), taking(1.0), within(2.0))
    assert caught.value.allowed.startswith("as good as 3.2 s allows, or longer")
    assert tightest(taking(1.0), taking(1.0), within(3.2))[0] == 0.1
    tolerance, plan = tightest(taking(1.0), taking(1.0), within(2.0, best_effort=True))
    assert tolerance == 0.1 and plan.predicted_s > 2.0


def test_predicted_errors_of_a_plan_add_in_the_squares():
    plan = plan_optics(bank(coma_um=0.5), sensor(32, 40), scene(shapes()), Accuracy(1e-2))
    parts = predicted_parts(plan)
    assert parts["nodes"] > 0
    assert predicted_error(plan) == pytest.approx(math.sqrt(sum(one**2 for one in parts.values())))
    lens = tuple(PlanStage(name, True, "", 1.0) for name in ("bank", "window"))
    assert predicted_error(replace(plan, stages=lens)) == 2.0
    assert first_frame_s(plan) == plan.predicted_s + plan.kernels_s


def test_light_for_a_time_is_that_of_the_tolerance_it_allows():
    camera = Camera(SimpleNamespace(title="Gaussians", bank=lambda _: bank()), sensor(16, 24))
    asked = {"probes": 0, "best_effort": True}
    light = expose(camera, scene(shapes()), "as good as 0.001 ms allows", **asked)
    assert light.tolerance == "0.1" and light.recipe["tolerance"] == 0.1
    (note,) = [one for one in light.notes if one.startswith("as good as 1e-06 s allows")]
    assert "planned for 0.1 of the local signal" in note and note.endswith("no plan is faster")
    assert np.array_equal(light.rates, expose(camera, scene(shapes()), 0.1, **asked).rates)

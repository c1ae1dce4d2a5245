"""The choice among candidates: the cheapest within the tolerance, and why the others lost."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gpusim.errors import UserError
from gpusim.optics.grid import SimGrid
from gpusim.plan.blocks import Layout
from gpusim.plan.candidates import Candidate, Part, choose

GRID = SimGrid(96, 128, 4, 2, 256, 16, (1, 1))
TOO_BIG = UserError("The kernels do not fit.", value="352 samples", allowed="less")


def candidate(name: str, cost_s: float | None, nodes: float = 5e-4, alias: float = 1e-4):
    parts = (
        ()
        if cost_s is None
        else (Part("whole", 0.775, Layout(GRID, {}, {"fft rows": cost_s}, 0.0)),)
    )
    limits = {"nodes": 1e-3, "alias": 1e-3}
    return Candidate(name, 2, None, 0.8, {"nodes": nodes, "alias": alias}, limits, parts)


def test_the_cheapest_within_the_tolerance_is_chosen():
    dear, cheap, wrong = candidate("a", 3.14), candidate("b", 1.4), candidate("c", 0.1, alias=4e-3)
    big = replace(candidate("d", None), obstacle=TOO_BIG)
    skipped = candidate("e", None, nodes=2e-3)
    finer = replace(candidate("f", None), oversampling=4)
    chosen, others = choose([dear, cheap, wrong, big, skipped, finer])
    assert chosen is cheap
    assert {other.name: other.lost for other in others} == {
        "a": "too dear: 3.14 s against 1.4 s",
        "c": "error of its alias 4.0e-03 above 1.0e-03",
        "d": "does not fit: 352 samples",
        "e": "error of its nodes 2.0e-03 above 1.0e-03",
        "f": "too dear: 2 samples a pixel meet the tolerance",
    }
    # What nearly won comes first, what cannot be done last.
    assert others[0].name == "a" and others[-1].name == "d"
    assert others[0].predicted_cost_s == 3.14 and others[0].predicted_error == 5e-4
    assert others[-1].predicted_cost_s is None


def test_a_cost_is_the_sum_over_scales_and_stages():
    one = Layout(GRID, {}, {"fft rows": 1.0, "dispatch": 0.25}, 0.25)
    assert one.frame_s == 1.25
    both = replace(candidate("a", 1.0), parts=(Part("core", 1, one), Part("tail", 1, one)))
    assert both.cost_s == 3.0


def test_where_none_meets_the_tolerance_the_nearest_is_taken():
    far, near = candidate("a", 0.1, nodes=4e-3), candidate("b", 9.0, nodes=2e-3)
    chosen, (other,) = choose([far, near])
    assert chosen is near and chosen.worst == "nodes" and chosen.excess == 2.0
    assert other.lost == "error of its nodes 4.0e-03 above 1.0e-03"


def test_where_nothing_fits_the_reason_is_raised():
    with pytest.raises(UserError) as caught:
        choose([replace(candidate("a", None), obstacle=TOO_BIG)])
    assert caught.value is TOO_BIG

"""Axes of a sweep: what is listed comes whole, what is drawn follows its law."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import stats

from gpusim.batch.axes import Axis, combined
from gpusim.errors import UserError


def draw(samples: int, sampler: str = "random", seed: int = 0, **axes: dict) -> list[dict]:
    made = {name: Axis(**fields) for name, fields in axes.items()}
    return combined(made, "sample", samples, sampler, seed)


def test_a_product_takes_every_value_with_every_other():
    axes = {"a": Axis(values=[1, 2]), "b": Axis(range=[0, 6, 2]), "c": Axis(linspace=(0, 1, 3))}
    found = combined(axes, "product", None, "random", 0)
    assert len(found) == 2 * 3 * 3
    assert len({tuple(one.values()) for one in found}) == 18
    assert found[0] == {"a": 1, "b": 0, "c": 0.0} and found[1]["c"] == 0.5


def test_a_zip_takes_the_first_of_each_then_the_second():
    axes = {"a": Axis(values=["x", "y"]), "b": Axis(geomspace=(1, 100, 2)), "c": Axis(values=[5])}
    found = combined(axes, "zip", None, "random", 0)
    assert [tuple(one.values()) for one in found] == [("x", 1.0, 5), ("y", pytest.approx(100), 5)]
    with pytest.raises(UserError, match="different length"):
        combined({"a": Axis(range=[0, 2]), "b": Axis(range=[0, 3])}, "zip", None, "random", 0)


@pytest.mark.parametrize("sampler", ["random", "sobol"])
@pytest.mark.parametrize(
    "fields, law",
    [
        ({"uniform": (2.0, 5.0)}, stats.uniform(2, 3)),
        ({"normal": (1.0, 0.5)}, stats.norm(1, 0.5)),
        ({"log_uniform": (0.01, 10.0)}, stats.loguniform(0.01, 10)),
    ],
)
def test_what_is_drawn_follows_its_law(sampler: str, fields: dict, law):
    values = [one["x"] for one in draw(1000, sampler, 3, x=fields, y={"uniform": (0, 1)})]
    # Kolmogorov and Smirnov's test: 1 in 1000 right ones would fail; the seed is fixed.
    assert stats.kstest(values, law.cdf).pvalue > 1e-3


def test_a_draw_is_the_same_again_and_an_axis_more_changes_none():
    alone = draw(50, seed=4, x={"uniform": (0, 1)})
    both = draw(50, seed=4, x={"uniform": (0, 1)}, y={"normal": (0, 1)})
    assert [one["x"] for one in both] == [one["x"] for one in alone]
    assert draw(50, seed=5, x={"uniform": (0, 1)}) != alone
    # A longer sweep begins with the shorter one's frames.
    assert draw(80, seed=4, x={"uniform": (0, 1)})[:50] == alone


def test_sobol_covers_more_evenly_than_chance():
    points = {
        sampler: np.array([list(one.values()) for one in draw(256, sampler, 1, x=UNIT, y=UNIT)])
        for sampler in ("random", "sobol")
    }
    uneven = {name: stats.qmc.discrepancy(one) for name, one in points.items()}
    assert uneven["sobol"] < uneven["random"] / 5


UNIT = {"uniform": (0.0, 1.0)}


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"values": [1], "range": [0, 2]},
        {"range": [2, 0]},
        {"range": [0, 2, 0]},
        {"uniform": (2.0, 1.0)},
        {"log_uniform": (0.0, 1.0)},
        {"normal": (0.0, -1.0)},
        {"values": []},
        {"geomspace": (-1.0, 1.0, 3)},
    ],
)
def test_an_axis_that_is_none_is_refused(fields: dict):
    with pytest.raises(ValidationError):
        Axis(**fields)


def test_what_does_not_go_together_is_refused():
    drawn = {"x": Axis(**UNIT)}
    with pytest.raises(UserError, match="drawn"):
        combined(drawn, "product", None, "random", 0)
    with pytest.raises(UserError, match="needs their number"):
        combined(drawn, "sample", None, "random", 0)
    many = {name: Axis(range=[0, 1000]) for name in "abc"}
    with pytest.raises(UserError, match="too many"):
        combined(many, "product", None, "random", 0)

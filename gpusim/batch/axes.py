"""The axes of a sweep: values that are listed, counted off, or drawn."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.special import ndtri

from gpusim.config.model import Strict
from gpusim.errors import UserError

MOST_FRAMES = 10_000_000
Number = Annotated[float, Field(allow_inf_nan=False)]


class Axis(Strict):
    """How one setting varies: exactly one of these.

    Attributes
    ----------
    values : list, optional
        These, in turn.
    range : list of int, optional
        [first, beyond] or [first, beyond, step], as Python's.
    linspace, geomspace : (first, last, count), optional
        Evenly spaced, or by equal factors.
    uniform, log_uniform : (low, high), optional
        Drawn evenly, or evenly in the logarithm.
    normal : (mean, standard deviation), optional
        Drawn from a normal law.
    """

    values: tuple[float | int | str | bool | None, ...] | None = Field(default=None, min_length=1)
    range: tuple[int, ...] | None = Field(default=None, min_length=2, max_length=3)
    linspace: tuple[Number, Number, Annotated[int, Field(ge=1)]] | None = None
    geomspace: tuple[Number, Number, Annotated[int, Field(ge=1)]] | None = None
    uniform: tuple[Number, Number] | None = None
    log_uniform: tuple[Number, Number] | None = None
    normal: tuple[Number, Annotated[float, Field(ge=0)]] | None = None

    @model_validator(mode="after")
    def _one(self) -> Axis:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"exactly one of {', '.join(type(self).model_fields)}")
        low_high = self.uniform or self.log_uniform
        if low_high is not None and not low_high[0] <= low_high[1]:
            raise ValueError("the lower end first")
        ends = self.log_uniform or (self.geomspace and self.geomspace[:2])
        if ends and min(ends) <= 0:
            raise ValueError("ends above 0: the spacing is one of factors")
        if self.range is not None and (len(self.range) > 2 and self.range[2] == 0):
            raise ValueError("a step other than 0")
        if self.range is not None and not len(_range(self.range)):
            raise ValueError("a range with a number in it")
        return self

    @property
    def is_drawn(self) -> bool:
        """Whether its values are drawn, not listed."""
        return any(one is not None for one in (self.uniform, self.log_uniform, self.normal))

    @property
    def listed(self) -> Sequence[object]:
        """Its values, in turn; none of one that is drawn."""
        if self.values is not None:
            return self.values
        if self.range is not None:
            return _range(self.range)
        if self.linspace is not None:
            return np.linspace(*self.linspace).tolist()
        if self.geomspace is not None:
            return np.geomspace(*self.geomspace).tolist()
        return ()

    def at(self, share: float) -> object:
        """Return the value at a share of its distribution, 0 to 1."""
        if self.uniform is not None:
            low, high = self.uniform
            return low + share * (high - low)
        if self.log_uniform is not None:
            low, high = (math.log(end) for end in self.log_uniform)
            return math.exp(low + share * (high - low))
        if self.normal is not None:
            mean, spread = self.normal
            # The ends of the unit interval lie infinitely far out.
            return mean + spread * float(ndtri(min(max(share, 1e-12), 1 - 1e-12)))
        return self.listed[min(int(share * len(self.listed)), len(self.listed) - 1)]


def _range(numbers: Sequence[int]) -> range:
    return range(*numbers)


def combined(
    axes: Mapping[str, Axis],
    combine: Literal["product", "zip", "sample"],
    samples: int | None,
    sampler: Literal["random", "sobol"],
    random_seed: int,
) -> list[dict[str, object]]:
    """Return the settings of each frame.

    Parameters
    ----------
    axes : mapping of str to Axis
    combine : str
        "product": every value with every other, the last axis fastest. "zip": the first of each,
        the second of each. "sample": drawn, ``samples`` of them.
    samples : int, optional
    sampler : str
        "random": independent draws, the same for an axis whatever others there are. "sobol": a
        scrambled Sobol sequence (Owen 1998), which covers the axes together more evenly.
    random_seed : int

    Raises
    ------
    UserError
        Axes that do not go together so, or too many frames.
    """
    if combine == "sample":
        if samples is None:
            raise UserError(
                "a sweep that draws needs their number", field="samples", allowed="1 or more"
            )
        shares = _shares(list(axes), samples, sampler, random_seed)
        return [
            {name: axis.at(row[k]) for k, (name, axis) in enumerate(axes.items())} for row in shares
        ]
    for name, axis in axes.items():
        if axis.is_drawn:
            raise UserError(
                f"values are drawn, and the sweep takes a {combine}",
                field=f"axes.{name}",
                allowed="values, range, linspace or geomspace; or combine: sample",
            )
    lists = [axis.listed for axis in axes.values()]
    if combine == "zip":
        lengths = {len(one) for one in lists if len(one) != 1}
        if len(lengths) > 1:
            raise UserError(
                "axes of different length cannot be taken together",
                field="axes",
                value=", ".join(f"{n}: {len(one)}" for n, one in zip(axes, lists, strict=True)),
                allowed="the same number of values, or one",
            )
        count = max(lengths, default=1)
        rows = [[one[k % len(one)] for one in lists] for k in range(count)]
    else:
        count = math.prod(len(one) for one in lists)
        _check_count(count)
        rows = itertools.product(*lists)
    _check_count(count)
    return [dict(zip(axes, row, strict=True)) for row in rows]


def _check_count(count: int) -> None:
    if count > MOST_FRAMES:
        raise UserError(
            "too many frames", field="axes", value=count, allowed=f"up to {MOST_FRAMES:,}"
        )


def _shares(names: list[str], samples: int, sampler: str, random_seed: int) -> np.ndarray:
    """Return a number from 0 to 1 for each sample and axis."""
    _check_count(samples)
    if sampler == "sobol":
        if not names:
            return np.zeros((samples, 0))
        from scipy.stats import qmc  # slow to import, and few sweeps draw so

        rule = qmc.Sobol(len(names), rng=np.random.default_rng(random_seed))
        # Whole powers of two keep the sequence's balance; what is beyond is left.
        return rule.random_base2(max(samples - 1, 0).bit_length())[:samples]
    columns = []
    for name in names:
        digest = hashlib.blake2b(f"{random_seed} {name}".encode(), digest_size=8).digest()
        columns.append(np.random.default_rng(int.from_bytes(digest, "little")).random(samples))
    return np.stack(columns, axis=1) if columns else np.zeros((samples, 0))

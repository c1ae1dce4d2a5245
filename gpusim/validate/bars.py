"""What has to hold: a computed figure against its bound."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self


@dataclass(frozen=True)
class Bar:
    """A bound that a figure must keep.

    Attributes
    ----------
    name : str
    value : float
        Found: the largest of what was compared.
    bound : float
    unit : str
    count : int
        How many were compared.
    """

    name: str
    value: float
    bound: float
    unit: str
    count: int

    @property
    def held(self) -> bool:
        """Whether it is kept; a figure that is no number keeps none."""
        return self.value <= self.bound

    @classmethod
    def largest(cls, name: str, errors: Iterable[float], bound: float, unit: str) -> Self:
        """Return the bar of the largest size of some errors.

        Raises
        ------
        ValueError
            There are none.
        """
        sizes = [abs(float(error)) for error in errors]
        # max() passes over a NaN that does not come first.
        worst = max(sizes) if all(size == size for size in sizes) else float("nan")
        return cls(name, worst, bound, unit, len(sizes))

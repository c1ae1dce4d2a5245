"""Compiling as a phase of its own: what it cost, kernel by kernel, and who is told of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Compiled:
    """What it took to compile one kernel.

    Attributes
    ----------
    path : str
        The stage name.
    overrides : dict
        Every override with its value.
    wall_s : float
        One that the driver finds in its cache takes next to nothing.
    """

    path: str
    overrides: Mapping[str, bool | int | float]
    wall_s: float


_told: list[Callable[[int, int], None]] = []


@contextmanager
def compiling(progress: Callable[[int, int], None]) -> Iterator[None]:
    """Call ``progress`` with (kernels compiled, kernels to compile) while the body compiles some.

    The body's recordings are counted together: the second number grows from one to the next.
    """
    done = 0

    def count(number: int, total: int) -> None:
        nonlocal done
        progress(done + number, done + total)
        done += total if number == total else 0

    _told.append(count)
    try:
        yield
    finally:
        _told.remove(count)


def tell_compiling(number: int, total: int) -> None:
    """Tell all that listen how many kernels of a recording are compiled, of how many."""
    for tell in _told:
        tell(number, total)

"""Work on many things at once, on all cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from threadpoolctl import threadpool_limits

Thing = TypeVar("Thing")
Result = TypeVar("Result")


def each(
    work: Callable[[Thing], Result],
    things: Iterable[Thing],
    progress: Callable[[int, int], None] | None = None,
) -> list[Result]:
    """Return the results of the work on each thing, in their order.

    NumPy and SciPy let go of the interpreter in their loops. Each thing has one BLAS thread:
    OpenBLAS's own threads wait by spinning.

    Parameters
    ----------
    work : callable
        Takes one thing.
    things : iterable
    progress : callable, optional
        Called with (things done, things in all).
    """
    things = list(things)
    results: list[Result] = []
    pool = ThreadPoolExecutor(os.cpu_count())
    try:
        with threadpool_limits(1):
            for result in pool.map(work, things):
                results.append(result)
                if progress is not None:
                    progress(len(results), len(things))
    finally:
        # Whoever stops it waits for what is in work, and for no more.
        pool.shutdown(cancel_futures=True)
    return results

"""Parts of a report that are measured at once, each in a process of its own.

Planning, tracing and predicting keep one core busy for most of their time; so many processes as
there are cores keep all of them.
"""

from __future__ import annotations

import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.queues import SimpleQueue
from typing import Any

from threadpoolctl import threadpool_limits

from gpusim.calibrate.rates import adapter_costs
from gpusim.gpu import default_device

Progress = Callable[[str, int, int], None]
Part = Callable[[Progress], Any]

LOOK_S = 0.2  # between looks at what the parts tell of their progress

_told: SimpleQueue


def at_once(parts: Sequence[Part], progress: Progress) -> list[Any]:
    """Return what parts give, in their order.

    Parameters
    ----------
    parts : sequence of callable
        Each is called with ``progress``. They and what they give are pickled. They begin in their
        order: those that take longest come first.
    progress : callable
        Called with (what, done, total).
    """
    with crew(progress) as workers:
        return workers.results([workers.begin(part) for part in parts])


class Crew:
    """Processes, one for each core, that work on parts: see `crew`."""

    def __init__(self, pool: ProcessPoolExecutor, told: SimpleQueue, progress: Progress) -> None:
        self._pool, self._told, self._progress = pool, told, progress
        self._made: list[Future] = []

    def begin(self, part: Part) -> Future:
        """Hand over a part: it begins when a process is free, while the caller goes on."""
        self._made.append(self._pool.submit(_measured, part))
        return self._made[-1]

    def results(self, parts: Sequence[Future]) -> list[Any]:
        """Wait for parts that have begun, and return what they give; a failure ends all."""
        running = set(self._made)
        while not all(one.done() for one in parts):
            done, running = wait(running, timeout=LOOK_S, return_when=FIRST_EXCEPTION)
            while not self._told.empty():
                self._progress(*self._told.get())
            for one in done:
                one.result()
        return [one.result() for one in parts]


@contextmanager
def crew(progress: Progress) -> Iterator[Crew]:
    """Start processes for parts, and end them.

    Parameters
    ----------
    progress : callable
        Called with (what, done, total), of the parts.
    """
    adapter_costs(default_device())  # measured before: parts would slow one another's measurement
    context = get_context("spawn")  # a copy of this process would share its GPU's device
    told = context.SimpleQueue()
    pool = ProcessPoolExecutor(os.cpu_count() or 1, context, _begin, (told,))
    try:
        yield Crew(pool, told, progress)
    except BaseException:
        for process in active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(told: SimpleQueue) -> None:
    """Prepare a process: whoever started it is the one that an interrupt stops.

    Mesa's software driver gets no threads of its own, for every core has a process: two that each
    rendered a lens at another focus took 42 s so, 46 s where each had two threads.
    """
    global _told
    _told = told
    os.environ["LP_NUM_THREADS"] = "0"
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    warnings.simplefilter("ignore")  # numba, which optiland uses, warns of its own insides


def _end_with_parent() -> None:
    """End when whoever started this process is gone: a killed one tells nobody."""
    parent_process().join()
    os._exit(1)


def _measured(part: Part) -> Any:
    with threadpool_limits(1):
        return part(lambda what, done, total: _told.put((what, done, total)))

"""Ctrl-C and SIGTERM: a run ends within a second, whatever it is doing, and leaves nothing behind.

Python raises an interrupt between two steps of the main thread; a step may be a compilation of ten
seconds, or the end of a pool of threads. So a thread waits for the signal too: the system writes
each to a pipe at once. It gives the main thread some time to end by itself, and then removes what
is not whole and ends the process.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from gpusim.cli.files import UNFINISHED

GRACE_S = 0.4  # for the main thread to end; then files are removed, well below a second in all
SIGNALS = (signal.SIGINT, signal.SIGTERM)
SHOW_CURSOR = "\x1b[?25h"
# Python's own process that removes what others leave, semaphores of a batch's workers, complains of
# each run that ends so. It takes its filters from here when it starts.
QUIET = "ignore::UserWarning:multiprocessing.resource_tracker"
RESUMES = "what is made stays, and --resume goes on"
_ADVICE: list[str] = []  # what to say after the signal


class Stopped(BaseException):
    """A signal asks the run to end. No subclass of what libraries catch."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def stopping() -> Iterator[None]:
    """Raise `Stopped` in the main thread at a signal; end the process where that is not enough."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    if QUIET not in sys.warnoptions:
        sys.warnoptions.append(QUIET)
    read, write = os.pipe()
    os.set_blocking(write, False)
    before = {number: signal.signal(number, _raise) for number in SIGNALS}
    wakeup = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    done = threading.Event()
    threading.Thread(target=_watch, args=(read, done), name="stop", daemon=True).start()
    try:
        yield
    except Stopped as stopped:
        _say(stopped.number)
        # Threads may still work: Python would wait for them.
        _end(stopped.number)
    finally:
        done.set()
        signal.set_wakeup_fd(wakeup)
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(write)  # the thread reads the end


@contextmanager
def advised(words: str) -> Iterator[None]:
    """Say these words too where a signal comes meanwhile."""
    _ADVICE.append(words)
    try:
        yield
    except Exception:
        _ADVICE.remove(words)
        raise
    # Not where it is `Stopped`: that is told when all is left.
    _ADVICE.remove(words)


def _raise(number: int, frame: FrameType | None) -> None:
    raise Stopped(number)


def _watch(read: int, done: threading.Event) -> None:
    """Wait for a signal, then for the main thread, and end the process where that does not."""
    while number := os.read(read, 1):
        if number[0] in SIGNALS and not done.wait(GRACE_S):
            _say(number[0])
            _end(number[0])
    os.close(read)


def _say(number: int) -> None:
    cursor = SHOW_CURSOR if sys.stderr.isatty() else ""
    with suppress(OSError, ValueError):
        words = "".join(f": {one}" for one in _ADVICE)
        os.write(2, f"{cursor}\nstopped by {signal.Signals(number).name}{words}\n".encode())


def _end(number: int) -> None:
    for folder in list(UNFINISHED):
        shutil.rmtree(folder, ignore_errors=True)
    os._exit(128 + number)

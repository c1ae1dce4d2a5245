"""The thread that makes pictures, so that the window never waits for one.

What is wanted has a number. A picture is shown only if nothing newer was shown before it, and what
is made for an older number is given up at its next step.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from gpusim.errors import UserError
from gpusim.gpu import wgsl
from gpusim.preview.engine import REFINED, Engine, Shown, Stale
from gpusim.preview.state import Knobs, View

NEWS_S = 0.25  # drawing the screen takes a core from the work for some 30 ms
REST_S = 0.35  # without a change, until the picture itself is made


@dataclass(frozen=True)
class Wanted:
    """What is asked for: knobs, a view, and probes of a certificate (0: none)."""

    number: int
    knobs: Knobs
    view: View
    probes: int = 0


class Worker:
    """Makes what was asked for last: a draft, and once nothing has changed for a while, the rest.

    Parameters
    ----------
    engine : Engine
    present : callable
        Called in the worker's thread with each picture and its number.
    refine : bool
        Whether to make the picture itself at rest.
    told : callable
        Called in the worker's thread when there is news of the work, some times a second.
    """

    def __init__(
        self,
        engine: Engine,
        present: Callable[[Shown, int], None],
        *,
        refine: bool = True,
        told: Callable[[], None] = lambda: None,
    ) -> None:
        self.engine, self.refine = engine, refine
        self.phase = ("", 0, 0)  # what is being done: name, done, total
        self.mistake: UserError | None = None  # of the newest request
        self.failure: BaseException | None = None  # ended the thread
        self._present, self._told = present, told
        self._told_at = 0.0
        self._changed = threading.Condition()
        self._wanted: Wanted | None = None
        self._drafted = self._refined = -1
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="preview", daemon=True)
        self._thread.start()

    def ask(self, knobs: Knobs, view: View, probes: int = 0) -> int:
        """Ask for a picture; return its number. What was asked for before is dropped."""
        with self._changed:
            number = 0 if self._wanted is None else self._wanted.number + 1
            self._wanted = Wanted(number, knobs, view, probes)
            self._changed.notify_all()
        return number

    def wait(self, number: int, kind: str, timeout_s: float) -> bool:
        """Wait until a picture of a number or a later one is made; return whether it was."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self.failure is not None or self._reached(number, kind), timeout_s
            )

    def _reached(self, number: int, kind: str) -> bool:
        return (self._refined if kind == REFINED else self._drafted) >= number

    @property
    def idle(self) -> bool:
        """Whether all that was asked for is made."""
        with self._changed:
            return self._wanted is None or self._reached(
                self._wanted.number, REFINED if self.refine else "draft"
            )

    def close(self) -> None:
        """End the thread and give the device's memory back."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        try:
            with wgsl.held():
                while (job := self._next()) is not None:
                    self._make(*job)
        except BaseException as error:
            self.failure = error
            with self._changed:
                self._changed.notify_all()
            self._told()
        finally:
            self.engine.release()

    def _next(self) -> tuple[Wanted, bool] | None:
        """Return what to make next, and whether it is a draft; None at the end."""
        with self._changed:
            while not self._closed:
                wanted = self._wanted
                if wanted is not None and not self._reached(wanted.number, "draft"):
                    return wanted, True
                if wanted is None or not self.refine or self._reached(wanted.number, REFINED):
                    self._changed.wait()
                elif not self._changed.wait(REST_S):
                    return wanted, False
            return None

    def _stale(self, wanted: Wanted) -> bool:
        return self._closed or self._wanted is not wanted

    def _make(self, wanted: Wanted, draft: bool) -> None:
        try:
            if draft:
                shown = self.engine.draft(wanted.knobs, wanted.view)
            else:
                shown = self.engine.refine(
                    wanted.knobs,
                    wanted.view,
                    lambda: self._stale(wanted),
                    self._progress,
                    wanted.probes,
                )
            self._present(shown, wanted.number)
            self.mistake = None
        except Stale:
            return
        except UserError as mistake:
            self.mistake = mistake
        finally:
            self.phase = ("", 0, 0)
        with self._changed:
            self._drafted = wanted.number
            if not draft or self.mistake is not None:
                self._refined = wanted.number
            self._changed.notify_all()
        self._told()

    def _progress(self, what: str, done: int, total: int) -> None:
        self.phase = (what, done, total)
        now = time.monotonic()
        if now - self._told_at > NEWS_S:
            self._told_at = now
            self._told()

"""The thread that makes pictures: newest first, old ones dropped, mistakes and failures told."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import pytest

from gpusim.errors import UserError
from gpusim.preview import worker as workers
from gpusim.preview.engine import Stale
from gpusim.preview.state import Knobs, View
from gpusim.preview.worker import Worker

KNOBS, VIEW = Knobs("mtf-only", "colorchecker"), View(0, 0, 1, 10, 10)


class FakeEngine:
    """Makes pictures that are the seed of their knobs, and refines in steps."""

    def __init__(self) -> None:
        self.released, self.refining, self.given_up = False, threading.Event(), []
        self.hold = threading.Event()
        self.hold.set()

    def draft(self, knobs, view):
        """Do as the engine does."""
        if knobs.seed == 99:
            raise UserError("no such seed")
        if knobs.seed == 98:
            raise ZeroDivisionError
        return SimpleNamespace(kind="draft", seed=knobs.seed)

    def refine(self, knobs, view, stale, progress, probes):
        """Do as the engine does."""
        self.refining.set()
        for _ in range(500):
            if stale():
                self.given_up.append(knobs.seed)
                raise Stale
            if self.hold.is_set():
                break
            time.sleep(0.01)
        return SimpleNamespace(kind="refined", seed=knobs.seed)

    def release(self):
        """Do as the engine does."""
        self.released = True


@pytest.fixture
def made(monkeypatch):
    monkeypatch.setattr(workers, "REST_S", 0.02)
    seen, engine = [], FakeEngine()
    worker = Worker(engine, lambda shown, number: seen.append((number, shown.kind, shown.seed)))
    yield worker, engine, seen
    worker.close()
    assert engine.released


def test_at_rest_the_newest_is_drafted_and_refined(made):
    worker, _, seen = made
    for seed in range(20):
        number = worker.ask(KNOBS.turned(seed=seed), VIEW)
    assert worker.wait(number, "refined", 10)
    assert seen[-2:] == [(19, "draft", 19), (19, "refined", 19)]
    assert [one[0] for one in seen] == sorted(one[0] for one in seen)
    assert worker.idle


def test_what_is_being_refined_is_given_up_when_a_knob_is_turned(made):
    worker, engine, seen = made
    engine.hold.clear()
    worker.ask(KNOBS.turned(seed=1), VIEW)
    assert engine.refining.wait(10)
    number = worker.ask(KNOBS.turned(seed=2), VIEW)
    assert worker.wait(number, "draft", 10)
    engine.hold.set()
    assert worker.wait(number, "refined", 10)
    assert engine.given_up == [1]
    assert (0, "refined", 1) not in seen


def test_a_mistake_is_told_and_the_next_picture_comes(made):
    worker, _, seen = made
    number = worker.ask(KNOBS.turned(seed=99), VIEW)
    assert worker.wait(number, "refined", 10)
    assert worker.mistake.problem == "no such seed"
    number = worker.ask(KNOBS.turned(seed=1), VIEW)
    assert worker.wait(number, "draft", 10)
    assert worker.mistake is None
    assert seen[0] == (1, "draft", 1)


def test_a_failure_is_kept_for_the_window(made):
    worker, _, _ = made
    number = worker.ask(KNOBS.turned(seed=98), VIEW)
    worker.wait(number, "draft", 10)
    assert isinstance(worker.failure, ZeroDivisionError)


def test_closing_ends_a_refinement(made):
    worker, engine, _ = made
    engine.hold.clear()
    worker.ask(KNOBS, VIEW)
    assert engine.refining.wait(10)
    started = time.monotonic()
    worker.close()
    assert time.monotonic() - started < 2

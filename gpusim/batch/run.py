"""A batch on Dask: tasks of some frames of one light, results on disk, nothing lost."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim.batch.cluster import connected
from gpusim.batch.kept import LIGHT_TOPIC, LIGHTS, SIDECAR, read_sidecar
from gpusim.batch.work import Task, work
from gpusim.config.text import read_record
from gpusim.disk import whole
from gpusim.errors import UserError

if TYPE_CHECKING:
    from distributed import Client

    from gpusim.batch.sweep import Sweep

FRAMES_A_TASK = 10  # a killed worker loses ten frames' work at most
SWEEP_FILE = "sweep.json"

Progress = Callable[[str, int, int], None]


@dataclass
class Outcome:
    """What became of a batch.

    Attributes
    ----------
    sweep : Sweep
    out : Path
    done : list of dict
        The sidecars of the frames that are there, in their order.
    failed : list of dict
        ``number``, ``settings`` and ``error`` of those that are not.
    new : int
        Frames that this run rendered.
    seconds : float
        Those of this run.
    """

    sweep: Sweep
    out: Path
    done: list[dict[str, Any]] = field(default_factory=list)
    failed: list[dict[str, Any]] = field(default_factory=list)
    new: int = 0
    seconds: float = 0.0

    @property
    def missing(self) -> int:
        """Frames that are neither there nor failed."""
        return len(self.sweep) - len(self.done) - len(self.failed)


def prepared(sweep: Sweep, out: Path, resume: bool) -> float:
    """Make the folder of a batch, or see that it is this sweep's; return the time in its raws.

    That is SOURCE_DATE_EPOCH where it is set (reproducible-builds.org), else when it was made.

    Raises
    ------
    UserError
        It holds another sweep's frames, or this one's and `resume` is not set.
    """
    known = out / SWEEP_FILE
    try:
        out.mkdir(parents=True, exist_ok=True)
        if known.exists():
            found = read_record(
                known,
                "the account of a sweep",
                *("digest", "taken"),
                allowed="what gpusim batch wrote; or a new folder",
            )
            if found["digest"] != sweep.digest:
                raise UserError(
                    "the folder holds the frames of another sweep",
                    file=out,
                    field="--out",
                    allowed="a new folder, or the sweep that these frames are of",
                )
            if not resume:
                raise UserError(
                    "the folder holds frames of this sweep",
                    file=out,
                    field="--out",
                    allowed="--resume to go on with them, or a new folder",
                )
            # Workers that were killed while writing left these: see `gpusim.disk.whole`.
            for left in out.glob(".[0-9]*-*"):
                left.unlink(missing_ok=True)
            return found["taken"]
        taken = _now()
        said = {"digest": sweep.digest, "taken": taken, "sweep": sweep.model_dump(mode="json")}
        with whole(known) as part:
            part.write_text(json.dumps(said, indent=1) + "\n")
        return taken
    except OSError as error:
        raise UserError(
            f"the output folder cannot be written: {error.strerror}", file=out, field="--out"
        ) from error


def _now() -> float:
    """Return the time that raws name, seconds since 1970."""
    told = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        return float(told or int(time.time()))
    except ValueError:
        raise UserError(
            "no time",
            field="SOURCE_DATE_EPOCH",
            value=told,
            allowed="seconds since 1970, or nothing",
        ) from None


def status(sweep: Sweep, out: Path) -> Outcome:
    """Return which frames of a sweep are there."""
    done = [read_sidecar(path) for path in sorted(out.glob(f"frame-*{SIDECAR}"))]
    return Outcome(sweep, out, [one for one in done if one["sweep"] == sweep.digest])


def tasks_of(sweep: Sweep, out: Path, taken: float) -> list[Task]:
    """Return the work that is left: frames of one light together, `FRAMES_A_TASK` at most."""
    left = [frame for frame in sweep.frames if not (out / f"{frame.name}{SIDECAR}").exists()]
    bare = sweep.model_copy()  # without what it has worked out, which workers do themselves
    tasks = []
    for _, group in groupby(left, key=lambda frame: frame.light_key):
        numbers = [frame.number for frame in group]
        for first in range(0, len(numbers), FRAMES_A_TASK):
            chunk = tuple(numbers[first : first + FRAMES_A_TASK])
            tasks.append(Task(bare, chunk, str(out), taken))
    return tasks


def run(
    sweep: Sweep,
    out: Path,
    *,
    resume: bool = False,
    workers: int = 1,
    scheduler: str | None = None,
    fail_fast: bool = False,
    progress: Progress | None = None,
    client: Client | None = None,
) -> Outcome:
    """Render a sweep into a folder.

    A frame is done when its sidecar, frame-NUMBER.json, is there: it is written last. Dask may run
    a task again after a worker was killed; frames that are there are left alone.

    Parameters
    ----------
    sweep : Sweep
    out : Path
        A folder; with a cluster one that all workers see.
    resume : bool
        Go on with what is there.
    workers : int
        Processes on this machine.
    scheduler : str, optional
        Address of a Dask scheduler, in place of processes of this machine.
    fail_fast : bool
        Whether to end with the first frame that fails; else failures are collected.
    progress : callable, optional
        Called with (what, done, total).
    client : distributed.Client, optional
        A cluster of the caller's.

    Raises
    ------
    UserError
        The folder is another sweep's, or the scheduler does not answer.
    """
    report = progress or (lambda what, done, total: None)
    taken = prepared(sweep, out, resume)
    started = time.perf_counter()
    total = len(sweep)
    outcome = status(sweep, out)
    there = len(outcome.done)
    report("frames", there, total)
    tasks = tasks_of(sweep, out, taken)
    if tasks:
        with connected(workers, scheduler, client) as dask:
            with _told(dask, report):
                _work(dask, tasks, outcome, fail_fast, lambda: report("frames", *_count(outcome)))
    outcome.done.sort(key=lambda one: one["number"])
    outcome.new = len(outcome.done) - there
    outcome.seconds = time.perf_counter() - started
    if not outcome.failed and not outcome.missing:
        shutil.rmtree(out / LIGHTS, ignore_errors=True)
    return outcome


@contextmanager
def _told(dask: Client, report: Progress) -> Iterator[None]:
    """Report how far workers are with their lights, which take most of a batch's first minute."""

    def tell(event: tuple[float, dict[str, Any]]) -> None:
        _, said = event
        report(f"light: {said['what']}", said["done"], said["total"])

    dask.subscribe_topic(LIGHT_TOPIC, tell)
    try:
        yield
    finally:
        with suppress(ValueError):  # the connection was lost, and with it the subscription
            dask.unsubscribe_topic(LIGHT_TOPIC)


def _count(outcome: Outcome) -> tuple[int, int]:
    return len(outcome.done) + len(outcome.failed), len(outcome.sweep)


def _work(
    dask: Client,
    tasks: list[Task],
    outcome: Outcome,
    fail_fast: bool,
    report: Callable[[], None],
) -> None:
    from distributed import as_completed

    # Not pure: the same task after a failure is another attempt.
    futures = dask.map(work, tasks, pure=False, retries=2)
    by_future = {future.key: task for future, task in zip(futures, tasks, strict=True)}
    for future in as_completed(futures):
        if future.status == "finished":
            for one in future.result():
                (outcome.failed if "error" in one else outcome.done).append(one)
        else:
            error = future.exception()
            for number in by_future[future.key].numbers:
                settings = outcome.sweep.frames[number].settings
                said = f"{type(error).__name__}: {error}"
                outcome.failed.append({"number": number, "settings": settings, "error": said})
        future.release()
        report()
        if fail_fast and outcome.failed:
            dask.cancel(futures)
            return

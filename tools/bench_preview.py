"""The jobs of tools/bench.py for the preview: from an event to the picture on the screen."""

from __future__ import annotations

import atexit
import tempfile
from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np

from gpusim.gpu import Device
from gpusim.preview.state import Knobs
from gpusim.preview.window import Offscreen

EVENTS = 20  # in a run of those that are quick
LONGEST_S = 60.0


def preview_job(device: Device, frame: tuple[int, int], what: str, job: Callable) -> object:
    """Time events of the demonstration camera's preview, drafts alone.

    ``what``: "sensor" (exposure), "pan" (what is there moves: no picture is awaited) or "focus".
    """
    screen = Offscreen(
        Knobs("demo", "demo", exposure_s=0.02), Path(tempfile.gettempdir()), refine=False
    )
    atexit.register(screen.close)
    screen.settle("draft", LONGEST_S)
    number, latency_s = count(1), []

    def settled() -> None:
        assert screen.app.worker.wait(screen.app.number, "draft", LONGEST_S)
        screen.frame()

    def sensor() -> None:
        screen.app.turn(exposure_s=0.02 + 1e-4 * (next(number) % 100))
        settled()

    def pan() -> None:
        view = screen.app.view
        screen.app.view = view.panned(3 if next(number) % 2 else -3, 0)
        screen.frame()

    def focus() -> None:
        screen.app.turn(focus_shift_um=0.5 * (1 + next(number) % 20))
        settled()

    event = {"sensor": sensor, "pan": pan, "focus": focus}[what]
    events = 1 if what == "focus" else EVENTS

    def run() -> None:
        before = len(screen.app.latency_s)
        for _ in range(events):
            event()
        latency_s.extend(screen.app.latency_s[before:])

    def facts(_: object) -> dict[str, object]:
        found = {"events": events, "view": f"{screen.app.view.width} x {screen.app.view.height}"}
        if latency_s:
            late = np.quantile(latency_s, (0.5, 0.95))
            found |= {"median_picture_s": float(late[0]), "p95_picture_s": float(late[1])}
        return found

    run()
    latency_s.clear()
    return job(run, screen.app.view.width * screen.app.view.height, {}, facts=facts)

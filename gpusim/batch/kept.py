"""What a worker keeps from task to task: its device's turn, and the lights that frames share."""

from __future__ import annotations

import json
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.batch.labels import labels_of
from gpusim.config.text import read_record
from gpusim.disk import alone, whole
from gpusim.library.expose import expose
from gpusim.library.light import Light
from gpusim.scene import make_scene

if TYPE_CHECKING:
    from gpusim.batch.frame import Frame
    from gpusim.batch.sweep import Sweep

LIGHTS, SIDECAR = ".lights", ".json"
LIGHT_TOPIC = "gpusim-light"  # of Dask's events: how far workers are with their lights
TOLD_S = 0.2  # between two of them: a screen shows no more
KEPT_LIGHTS = 2  # in a worker's memory: frames come light after light

# Tasks of one worker, two of them at a time, take turns on its device and with what it keeps.
DEVICE = threading.Lock()
SWEEPS: dict[str, Sweep] = {}  # of this worker, with their frames
_LIGHTS: OrderedDict[tuple[str, str], Light] = OrderedDict()
_LABELS: OrderedDict[tuple[str, str], dict[str, np.ndarray]] = OrderedDict()


def exposed(frame: Frame, progress: Callable[[str, int, int], None] | None = None) -> Light:
    """Return the light of a frame."""
    sweep, camera = frame.sweep, frame.camera()
    scene = make_scene(frame.scene, **frame.scene_options, frame=camera.frame)
    return expose(
        camera,
        scene,
        sweep.tolerance,
        probes=sweep.probes,
        tile=sweep.tile,
        best_effort=sweep.best_effort,
        progress=progress,
    )


def light_of(frame: Frame, out: Path) -> Light:
    """Return the light of a frame, made once however many workers ask."""
    key = (str(out), frame.light_key)
    if key not in _LIGHTS:
        folder = out / LIGHTS
        folder.mkdir(exist_ok=True)
        path = folder / f"{frame.light_key}.npz"
        with alone(folder / f"{frame.light_key}.lock"):
            if not path.exists():
                light = exposed(frame, _telling())
                with whole(out / recipe_name(frame)) as part:
                    part.write_text(json.dumps(light.recipe))
                light.save(path)
            else:
                light = Light.load(path)
        _LIGHTS[key] = light
        while len(_LIGHTS) > KEPT_LIGHTS:
            _LIGHTS.popitem(last=False)[1].release()
    _LIGHTS.move_to_end(key)
    return _LIGHTS[key]


def read_sidecar(path: Path) -> dict[str, Any]:
    """Return what is known of a frame that is there.

    Raises
    ------
    UserError
        The file is not what a batch wrote.
    """
    return read_record(
        path,
        "a frame's sidecar",
        *("number", "settings", "sweep"),
        allowed="what gpusim batch wrote; without it the frame is rendered again",
    )


def recipe_name(frame: Frame) -> str:
    """Return the name of the file that says how a frame's light is made again."""
    return f"light-{frame.light_key}{SIDECAR}"


def kept_labels(frame: Frame, out: Path) -> dict[str, np.ndarray]:
    """Return the labels of a frame on all lit pixels: those of its light, kept like that."""
    key = (str(out), frame.light_key)
    if key not in _LABELS:
        _LABELS[key] = labels_of(frame)
        while len(_LABELS) > KEPT_LIGHTS:
            _LABELS.popitem(last=False)
    _LABELS.move_to_end(key)
    return _LABELS[key]


def _telling() -> Callable[[str, int, int], None]:
    """Return what tells the client how far a light is, at most every `TOLD_S`."""
    from distributed import get_worker

    try:
        worker = get_worker()
    except ValueError:  # in a process of no cluster nobody listens
        return lambda what, done, total: None
    last: dict[str, float] = {}

    def tell(what: str, done: int, total: int) -> None:
        now = time.monotonic()
        if done in (0, total) or now - last.get(what, 0.0) > TOLD_S:
            last[what] = now
            worker.log_event(LIGHT_TOPIC, {"what": what, "done": done, "total": total})

    return tell

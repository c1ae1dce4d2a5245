"""What a worker does: bring a light to the photosites once, and read the frames that share it."""

from __future__ import annotations

import json
import math
import os
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import gpusim
from gpusim.batch.labels import in_frame, labels_of
from gpusim.errors import UserError
from gpusim.gpu import held
from gpusim.library.again import recipe_of_frame
from gpusim.library.expose import expose
from gpusim.library.frame import TOGETHER, read_frames
from gpusim.library.light import Light
from gpusim.metrics.picture import read_picture
from gpusim.metrics.summary import summary
from gpusim.scene import make_scene
from gpusim.scene.exr import write_exr

if TYPE_CHECKING:
    from gpusim.batch.sweep import Frame, Sweep
    from gpusim.library import frame as library
    from gpusim.sensor.readout import Shot

LIGHTS, SIDECAR = ".lights", ".json"
# What a frame's file ends with, by output.
KINDS = {
    "raw": "dng",
    "npz": "npz",
    "exr": "exr",
    "developed": "png",
    "truth": "truth.exr",
    "labels": "labels.npz",
    "crops": "crops.npz",
}
LABELLED = {"labels", "crops"}  # outputs that hold labels
COMPUTED = {"npz", "exr", "developed", "truth", "crops"}  # outputs that take the device once more
NOT_MEASURED = ".not_measured"  # after a measure's name: why it has no figures
LIGHT_TOPIC = "gpusim-light"  # of Dask's events: how far workers are with their lights
TOLD_S = 0.2  # between two of them: a screen shows no more
KEPT_LIGHTS = 2  # in a worker's memory: frames come light after light

# Tasks of one worker, two of them at a time, take turns on its device and with what it keeps.
_DEVICE = threading.Lock()
_SWEEPS: dict[str, Sweep] = {}  # of this worker, with their frames
_LIGHTS: OrderedDict[tuple[str, str], Light] = OrderedDict()
_LABELS: OrderedDict[tuple[str, str], dict[str, np.ndarray]] = OrderedDict()


@dataclass(frozen=True)
class Task:
    """Some frames of one light, for one worker.

    Attributes
    ----------
    sweep : Sweep
    numbers : tuple of int
        Frames of the sweep.
    out : str
        Folder of the batch.
    taken : float
        Time in the raws, seconds since 1970: that of the batch, so that a frame rendered again has
        the same bytes.
    """

    sweep: Sweep
    numbers: tuple[int, ...]
    out: str
    taken: float


def work(task: Task) -> list[dict[str, Any]]:
    """Render the frames of a task that are not there; return what is in their sidecars.

    A frame that fails has ``error`` in place of its figures, and no sidecar.
    """
    out = Path(task.out)
    with _DEVICE:
        frames = _SWEEPS.setdefault(task.sweep.digest, task.sweep).frames
    found, left = [], []
    for frame in (frames[number] for number in task.numbers):
        sidecar = out / f"{frame.name}{SIDECAR}"
        if sidecar.exists():
            found.append(json.loads(sidecar.read_text()))
        else:
            left.append(frame)
    return found + _rendered(left, out, datetime.fromtimestamp(task.taken, UTC))


def rendered(frames: Sequence[Frame]) -> Iterator[tuple[Frame, library.Frame]]:
    """Yield frames as they are rendered, in this process and without files.

    Raises
    ------
    UserError
        A frame that cannot be rendered.
    """
    with held():
        for _, group in groupby(frames, key=lambda frame: frame.light_key):
            own = list(group)
            light = exposed(own[0])
            for chunk in _chunks(own):
                for frame, taken in _taken(chunk, light):
                    if isinstance(taken, UserError):
                        raise taken
                    yield frame, taken


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


def _chunks(frames: Sequence[Frame]) -> Iterator[Sequence[Frame]]:
    """Yield frames of one light as many at a time as are read together."""
    for first in range(0, len(frames), TOGETHER):
        yield frames[first : first + TOGETHER]


def _taken(frames: Sequence[Frame], light: Light) -> list[tuple[Frame, library.Frame | UserError]]:
    """Return what frames of one light are, or why there is none."""
    ready = [_ready(frame, light) for frame in frames]
    taken = iter(read_frames([one for one in ready if isinstance(one, tuple)]))
    found = [next(taken) if isinstance(one, tuple) else one for one in ready]
    return list(zip(frames, found, strict=True))


def _ready(frame: Frame, light: Light) -> tuple[Light, Shot] | library.Frame | UserError:
    """Return what to read for a frame; the frame itself where no noise is drawn; or why not."""
    try:
        read_out = dict(frame.read_out)
        gain = {name: read_out.pop(name, None) for name in ("iso", "gain")}
        seen = light.at(sensor=frame.sensor(), **gain)
        if read_out.pop("noise", True):
            return seen, seen.shot(**read_out)
        return seen.capture(**read_out, noise=False)
    except UserError as error:
        return error


def _rendered(frames: Sequence[Frame], out: Path, taken_at: datetime) -> list[dict[str, Any]]:
    """Render frames of one light into files; return what is in their sidecars.

    Another task takes its turn on the device while the files of this one are written.
    """
    if not frames:
        return []
    accounts: list[Callable[[], dict[str, Any]]] = []
    lit_s = 0.0
    # The disk makes files last while the next frames are made.
    with held(), ThreadPoolExecutor(1) as disk:
        for chunk in _chunks(frames):
            with _DEVICE:
                started = time.perf_counter()
                try:
                    light = _light(frames[0], out)
                except (UserError, OSError) as error:
                    return [_failed(frame, error) for frame in frames]
                if chunk[0] is frames[0]:
                    lit_s = time.perf_counter() - started
                made = _taken(chunk, light)
            for frame, taken in made:
                try:
                    if isinstance(taken, UserError):
                        raise taken
                    written = _written(frame, taken, out, taken_at, lit_s, started)
                    accounts.append(disk.submit(_kept, frame, *written).result)
                except (UserError, OSError) as error:
                    accounts.append(partial(_failed, frame, error))
                started, lit_s = time.perf_counter(), 0.0
        return [account() for account in accounts]


def _failed(frame: Frame, error: UserError | OSError) -> dict[str, Any]:
    """Return the account of a frame that is not there."""
    said = str(error)
    if isinstance(error, UserError):
        parts = error.problem, error.field, error.value, error.allowed
        said = " ".join(str(one) for one in parts if one)
    return {"number": frame.number, "settings": frame.settings, "error": said}


def _written(
    frame: Frame, taken: library.Frame, out: Path, taken_at: datetime, lit_s: float, started: float
) -> tuple[dict[str, Any], dict[Path, Path]]:
    """Write one frame's files beside their places; return what its sidecar holds, and the places.

    The sidecar comes last: where that is, all are.

    Parameters
    ----------
    frame, taken
    out : Path
    taken_at : datetime
        The time in its raw.
    lit_s : float
        Seconds that its light took.
    started : float
        When the work on it began.
    """
    labels: dict[str, np.ndarray] = {}
    if frame.sweep.labels and not LABELLED.isdisjoint(frame.sweep.outputs):
        with _DEVICE:
            labels = in_frame(_labels(frame, out), taken)
    places: dict[Path, Path] = {}
    try:
        files = [f"{frame.name}.{KINDS[kind]}" for kind in frame.sweep.outputs]
        for kind, name in zip(frame.sweep.outputs, files, strict=True):
            part = beside(out / name)
            places[part] = out / name
            with _DEVICE if kind in COMPUTED else nullcontext():
                _write(kind, part, frame, taken, taken_at, labels)
        facts = _facts(frame, taken, out, taken_at)
        facts |= {"files": files, "light_s": lit_s, "seconds": time.perf_counter() - started}
        sidecar = out / f"{frame.name}{SIDECAR}"
        part = beside(sidecar)
        places[part] = sidecar
        part.write_text(json.dumps(facts, default=_plain))
    except BaseException:
        for part in places:
            part.unlink(missing_ok=True)
        raise
    return facts, places


def _kept(frame: Frame, facts: dict[str, Any], places: dict[Path, Path]) -> dict[str, Any]:
    """Put files into their places, once they are on disk; return the facts, or why they are not."""
    try:
        for part, path in places.items():
            _last(part, path)
    except OSError as error:
        return _failed(frame, error)
    finally:
        for part in places:
            part.unlink(missing_ok=True)
    return facts


def _write(
    kind: str,
    part: Path,
    frame: Frame,
    taken: library.Frame,
    taken_at: datetime,
    labels: dict[str, np.ndarray],
) -> None:
    """Write one output of a frame."""
    if kind == "truth":
        write_exr(part, {"Y": taken.truth_dn})
    elif kind == "labels":
        _save_arrays(part, labels)
    elif kind == "crops":
        _save_arrays(part, crops_of(frame, taken, labels))
    else:
        taken.save(part, taken=taken_at)


def _facts(frame: Frame, taken: library.Frame, out: Path, taken_at: datetime) -> dict[str, Any]:
    """Return what the sidecar says of the frame itself."""
    certificate, made = taken.certificate, {}
    if "raw" in frame.sweep.outputs:
        name = f"{frame.name}.{KINDS['raw']}"
        part, light = beside(out / name), _recipe_name(frame)
        made["recipe"] = recipe_of_frame(taken, part, taken_at, light=light) | {"raw": name}
    return {
        "number": frame.number,
        "scene": frame.scene,
        "settings": frame.settings,
        "exposure_s": taken.exposure_s,
        "iso": taken.iso,
        "seed": taken.shot.seed,
        "frame": taken.shot.frame,
        **_level(taken.raw),
        "saturated": np.count_nonzero(taken.saturated) / taken.raw.size,
        **_measured(frame, out),
        "certificate_rms": None if certificate is None else certificate.total_rms,
        "certificate_met": None if certificate is None else certificate.met,
        "gpusim": gpusim.__version__,
        "sweep": frame.sweep.digest,
        **made,
    }


def _level(raw: np.ndarray) -> dict[str, float]:
    """Return mean and standard deviation of a raw, DN."""
    deviation = raw.astype(np.float64)
    mean = float(deviation.mean())
    deviation -= mean  # once: NumPy's own functions convert the raw three times
    np.square(deviation, out=deviation)
    return {"mean_dn": mean, "std_dn": math.sqrt(deviation.mean())}


def crops_of(
    frame: Frame, taken: library.Frame, labels: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return ``xy`` (n, 2), and the crops (n, rows, cols) of ``raw``, ``truth_dn`` and labels."""
    crops, seed = frame.sweep.crops, frame.sweep.random_seed
    assert crops is not None  # the sweep is checked
    places = crops.places(taken.areas.active, taken.raw.shape, seed, frame.number)
    planes = {"raw": taken.raw, "truth_dn": taken.truth_dn, **labels}
    return {"xy": places, **{name: crops.cut(plane, places) for name, plane in planes.items()}}


def _save_arrays(part: Path, arrays: dict[str, np.ndarray]) -> None:
    with part.open("wb") as file:  # given a name, NumPy would add a suffix to it
        np.savez_compressed(file, **arrays)


def _measured(frame: Frame, out: Path) -> dict[str, Any]:
    """Return figures of a frame's raw file, and why there are none."""
    if not frame.sweep.metrics:
        return {}
    planes = read_picture(beside(out / f"{frame.name}.{KINDS['raw']}"))
    figures, failed = summary(planes, frame.sweep.metrics)
    return figures | {f"{name}{NOT_MEASURED}": why for name, why in failed.items()}


def _recipe_name(frame: Frame) -> str:
    return f"light-{frame.light_key}{SIDECAR}"


def _plain(value: object) -> object:
    return value.item() if isinstance(value, np.generic) else str(value)


def beside(path: Path) -> Path:
    """Return the name under which a file is written, beside its place."""
    return path.with_name(f".{os.getpid()}-{path.name}")


def _last(part: Path, path: Path) -> None:
    """Put a file into its place, once it is on disk."""
    with part.open("rb") as file:
        os.fsync(file.fileno())
    os.replace(part, path)


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield a name beside a file, which takes the file's place once it is written and on disk."""
    part = beside(path)
    try:
        yield part
        _last(part, path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Wait until no other worker holds a file, and hold it; the system frees it after a kill."""
    with path.open("w") as lock:
        try:
            import fcntl
        except ImportError:  # Windows: two workers may make a light twice, with the same bytes
            pass
        else:
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _labels(frame: Frame, out: Path) -> dict[str, np.ndarray]:
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


def _light(frame: Frame, out: Path) -> Light:
    """Return the light of a frame, made once however many workers ask."""
    key = (str(out), frame.light_key)
    if key not in _LIGHTS:
        folder = out / LIGHTS
        folder.mkdir(exist_ok=True)
        path = folder / f"{frame.light_key}.npz"
        with _alone(folder / f"{frame.light_key}.lock"):
            if not path.exists():
                light = exposed(frame, _telling())
                with whole(out / _recipe_name(frame)) as part:
                    part.write_text(json.dumps(light.recipe))
                light.save(path)
            else:
                light = Light.load(path)
        _LIGHTS[key] = light
        while len(_LIGHTS) > KEPT_LIGHTS:
            _LIGHTS.popitem(last=False)[1].release()
    _LIGHTS.move_to_end(key)
    return _LIGHTS[key]

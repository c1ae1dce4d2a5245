"""What a worker does: bring a light to the photosites once, and read the frames that share it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim.batch.files import FrameFiles, failed, put_in_place
from gpusim.batch.kept import DEVICE, SIDECAR, SWEEPS, exposed, light_of, read_sidecar
from gpusim.errors import UserError
from gpusim.gpu import held
from gpusim.library.burst import TOGETHER, read_frames
from gpusim.library.light import Light

if TYPE_CHECKING:
    from gpusim.batch.frame import Frame
    from gpusim.batch.sweep import Sweep
    from gpusim.library import frame as library
    from gpusim.sensor.readout import Shot


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
    with DEVICE:
        frames = SWEEPS.setdefault(task.sweep.digest, task.sweep).frames
    found, left = [], []
    for frame in (frames[number] for number in task.numbers):
        sidecar = out / f"{frame.name}{SIDECAR}"
        if sidecar.exists():
            found.append(read_sidecar(sidecar))
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
            with DEVICE:
                started = time.perf_counter()
                try:
                    light = light_of(frames[0], out)
                except (UserError, OSError) as error:
                    return [failed(frame, error) for frame in frames]
                if chunk[0] is frames[0]:
                    lit_s = time.perf_counter() - started
                made = _taken(chunk, light)
            for frame, taken in made:
                try:
                    if isinstance(taken, UserError):
                        raise taken
                    written = FrameFiles(frame, taken, out, taken_at).write(lit_s, started)
                    accounts.append(disk.submit(put_in_place, frame, *written).result)
                except (UserError, OSError) as error:
                    accounts.append(partial(failed, frame, error))
                started, lit_s = time.perf_counter(), 0.0
        return [account() for account in accounts]

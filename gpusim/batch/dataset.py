"""A sweep as a data set for training: raw, clean truth, labels and parameters, without files."""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from gpusim.batch.files import crops_of
from gpusim.batch.labels import in_frame, labels_of
from gpusim.batch.work import rendered
from gpusim.errors import UserError

if TYPE_CHECKING:
    from gpusim.batch.frame import Frame
    from gpusim.batch.sweep import Sweep
    from gpusim.library import frame as library

WAIT_S = 0.1  # between looks at whether anyone still reads


class Sample(NamedTuple):
    """One frame, or a crop of one.

    Attributes
    ----------
    raw : ndarray of float32 (rows, cols)
        Digital numbers, noise and fixed patterns included.
    clean : ndarray of float32 (rows, cols)
        Mean signal, DN.
    labels : dict of str to ndarray (rows, cols, ...)
        Those of the sweep's field ``labels``.
    parameters : dict of str to object
        The frame's number, scene and settings; of a crop its place ``x``, ``y``. What the frame
        leaves to its camera is not there.

    Examples
    --------
    >>> import gpusim as gs
    >>> sweep = gs.Sweep(
    ...     camera="mtf-only", scenes=["colorchecker"], rows=48, cols=64, tolerance=1e-2, probes=0,
    ... )
    >>> sample = next(iter(sweep.dataset()))
    >>> sample.raw.shape, sample.clean.shape, sample.labels, sample.parameters["scene"]
    ((48, 64), (48, 64), {}, 'colorchecker')
    """

    raw: np.ndarray
    clean: np.ndarray
    labels: dict[str, np.ndarray]
    parameters: dict[str, Any]


class Dataset:
    """An iterable of `Sample`: see `gpusim.batch.sweep.Sweep.dataset`.

    Examples
    --------
    >>> import gpusim as gs
    >>> sweep = gs.Sweep(
    ...     camera="mtf-only", scenes=["colorchecker"], rows=48, cols=64, tolerance=1e-2, probes=0,
    ...     axes={"seed": {"range": [0, 4]}},
    ... )
    >>> len(sweep.dataset(shard=0, shards=2))
    2
    """

    def __init__(self, sweep: Sweep, shard: int, shards: int, prefetch: int) -> None:
        if not 0 <= shard < shards:
            raise UserError(
                "no such shard",
                field="shard",
                value=f"{shard} of {shards}",
                allowed="0 to shards - 1",
            )
        if prefetch < 0:
            raise UserError(
                "frames cannot be made before less than none", field="prefetch", value=prefetch,
                allowed="0 or more",
            )  # fmt: skip
        sweep.check()
        self.sweep, self.shard, self.shards, self.prefetch = sweep, shard, shards, prefetch

    def __repr__(self) -> str:
        return (
            f"Dataset({len(self)} samples of {len(self._frames())} frames, "
            f"shard {self.shard} of {self.shards})"
        )

    def __len__(self) -> int:
        """Return how many samples this shard has."""
        crops = self.sweep.crops
        return len(self._frames()) * (1 if crops is None else crops.a_frame)

    def __iter__(self) -> Iterator[Sample]:
        """Yield the samples of this shard; in a PyTorch worker those of its share of it."""
        return _ahead(self._samples(*_torch_worker()), self.prefetch)

    def _frames(self, part: int = 0, parts: int = 1) -> list[Frame]:
        """Return the frames of a part of this shard: neighbours, so that they share lights."""
        frames = self.sweep.frames
        place, places = self.shard * parts + part, self.shards * parts
        first, beyond = (len(frames) * one // places for one in (place, place + 1))
        return frames[first:beyond]

    def _samples(self, part: int, parts: int) -> Iterator[Sample]:
        key, labels = None, {}
        for frame, taken in rendered(self._frames(part, parts)):
            if self.sweep.labels and frame.light_key != key:
                key, labels = frame.light_key, labels_of(frame)
            yield from samples_of(frame, taken, in_frame(labels, taken))


def samples_of(
    frame: Frame, taken: library.Frame, labels: dict[str, np.ndarray]
) -> Iterator[Sample]:
    """Yield the samples of one frame."""
    given = {name: value for name, value in frame.settings.items() if value is not None}
    parameters = {"number": frame.number, "scene": frame.scene, **given}
    if frame.sweep.crops is None:
        yield Sample(taken.raw.astype(np.float32), taken.truth_dn, labels, parameters)
        return
    cut = crops_of(frame, taken, labels)
    for at, (x, y) in enumerate(cut["xy"]):
        yield Sample(
            cut["raw"][at].astype(np.float32),
            cut["truth_dn"][at],
            {name: cut[name][at] for name in labels},
            {**parameters, "x": int(x), "y": int(y)},
        )


def _torch_worker() -> tuple[int, int]:
    """Return which of how many workers of a PyTorch DataLoader this process is.

    There is one only where PyTorch has been imported: nothing is imported for it.
    """
    data = sys.modules.get("torch.utils.data")
    info = None if data is None else data.get_worker_info()
    return (0, 1) if info is None else (info.id, info.num_workers)


def _ahead(samples: Iterator[Sample], count: int) -> Iterator[Sample]:
    """Yield what an iterator yields, made by a thread that is ``count`` ahead."""
    if not count:
        yield from samples
        return
    made: queue.Queue[Sample | BaseException | None] = queue.Queue(count)
    closed = threading.Event()

    def put(one: Sample | BaseException | None) -> None:
        while not closed.is_set():
            try:
                return made.put(one, timeout=WAIT_S)
            except queue.Full:
                continue

    def make() -> None:
        try:
            for one in samples:
                put(one)
                if closed.is_set():
                    return
            put(None)
        except BaseException as error:  # it is the reader's to see
            put(error)

    thread = threading.Thread(target=make, daemon=True)
    thread.start()
    try:
        while (one := made.get()) is not None:
            if isinstance(one, BaseException):
                raise one
            yield one
    finally:
        closed.set()
        thread.join()

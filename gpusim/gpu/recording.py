"""A recording: a flat list of commands over proxies, run at once, timed by stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from .arrays import Array
from .commands import Clear, Command, Copy, Dispatch, Download, Proxy, Upload
from .device import Device
from .packing import ShaderError
from .pool import Use
from .run import Run

if TYPE_CHECKING:
    from .kernel import Kernel

_UNIFORM_STEP = 256  # WebGPU's portable alignment of uniform offsets


@dataclass
class Result(Mapping):
    """The downloaded arrays by label, and what the run cost.

    Attributes
    ----------
    times_s : dict of str to float
        Seconds for each stage.
    clock : str
        ``gpu`` (timestamps) or ``wall``.
    """

    arrays: dict[str, np.ndarray]
    times_s: dict[str, float]
    clock: str

    def __getitem__(self, label: str) -> np.ndarray:
        return self.arrays[label]

    def __iter__(self) -> Iterator[str]:
        return iter(self.arrays)

    def __len__(self) -> int:
        return len(self.arrays)


class Recording:
    """Commands for one device; :meth:`run` submits them.

    A recording may be run again: it then uploads and computes everything anew.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self._segments: list[list[Command]] = [[]]
        self._proxies: dict[str, Proxy] = {}
        self._written: set[str] = set()
        self._params = bytearray()
        self._offsets: dict[bytes, int] = {}
        self._downloads: set[str] = set()
        self._prefix = ""

    @property
    def commands(self) -> Iterator[Command]:
        """All commands, in order."""
        return chain.from_iterable(self._segments)

    @property
    def params(self) -> bytes:
        """The uniforms of all dispatches, each at its ``offset``."""
        return bytes(self._params)

    @contextmanager
    def labelled(self, prefix: str) -> Iterator[None]:
        """Begin the labels of all buffers that are declared meanwhile with a text.

        So that one recording holds the same work several times.
        """
        before, self._prefix = self._prefix, self._prefix + prefix
        try:
            yield
        finally:
            self._prefix = before

    def buffer(
        self,
        label: str,
        shape: tuple[int, ...] | int,
        dtype: np.dtype | type,
        use: Use = Use.DATA,
    ) -> Proxy:
        """Declare a transient array; its content is undefined until something writes it.

        Raises
        ------
        ShaderError
            The label is taken, or the dtype is none that shaders have.
        """
        label = self._prefix + label
        if label in self._proxies:
            raise ShaderError(f"this recording already has a buffer {label!r}")
        proxy = self._proxies[label] = Proxy(label, shape, dtype, use)
        return proxy

    def upload(self, target: Array, array: np.ndarray) -> None:
        """Write a host array into a buffer; the array is read when the recording runs."""
        command = Upload(target, target.checked(array))
        self._check((), (target,))
        self._segments[-1].append(command)

    def copy(self, source: Array, target: Array) -> None:
        """Copy a buffer into texels of as many bytes.

        Raises
        ------
        ShaderError
            The arrays have other uses, or their sizes differ.
        """
        uses = (source.use, target.use)
        if uses != (Use.DATA, Use.TEXELS) or source.nbytes != target.nbytes:
            raise ShaderError(f"{source} cannot be copied into {target}")
        self._check((source,), (target,))
        self._segments[-1].append(Copy(source, target))

    def clear(self, target: Array) -> None:
        """Fill a buffer with zeros; texels are not cleared."""
        if target.use is Use.TEXELS:
            raise ShaderError(f"{target} is filled by upload and copy alone")
        self._check((), (target,))
        self._segments[-1].append(Clear(target))

    def download(self, source: Array, dtype: type | None = None) -> str:
        """Copy a buffer to the host; return its label, the key in the result.

        Parameters
        ----------
        source : Array
            No texels.
        dtype : type, optional
            The kind of the numbers on the host, which hold the buffer's; by default its own.
        """
        if source.use is Use.TEXELS:
            raise ShaderError(f"{source} is what a buffer was copied into: download that")
        if source.label in self._downloads:
            raise ShaderError(f"buffer {source.label!r} is downloaded twice")
        self._check((source,), ())
        self._segments[-1].append(Download(source, np.dtype(dtype or source.dtype)))
        self._downloads.add(source.label)
        return source.label

    def mark(self) -> None:
        """End a segment: :meth:`run` submits and waits here, and reports progress."""
        self._segments.append([])

    def dispatch(
        self,
        kernel: Kernel,
        groups: tuple[int, int, int],
        params: bytes,
        buffers: Mapping[str, Array],
    ) -> None:
        """Append a checked dispatch; :meth:`Kernel.record` is the way to call it."""
        writes = [array for name, array in buffers.items() if kernel.writes(name)]
        reads = [array for name, array in buffers.items() if not kernel.writes(name)]
        empty = [array.label for array in buffers.values() if array.nbytes == 0]
        if 0 in groups:  # nothing to compute: what it would have written counts as written
            self._check(reads, writes, f"{kernel.path}: ")
            return
        if empty:
            raise ShaderError(f"{kernel.path}: {empty} have no elements")
        if params not in self._offsets:
            self._offsets[params] = len(self._params)
            self._params += params + bytes(-len(params) % _UNIFORM_STEP)
        self._check(reads, writes, f"{kernel.path}: ")
        command = Dispatch(kernel, groups, self._offsets[params], dict(buffers))
        self._segments[-1].append(command)

    def _check(self, reads: Sequence[Array], writes: Sequence[Array], where: str = "") -> None:
        """Refuse foreign proxies and proxies read before anything wrote them; note the writes."""
        for array in (*reads, *writes):
            if isinstance(array, Proxy) and self._proxies.get(array.label) is not array:
                raise ShaderError(f"{where}buffer {array.label!r} is of another recording")
        for array in reads:
            if isinstance(array, Proxy) and array.label not in self._written:
                raise ShaderError(f"{where}buffer {array.label!r} is read before it is written")
        self._written.update(array.label for array in writes)

    def run(self, progress: Callable[[int, int], None] | None = None) -> Result:
        """Submit everything, wait, and return the downloads.

        Parameters
        ----------
        progress : callable, optional
            Called with (segments done, segments in all) after each segment.

        Raises
        ------
        OutOfMemoryError
            The buffers do not fit the GPU memory budget.
        DeviceLostError
            The device went away.
        ShaderError
            A shader does not compile.
        """
        segments = [segment for segment in self._segments if segment]
        run = Run(self.device)
        with self.device.telling_of_loss():
            first_uses = {
                command.kernel.key: command
                for command in self.commands
                if isinstance(command, Dispatch) and command.kernel.key not in self.device.compiled
            }
            try:
                run.allocate(self._proxies, bytes(self._params))
                run.compile(list(first_uses.values()))
                for number, segment in enumerate(segments, start=1):
                    run.segment(segment)
                    if progress is not None:
                        progress(number, len(segments))
            finally:
                run.release()
        return Result(run.arrays, dict(run.times_s), run.clock)

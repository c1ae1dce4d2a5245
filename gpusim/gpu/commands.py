"""The commands that a recording is a list of, and its transient arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .arrays import Array

if TYPE_CHECKING:
    from .kernel import Kernel


class Proxy(Array):
    """A transient array of one recording: memory only while the recording runs."""


@dataclass(frozen=True)
class Upload:
    """Write a host array into a buffer."""

    target: Array
    array: np.ndarray


@dataclass(frozen=True)
class Copy:
    """Copy a buffer into a texture of as many bytes."""

    source: Array
    target: Array


@dataclass(frozen=True)
class Clear:
    """Fill a buffer with zeros."""

    target: Array


@dataclass(frozen=True)
class Download:
    """Copy a buffer to the host, under its label, as numbers of a kind."""

    source: Array
    dtype: np.dtype


@dataclass(frozen=True)
class Dispatch:
    """Run a kernel over a grid of workgroups; ``offset`` is where its params lie."""

    kernel: Kernel
    groups: tuple[int, int, int]
    offset: int
    buffers: Mapping[str, Array]


Command = Upload | Copy | Clear | Download | Dispatch

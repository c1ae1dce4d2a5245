"""Kernels compiled ahead, on further cores, by further devices of the same adapter.

Mesa's software driver compiles a kernel at its first dispatch, on the one thread of a device's
queue. It keeps the code on disk, under a key that has no device in it: what another device has
compiled comes from there in 0.1 s, where Mesa 25 compiles a kernel for up to 7 s. Two cores took
11.5 s for four kernels of `fft_columns` that one took 21.9 s for.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress

from .commands import Dispatch
from .compiling import Compiled
from .device import Device
from .packing import ShaderError

MOST = 3  # further devices: LLVM takes some 100 MB for a kernel that it works on


class Ahead:
    """Threads that compile the last of some kernels while the caller compiles the first.

    Parameters
    ----------
    device : Device
        The caller's.
    compile_one : callable
        Compiles the kernel of a dispatch on a device.
    left : deque of Dispatch
        First uses of kernels: threads take from the end what nobody has taken yet.
    """

    def __init__(
        self,
        device: Device,
        compile_one: Callable[[Device, Dispatch], object],
        left: deque[Dispatch],
    ) -> None:
        self._device, self._compile_one, self._left = device, compile_one, left
        self._taken: list[Dispatch] = []
        self._compiled: dict[object, Compiled] = {}
        count = min((os.cpu_count() or 1) - 1, MOST, len(left))
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(count)]
        for thread in self._threads:
            thread.start()

    def taken(self) -> tuple[list[Dispatch], dict[object, Compiled]]:
        """Wait for the threads; return what they took, and what compiling it took, by key."""
        for thread in self._threads:
            thread.join()
        return self._taken, self._compiled

    def stop(self) -> None:
        """Let the threads take no more, and wait for them."""
        self._left.clear()
        self.taken()

    def _work(self) -> None:
        """Compile until nothing is left; the caller's own device will tell what fails."""
        import wgpu

        failures = wgpu.GPUError, RuntimeError, ShaderError
        with suppress(*failures), self._device.another() as device:
            for command in popped(self._left.pop):
                self._taken.append(command)
                self._compile_one(device, command)
                self._compiled |= device.compiled


def popped(pop: Callable[[], Dispatch]) -> Iterator[Dispatch]:
    """Take from an end of what threads share until nothing is left."""
    with suppress(IndexError):
        while True:
            yield pop()

"""What a screen made for the last frame, kept while what it was made of stays the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gpusim.preview.engine import Shown


class Memory:
    """Values by name, each with the key that it was made for."""

    def __init__(self) -> None:
        self._held: dict[str, tuple[Any, Any]] = {}

    def of(self, name: str, key: Any, make: Callable[[], Any]) -> Any:
        """Return what was made for a key, made anew when the key is another."""
        held = self._held.get(name)
        if held is None or not _same(held[0], key):
            held = self._held[name] = (key, make())
        return held[1]

    def clear(self) -> None:
        """Forget everything."""
        self._held.clear()


def _same(one: Any, other: Any) -> bool:
    """Return whether two keys are the same: arrays and pictures by identity."""
    if isinstance(one, tuple) and isinstance(other, tuple) and len(one) == len(other):
        return all(_same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, np.ndarray | Shown) or isinstance(other, np.ndarray | Shown):
        return one is other
    return one == other

"""Tiles of the stages that draw for four pixels at a time, against the whole frame.

Their dispatch begins with an aligned group of four: every phase of the first column, and widths
around a workgroup's 128 pixels.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from harness import assert_close, unwritten

WHOLE = (12, 400)
shapes = pytest.mark.parametrize(
    "shape", [(1, 1), (1, 2), (1, 130), (3, 1), (2, 125), (5, 129), (3, 256)]
)
columns = pytest.mark.parametrize("col0", [0, 1, 2, 3, 127])


def check_tile(
    on_device: Callable[..., np.ndarray], plane: np.ndarray, shape: tuple[int, int], col0: int
) -> None:
    """Compare a tile at row 7 with the part of the whole, and see that nothing lies behind it."""
    part = np.s_[7 : 7 + shape[0], col0 : col0 + shape[1]]
    tile = np.ascontiguousarray(plane[part])
    found = on_device(tile, (7, col0), spare=300)
    assert unwritten(found[tile.size :]).all()
    assert_close(found[: tile.size].reshape(shape), on_device(plane)[part].copy(), atol=0)

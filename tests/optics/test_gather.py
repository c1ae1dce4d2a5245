"""Gather: windows transformed back and added, against the definition.

Tolerance: 60 roundings of a transform of 160 (see test_spread) of the sum of the moduli of one
window's line, twice each frequency, and at most two windows on one sample with one addition: 62
2^-24 of twice the largest sum.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import ULP

from gpusim.reference.gather import gather

LENGTH, HALF = 160, 81


def made(across: int, rows: int) -> np.ndarray:
    """Return column frequencies of real windows: those of kx = 0 and 80 are real in y."""
    rng = np.random.default_rng(across)
    columns = rng.normal(size=(across, HALF, rows, 2)).astype(np.float32).view(np.complex64)[..., 0]
    columns[:, [0, -1]] = columns[:, [0, -1]].real
    return columns


def on_device(columns: np.ndarray, side: int, lines: int, before: int = 0) -> np.ndarray:
    across, _, rows = columns.shape
    cols = (across - 1) * side + LENGTH
    pairs = columns.reshape(across, HALF, rows // 2, 2).swapaxes(1, 2)  # [column, y/2, kx, y%2]
    result = run_stage(
        "optics/gather",
        (-(-lines // 8), 1, 1),
        {"lines": lines, "across": across, "first": before // 4},
        {"columns": np.ascontiguousarray(pairs)},
        {"image": (before + rows * cols, np.float32)},
        SIDE=side,
    )
    assert unwritten(result["image"][:before]).all()
    return result["image"][before:].reshape(rows, cols)


@pytest.mark.parametrize(
    ("side", "across", "rows"), [(128, 2, 160), (80, 3, 40), (80, 1, 12), (152, 2, 18)]
)
def test_the_image_is_that_of_the_reference(side: int, across: int, rows: int):
    columns = made(across, rows)
    found = on_device(columns, side, rows // 2, before=400)  # of a second channel
    allowed = 62 * ULP * 2 * 2 * np.abs(columns).sum(axis=1).max()
    assert_close(found, gather(columns, side, LENGTH), atol=allowed)


def test_no_more_lines_than_asked_for_are_written():
    columns = made(1, 24)
    found = on_device(columns, 80, 12)
    few = on_device(columns[:, :, :18], 80, 9)
    assert np.array_equal(few, found[:18])

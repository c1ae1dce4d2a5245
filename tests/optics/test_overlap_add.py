"""Overlap-add: windows transformed back and added, against the definition.

Tolerance: 20 roundings of a transform of 160 (see test_blur_fft) of the sum of the moduli of one
window's line, twice each frequency, one addition before; and at most two windows on one sample with
one addition: 22 2^-24 of twice the largest sum.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import ULP

from gpusim.reference.overlap_add import overlap_add

LENGTH, HALF = 160, 81


def made(across: int, rows: int, seed: int = 0) -> np.ndarray:
    """Return column frequencies of real windows: those of kx = 0 and 80 are real in y."""
    rng = np.random.default_rng(across + 10 * seed)
    columns = rng.normal(size=(across, HALF, rows, 2)).astype(np.float32).view(np.complex64)[..., 0]
    columns[:, [0, -1]] = columns[:, [0, -1]].real
    return columns


def on_device(columns: np.ndarray, side: int, lines: int, before: int = 0) -> np.ndarray:
    """Return the image of each channel; `columns` (channels, across, 81, rows)."""
    channels, across, _, rows = columns.shape
    cols = (across - 1) * side + LENGTH
    pairs = columns.reshape(channels, across, HALF, rows // 2, 2).swapaxes(2, 3)
    result = run_stage(
        "optics/overlap_add",
        (-(-lines // 8), 1, 1),
        {"lines": lines, "rows": rows, "across": across, "first": before // 4},
        {"columns": np.ascontiguousarray(pairs)},
        {"image": (before + channels * rows * cols, np.float32)},
        SIDE=side,
    )
    assert unwritten(result["image"][:before]).all()
    return result["image"][before:].reshape(channels, rows, cols)


@pytest.mark.parametrize(
    ("side", "across", "rows"), [(128, 2, 160), (80, 3, 40), (80, 1, 12), (152, 2, 18)]
)
def test_the_image_is_that_of_the_reference(side: int, across: int, rows: int):
    columns = np.stack([made(across, rows, channel) for channel in (0, 1)])
    found = on_device(columns, side, rows, before=400)  # channels before them
    allowed = 22 * ULP * 2 * 2 * np.abs(columns).sum(axis=2).max()
    for image, of_channel in zip(found, columns, strict=True):
        assert_close(image, overlap_add(of_channel, side, LENGTH), atol=allowed)


def test_no_more_lines_than_asked_for_are_written():
    columns = made(1, 24)[None]
    found = on_device(columns, 80, 12)[0]
    few = on_device(columns, 80, 9)[0]
    assert np.array_equal(few[:18], found[:18])
    assert unwritten(few[18:].reshape(-1)).all()

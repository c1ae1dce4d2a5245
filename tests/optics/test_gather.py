"""Gather: windows transformed back and added, against the definition.

Tolerance: 60 roundings of a transform of 160 (see test_spread) of the sum of the moduli of one
window's line, twice each frequency, and at most four windows on one sample with three additions: 64
2^-24 of four times the largest sum.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import ULP

from gpusim.reference.gather import gather

LENGTH, HALF = 160, 81


def made(blocks: int) -> np.ndarray:
    """Return column frequencies of real windows: those of kx = 0 and 80 are real in y."""
    rng = np.random.default_rng(blocks)
    columns = (
        rng.normal(size=(blocks, HALF, LENGTH, 2)).astype(np.float32).view(np.complex64)[..., 0]
    )
    columns[:, [0, -1]] = columns[:, [0, -1]].real
    return columns


def on_device(
    columns: np.ndarray, down: int, across: int, side: int, before: int = 0
) -> np.ndarray:
    frame = (down * side + LENGTH, across * side + LENGTH)
    given = {"columns": np.ascontiguousarray(columns)}
    for parity in (0, 1):
        lines = (down - parity + 1) // 2 * LENGTH // 2
        params = {
            "lines": lines,
            "across": across,
            "down": down,
            "stride": frame[1] // 4,
            "parity": parity,
            "first": before // 4,
        }
        # The odd rows find what the even ones left.
        outputs = {"image": (before + frame[0] * frame[1], np.float32)}
        groups = (-(-lines // 8), 1, 1)
        given |= run_stage("optics/gather", groups, params, given, outputs, SIDE=side)
    assert unwritten(given["image"][:before]).all()
    return given["image"][before:].reshape(frame)


@pytest.mark.parametrize(("side", "down", "across"), [(128, 1, 2), (80, 3, 2), (80, 2, 1)])
def test_the_image_is_that_of_the_reference(side: int, down: int, across: int):
    columns = made(down * across)
    found = on_device(columns, down, across, side, before=400)  # of a second channel
    expected = gather(columns, across, side)
    rows, cols = expected.shape
    allowed = 64 * ULP * 4 * 2 * np.abs(columns).sum(axis=1).max()
    assert_close(found[:rows, :cols], expected, atol=allowed)
    assert unwritten(found[rows:].reshape(-1)).all()
    assert unwritten(found[:, cols:].reshape(-1)).all()

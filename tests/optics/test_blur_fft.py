"""Blur FFT: row spectra of blocks against the definition.

Tolerance, in 2^-24 of the sum S = sum |a| along the row: a transform of 160 has the levels 5 (two
constants and their products, 8 roundings), 4 (2), a turn (4), 4 (2), the root of one half (3) and 2
(1): 20. With the weight (4), the product (1) and the mean of two (1): 26 S.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import ULP

from gpusim.reference.blur_fft import blur_fft

LENGTH = 160


def on_device(image: np.ndarray, side: int, per_cell: int, lines: int | None = None) -> np.ndarray:
    down, across = (count // side for count in image.shape)
    shape = (down * across, 2, side // 2, LENGTH // 2 + 1, 2)
    lines = down * across * side if lines is None else lines
    result = run_stage(
        "optics/blur_fft",
        (-(-lines // 64), 1, 1),
        {"lines": lines, "across": across, "per_cell": per_cell, "stride": image.shape[1] // 4},
        {"image": image},
        {"spectra": (int(np.prod(shape)), np.complex64)},
        SIDE=side,
    )
    found = result["spectra"].reshape(shape)  # [block, node, y/2, kx, y%2]
    return found.transpose(0, 2, 4, 3, 1).reshape(down * across, side, -1, 2)


@pytest.mark.parametrize(("side", "per_cell", "down", "across"), [(128, 1, 1, 2), (80, 2, 2, 3)])
def test_spectra_are_those_of_the_reference(side: int, per_cell: int, down: int, across: int):
    rng = np.random.default_rng(side)
    image = rng.uniform(-1, 1, (down * side, across * side)).astype(np.float32)
    found = on_device(image, side, per_cell)
    expected = blur_fft(image, side, per_cell, LENGTH)
    rows = np.abs(image.reshape(down, side, across, side)).sum(axis=3, dtype=float)
    bound = 26 * ULP * rows.swapaxes(1, 2).reshape(-1, side, 1, 1)
    assert_close(found, expected, atol=np.broadcast_to(bound, expected.shape))


def test_no_more_lines_than_asked_for_are_written():
    image = np.ones((80, 80), np.float32)
    found = on_device(image, 80, 1, lines=70)
    assert unwritten(found[0, 70:].reshape(-1)).all()
    assert not unwritten(found[0, :70].reshape(-1)).any()

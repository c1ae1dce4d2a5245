"""Blur product: columns convolved with four nodes' PSFs, against the definition.

Tolerance: two transforms of 160 (see test_blur_fft, 20 roundings each of the sum of the moduli),
the weight (5), the product (3), the sums over four nodes (3) and over two windows (1): 52 2^-24 of
S, S the sum over ky of |A| |H| with |A| the sum of the column's moduli. And the transform of the
PSF's rows h, of which the norm errs by 20 2^-24 of itself: by Schwarz' inequality
20 2^-24 |A| sqrt(160) |H|_2, and |H|_2 = sqrt(160) |h|_2.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import ULP

from gpusim.gpu import default_device
from gpusim.optics.blur import straight_through
from gpusim.reference.blur_product import blur_product

LENGTH, HALF, CHANNELS = 160, 81, 2


def made(
    side: int, per_cell: int, cells: tuple[int, int], rows: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return random row spectra, and PSFs that differ from node to node; of each channel."""
    rng = np.random.default_rng(side + per_cell)
    blocks = cells[0] * cells[1] * per_cell**2
    spectra = rng.normal(size=(CHANNELS, blocks, side, HALF, 4)).astype(np.float32)
    psfs = np.zeros((CHANNELS, cells[0] + 1, cells[1] + 1, LENGTH, LENGTH))
    psfs[..., :rows, :20] = rng.random((*psfs.shape[:3], rows, 20))
    return spectra.view(np.complex64), psfs


def paired(lines: np.ndarray) -> np.ndarray:
    """Return lines [..., y, kx] as the shaders have them: [..., y/2, kx, y%2]."""
    pairs = lines.reshape(*lines.shape[:-2], -1, 2, HALF)
    return np.ascontiguousarray(pairs.swapaxes(-1, -2))


def on_device(
    spectra: np.ndarray,
    psfs: np.ndarray,
    side: int,
    per_cell: int,
    cells: tuple[int, int],
    rows: int,
    lines: int | None = None,
    *,
    straight: bool,
):
    transformed = np.fft.rfft(psfs[..., :rows, :]) / LENGTH**2
    down, across = (count * per_cell for count in cells)
    lines = CHANNELS * across * HALF if lines is None else lines
    height = (down - 1) * side + LENGTH
    result = run_stage(
        "optics/blur_product",
        (-(-lines // 8), 1, 1),
        {"lines": lines, "across": across, "down": down, "per_cell": per_cell},
        {
            "spectra": paired(spectra.transpose(0, 1, 4, 2, 3)).astype(np.complex64),
            "psfs": paired(transformed).astype(np.complex64),
        },
        {"columns": (CHANNELS * across * height * HALF, np.complex64)},
        SIDE=side,
        ROWS=rows,
        STRAIGHT=straight,
        KEEP=straight and per_cell == 1,
    )
    found = result["columns"].reshape(CHANNELS, across, height // 2, HALF, 2)
    return found.transpose(0, 1, 3, 2, 4).reshape(CHANNELS, across, HALF, height)


def bound(spectra: np.ndarray, psfs: np.ndarray) -> float:
    columns = np.abs(spectra).sum(axis=2, dtype=float).max()
    # A column meets both nodes of a side with weights whose sum is one: two sides.
    responses = np.abs(np.fft.fft2(psfs)).sum(axis=-2).max() / LENGTH**2
    rows = np.linalg.norm(np.fft.rfft(psfs), axis=-2).max() / LENGTH**2
    return (52 * responses + 20 * LENGTH * rows) * ULP * 2 * columns


# Straight through, lavapipe compiles 9 s for each set of constants: these are those of test_blur.
@pytest.mark.parametrize(
    ("side", "per_cell", "cells", "rows", "straight"),
    [
        (128, 1, (1, 2), 32, True),
        (80, 2, (1, 1), 10, True),
        (80, 1, (3, 2), 32, True),
        (80, 2, (2, 1), 10, False),
        (152, 1, (2, 2), 10, False),
    ],
)
def test_columns_are_those_of_the_reference(
    side: int, per_cell: int, cells: tuple[int, int], rows: int, straight: bool
):
    if straight and not straight_through(str(default_device().report()["driver"])):
        pytest.skip("nothing runs straight through on this driver, and it would compile too long")
    spectra, psfs = made(side, per_cell, cells, rows)
    found = on_device(spectra, psfs, side, per_cell, cells, rows, straight=straight)
    across = cells[1] * per_cell
    expected = np.stack(
        [blur_product(*one, across, per_cell, LENGTH) for one in zip(spectra, psfs, strict=True)]
    )
    allowed = bound(spectra, psfs)
    # An error of the size that is sought, a node taken for its neighbour, is far above the bound.
    assert np.abs(expected).max() > 1000 * allowed
    windows = np.zeros(expected.shape[-1])  # of each row: both err where two overlap
    for first in range(0, cells[0] * per_cell * side, side):
        windows[first : first + LENGTH] += 1
    assert_close(found, expected, atol=np.broadcast_to(allowed * windows, expected.shape))


def test_no_more_lines_than_asked_for_are_written():
    spectra, psfs = made(80, 1, (1, 1), 10)
    found = on_device(spectra, psfs, 80, 1, (1, 1), 10, lines=70, straight=False)
    assert unwritten(found[0, 0, 70:].reshape(-1)).all()
    assert unwritten(found[1].reshape(-1)).all()
    assert not unwritten(found[0, 0, :70].reshape(-1)).any()

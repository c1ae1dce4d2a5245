"""Mix: columns convolved with four nodes' PSFs, against the definition.

Tolerance: two transforms of 160 (see test_spread, 60 roundings each of the sum of the moduli), one
product and the sum over four nodes: 140 2^-24 of S, S the sum over ky of |A| |H| with |A| the sum
of the column's moduli. And the transform of the PSF's rows h, of which the norm errs by 60 2^-24 of
itself: by Schwarz' inequality 60 2^-24 |A| sqrt(160) |H|_2, |H|_2 = sqrt(160) |h|_2.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import ULP

from gpusim.reference.mix import mix

LENGTH, HALF, ROWS = 160, 81, 20


def made(side: int, per_cell: int, cells: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return random row spectra, and PSFs that differ from node to node."""
    rng = np.random.default_rng(side + per_cell)
    blocks = cells[0] * cells[1] * per_cell**2
    spectra = rng.normal(size=(blocks, side, HALF, 4)).astype(np.float32)
    psfs = np.zeros((cells[0] + 1, cells[1] + 1, LENGTH, LENGTH))
    psfs[..., :ROWS, :20] = rng.random((cells[0] + 1, cells[1] + 1, ROWS, 20))
    return spectra.view(np.complex64), psfs


def on_device(
    spectra: np.ndarray,
    psfs: np.ndarray,
    side: int,
    per_cell: int,
    cells: int,
    lines: int | None = None,
):
    transformed = np.fft.rfft(psfs[..., :ROWS, :]).swapaxes(-1, -2) / LENGTH**2
    lines = len(spectra) * HALF if lines is None else lines
    result = run_stage(
        "optics/mix",
        (-(-lines // 64), 1, 1),
        {"lines": lines, "cells": cells, "per_cell": per_cell},
        {
            "spectra": np.ascontiguousarray(spectra),
            "psfs": np.ascontiguousarray(transformed, np.complex64),
        },
        {"columns": (len(spectra) * HALF * LENGTH, np.complex64)},
        SIDE=side,
        ROWS=ROWS,
    )
    return result["columns"].reshape(len(spectra), HALF, LENGTH)


def bound(spectra: np.ndarray, psfs: np.ndarray) -> float:
    columns = np.abs(spectra).sum(axis=1, dtype=float).max()
    # A column meets both nodes of a side with weights whose sum is one: two sides.
    responses = np.abs(np.fft.fft2(psfs)).sum(axis=-2).max() / LENGTH**2
    rows = np.linalg.norm(np.fft.rfft(psfs), axis=-2).max() / LENGTH**2
    return (140 * responses + 60 * LENGTH * rows) * ULP * 2 * columns


@pytest.mark.parametrize(
    ("side", "per_cell", "cells"), [(128, 1, (1, 2)), (80, 2, (1, 1)), (80, 1, (2, 2))]
)
def test_columns_are_those_of_the_reference(side: int, per_cell: int, cells: tuple[int, int]):
    spectra, psfs = made(side, per_cell, cells)
    found = on_device(spectra, psfs, side, per_cell, cells[1])
    expected = mix(spectra, psfs, cells[1] * per_cell, per_cell, LENGTH)
    allowed = bound(spectra, psfs)
    # An error of the size that is sought, a node taken for its neighbour, is far above the bound.
    assert np.abs(expected).max() > 1000 * allowed
    assert_close(found, expected, atol=allowed)


def test_no_more_lines_than_asked_for_are_written():
    spectra, psfs = made(80, 1, (1, 1))
    found = on_device(spectra, psfs, 80, 1, 1, lines=70)
    assert unwritten(found[0, 70:].reshape(-1)).all()
    assert not unwritten(found[0, :70].reshape(-1)).any()

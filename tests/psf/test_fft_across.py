"""FFT across: against the definition, for pupils of any half width and several beams.

Tolerance. The amplitude takes 108 roundings of the transform (see test_line_fft), 2^-24 each of a
sum of at most S: all |parts| of both columns that share a transform, and of both halves of the
pupil. |U + e|^2 is off by 2 |U| |e| + |e|^2, with |e| up to sqrt(2) times that of a part, and by
two roundings of its own.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import ULP, complex_noise, twiddles

from gpusim.gpu import Kernel
from gpusim.optics.convolve import FIRST_RADIX
from gpusim.reference.fft_across import fft_across


def on_device(lines: np.ndarray, length: int, pairs: int, mirrored: bool = True) -> np.ndarray:
    _, columns, rows = lines.shape
    high = columns // 2 + 1 if mirrored else columns
    return run_stage(
        "psf/fft_across",
        (columns // 2, pairs, 1),
        {"rows": rows},
        {"twiddle": twiddles(length), "lines": lines},
        {"intensity": ((len(lines), high, columns), np.float32)},
        T=length,
        LANES=length // 8,
        FIRST_RADIX=FIRST_RADIX[length],
        N=columns,
        MIRRORED=mirrored,
    )["intensity"]


@pytest.mark.parametrize("mirrored", [True, False])
@pytest.mark.parametrize(
    ("length", "columns", "rows"),
    [(512, 64, 37), (1024, 16, 512), (1024, 512, 40), (512, 512, 1), (1024, 2, 101)],
)
def test_intensities_are_those_of_the_reference(
    length: int, columns: int, rows: int, mirrored: bool
):
    lines = complex_noise(np.random.default_rng(rows), 2, columns, rows)
    found = on_device(lines, length, 2, mirrored)
    expected = fft_across(lines, length, mirrored)
    parts = np.abs(lines.real.astype(float)) + np.abs(lines.imag.astype(float))
    off = 2**0.5 * 108 * ULP * 2 * 2 * parts.sum(axis=2).max()
    bound = 2 * np.sqrt(expected) * off + off**2 + 2 * ULP * expected
    assert_close(found, expected, atol=bound)
    if columns > 2:
        with pytest.raises(AssertionError, match="elements are bad"):
            assert_close(found[:, :, ::-1], expected, atol=bound)
    if columns > 2 and rows > 1 and not mirrored:
        with pytest.raises(AssertionError, match="elements are bad"):
            assert_close(found[:, :0:-1], expected[:, 1:], atol=bound[:, 1:])


def test_a_whole_pupil_may_have_as_many_rows_as_cells():
    lines = complex_noise(np.random.default_rng(8), 1, 8, 512)
    found, expected = on_device(lines, 512, 1, False), fft_across(lines, 512, False)
    parts = np.abs(lines.real.astype(float)) + np.abs(lines.imag.astype(float))
    off = 2**0.5 * 108 * ULP * 2 * parts.sum(axis=2).max()
    assert_close(found, expected, atol=2 * np.sqrt(expected) * off + off**2 + 2 * ULP * expected)


def test_a_beam_that_is_not_dispatched_is_left_alone():
    found = on_device(complex_noise(np.random.default_rng(5), 2, 16, 9), 512, 1)
    assert unwritten(found[1]).all()
    assert not unwritten(found[0]).any()


def test_a_slit_gives_its_closed_form():
    # 2 A cells of 1: |sin(2 pi A m / T) / sin(pi m / T)|^2, dark at m = T / (2 A).
    length, rows = 512, 32
    found = on_device(np.ones((1, 64, rows), np.complex64), length, 1)[0]
    m = np.arange(1, 33)
    closed = (np.sin(2 * np.pi * rows * m / length) / np.sin(np.pi * m / length)) ** 2
    off = 2**0.5 * 108 * ULP * 4 * rows
    bound = 2 * np.sqrt(closed) * off + off**2 + 2 * ULP * closed
    for column in found.T:
        assert column[0] == pytest.approx((2 * rows) ** 2, rel=2 * 108 * 2 * ULP)
        assert_close(column[1:], closed, atol=bound)


def test_the_defaults_are_of_one_grid():
    made = Kernel("psf/fft_across")
    assert made.overrides == {"T": 1024, "LANES": 128, "FIRST_RADIX": 2, "N": 256, "MIRRORED": True}
    assert made.workgroup_size == (128, 1, 1)

"""FFT along: against the definition, for odd and even rows, wide and narrow windows, many beams.

Tolerance: 108 roundings of the transform (see test_line_fft) of a sum of at most S, the sum of all
|parts| of both rows that share a transform; 2^-24 S each. The first pass of a line of 2 8^n is one
of radix 2, which takes fewer.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import ULP, complex_noise, twiddles

from gpusim.gpu import Kernel
from gpusim.optics.convolve import FIRST_RADIX
from gpusim.reference.fft_along import fft_along


def on_device(field: np.ndarray, columns: int, pairs: int, **changed: int) -> np.ndarray:
    _, rows, length = field.shape
    overrides = {"T": length, "LANES": length // 8, "FIRST_RADIX": FIRST_RADIX[length]}
    return run_stage(
        "psf/fft_along",
        (-(-rows // 2), pairs, 1),
        {"rows": rows},
        {"twiddle": twiddles(length), "field": field},
        {"lines": ((len(field), columns, rows), np.complex64)},
        **overrides | {"N": columns} | changed,
    )["lines"]


@pytest.mark.parametrize(
    ("length", "columns", "rows"),
    [(512, 64, 5), (1024, 256, 3), (1024, 512, 4), (512, 512, 1), (1024, 2, 2)],
)
def test_lines_are_those_of_the_reference(length: int, columns: int, rows: int):
    field = complex_noise(np.random.default_rng(rows), 2, rows, length)
    found = on_device(field, columns, 2)
    expected = fft_along(field, columns)
    parts = np.abs(field.real.astype(float)) + np.abs(field.imag.astype(float))
    bound = 108 * ULP * 2 * parts.sum(axis=2).max()
    assert_close(found, expected, atol=bound)
    # It would see a neighbouring column, or row: they differ by far more.
    assert np.abs(np.diff(expected, axis=1)).max() > 1e3 * bound
    with pytest.raises(AssertionError, match="elements are bad"):
        assert_close(np.roll(found, 1, axis=1), expected, atol=bound)


def test_a_beam_that_is_not_dispatched_is_left_alone():
    field = complex_noise(np.random.default_rng(5), 2, 3, 512)
    found = on_device(field, 64, 1)
    assert unwritten(found[1]).all()
    assert not unwritten(found[0]).any()


def test_a_tilt_moves_the_light_to_its_column():
    # exp(-2 pi i j k / T) is all in column n = k, which stands at N/2 + k.
    for k in (0, 5, -32, 31):
        field = np.exp(-2j * np.pi * k * np.arange(512) / 512)[None, None].astype(np.complex64)
        power = np.abs(on_device(field, 64, 1)[0, :, 0])
        assert np.argmax(power) == 32 + k
        assert power[32 + k] == pytest.approx(512, rel=1e-5)


def test_the_defaults_are_of_one_grid():
    made = Kernel("psf/fft_along")
    assert made.overrides == {"T": 1024, "LANES": 128, "FIRST_RADIX": 2, "N": 256}
    assert made.workgroup_size == (128, 1, 1)

"""FFT of rows: against the definition, for every length, odd blocks and several planes.

Tolerance: 108 roundings of the transform (see test_line_fft), and before it three of the weight
(the position s is a sum of a product, and 1 - s) and one of the product with it. Each is one of a
sum of at most S = sum |a| (|1 - s| + |s|) along the row: 112 * 2^-24 S.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import DEFAULT_GRID, ULP, convolve_for, twiddles

from gpusim.gpu import Device, Kernel
from gpusim.optics.convolve import FIRST_RADIX
from gpusim.optics.grid import SimGrid
from gpusim.plan.blocks import TRANSFORMS
from gpusim.reference.fft_rows import fft_rows

F32 = np.float32


def planes(count: int, height: int, width: int) -> np.ndarray:
    """Return random planes in which no two rows or columns are alike."""
    return np.random.default_rng(width).uniform(-1, 1, (count, height, width)).astype(F32)


def on_device(
    a: np.ndarray,
    length: int,
    first_s: float,
    step_s: float,
    needed=None,
    spare=0,
    mirrored=(0, 0),
):
    count, height, width = a.shape
    # Behind the planes lies a row of numbers: a NaN of the harness that is read and written again
    # would look unwritten.
    given = np.append(a.ravel(), np.ones(width, F32))
    result = run_stage(
        "optics/fft_rows",
        (-(-height // 2), count if needed is None else needed, 1),
        {"first_s": first_s, "step_s": step_s, "mirrored": mirrored},
        {"twiddle": twiddles(length), "planes": given},
        {"spectra": (count * height * length + spare, np.complex64)},
        T=length,
        LANES=length // 8,
        FIRST_RADIX=FIRST_RADIX[length],
        BX=width,
        BY=height,
    )
    return result["spectra"]


def bounds(a: np.ndarray, s: np.ndarray, length: int) -> np.ndarray:
    total = np.sum(np.abs(a) * (np.abs(1 - s) + np.abs(s)), axis=2, keepdims=True, dtype=float)
    return np.broadcast_to(112 * ULP * total, (*a.shape[:2], length))


@pytest.mark.parametrize(
    ("length", "shape"),
    [(256, (2, 5, 203)), (512, (1, 3, 397)), (1024, (2, 2, 1024)), (256, (1, 1, 1))],
)
def test_spectra_are_those_of_the_reference(length: int, shape: tuple[int, int, int]):
    a = planes(*shape)
    first_s, step_s = float(F32(0.125 / shape[2])), float(F32(0.8 / shape[2]))
    found = on_device(a, length, first_s, step_s, spare=70)
    size = a.size // shape[2] * length
    assert unwritten(found[size:]).all()
    expected = fft_rows(a, first_s, step_s, length)
    s = first_s + step_s * np.arange(shape[2])
    assert_close(found[:size].reshape(expected.shape), expected, atol=bounds(a, s, length))


@pytest.mark.parametrize("mirrored", [(1, 0), (0, 1), (1, 1)])
def test_a_mirror_image_is_read_from_its_end(mirrored: tuple[int, int]):
    a = planes(2, 5, 203)
    found = on_device(a, 256, 0.1, 0.004, mirrored=mirrored).reshape(2, 5, 256)
    turned = a[:, :: -1 if mirrored[1] else 1, :: -1 if mirrored[0] else 1]
    expected = fft_rows(turned, 0.1, 0.004, 256)
    s = 0.1 + 0.004 * np.arange(203)
    assert_close(found, expected, atol=bounds(turned, s, 256))


def test_a_plane_that_is_not_needed_is_left_out():
    a = planes(3, 4, 65)
    found = on_device(a, 256, 0.0, 0.0, needed=2).reshape(3, 4, 256)
    assert unwritten(found[2]).all()
    assert_close(found[:2], fft_rows(a[:2], 0.0, 0.0, 256), atol=bounds(a[:2], np.zeros(65), 256))


def test_the_right_node_is_the_imaginary_part():
    """S = 1 everywhere: the real rows, times i; so Re of the transform's inverse is zero."""
    a = planes(1, 2, 100)
    found = on_device(a, 256, 1.0, 0.0).reshape(2, 256)
    back = np.fft.ifft(found.astype(complex))
    allowed = bounds(a, np.ones(100), 256)[0].max()  # an average of 256 errors
    assert_close(back[:, :100].imag, a[0].astype(float), atol=allowed)
    assert_close(back.real, np.zeros((2, 256)), atol=allowed)
    assert_close(back[:, 100:].imag, np.zeros((2, 156)), atol=allowed)


@pytest.mark.parametrize("length", TRANSFORMS)
def test_the_host_makes_the_kernel_for_its_grid(device: Device, length: int):
    grid = SimGrid(50, 75, 4, 2, length, 40, (1, 1))
    kernel = convolve_for(device, grid, [0, 1, 1, 2], 3).fft_rows
    assert kernel.workgroup_size == (length // 8, 1, 1)
    assert (kernel.overrides["BX"], kernel.overrides["BY"]) == grid.block
    assert length in kernel.overrides["FIRST_RADIX"] * 8 ** np.arange(5)


def test_the_defaults_are_of_one_grid(device: Device):
    made = convolve_for(device, DEFAULT_GRID, [0, 1, 1, 2], 3)
    assert Kernel("optics/fft_rows").overrides == made.fft_rows.overrides

"""Inverse FFT: against the definitions, for windows over every border of the planes.

Tolerance: a result is a sum over M frequencies of two sites that share a transform. They are added
(one rounding), 108 follow in the transform (see test_line_fft), one where it is added: in units of
2^-24 of the sum of all |parts|; and one of what is there already.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage
from optics.made import DEFAULT_GRID, ULP, complex_noise, convolve_for, twiddles

from gpusim.gpu import Device, Kernel
from gpusim.optics.grid import SimGrid
from gpusim.reference.inverse_fft import inverse_fft

F32 = np.float32


def case(
    device: Device, length, stride, period, origin, size, seed=0, layers=1, step=(1, 1), seen=None
):
    """Add a window of noise to planes of noise; return result, reference, bound and the planes."""
    grid = SimGrid(32, 40, stride, period, length, 16, (1, 1), layers)
    kernel = convolve_for(device, grid, [0] * grid.sites, 1).inverse_fft
    seen = seen or (grid.window, grid.window)
    rng = np.random.default_rng(seed)
    pairs = -(-grid.sites // 2)
    folded = complex_noise(rng, grid.sites, grid.length // 2 + 1, grid.window)
    folded[:, 0], folded[:, -1] = folded[:, 0].real, 0  # the planes are real
    rates = rng.uniform(0, 100, (grid.sites, *size)).astype(F32)
    side_by_side = np.zeros((2 * pairs, grid.length // 2, grid.window), np.complex64)
    side_by_side[: grid.sites] = folded[:, :-1]
    side_by_side = side_by_side.reshape(pairs, 2, -1, grid.window).transpose(0, 3, 2, 1)
    found = run_stage(
        kernel,
        (-(-seen[1] // stride), -(-grid.sites // 4), 1),
        {"origin": origin, "step": step, "size": size[::-1], "seen": seen},
        {"twiddle": twiddles(length), "folded": side_by_side.copy(), "rates": rates},
        {"rates": (rates.shape, F32)},
    )["rates"]
    # The sum over each row of photosites and site: the inner frequencies count with their mirrors.
    amount = 2 * np.abs(folded.view(F32)).sum(axis=1, dtype=float)
    amount = amount.reshape(grid.sites, grid.window, 2).sum(axis=2)
    paired = np.add.reduceat(amount, range(0, grid.sites, 2))
    roundings = 1 + 108 + 1
    expected = inverse_fft(folded, rates, origin, step, seen)
    return found, expected, roundings * ULP * paired.max() + ULP * 100, rates


@pytest.mark.parametrize(
    ("length", "stride", "period", "origin", "size"),
    [
        (256, 4, 2, (5, 3), (80, 90)),  # inside
        (256, 4, 2, (-7, -3), (43, 51)),  # beyond every border
        (256, 2, 1, (-100, 20), (31, 29)),  # one site, without a partner
        (512, 8, 4, (30, -60), (50, 95)),
        (1024, 8, 2, (-70, -1), (70, 60)),
        (256, 1, 2, (-3, -200), (60, 40)),
        (256, 4, 2, (0, 0), (1, 1)),
        (256, 4, 2, (-63, -63), (9, 12)),  # its last photosite alone
    ],
)
def test_windows_are_added_as_by_the_reference(
    device: Device, length, stride, period, origin, size
):
    found, expected, bound, _ = case(device, length, stride, period, origin, size)
    assert_close(found, expected, atol=bound)


@pytest.mark.parametrize(
    ("origin", "step"), [((60, 3), (-1, 1)), ((5, 70), (1, -1)), ((92, 20), (-1, -1))]
)
def test_windows_of_mirror_images_are_added_from_their_end(device: Device, origin, step):
    found, expected, bound, rates = case(device, 256, 4, 2, origin, (80, 90), step=step)
    assert_close(found, expected, atol=bound)
    assert np.abs(expected - rates).max() > 1000 * bound


@pytest.mark.parametrize("seen", [(41, 64), (64, 41), (40, 2), (1, 1)])
def test_what_no_light_reaches_is_not_added(device: Device, seen):
    found, expected, bound, rates = case(device, 256, 4, 2, (2, 1), (66, 67), seen=seen)
    assert_close(found, expected, atol=bound)
    assert np.array_equal(found[:, :, 2 + seen[0] :], rates[:, :, 2 + seen[0] :])
    assert np.array_equal(found[:, 1 + seen[1] :], rates[:, 1 + seen[1] :])


@pytest.mark.parametrize("layers", [2, 3, 5])
def test_layers_may_be_of_any_number(device: Device, layers: int):
    found, expected, bound, _ = case(device, 256, 2, 1, (-5, 3), (43, 51), layers=layers)
    assert_close(found, expected, atol=bound)


@pytest.mark.parametrize("origin", [(-64, 0), (0, -64), (12, 0), (0, 9)])
def test_a_window_beside_the_planes_changes_nothing(device: Device, origin):
    found, _, _, rates = case(device, 256, 4, 2, origin, (9, 12))
    assert_close(found, rates, atol=0)


def test_the_defaults_are_of_one_grid(device: Device):
    made = convolve_for(device, DEFAULT_GRID, [0, 1, 1, 2], 3)
    assert Kernel("optics/inverse_fft").overrides == made.inverse_fft.overrides


def test_the_dispatch_is_as_the_header_says():
    kernel = Kernel("optics/inverse_fft", T=256, LANES=32, M=64)
    assert kernel.workgroup_size == (32, 1, 1)

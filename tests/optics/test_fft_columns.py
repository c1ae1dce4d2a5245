"""FFT of columns: against the definitions, for all lengths, strides, periods and channels.

Tolerance, as a norm along ky, where each step is a rotation (times sqrt T or sqrt M) and the
roundings of its elements keep their share of its norm: 108 roundings of the forward transform (see
test_line_fft) after 6 of sides and weights; the product with a kernel 3, the sum over planes and
nodes 4 J; folding 3 and up to 7 products with a turn (4 each), the shift to the site 4, the sum
over D columns D; 108 of the inverse transform. In units of 2^-24, and times D for the columns, of

    sqrt(T) max|H| sum over planes and nodes of sqrt(T) |A r|_2,

which bounds every result: it is a sum of T products of X = DFT(A r) and H.
"""

import numpy as np
import pytest
from harness import assert_close, filled, run_stage, unwritten
from optics.made import DEFAULT_GRID, ULP, complex_noise, convolve_for, twiddles

from gpusim.gpu import Device, Kernel
from gpusim.optics.convolve import Scratch, fft_columns_passes
from gpusim.optics.grid import SimGrid
from gpusim.reference.fft_columns import fft_columns

F32 = np.float32
NODES = ("kernels_00", "kernels_10", "kernels_01", "kernels_11")


def packed(kernels: np.ndarray) -> np.ndarray:
    """Return [plane, kx, channel, ky] as eight invocations read it: ky = T/256 (p + 16 q) + g."""
    planes, _, channels, length = kernels.shape
    out = np.zeros((planes, length // 16, length // 256, 16, channels, 8, 8, 2), np.complex64)
    for kx, g, p, q in np.ndindex(length // 2, length // 256, 16, 16):
        ky = length // 256 * (p + 16 * q) + g
        out[:, kx // 8, g, p, :, q // 2, kx % 8, q % 2] = kernels[:, kx, :, ky]
    return out


def case(
    device,
    length,
    stride,
    period,
    channels,
    height,
    planes,
    needed=None,
    first_s=0.1,
    nodes=4,
    layers=1,
    mirrored=(0, 0),
):
    """Run the shader on noise; return its result, the reference, the bound, the host's part."""
    grid = SimGrid(32, 40, stride, period, length, 16, (1, 1), layers)
    # Channels in an order of their own; where sites lie between samples, each is a channel.
    # Every channel at sites of even and of odd number, where there are enough of them.
    turn = 2 if channels == 2 else 4
    site_channels = [(3 * site + site // turn + 1) % channels for site in range(grid.sites)]
    made = convolve_for(device, grid, site_channels, channels)
    passes = [
        (kernel, params | {"height": height})
        for kernel, params in fft_columns_passes(grid, made.outputs, nodes)
    ]
    outputs, step = len(made.outputs.places), made.outputs.step
    rng = np.random.default_rng(length + stride)
    spectra = complex_noise(rng, planes, height, length)
    if nodes == 1:  # of real rows: each frequency is its mirror's conjugate
        partner = np.roll(spectra[..., ::-1], 1, axis=-1)
        spectra = 0.5 * (spectra + partner.conj())
    kernels = [complex_noise(rng, planes, length // 2 + 1, outputs, length) for _ in range(4)]
    for kernel_of_node in kernels:
        kernel_of_node[:, -1] = 0  # kernels have no frequency kx = T/2
    first_s, step_s = float(F32(first_s)), float(F32(0.85 / height))
    needed = planes if needed is None else needed
    pairs = -(-grid.sites // 2)
    shape = (pairs, grid.window, length // 2, 2)
    lines = filled(int(np.prod(Scratch.shapes(grid, planes)["lines"])), np.float32)
    inputs = {"twiddle": twiddles(length), "spectra": spectra}
    inputs |= {name: packed(one) for name, one in zip(NODES, kernels, strict=True)}
    result = filled(int(np.prod(shape)) + 70, np.complex64)
    params = {"first_s": first_s, "step_s": step_s, "planes": needed, "mirrored": mirrored}
    for kernel, sizes in passes:
        given = {"lines": lines, "folded": result}
        found = run_stage(
            kernel,
            (length // 16, 1, 1),
            params | sizes,
            inputs | given,
            {name: (array.shape, array.dtype) for name, array in given.items()},
        )
        lines, result = found["lines"], found["folded"]
    assert unwritten(result[-70:]).all()
    offsets = [np.arange(period)[:: -1 if turned else 1] * step for turned in mirrored]
    sites = [
        (channel, offsets[0][site % period], offsets[1][site // period]) if step else (site, 0, 0)
        for site, channel in enumerate(site_channels)
    ]
    largest = max(np.abs(one).max() for one in kernels)
    spectra, kernels = spectra[:needed], [one[:needed].transpose(1, 0, 2, 3) for one in kernels]
    if nodes < 4:  # no weights: the upper nodes of a block on their line
        first_s = step_s = 0.0
    expected = fft_columns(
        spectra, kernels, first_s=first_s, step_s=step_s, sites=sites, stride=stride
    )
    s = first_s + step_s * np.arange(height)
    # |A_0| and |A_1| are at most the mean of |Z[k]| and |Z[T-k]|, which are at most sqrt 2.
    norm = sum(np.sqrt(length * np.sum(2 * weight**2)) for weight in (1 - s, 1 - s, s, s)) * needed
    roundings = 6 + 108 + 3 + 4 * needed + 35 + stride + 108
    bound = roundings * ULP * np.sqrt(length) * largest * norm
    found = result[:-70].reshape(shape).transpose(0, 3, 2, 1).reshape(2 * pairs, -1, grid.window)
    assert not expected[:, -1].any()
    return found[: grid.sites], expected[:, :-1], bound, made


@pytest.mark.parametrize("mirrored", [(1, 0), (0, 1), (1, 1)])
@pytest.mark.parametrize(("stride", "period"), [(4, 2), (8, 4), (2, 1)])
def test_sites_of_a_mirror_image_lie_the_other_way_round(
    device: Device, stride: int, period: int, mirrored: tuple[int, int]
):
    length, channels = (512, 4) if period == 4 else (256, 3 if period == 2 else 1)
    found, expected, bound, _ = case(
        device, length, stride, period, channels, 45, 1, mirrored=mirrored
    )
    assert_close(found, expected, atol=bound)


@pytest.mark.parametrize("nodes", [1, 2])
def test_lines_of_modes_have_no_nodes_below_them(device: Device, nodes: int):
    """The params' weights, which are not zero, and the lower nodes' kernels are not used."""
    found, expected, bound, _ = case(device, 256, 4, 2, 3, 45, 2, nodes=nodes)
    assert_close(found, expected, atol=bound)


@pytest.mark.parametrize(
    ("length", "stride", "period", "channels", "height", "planes"),
    [
        (256, 1, 1, 1, 13, 2),
        (256, 2, 2, 2, 31, 1),
        (256, 4, 2, 3, 45, 2),
        (256, 1, 2, 3, 17, 1),  # four sites half a pixel's samples apart: a kernel each
        (512, 8, 4, 4, 70, 1),  # sixteen sites, all together
        pytest.param(1024, 8, 4, 3, 140, 1, marks=pytest.mark.slow),  # eight of sixteen at a time
        (512, 4, 2, 3, 336, 2),
    ],
)
def test_folded_spectra_are_those_of_the_reference(
    device: Device, length, stride, period, channels, height, planes
):
    found, expected, bound, _ = case(device, length, stride, period, channels, height, planes)
    assert_close(found, expected, atol=bound)


@pytest.mark.parametrize(
    ("length", "stride", "period", "layers", "channels"),
    [
        (256, 2, 1, 2, 2),
        (256, 2, 1, 3, 3),
        (256, 1, 1, 6, 3),  # four layers, then two
        (512, 8, 4, 1, 5),  # sixteen sites with a kernel each, four at a time
    ],
)
def test_layers_and_many_channels_are_those_of_the_reference(
    device: Device, length, stride, period, layers, channels
):
    found, expected, bound, _ = case(device, length, stride, period, channels, 21, 1, layers=layers)
    assert_close(found, expected, atol=bound)


def test_a_block_as_high_as_the_transform(device: Device):
    found, expected, bound, _ = case(device, 256, 1, 1, 1, 256, 1)
    assert_close(found, expected, atol=bound)


def test_planes_that_are_not_needed_are_left_out(device: Device):
    found, expected, bound, _ = case(device, 256, 2, 2, 2, 31, 3, needed=2, first_s=0.0)
    assert_close(found, expected, atol=bound)
    none, _, _, _ = case(device, 256, 2, 2, 2, 31, 3, needed=0)
    assert_close(none, np.zeros(none.shape), atol=0)


def test_the_host_packs_the_channels_of_the_sites_four_bits_each(device: Device):
    made = case(device, 512, 8, 4, 4, 70, 1)[3]
    words = made.fft_columns[0][1]["site_channels"]
    channels = [words[site // 8] >> 4 * (site % 8) & 15 for site in range(16)]
    assert channels == [(3 * site + site // 4 + 1) % 4 for site in range(16)]
    assert set(channels) == {0, 1, 2, 3}


def test_the_defaults_are_of_one_grid(device: Device):
    made = convolve_for(device, DEFAULT_GRID, [0, 1, 1, 2], 3)
    passes = [kernel.overrides for kernel, _ in made.fft_columns]
    defaults = [Kernel("optics/fft_columns", PHASE=phase).overrides for phase in range(3)]
    assert passes == defaults


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("optics/fft_columns").workgroup_size == (8, 1, 1)

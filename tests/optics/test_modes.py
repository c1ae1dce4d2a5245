"""Modes: rows weighted with maps, against the definition, and whole frames convolved in space.

Tolerance of the stage: 108 roundings of the transform (see test_line_fft); before it, of each
weight, three interpolations of two products and a sum each, and one rounding of each position,
which moves a weight by 2^-24 times the position's largest value times the maps' difference from
node to node; one product with the sample. Each is one of a sum of at most S = sum |a| max|m| along
the row, of either line: (108 + 10 + 2 nodes) 2^-24 S.
"""

from dataclasses import replace

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import DEFAULT_GRID, ULP, convolve_for, twiddles
from optics.whole import everything
from optics.whole_frame import (
    BLURRED,
    LENS,
    WEIGHTS,
    camera,
    check_rectangles,
    in_space,
    mosaic,
    on_device,
    source,
)

from gpusim.gpu import Device, Kernel, Recording
from gpusim.gpu.pool import size_class
from gpusim.optics.convolve import FIRST_RADIX
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels
from gpusim.optics.modes import Decomposition, Modes, mode_decomposition
from gpusim.optics.nodes import Scale
from gpusim.optics.sampling import node_kernels, sampled_kernels
from gpusim.plan.blocks import TRANSFORMS
from gpusim.psf.places import Heights
from gpusim.reference.modes import modes

F32 = np.float32


def noise(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, shape).astype(F32)


def on_stage(planes, maps, first, step, node, length, lines):
    """Return the spectra of a block's pairs of lines (pairs, BY, T)."""
    count, height, width = planes.shape
    rank, down, across = maps.shape
    pairs = -(-count * rank // 2)
    # Behind the planes lies a row of numbers: what no line needs is read and not used.
    given = np.append(planes.ravel(), np.ones(width, F32))
    result = run_stage(
        "optics/modes",
        (-(-height // 2), -(-lines // 2), 1),
        {"first": first, "step": step, "node": node, "lines": lines},
        {"twiddle": twiddles(length), "planes": given, "maps": maps},
        {"spectra": (pairs * height * length, np.complex64)},
        T=length,
        LANES=length // 8,
        FIRST_RADIX=FIRST_RADIX[length],
        BX=width,
        BY=height,
        RANK=rank,
        MAP_X=across,
        MAP_Y=down,
    )
    return result["spectra"].reshape(pairs, height, length)


# length, planes (J, BY, BX), maps (R, ny, nx), planes that are needed
CASES = {
    "one map, two planes to a pair": (256, (2, 5, 203), (1, 3, 4), 2),
    "one line": (256, (1, 3, 65), (1, 2, 2), 1),
    "two maps of one plane": (512, (1, 4, 397), (2, 4, 7), 1),
    "three maps, a pair of two planes, a line alone": (256, (3, 7, 100), (3, 5, 3), 3),
    "a plane that is not needed": (256, (2, 2, 40), (3, 2, 9), 1),
    "more nodes than lanes": (256, (1, 3, 256), (2, 3, 60), 1),
    "the longest": (1024, (1, 2, 1024), (4, 2, 3), 1),
}


@pytest.mark.parametrize("name", CASES)
def test_spectra_are_those_of_the_reference(name: str):
    length, shape, of_maps, needed = CASES[name]
    planes, maps = noise(1, *shape), noise(2, *of_maps)
    node = (1 if of_maps[2] > 2 else 0, of_maps[1] - 2)
    cells = np.array(of_maps[:0:-1]) - 1 - node  # to the far end of the maps
    step = (0.95 * cells / shape[:0:-1]).astype(F32)
    first = (0.03 * cells).astype(F32)
    lines = needed * of_maps[0]
    found = on_stage(planes, maps, first, step, node, length, lines)
    start = tuple(float(f) + n for f, n in zip(first, node, strict=True))
    expected = modes(planes[:needed], maps, start, tuple(map(float, step)), length)
    assert unwritten(found[len(expected) :]).all()
    total = np.abs(maps).max() * np.abs(planes[:needed]).sum(axis=2, dtype=float).max()
    allowed = 2 * (118 + 2 * max(of_maps)) * ULP * total  # of two lines
    assert_close(found[: len(expected)], expected, atol=allowed)


def test_a_plane_that_is_not_needed_may_hold_anything():
    """Three maps of one plane: what the fourth line would read is no number."""
    planes, maps = noise(3, 2, 4, 65), noise(4, 3, 2, 2)
    planes[1] = np.nan
    found = on_stage(planes, maps, (0.1, 0.1), (0.01, 0.1), (0, 0), 256, 3)
    expected = modes(planes[:1], maps, (F32(0.1), F32(0.1)), (F32(0.01), F32(0.1)), 256)
    assert_close(found[:2], expected, atol=2 * 124 * ULP * np.abs(planes[0]).sum(axis=1).max())


def decomposed(scale: Scale, cells: tuple[int, int], planes: int = 2) -> Decomposition:
    return mode_decomposition(scale.kernels, scale.grid, scale.pitch_um, cells, planes)


FRAMES = {
    "two samples a pixel": (SimGrid(33, 46, 4, 2, 256, 32, (1, 1)), 0.8, LENS, (2, 1)),
    "one site, several blocks": (SimGrid(30, 99, 2, 1, 256, 32, (1, 1)), 0.8, LENS, (3, 2)),
    "sites between samples": (SimGrid(34, 47, 1, 2, 256, 32, (1, 1)), 0.8, BLURRED, (2, 2)),
}


@pytest.mark.parametrize("name", FRAMES)
def test_all_modes_are_the_mixture_of_the_nodes(device: Device, name: str):
    grid, sigma, lens, cells = FRAMES[name]
    scale, site_channels = camera(grid, sigma, lens)
    blocks = source(grid, len(WEIGHTS))
    needed = {block: (2, 1)[sum(block) % 2] for block in blocks}
    all_of_them = decomposed(scale, cells)

    def make(*arguments: object) -> Modes:
        return Modes(*arguments, decomposition=all_of_them)

    frame = (0, 0, grid.rows, grid.cols)
    found = on_device(device, make, scale, site_channels, blocks, needed, frame)
    expected = in_space(scale, site_channels, blocks, needed, cells)
    # As for the FFTs of PSF nodes; the modes' float32 adds one rounding for each of 24 at most.
    image = mosaic(found, grid.period, expected.shape)
    assert_close(image, expected, atol=324 * ULP * np.abs(expected).max())


@pytest.mark.parametrize(("rank", "planes"), [(1, 1), (1, 2), (2, 1), (3, 2)])
def test_few_modes_are_their_sum(device: Device, rank: int, planes: int):
    """A line alone; a pair of two planes; a pair of one; three pairs, one of them of two planes."""
    grid, cells = SimGrid(33, 46, 4, 2, 256, 32, (1, 1)), (2, 2)
    scale, site_channels = camera(grid, 0.8)
    few = decomposed(scale, cells).truncated(rank)
    blocks = source(grid, len(WEIGHTS))
    needed = dict.fromkeys(blocks, planes)

    def kernels_of(x: int, y: int) -> np.ndarray:
        return np.tensordot(few.maps[:, y, x], few.modes.astype(float), axes=1)

    frame = (0, 0, grid.rows, grid.cols)
    found = on_device(
        device, lambda *a: Modes(*a, decomposition=few), scale, site_channels, blocks, needed, frame
    )
    expected = in_space(scale, site_channels, blocks, needed, cells, kernels_of)
    image = mosaic(found, grid.period, expected.shape)
    assert_close(image, expected, atol=300 * ULP * np.abs(expected).max())


def test_a_rectangle_gets_the_same_bits_as_the_whole(device: Device):
    grid = SimGrid(33, 46, 4, 2, 256, 96, (1, 1))
    scale, site_channels = camera(grid, 0.8)
    three = decomposed(scale, (2, 1)).truncated(3)
    rects = [(0, 0, 8, 10), (14, 20, 7, 9), (30, 44, 3, 2)]
    check_rectangles(device, lambda *a: Modes(*a, decomposition=three), scale, site_channels, rects)


def test_the_nodes_of_a_decomposition_are_those_of_the_grid():
    """All modes together give every node's least-squares kernels back."""
    grid, cells = SimGrid(33, 46, 4, 2, 256, 32, (2, 1)), (2, 1)
    scale, _ = camera(grid, 0.8)
    found = decomposed(scale, cells)

    def sample(x: int, y: int) -> np.ndarray:
        at = (np.array(grid.node_position((x, y))) - grid.centre) * scale.pitch_um
        return sampled_kernels(scale.kernels, *at, scale.pitch_um, grid.half_size, planes=2)

    assert (np.diff(found.singular_values) < 0).all()
    assert_close(np.mean(found.maps**2, axis=(1, 2)), np.ones(found.rank), atol=1e-12)
    for x, y in np.ndindex(grid.nodes):
        expected = node_kernels(lambda dx, dy, x=x, y=y: sample(x + dx, y + dy))
        kernels = np.tensordot(found.maps[:, y, x], found.modes.astype(float), axes=1)
        # float32 of the samples, which have weights of up to 4/3 and maps of up to sqrt 6.
        assert_close(kernels, expected, atol=16 * ULP * np.abs(expected).max())


@pytest.mark.parametrize(("pitch_um", "ringing"), [(0.775, False), (2.5, True)])
def test_the_predicted_error_is_that_of_the_edges(pitch_um: float, ringing: bool):
    """Edges of all nodes, from the kernels themselves; with every mode they are right."""
    grid, cells = SimGrid(33, 46, 4, 2, 256, 32, (1, 1)), (3, 2)
    scale, _ = camera(grid, 0.8)
    scale = replace(scale, kernels=everything(pitch_um=pitch_um), pitch_um=pitch_um)
    assert scale.kernels.ringing is ringing
    every = decomposed(scale, cells)
    assert (np.diff(every.singular_values) < 0).all()
    whole = np.tensordot(every.maps, every.modes[:, 0].astype(float), axes=(0, 0))
    for rank in (1, 4, 7):
        few = every.truncated(rank)
        rest = whole - np.tensordot(few.maps, few.modes[:, 0].astype(float), axes=(0, 0))
        if ringing:  # held times a raised cosine over all of the band
            cycles = np.fft.fftfreq(rest.shape[-1])
            cycles = np.minimum(np.hypot(cycles, cycles[:, None]), 0.4999)
            ends = np.cos(np.pi / 2 * np.clip((2 * cycles - 0.85) / 0.15, 0, 1)) ** 2
            rest = np.fft.ifft2(np.fft.fft2(rest) * ends / np.cos(np.pi * cycles) ** 2).real
        signal = whole.sum(axis=(-1, -2))[..., None]
        edges = [np.abs(np.cumsum(rest.sum(axis=axis), axis=-1) / signal) for axis in (-1, -2)]
        expected = np.sqrt(np.mean([edge.max(axis=-1) ** 2 for edge in edges]))
        # Modes are float32: 2^-24 of each of the 64 sums; sharpened, up to 44 times as much.
        assert_close(few.errors[-1], expected, atol=64 * ULP * (44 if ringing else 1))
    assert every.errors[-1] < (44e-6 if ringing else 1e-6) < every.errors[0]


def test_the_rank_is_the_smallest_that_keeps_the_error():
    nothing = np.zeros((4, 1, 1, 2, 2), F32)
    errors = np.array([0.1, 0.01, 0.02, 0.001])
    found = Decomposition(nothing, nothing[..., 0, 0], errors, errors)
    assert found.rank_within(0.015) == (2, 0.01)
    assert found.rank_within(0.1) == (1, 0.1)
    assert found.rank_within(1e-9) == (4, 0.001)  # it cannot be kept
    few = found.truncated(2)
    assert few.rank == 2 and len(few.maps) == len(few.errors) == len(few.singular_values) == 2


@pytest.mark.parametrize("length", TRANSFORMS)
def test_the_host_makes_the_kernels_for_its_grid(device: Device, length: int):
    grid = SimGrid(50, 75, 4, 2, length, 40, (1, 1))
    made = stage_for(device, grid, 2)
    assert made.modes.workgroup_size == (length // 8, 1, 1)
    assert (made.modes.overrides["BX"], made.modes.overrides["BY"]) == grid.block
    # All but the number of nodes as for nodes.
    nodes = convolve_for(device, grid, [0, 1, 1, 2], 3)
    for (own, sizes), (other, expected) in zip(made.fft_columns, nodes.fft_columns, strict=True):
        two = {} if other.overrides["PHASE"] == 2 else {"NODES": 2}
        assert own.overrides == other.overrides | two
        assert sizes == expected
    assert made.inverse_fft.overrides == nodes.inverse_fft.overrides
    made.release()
    nodes.release()


def stage_for(device: Device, grid: SimGrid, rank: int) -> Modes:
    """Return the modes of a sim grid, one plane of nothing."""
    size = 2 * grid.half_size
    nothing = Decomposition(
        np.zeros((rank, 1, 3, size, size), F32),
        np.zeros((rank, 4, 5)),
        np.ones(rank),
        np.ones(rank),
    )
    kernels = FieldKernels(np.zeros((1, 1, 3, 4, 4), F32), Heights(np.zeros(1)), 1.0)
    scale = Scale("test", grid, 1.0, 0.0, kernels)
    return Modes(device, scale, {(0, 0): 1}, 1.0, [0, 1, 1, 2], decomposition=nothing)


def test_modes_come_and_go_together(device: Device):
    grid = SimGrid(50, 75, 4, 2, 256, 40, (1, 1))
    made, blocks = stage_for(device, grid, 3), [(0, 0)]
    # Three lines, the last pair's second of zeros: twice two, of three channels.
    half = size_class(2 * 3 * 128 * 256 * 8)
    assert made.load_bytes(blocks) == made.missing_bytes(blocks) == made.block_bytes(1) == 2 * half
    assert made.load_bytes([]) == made.held_bytes == 0
    seen = []
    made.load(blocks, lambda: seen.append(made.held_bytes))
    assert seen == [half, 2 * half] and made.made == 2
    assert made.missing_bytes(blocks) == 0
    odd = device.read(made.nodes[1, 0])
    assert odd.shape[0] == 2 and not odd[1].any()
    assert made.shed(1, blocks) == 0  # all of it is used
    assert made.shed(1) == half and made.held_bytes == half
    assert made.shed(2 * half) == half and not made.nodes
    rec = Recording(device)
    arrays = vars(made.scratch(rec, 1)).values()
    assert made.scratch_bytes(1) == sum(size_class(array.nbytes) for array in arrays)
    made.release()


def test_the_defaults_are_of_one_grid(device: Device):
    made = stage_for(device, DEFAULT_GRID, 2)
    assert Kernel("optics/modes").overrides == made.modes.overrides
    made.release()

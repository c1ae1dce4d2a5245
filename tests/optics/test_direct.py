"""Direct: against the definition of the sum, and against a frame convolved in space.

Tolerance of the stage: a result is a sum of n = J L 4 G products (of L lines of 4 G taps, the zeros
among them included), each rounded once and added; before it at most eight roundings of the taps
(two interpolations in t, their difference, its product with e step_s) and four of the position s.
The terms are at most |a| max|H| (1 + 2 |e step_s| + 2 |s(p)|), e at most the last tap and the
places' offset: (n + 12) 2^-24 times the sum of these. The position's own rounding, 2^-24 (|first_s|
+ |i step_s|), is below that.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import DEFAULT_GRID, ULP
from optics.whole_frame import (
    BLURRED,
    LENS,
    WEIGHTS,
    by_layer,
    camera,
    check_rectangles,
    on_device,
    source,
)

from gpusim.gpu import Device, Kernel, Recording
from gpusim.gpu.pool import size_class
from gpusim.optics.direct import Direct, direct_work, packed_taps, support_within, tap_layout
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels
from gpusim.optics.nodes import Outputs, Scale, outputs_of
from gpusim.psf.places import Heights
from gpusim.reference.direct import direct

F32 = np.float32
NODES = ("taps_00", "taps_10", "taps_01", "taps_11")


def stage_for(device: Device, grid: SimGrid, sites: list[int], support: int):
    """Return the kernels of a sim grid as the chain makes them, without any PSF nodes."""
    places = Heights(np.array([0.0, 1.0]))
    nothing = FieldKernels(np.zeros((3, 1, 3, 4, 4), F32), places, 0.5)
    return Direct(device, Scale("test", grid, 1.0, 0.0, nothing), {}, 1.0, sites, support=support)


def case(device, grid: SimGrid, support, planes, needed, origin, size, weighted=True):
    """Run the shader on noise and ones; return the added planes, the reference, the bound.

    Not weighted, the reference is of the first node alone.
    """
    sites = [site % 3 for site in range(grid.sites)]
    stage = stage_for(device, grid, sites, support)
    outputs, layout = outputs_of(grid, sites, 3), stage.layout
    rng = np.random.default_rng(support + grid.stride)
    a = rng.uniform(-1, 1, (planes, grid.block[1], grid.block[0])).astype(F32)
    shape = (planes, len(outputs.places), layout.lines, layout.lines)
    taps = [rng.uniform(-1, 1, shape).astype(F32) for _ in range(4)]
    first, step = (0.1, 0.2), (0.7 / grid.block[0], 0.6 / grid.block[1])
    rows, cols = ((side + 2 * grid.half_size) // grid.stride for side in grid.block[::-1])
    lines = range(max(0, -origin[1]), min(rows, size[1] - origin[1]))
    before = rng.uniform(-1, 1, (grid.sites, size[1], size[0])).astype(F32)
    result = run_stage(
        stage.kernel,
        (-(-layout.eights * len(lines) // 64), grid.period * layout.places // layout.columns, 1),
        {
            "first_s": first[0],
            "step_s": step[0],
            "first_t": first[1],
            "step_t": step[1],
            "planes": needed,
            "first_line": lines[0],
            "lines": len(lines),
            "origin": origin,
            "size": size,
        },
        {"planes": a, "rates": before}
        | {
            name: packed_taps(of_node, layout, grid.sites_across, outputs.of_site)
            for name, of_node in zip(NODES, taps, strict=True)
        },
        {"rates": (before.shape, F32)},
    )["rates"].reshape(before.shape)
    offsets = [
        (site % grid.period * outputs.step, site // grid.period * outputs.step)
        for site in range(grid.sites)
    ]

    def summed(planes: np.ndarray, kernels: list[np.ndarray]) -> np.ndarray:
        used = [of_node[:needed, outputs.of_site] for of_node in kernels]
        return direct(
            planes[:needed],
            used,
            low=layout.low,
            first=first,
            step=step,
            sites=offsets,
            stride=grid.stride,
            reach=grid.half_size,
        )

    largest = [np.max(np.abs(taps), axis=0)] * 4
    n = needed * layout.lines * 4 * layout.groups
    reach = (max(layout.high, -layout.low) + max(layout.offsets)) * step[0]
    place = first[0] + step[0] * (grid.block[0] + grid.half_size)
    bound = (n + 12) * ULP * (1 + 2 * reach + 2 * place) * summed(np.abs(a), largest)
    expected = summed(a, taps if weighted else [taps[0]] * 4)
    y, x = (np.arange(side) - o for side, o in zip(size[::-1], origin[::-1], strict=True))
    inside = ((y >= 0) & (y < rows))[:, None] & ((x >= 0) & (x < cols))
    at = np.s_[:, np.clip(y, 0, rows - 1)[:, None], np.clip(x, 0, cols - 1)]
    added = np.where(inside, expected[at], 0.0)
    return result, before + added, np.where(inside, bound[at] + 2 * ULP, 0.0) + ULP * inside


CASES = {
    "two columns of sites": (SimGrid(20, 24, 4, 2, 256, 16, (1, 1)), 6, 2, 2, (-3, 2), (31, 37)),
    "photosites two samples apart": (
        SimGrid(33, 29, 2, 1, 256, 8, (1, 1)),
        5,
        1,
        1,
        (2, 3),
        (60, 60),
    ),
    "one column of sites": (SimGrid(9, 11, 4, 1, 256, 12, (1, 1)), 7, 1, 1, (0, 0), (19, 16)),
    "sites two vec4f apart": (SimGrid(9, 17, 8, 2, 256, 16, (1, 1)), 6, 2, 1, (1, -2), (14, 12)),
    "sixteen sites": (SimGrid(12, 9, 8, 4, 256, 16, (1, 1)), 4, 1, 1, (0, 0), (8, 8)),
    # The second pair of places begins at another vec4f than the first.
    "sites between samples": (SimGrid(20, 14, 1, 2, 256, 8, (1, 1)), 5, 1, 1, (-5, 1), (25, 30)),
    "layers two samples apart": (
        SimGrid(33, 29, 2, 1, 256, 8, (1, 1), 3),
        5,
        1,
        1,
        (2, 3),
        (60, 60),
    ),
    "three layers, one column": (
        SimGrid(9, 11, 4, 1, 256, 12, (1, 1), 3),
        7,
        2,
        2,
        (0, 0),
        (19, 16),
    ),
    "a sample a pixel": (SimGrid(12, 14, 4, 4, 256, 8, (1, 1)), 3, 1, 1, (0, 0), (9, 9)),
}


@pytest.mark.parametrize("name", CASES)
def test_sums_are_those_of_the_reference(device: Device, name: str):
    found, expected, bound = case(device, *CASES[name])
    assert not unwritten(found).any()
    assert_close(found, expected, atol=bound)


def test_the_bound_is_far_below_a_wrong_weight(device: Device):
    """The same case with its nodes' weights left out is off by far more."""
    found, unweighted, bound = case(device, *CASES["two columns of sites"], weighted=False)
    assert np.abs(found - unweighted).max() > 100 * bound.max()


@pytest.mark.parametrize(
    ("grid", "sigma", "lens", "support"),
    [
        (SimGrid(33, 46, 4, 2, 256, 32, (2, 1)), 0.8, LENS, 28),
        (SimGrid(22, 25, 2, 1, 256, 32, (1, 2)), 0.8, LENS, 28),
        (SimGrid(29, 31, 8, 4, 512, 32, (2, 2)), 0.0, LENS, 28),
        (SimGrid(34, 47, 1, 2, 256, 32, (2, 2)), 0.8, BLURRED, 28),
        (SimGrid(22, 25, 2, 1, 256, 32, (1, 2), 3), 0.8, LENS, 28),
    ],
)
def test_each_sample_is_spread_by_the_mixture_of_its_nodes(
    device: Device, grid: SimGrid, sigma, lens, support
):
    scale, site_channels = camera(grid, sigma, lens)
    blocks = source(grid, len(WEIGHTS))
    needed = {block: (2, 1, 2, 0, 1)[sum(block) % 5] for block in blocks}

    def make(*arguments: object) -> Direct:
        return Direct(*arguments, support=support)

    frame = (0, 0, grid.rows, grid.cols)
    found = on_device(device, make, scale, site_channels, blocks, needed, frame)
    # The same bound as that of the FFTs: the taps left out give less than 50 ULP.
    for image, expected in by_layer(found, scale, site_channels, blocks, needed):
        assert_close(image, expected, atol=300 * ULP * np.abs(expected).max())


def test_a_rectangle_gets_the_same_bits_as_the_whole(device: Device):
    grid = SimGrid(33, 46, 4, 2, 256, 16, (2, 1))
    scale, site_channels = camera(grid, 0.8)
    rects = [(0, 0, 8, 10), (14, 20, 7, 9), (30, 44, 3, 2)]
    check_rectangles(device, lambda *a: Direct(*a, support=6), scale, site_channels, rects)


def test_taps_take_the_memory_that_was_said(device: Device):
    grid = SimGrid(40, 40, 4, 2, 256, 16, (2, 2))
    scale, site_channels = camera(grid, 0.0)
    needed = {block: 1 + block[0] for block in np.ndindex(grid.blocks)}
    stage = Direct(device, scale, needed, 1.4, site_channels[:4], support=6)
    said = stage.load_bytes(needed)
    stage.load(needed)
    assert stage.held_bytes == said > 0 == stage.missing_bytes(needed)
    assert stage.made == len(stage.nodes) == 9
    # One block of two planes takes four nodes, each as large as the largest here.
    most = max(size_class(node.nbytes) for node in stage.nodes.values())
    assert stage.block_bytes(2) == 4 * most
    stage.release()
    rec = Recording(device)
    assert stage.scratch_bytes(2) == size_class(stage.scratch(rec, 2).planes.nbytes)


def test_the_support_is_the_smallest_that_keeps_the_error():
    """The predicted error is that of an edge through the photosite, of taps cut by hand."""
    grid = SimGrid(40, 40, 4, 2, 256, 16, (1, 1))
    scale, _ = camera(grid, 0.0)
    options = {"oversampling": 2, "aperture_um": 1.4, "sigma": 0.0}
    arguments = (scale.kernels, scale.pitch_um, 16.0, (100.0, 80.0))
    supports = [support_within(*arguments, allowed, **options) for allowed in (1e-2, 1e-3, 1e-4)]
    assert all(error <= 10.0**-n for n, (_, error) in enumerate(supports, start=2))
    sizes = [support for support, _ in supports]
    assert sizes == sorted(set(sizes))
    # One sample less keeps less than was allowed: asked for a little more than each error.
    for support, error in supports:
        assert support_within(*arguments, error * 1.001, **options)[0] == support
        assert support_within(*arguments, error * 0.999, **options)[0] > support


def test_what_is_out_of_reach_is_said(device: Device):
    with pytest.raises(ValueError, match="support of 15"):
        stage_for(device, SimGrid(20, 24, 4, 2, 256, 12, (1, 1)), [0, 1, 1, 2], 15)
    scale, _ = camera(SimGrid(40, 40, 4, 2, 256, 16, (1, 1)), 0.0)
    options = {"oversampling": 2, "aperture_um": 1.4, "sigma": 0.0}
    support, error = support_within(
        scale.kernels, scale.pitch_um, 4.0, (100.0, 80.0), 1e-12, **options
    )
    assert error > 1e-12 and support > 10


def test_work_counts_the_taps_of_all_photosites():
    grid = SimGrid(248, 248, 4, 2, 512, 88, (2, 2))
    needed = {block: 1 + block[0] for block in np.ndindex(grid.blocks)}
    work = direct_work(grid, 8, needed, [0, 1, 1, 2])
    # Each line of a block meets 16 / 4 lines of photosites of 2 rows of sites; 128 photosites of
    # 2 columns of sites across, eight by eight; 5 vec4f of taps; 2 for the nodes.
    assert work == 336 * 4 * 2 * 128 * 2 * 20 * 2 * sum(needed.values())


def test_the_defaults_are_of_one_grid(device: Device):
    stage = stage_for(device, DEFAULT_GRID, [0, 1, 1, 2], 8)
    assert Kernel("optics/direct").overrides == stage.kernel.overrides


def test_taps_lie_where_the_shader_looks(device: Device):
    """One tap of one kernel: its place in the packed lines, worked out by hand."""
    grid = SimGrid(20, 24, 4, 2, 256, 16, (1, 1))
    outputs = Outputs([(0, 0.5, 0.5)], 2, [0, 0, 0, 0])
    layout = tap_layout(grid, 3, outputs)
    assert (layout.low, layout.high, layout.lines) == (-3, 2, 6)
    taps = np.zeros((1, 1, 6, 6))
    taps[0, 0, 1, 2] = 1.0  # d_y = -2, d_x = -1
    packed = packed_taps(taps, layout, 2, outputs.of_site)
    # Line 2 + 2; the first vec4f begins at -4: places at 0 and 2 find d_x = -1 at 1 and 3.
    assert packed.shape == (1, 2, 1, 6, 3, 2, 4)
    found = np.argwhere(packed)
    assert found.tolist() == [
        [0, row, 0, 4, place // 4 + 1, column, place % 4]
        for row in (0, 1)
        for column, place in ((0, 1), (1, 3))
    ]

"""Warp: against SciPy's cubic splines, down to rasters of one sample, at borders and the rim.

Tolerance. The point u = centre + scale (x + x d): x + x d is off by 20 roundings at most, of |x|
and twice the largest coefficient (see test_distortion), and four follow, of |u| + |centre|. The
spline's gradient is at most 1.5 C along each axis, C the largest |coefficient| (sum |beta3'| <=
1.5). Sixteen products with weights of some 8 roundings each: 4 + 4 + 8 + 8 = 24 of C.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import DEFAULT_GRID, ULP, bank, bent, pieces_of, shader_terms
from scipy.ndimage import map_coordinates, spline_filter

from gpusim.gpu import Device, Kernel, Recording
from gpusim.optics.chief_ray import FIT_ERROR_UM, chief_ray_map, radial_map
from gpusim.optics.convolve import Scale
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels
from gpusim.optics.warp import PLANES, SIDE, Warp, is_identity, low_pass, sharing, stretch
from gpusim.psf.places import Heights
from gpusim.reference.chief_ray import chief_ray
from gpusim.reference.warp import warp
from gpusim.scene.raster import Raster

F32 = np.float32
NO_KERNELS = FieldKernels(np.zeros((3, 2, 1, 4, 4), F32), Heights(np.array([0.0, 1.0])), 0.5)
IDENTITY = np.zeros((1, 4))
BENT = pieces_of([1.05, -0.1, 0.06, -0.05, 0.04, -0.03, 0.02, -0.01])
STRAIGHT_MAP = radial_map(lambda r: r, 400.0)


ONE_POINT = np.ones(1)


def raster(rows: int, cols: int) -> np.ndarray:
    return np.random.default_rng(rows * 100 + cols).uniform(0, 1, (rows, cols))


def on_device(
    samples, origin, shape, centre, scale, distortion, radius, circle=(0.0, 0.0), plane=0, count=1,
    weights=ONE_POINT, step=1.0, side=2, others=(),
):  # fmt: skip
    """Run the stage; `others` are rasters of further planes. What is not to be read is NaN."""
    general = distortion.ndim == 3
    squeezed = len(weights) > 1
    given = [spline_filter(one, order=3, mode="mirror").astype(F32) for one in (samples, *others)]
    given += [np.full(samples.shape, np.nan, F32)] * (3 - len(given))
    each = 1 if squeezed else side
    invocations = math.prod(-(-size // each) for size in shape)
    params = {
        "circle": circle,
        "origin": origin,
        "centre": centre,
        "size": samples.shape[::-1],
        "first": (0, 0),
        "cols": samples.shape[1],
        "inverse_radius2": radius**-2,
        "pieces": len(distortion) - 3 if general else len(distortion),
        "scale": scale,
        "plane": plane,
        "reach": len(weights) // 2,
        "step": step,
    }
    result = run_stage(
        "optics/warp",
        (-(-invocations // 64), 1, 1),
        params,
        {
            "coefficients": given[0],
            "coefficients_1": given[1],
            "coefficients_2": given[2],
            "terms": shader_terms(distortion),
            "weights": np.append(weights, 0).astype(F32),
        },
        {"planes": ((count, *shape), F32)},
        BX=shape[1],
        BY=shape[0],
        AXIS=not general,
        SQUEEZED=squeezed,
        SIDE=2 if squeezed else side,
        PLANES=1 + len(others),
    )
    return result["planes"]


def reference(
    samples, origin, shape, centre, scale, distortion, radius, circle=(0.0, 0.0), **given
) -> np.ndarray:
    given |= {"distortion": distortion, "radius": radius, "circle": circle}
    return warp(samples, origin, shape, centre, scale, **given)


def bound(samples, origin, shape, centre, scale, distortion) -> float:
    """Return the tolerance of the header, at its largest over the block, with r2 <= 1."""
    largest = np.abs(spline_filter(samples, order=3, mode="mirror")).max()
    reach = np.abs(np.array(origin)) + np.array(shape[::-1])
    amount = scale * reach.max() * (1 + 2 * np.abs(distortion).max())
    return float(largest * ULP * (2 * 1.5 * (24 * amount + 4 * np.abs(centre).max()) + 24))


@pytest.mark.parametrize(
    "case",
    [
        (4, (23, 31), (-20.5, -13.5), (37, 45), (14.3, 10.6), 0.37, BENT, 40.0),
        (3, (23, 31), (-20.5, -13.5), (37, 45), (14.3, 10.6), 0.7, BENT, 40.0),
        (2, (23, 31), (3.5, -30.5), (16, 17), (14.3, 10.6), 0.9, BENT, 40.0),
        (2, (9, 14), (-21.5, -14.5), (30, 43), (6.5, 4.0), 1.0, IDENTITY, 1000.0),
        (1, (23, 31), (-3.5, -3.5), (7, 9), (14.3, 10.6), 2.9, BENT, 40.0),
    ],
    ids=["bent", "bent more", "beyond the rim", "beyond the raster", "one a patch"],
)
def test_samples_are_those_of_the_reference(case):
    side, size, *place = case
    samples = raster(*size)
    found = on_device(samples, *place, side=side)[0]
    expected = reference(samples, *place)
    assert_close(found, expected, atol=bound(samples, *place[:5]))
    # Control: where twice as many share a patch, they do not all find in it what they read.
    crowded = on_device(samples, *place, side=2 * side)[0]
    assert np.abs(crowded - expected).max() > 0.01


@pytest.mark.parametrize("scale", [0.2, 0.41, 0.54, 0.56, 0.8, 1.0, 1.5])
@pytest.mark.parametrize("squash", [0.0, 0.4, 1.0])
def test_points_that_share_a_patch_lie_within_one_of_their_middle(scale: float, squash: float):
    """Maps stretch by `scale` along a direction, and by a share of it across."""
    side = sharing(scale)
    assert side == (4 if scale <= 0.55 else 3 if scale <= 0.825 else 2)
    at = np.stack(np.meshgrid(*2 * [np.arange(side) - (side - 1) / 2]), axis=-1)
    angle = np.linspace(0, np.pi, 181)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    stretched = np.einsum("ak,al->akl", along, along) * (1 - squash) + squash * np.eye(2)
    farthest = np.abs(scale * np.einsum("akl,yxl->ayxk", stretched, at)).max()
    assert farthest <= 1
    assert side == SIDE or farthest * side / (side - 1) > 0.75  # few more would fit


@pytest.mark.parametrize("count", [2, 3])
def test_planes_that_are_made_at_once_are_apart(count: int):
    """They share places and weights, also those of a sum over points, and nothing else."""
    each = np.random.default_rng(count).uniform(0, 1, (count, 23, 31))
    place = ((-20.5, -13.5), (19, 22), (14.3, 10.6), 0.37, BENT, 40.0)
    for weights, step in ((ONE_POINT, 1.0), (np.array([-0.25, 0.5, 0.75]), 0.5)):
        given = {"weights": weights, "step": step}
        found = on_device(each[0], *place, **given, plane=1, count=count + 2, others=each[1:])
        assert unwritten(found[[0, -1]]).all()
        for one, samples in zip(found[1:-1], each, strict=True):
            expected = reference(samples, *place, **given)
            # As below: a step of 4 roundings each way, and nine weighted sums.
            allowed = 1.3 * bound(samples, *place[:5]) * np.abs(weights).sum() ** 2
            assert_close(one, expected, atol=allowed + 9 * ULP * np.abs(expected).max())


@pytest.mark.parametrize("cells", [1, 2, 5, 16])
def test_a_lens_without_an_axis_has_a_map_in_both_coordinates(cells: int):
    """Its image circle has a centre of its own, and cuts the block."""
    samples, radius, circle = raster(23, 31), 20.0, (3.3, -4.2)
    terms = bent(cells, cells, radius)
    place = ((-20.5, -13.5), (37, 45), (14.3, 10.6), 0.37, terms, radius, circle)
    found = on_device(samples, *place)[0]
    expected = reference(samples, *place)
    # Forty roundings of the net, at most 0.1 radii, and of a place in it where that changes by 0.3
    # radii; four of u.
    off = ULP * ((40 * 0.4 + 4) * radius * 0.37 + 4 * 14.3)
    largest = np.abs(spline_filter(samples, order=3, mode="mirror")).max()
    assert_close(found, expected, atol=largest * (2 * 1.5 * off + 24 * ULP))
    assert 0.2 < np.mean(expected == 0) < 0.9
    # Controls: the terms of x and y, and what they give, told apart.
    for wrong in (terms.swapaxes(0, 1), terms[..., ::-1]):
        assert np.abs(reference(samples, *place[:4], wrong, *place[5:]) - expected).max() > 0.01


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 1), (1, 9), (7, 1), (2, 2), (3, 4)])
def test_rasters_of_few_samples(size: tuple[int, int]):
    samples = raster(*size)
    place = ((-7.5, -5.5), (12, 17), ((size[1] - 1) / 2, (size[0] - 1) / 2), 0.77, IDENTITY)
    found = on_device(samples, *place, 1000.0)[0]
    assert_close(found, reference(samples, *place, 1000.0), atol=bound(samples, *place))


def test_at_its_samples_the_spline_is_the_raster():
    samples = raster(16, 19)
    place = ((0.0, 0.0), samples.shape, (0.0, 0.0), 1.0, IDENTITY)
    assert_close(on_device(samples, *place, 1000.0)[0], samples, atol=bound(samples, *place))


def test_the_image_circle_belongs_to_the_image_and_beyond_is_black():
    """Radius 16, samples at whole numbers: (16, 0) lies on the circle, (16, 1) 0.2 % beyond."""
    found = on_device(np.ones((4, 4)), (0.0, 0.0), (19, 20), (1.5, 1.5), 0.1, IDENTITY, 16.0)[0]
    y, x = np.mgrid[:19, :20]
    assert_close(found, (x**2 + y**2 <= 256).astype(float), atol=24 * ULP)
    assert found[0, 16] > 0 and found[1, 16] == 0


def test_one_plane_of_several_is_written():
    samples = raster(5, 6)
    place = ((-2.5, -2.5), (9, 20), (2.5, 2.0), 0.5, IDENTITY)
    found = on_device(samples, *place, 1000.0, plane=1, count=3)
    assert unwritten(found[[0, 2]]).all()
    assert_close(found[1], reference(samples, *place, 1000.0), atol=bound(samples, *place))


@pytest.mark.parametrize("count", [1, 2, 4])
def test_the_host_places_the_raster(device: Device, count: int):
    """Warp against the spline of its own coefficients, sampled through the bank's map, in um."""
    lens = bank()
    chief_ray = chief_ray_map(lens)
    planes = np.random.default_rng(5).uniform(0.4, 1, (2, 12, 16)).astype(F32)
    grid = SimGrid(24, 32, 4, 2, 256, 20, (1, 2))
    pitch_um = 0.775
    placed = Raster(planes).placed(32 * 0.775, 24 * 0.775, pitch_um)
    # Four are more than are made at once.
    coefficients = np.array([[1.0, 0.5, -2.0, 0.0], [0.25, -1.0, 0.3, 1.5]])[:, :count]
    stage = Warp(
        device, placed, coefficients, Scale("test", grid, pitch_um, 0.0, NO_KERNELS), chief_ray
    )
    assert stage.needed == dict.fromkeys(np.ndindex(grid.blocks), count)
    block = (0, 1)
    stage.load([block])
    rec = Recording(device)
    out = rec.buffer("planes", (count, grid.block[1], grid.block[0]), F32)
    rec.clear(out)
    stage.record(rec, block, out)
    label = rec.download(out)
    found = rec.run()[label]
    stage.release()
    x0, y0 = np.array(grid.block_origin(block)) - grid.centre
    y, x = np.mgrid[: grid.block[1], : grid.block[0]]
    x_um, y_um = (x + 0.5 + x0) * pitch_um, (y + 0.5 + y0) * pitch_um
    height = np.hypot(x_um, y_um)
    scale = lens.ideal_from_real(height)[0] / height
    cols = (x_um * scale - placed.x0_um) / placed.pitch_um - 0.5
    rows = (y_um * scale - placed.y0_um) / placed.pitch_um - 0.5
    splines = np.tensordot(coefficients.T, placed.spline_coefficients().astype(float), axes=1)
    expected = np.stack(
        [
            map_coordinates(
                plane,
                [rows.clip(0, plane.shape[0] - 1), cols.clip(0, plane.shape[1] - 1)],
                order=3,
                prefilter=False,
                mode="mirror",
            )
            for plane in splines
        ]
    )
    # The polynomial is within FIT_ERROR_UM of the bank's map; f32 adds 1e-4 raster samples at most.
    off = FIT_ERROR_UM / placed.pitch_um + 1e-4
    assert_close(found, expected, atol=2 * 1.5 * off * np.abs(splines).max())


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 1)])
def test_a_raster_of_one_row_or_column_is_loaded_whole(device: Device, size: tuple[int, int]):
    placed = Raster(np.full((1, *size), 0.5, F32)).placed(16 * 1.55, 16 * 1.55, 0.775)
    grid = SimGrid(32, 32, 4, 2, 256, 40, (1, 1))
    scale = Scale("test", grid, 0.775, 0.0, NO_KERNELS)
    stage = Warp(device, placed, np.eye(1), scale, chief_ray_map(bank()))
    stage.load([(0, 0)])
    rec = Recording(device)
    out = rec.buffer("planes", (1, grid.block[1], grid.block[0]), F32)
    stage.record(rec, (0, 0), out)
    label = rec.download(out)
    assert_close(rec.run()[label], np.full(out.shape, 0.5), atol=24 * ULP)
    assert stage.loaded == (range(size[1]), range(size[0]))
    stage.release()


def test_a_block_sees_the_same_whatever_else_is_loaded(device: Device):
    """What is brought for one block holds all that it reads, to the bit, also at borders."""
    lens = bank(distortion=-0.1)
    planes = np.random.default_rng(8).uniform(0.4, 1, (1, 90, 130)).astype(F32)
    grid = SimGrid(96, 128, 4, 2, 256, 104, (3, 2))  # blocks of 48 samples, well beyond the sensor
    placed = Raster(planes).placed(64 * 1.55, 48 * 1.55, 0.775)
    scale = Scale("test", grid, 0.775, 0.0, NO_KERNELS)
    stage = Warp(device, placed, np.eye(1), scale, chief_ray_map(lens))
    blocks = list(np.ndindex(grid.blocks))

    def at(block: tuple[int, int]) -> np.ndarray:
        rec = Recording(device)
        out = rec.buffer("planes", (1, grid.block[1], grid.block[0]), F32)
        stage.record(rec, block, out)
        label = rec.download(out)
        return rec.run()[label]

    stage.load(blocks)
    assert stage.loaded == (range(130), range(90))
    assert stage.load_bytes(blocks) == 49152  # 46800 bytes, in a buffer of 1.5 x 2^15
    whole = {block: at(block) for block in blocks}
    sizes = set()
    for block in blocks:
        stage.load([block])
        sizes.add(tuple(map(len, stage.loaded)))
        assert_close(at(block), whole[block], atol=0)
    # 48 samples of 0.775 um are 24 of the raster's, and four around them; at the border fewer.
    assert max(size[0] for size in sizes) < 50 and len(sizes) > 3
    stage.release()


def test_a_sum_over_points_is_that_of_the_reference():
    samples = raster(23, 31)
    place = ((-20.5, -13.5), (21, 25), (14.3, 10.6), 0.37, BENT, 40.0)
    weights = np.array([-0.25, 0.5, 0.75, 0.375, -0.375])  # lopsided: none is taken for another
    found = on_device(samples, *place, weights=weights, step=0.625)[0]
    expected = reference(samples, *place, weights=weights, step=0.625)
    # One more step of 4 roundings each way, and 25 weighted sums.
    allowed = bound(samples, *place[:5]) * np.abs(weights).sum() ** 2
    assert_close(found, expected, atol=1.3 * allowed + 25 * ULP * np.abs(expected).max())
    turned = on_device(samples, *place, weights=weights[::-1].copy(), step=0.625)[0]
    assert np.abs(turned - expected).max() > 0.05


# An equidistant fisheye of 57 deg, R = f = 400 sim samples: real r = f theta against f tan(theta),
# 36 % of barrel. At its edge a step in r is 1 / cos^2 = 3.4 ideal steps, one along the rim 1.56.
BARREL_MAP = radial_map(lambda r: 400 * np.tan(r / 400), 400.0)


def squeezed_wave(cycles: float, weights: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a wave of the ideal plane as warped near the right edge, and as it is there."""
    x = np.arange(356.0, 390.0)
    k = np.arange(1261) - 630
    wave = 1 + 0.5 * np.cos(2 * np.pi * cycles * k + 0.4)
    samples = np.broadcast_to(wave, (9, 1261)).copy()
    place = ((x[0], -1.0), (3, len(x)), (630.0, 4.0), 1.0, BARREL_MAP.pieces, 400.0)
    side = 2 if points > 1 else 1
    found = on_device(samples, *place, weights=weights, step=1 / points, side=side)[0, 1]
    u = 400 * np.tan(x / 400)
    return found - 1, 0.5 * np.cos(2 * np.pi * cycles * u + 0.4)


@pytest.mark.parametrize("real_cycles", [0.05, 0.15, 0.22])
def test_where_the_raster_is_squeezed_what_pixels_see_keeps_its_contrast(real_cycles: float):
    # Near x = 373 a step is sec(373 / 400)^2 = 2.8 of the raster's; over the block 2.5 to 3.2, and
    # the frequency varies with it: up to 0.25 at the far end.
    found, exact = squeezed_wave(real_cycles / 2.8, low_pass(3), 3)
    # 1.7e-3 of the passband, 1e-4 of the spline, and what the frequency changes over 5 samples.
    assert np.abs(found - exact).max() < 0.5 * 4e-3
    # With no low-pass it is as good: contrast is not what it is for.
    assert np.abs(squeezed_wave(real_cycles / 2.8, np.ones(1), 1)[0] - exact).max() < 0.5 * 2e-3


@pytest.mark.parametrize("cycles", [0.33, 0.36, 0.4, 0.45])
def test_where_the_raster_is_squeezed_finer_detail_does_not_come_back(cycles: float):
    # 0.92 to 1.26 cycles per sim sample in the middle, 0.82 at least.
    found, _ = squeezed_wave(cycles, low_pass(3), 3)
    assert np.abs(found).max() < 0.5 * 0.06
    aliased, _ = squeezed_wave(cycles, np.ones(1), 1)
    assert np.abs(aliased).max() > 0.5 * 0.6


@pytest.mark.parametrize("points", [2, 3, 4, 6])
def test_the_low_pass_passes_and_stops_what_it_must(points: int):
    weights = low_pass(points)
    at = (np.arange(len(weights)) - len(weights) // 2) / points
    np.testing.assert_array_equal(weights, weights[::-1])
    f = np.linspace(0, points / 2, 2001)
    gain = np.cos(2 * np.pi * np.outer(f, at)) @ weights
    assert np.abs(gain[f <= 0.25] - 1).max() < 2e-3
    assert np.abs(gain[f >= 0.75]).max() < 0.065
    assert gain[0] == pytest.approx(1, abs=1e-12)


def test_only_blocks_that_are_squeezed_have_a_low_pass(device: Device):
    grid = SimGrid(192, 256, 4, 2, 128, 20, (1, 2))
    placed = Raster(np.ones((1, 384, 512), F32)).placed(256.0, 192.0, 1.0)
    scale = Scale("test", grid, 1.0, 0.0, NO_KERNELS)
    straight = Warp(device, placed, np.ones((1, 1)), scale, STRAIGHT_MAP)
    assert set(straight.points.values()) == {1}
    barrel = Warp(device, placed, np.ones((1, 1)), scale, BARREL_MAP)
    across = [barrel.points[x, grid.blocks[1] // 2] for x in range(grid.blocks[0])]
    assert min(across[0], across[-1]) >= 2
    assert across[len(across) // 2] == 1
    assert barrel.points[0, 0] >= across[0]  # the corner is farther out
    # A raster of half as many samples is not fine enough to need any.
    coarse = Raster(np.ones((1, 192, 256), F32)).placed(256.0, 192.0, 1.0)
    relaxed = Warp(device, coarse, np.ones((1, 1)), scale, BARREL_MAP)
    assert relaxed.points[grid.blocks[0] // 2, grid.blocks[1] // 2] == 1
    for stage in (straight, barrel, relaxed):
        stage.release()


def test_points_of_the_low_pass_lie_close_enough_to_share_a_patch(device: Device):
    grid = SimGrid(192, 256, 4, 2, 128, 20, (1, 2))
    placed = Raster(np.ones((1, 384, 512), F32)).placed(256.0, 192.0, 1.0)
    scale = Scale("test", grid, 1.0, 0.0, NO_KERNELS)
    # 276 off, where the blocks end, a step along the radius is 1 + 21 (276 / 280)^2 = 21.4.
    steep = Warp(
        device, placed, np.ones((1, 1)), scale, radial_map(lambda r: r + 7 * r**3 / 280**2, 280.0)
    )
    steep.release()
    assert steep.side == 2
    assert sharing(21.4 / steep.points[grid.blocks[0] - 1, grid.blocks[1] // 2]) == 2


def test_stretch_is_the_maps_derivative():
    at = np.array([[3.0, -8.0], [25.0, 20.0], [0.0, 0.0], [40.0, 1.0]])
    found = stretch(replace(STRAIGHT_MAP, pieces=BENT, radius_um=40.0), at, 1e-3)
    jacobian = chief_ray(at, BENT, 40.0)[1]
    # Columns: how far u moves with x and with y.
    np.testing.assert_allclose(found[:3], np.linalg.norm(jacobian, axis=-2)[:3], rtol=1e-6)
    np.testing.assert_array_equal(found[3], 0)  # beyond the circle


def test_coordinates_are_good_to_a_thousandth_of_a_pixel():
    # The far corner of 12 MP with two samples a pixel, 5070 samples off the axis, and a distortion
    # of 5 %. Coefficients that rise by 1 from sample to sample make u itself, but for the spline's
    # own rounding; around the block alone, so that what is rounded is small.
    radius = 5100.0
    distortion = pieces_of([1.0, 0.04, 0.01])
    cols = 9000
    for origin in ((4040.5, 3024.5), (-4056.5, 3024.5)):
        shape = (16, 16)
        x = origin[0] + np.arange(16)[None]
        y = origin[1] + np.arange(16)[:, None]
        lit = x**2 + y**2 <= radius**2
        g = np.polynomial.Polynomial([1.0, 0.04, 0.01])((x**2 + y**2) / radius**2)
        u = cols / 2 - 0.5 + x * g
        near = round(float(u.mean()))
        # Along columns of a raster of one row.
        ramp = (np.arange(cols) - near).clip(-400, 400).astype(float)[None]
        found = run_stage(
            "optics/warp",
            (1, 1, 1),
            {
                "circle": (0.0, 0.0),
                "origin": origin,
                "centre": (cols / 2 - 0.5, 0.0),
                "size": (cols, 1),
                "first": (0, 0),
                "cols": cols,
                "inverse_radius2": radius**-2,
                "pieces": len(distortion),
                "scale": 1.0,
                "plane": 0,
                "reach": 0,
                "step": 1.0,
            },
            {
                "coefficients": ramp.astype(F32),
                "coefficients_1": np.full((1, 1), np.nan, F32),
                "coefficients_2": np.full((1, 1), np.nan, F32),
                "terms": shader_terms(distortion),
                "weights": np.array([1, 0], F32),
            },
            {"planes": ((1, *shape), F32)},
            BX=16,
            BY=16,
            SIDE=2,
        )["planes"][0]
        off_samples = np.abs(found.astype(float) - (u - near))[lit]
        assert lit.sum() > 100
        # Two samples are a pixel.
        assert off_samples.max() / 2 < 1e-3
        assert off_samples.max() > 0  # it is rounded: the test can tell


def test_an_identity_is_exact_and_has_no_spline(device: Device):
    grid = SimGrid(24, 32, 4, 2, 256, 20, (2, 2))
    # Calm enough that the spline through the samples is nowhere negative.
    planes = np.random.default_rng(8).uniform(0.9, 1.1, (1, 48, 64)).astype(F32)
    placed = Raster(planes).placed(32 * 0.775, 24 * 0.775, 0.775)
    scale = Scale("test", grid, 0.775, 0.0, NO_KERNELS)
    straight = replace(STRAIGHT_MAP, radius_um=1000.0)
    for off in (0.0, 5e-5, -5e-5):  # of a sample: an identity to rounding
        near = replace(placed, x0_um=placed.x0_um + off * 0.775)
        stage = Warp(device, near, np.ones((1, 1)), scale, straight)
        assert stage.identity
        for block in ((0, 0), (1, 1)):
            stage.load([block])
            rec = Recording(device)
            out = rec.buffer("planes", (1, grid.block[1], grid.block[0]), F32)
            rec.clear(out)
            stage.record(rec, block, out)
            label = rec.download(out)
            # Around the sensor the raster's border goes on.
            cols, rows = (
                np.clip(int(first) + np.arange(count), 0, size - 1)
                for first, count, size in zip(
                    grid.block_origin(block), grid.block, (64, 48), strict=True
                )
            )
            np.testing.assert_array_equal(rec.run()[label][0], planes[0][np.ix_(rows, cols)])
        assert min(part.start for part in stage.loaded) > 0
        stage.release()
    # Half a sample off, another pitch, or any distortion to speak of is none.
    shifted = replace(placed, x0_um=placed.x0_um + 0.39)
    bent = radial_map(lambda r: 1.00001 * r, 1000.0)
    assert not is_identity(shifted, scale, straight)
    assert not is_identity(replace(placed, pitch_um=0.776), scale, straight)
    assert not is_identity(placed, scale, bent)


def test_what_a_squeezed_block_sees_is_all_there(device: Device):
    """To the bit, whatever else is loaded: the low-pass reaches beyond the block."""
    # Larger than the image, so that it ends beyond what the blocks see.
    planes = np.random.default_rng(9).uniform(0.4, 1, (1, 800, 1000)).astype(F32)
    grid = SimGrid(192, 256, 4, 2, 128, 20, (1, 2))
    placed = Raster(planes).placed(500.0, 400.0, 1.0)
    scale = Scale("test", grid, 1.0, 0.0, NO_KERNELS)
    barrel = replace(BARREL_MAP, radius_um=300.0)
    stage = Warp(device, placed, np.ones((1, 1)), scale, barrel)
    blocks = [(0, grid.blocks[1] // 2), (1, 1), (0, 0)]
    found = []
    for loaded in (list(np.ndindex(grid.blocks)), None):
        for block in blocks:
            stage.load(loaded or [block])
            rec = Recording(device)
            out = rec.buffer("planes", (1, grid.block[1], grid.block[0]), F32)
            stage.record(rec, block, out)
            label = rec.download(out)
            found.append(rec.run()[label])
    stage.release()
    assert stage.points[blocks[0]] > 1
    for whole, part in zip(found[:3], found[3:], strict=True):
        np.testing.assert_array_equal(part, whole)


def test_an_identity_keeps_what_the_spline_makes_of_a_highlight():
    planes = np.ones((1, 21, 21), F32)
    planes[0, 10, 10] = 1e5
    placed = Raster(planes).placed(10.5, 10.5, 1.0)
    coefficients = placed.spline_coefficients()
    found = placed.values(coefficients)[0]
    y, x = np.mgrid[:21, :21].astype(float)
    spline = map_coordinates(
        coefficients[0].astype(float), [y, x], order=3, prefilter=False, mode="mirror"
    )
    assert_close(found, spline, rtol=2e-5)
    assert abs(found[10, 10] / 1e5 - 1) > 0.1  # not the sample


def test_the_defaults_are_of_the_default_grid(device: Device):
    placed = Raster(np.ones((1, 4, 4), F32)).placed(100.0, 100.0, 1.0)
    scale = Scale("test", DEFAULT_GRID, 1.0, 0.0, NO_KERNELS)
    stage = Warp(device, placed, np.ones((1, 1)), scale, chief_ray_map(bank()))
    stage.release()
    assert Kernel("optics/warp").overrides == stage.kernels[1, False].overrides | {"SIDE": SIDE}
    assert stage.kernels[PLANES, True].workgroup_size == (64, 1, 1)


def test_black_and_unlit_blocks_need_no_plane(device: Device):
    """What a block is said not to need is black when it is computed; and some are needed."""
    chief_ray = chief_ray_map(bank(circle_um=50.0))
    planes = np.zeros((2, 96, 128), F32)
    planes[:, 40:44, 30:34] = 1.0
    grid = SimGrid(96, 128, 4, 2, 256, 20, (4, 4))
    placed = Raster(planes).placed(64 * 0.775, 48 * 0.775, 0.3875)
    scale = Scale("test", grid, 0.3875, 0.0, NO_KERNELS)
    stage = Warp(device, placed, np.eye(2), scale, chief_ray)
    found = {}
    for block in stage.needed:
        rec = Recording(device)
        out = rec.buffer("planes", (2, grid.block[1], grid.block[0]), F32)
        rec.clear(out)
        stage.load([block])
        stage.record(rec, block, out)
        label = rec.download(out)
        found[block] = np.abs(rec.run()[label]).max()
    stage.release()
    assert set(stage.needed.values()) == {0, 2}
    assert max(found[block] for block, count in stage.needed.items() if not count) < 1e-9
    assert max(found.values()) > 0.5

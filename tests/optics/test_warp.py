"""Warp: against SciPy's cubic splines, down to rasters of one sample, at borders and the rim.

Tolerance. The point u = centre + scale x g: g is off by 20 roundings of sum |c_k| r2^k (see
test_distortion), and four follow, of at most |scale x| sum |c_k| r2^k and of |u| + |centre|. The
spline's gradient is at most 1.5 C along each axis, C the largest |coefficient| (sum |beta3'| <=
1.5). Sixteen products with weights of some 8 roundings each: 4 + 4 + 8 + 8 = 24 of C.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import DEFAULT_GRID, ULP, bank, bent, shader_terms
from scipy.ndimage import map_coordinates, spline_filter

from gpusim.gpu import Device, Kernel, Recording
from gpusim.lens.places import Heights
from gpusim.optics.chief_ray import FIT_ERROR_UM, chief_ray_map
from gpusim.optics.convolve import Scale
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels
from gpusim.optics.warp import Warp
from gpusim.reference.warp import warp
from gpusim.scene.raster import Raster

F32 = np.float32
NO_KERNELS = FieldKernels(np.zeros((2, 2, 1, 4, 4), F32), Heights(np.array([0.0, 1.0])), 0.5)
IDENTITY = np.eye(8)[0]
BENT = np.array([1.05, -0.1, 0.06, -0.05, 0.04, -0.03, 0.02, -0.01], F32).astype(float)


def raster(rows: int, cols: int) -> np.ndarray:
    return np.random.default_rng(rows * 100 + cols).uniform(0, 1, (rows, cols))


def on_device(
    samples, origin, shape, centre, scale, distortion, radius, circle=(0.0, 0.0), plane=0, count=1
):
    general = distortion.ndim == 3
    params = {
        "g_low": np.full(4, 9.0) if general else distortion[:4],
        "g_high": np.full(4, 9.0) if general else distortion[4:],
        "circle": circle,
        "origin": origin,
        "centre": centre,
        "size": samples.shape[::-1],
        "first": (0, 0),
        "cols": samples.shape[1],
        "inverse_radius2": radius**-2,
        "scale": scale,
        "plane": plane,
    }
    result = run_stage(
        "optics/warp",
        (-(-shape[1] // 16), -(-shape[0] // 16), 1),
        params,
        {
            "coefficients": spline_filter(samples, order=3, mode="mirror").astype(F32),
            "terms": shader_terms(distortion) if general else np.full((1, 2), np.nan, F32),
        },
        {"planes": ((count, *shape), F32)},
        BX=shape[1],
        BY=shape[0],
        DEGREE=len(distortion) - 1 if general else 0,
    )
    return result["planes"]


def bound(samples, origin, shape, centre, scale, distortion) -> float:
    """Return the tolerance of the header, at its largest over the block, with r2 <= 1."""
    largest = np.abs(spline_filter(samples, order=3, mode="mirror")).max()
    reach = np.abs(np.array(origin)) + np.array(shape[::-1])
    amount = scale * reach.max() * np.abs(distortion).sum()
    return float(largest * ULP * (2 * 1.5 * (24 * amount + 4 * np.abs(centre).max()) + 24))


@pytest.mark.parametrize(
    "case",
    [
        ((23, 31), (-20.5, -13.5), (37, 45), (14.3, 10.6), 0.37, BENT, 40.0),
        ((23, 31), (3.5, -30.5), (16, 17), (14.3, 10.6), 0.9, BENT, 40.0),
        ((9, 14), (-21.5, -14.5), (30, 43), (6.5, 4.0), 1.0, IDENTITY, 1000.0),
    ],
    ids=["bent", "beyond the rim", "beyond the raster"],
)
def test_samples_are_those_of_the_reference(case):
    size, *place = case
    samples = raster(*size)
    found = on_device(samples, *place)[0]
    assert_close(found, warp(samples, *place), atol=bound(samples, *place[:5]))


@pytest.mark.parametrize("degree", [1, 2, 5, 11])
def test_a_lens_without_an_axis_has_a_map_in_both_coordinates(degree: int):
    """Its image circle has a centre of its own, and cuts the block."""
    samples, radius, circle = raster(23, 31), 20.0, (3.3, -4.2)
    terms = bent(degree, degree, radius).astype(F32).astype(float)
    place = ((-20.5, -13.5), (37, 45), (14.3, 10.6), 0.37, terms, radius, circle)
    found = on_device(samples, *place)[0]
    expected = warp(samples, *place)
    # Two roundings for each term on its way, of all terms together at most 1.1 radii; |z| <= 1.
    steps = (degree + 1) * (degree + 2)
    off = ULP * (steps * 1.1 * radius * 0.37 + 4 * 14.3)
    largest = np.abs(spline_filter(samples, order=3, mode="mirror")).max()
    assert_close(found, expected, atol=largest * (2 * 1.5 * off + 24 * ULP))
    assert 0.2 < np.mean(expected == 0) < 0.9
    # Controls: the terms of x and y, and what they give, told apart.
    for wrong in (terms.swapaxes(0, 1), terms[..., ::-1]):
        assert np.abs(warp(samples, *place[:4], wrong, *place[5:]) - expected).max() > 0.01


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 1), (1, 9), (7, 1), (2, 2), (3, 4)])
def test_rasters_of_few_samples(size: tuple[int, int]):
    samples = raster(*size)
    place = ((-7.5, -5.5), (12, 17), ((size[1] - 1) / 2, (size[0] - 1) / 2), 0.77, IDENTITY)
    found = on_device(samples, *place, 1000.0)[0]
    assert_close(found, warp(samples, *place, 1000.0), atol=bound(samples, *place))


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
    assert_close(found[1], warp(samples, *place, 1000.0), atol=bound(samples, *place))


def test_the_host_places_the_raster(device: Device):
    """Warp against the spline of its own coefficients, sampled through the bank's map, in um."""
    lens = bank()
    chief_ray = chief_ray_map(lens)
    planes = np.random.default_rng(5).uniform(0.4, 1, (2, 12, 16)).astype(F32)
    grid = SimGrid(24, 32, 4, 2, 256, 20, (1, 2))
    pitch_um = 0.775
    placed = Raster(planes).placed(32 * 0.775, 24 * 0.775, pitch_um)
    coefficients = np.array([[1.0, 0.5], [0.25, -1.0]])
    stage = Warp(
        device, placed, coefficients, Scale("test", grid, pitch_um, 0.0, NO_KERNELS), chief_ray
    )
    assert stage.needed == dict.fromkeys(np.ndindex(grid.blocks), 2)
    block = (0, 1)
    stage.load([block])
    rec = Recording(device)
    out = rec.buffer("planes", (2, grid.block[1], grid.block[0]), F32)
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


def test_the_defaults_are_of_the_default_grid(device: Device):
    placed = Raster(np.ones((1, 4, 4), F32)).placed(100.0, 100.0, 1.0)
    scale = Scale("test", DEFAULT_GRID, 1.0, 0.0, NO_KERNELS)
    stage = Warp(device, placed, np.ones((1, 1)), scale, chief_ray_map(bank()))
    stage.release()
    assert Kernel("optics/warp").overrides == stage.kernel.overrides
    assert stage.kernel.workgroup_size == (16, 16, 1)

"""Paint: against convolution with the Gaussian, shape by shape, in float64.

Tolerance of a weight. Phi is good to 1e-6 (see test_normal), four times for a rectangle. The
distance to an edge is off by 30 roundings of the position, |u| at most 200 samples (24 of the map,
see test_distortion; the difference from the centre, the dot product): 4e-4 samples, over a Gaussian
of at least 0.7 samples with a density of 0.4: 2.1e-4, twice where two edges meet. The width takes
some 40 roundings: nothing beside it. WEIGHT = 5e-4. A disc of 16 s or more: the shader's first-
order term leaves 0.07 (s/R)^2 of the Gaussian's integral besides, 3e-4 at most. A smaller one is
cut into strips, which leave 3e-6.
Weights act on differences of materials, and at most two shapes have an edge at one place.
"""

from itertools import pairwise

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import DEFAULT_GRID, bank, bent, pieces_of, scene, shader_terms, shapes
from scipy.special import i0e, ndtr

from gpusim.gpu import Device, Kernel, Recording
from gpusim.optics.chief_ray import chief_ray_map
from gpusim.optics.convolve import Scale
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels
from gpusim.optics.paint import (
    SIGMA,
    Paint,
    primitives_by_block,
    tiles_by_block,
)
from gpusim.optics.paint_table import DISC_KIND, PRIMITIVE, SMALL_DISC, table_of, with_steps
from gpusim.psf.places import Heights
from gpusim.reference.chief_ray import chief_ray as chief_ray_twin
from gpusim.reference.paint import disc_coverage, paint
from gpusim.scene.chart import Chart, Disc, Polygon, Primitive, Rect, materials_under

F32 = np.float32
WEIGHT = 5e-4
IDENTITY = np.zeros((1, 4))
BENT = pieces_of([1.05, -0.1, 0.06, -0.05, 0.04, -0.03, 0.02, -0.01])
NO_KERNELS = FieldKernels(np.zeros((3, 1, 3, 4, 4), F32), Heights(np.array([0.0, 1.0])), 0.5)


def materials(count: int, planes: int) -> np.ndarray:
    """Return coefficients from -1 to 1, as the reduced basis has them."""
    return np.random.default_rng(9).uniform(-1, 1, (count, planes)).astype(F32).astype(float)


def on_device(
    shapes: list[Primitive],
    table: np.ndarray,
    origin: tuple[float, float],
    shape: tuple[int, int],
    background: int = 0,
    sigma: float = 0.8,
    distortion: np.ndarray = IDENTITY,
    radius: float = 1e4,
    circle: tuple[float, float] = (0.0, 0.0),
    needed: int | None = None,
    least_stretch: float = 1.0,
) -> np.ndarray:
    """Paint shapes in the order given; in the table they lie in another order, among others.

    Every tile has all shapes, and needs all planes or as many as said.
    """
    rng = np.random.default_rng(len(shapes))
    place = rng.permutation(len(shapes) + 3)[: len(shapes)]
    under = materials_under(shapes, background)
    coefficients, steps = with_steps(table, [one.material for one in shapes], under)
    rows = np.zeros(len(shapes) + 3, PRIMITIVE)
    rows["half_size"] = rows["axis"] = np.nan  # of those that the block does not see
    made, corners = table_of(shapes, steps, 1.0, sigma, least_stretch)
    for at, row in zip(place, made, strict=False):
        rows[at] = row
        if rows[at]["kind"] == DISC_KIND:
            rows[at]["half_size"][1] = np.nan
    eight = np.full((len(coefficients), 8), np.nan, F32)
    eight[:, : table.shape[1]] = coefficients
    planes = table.shape[1]
    general = distortion.ndim == 3
    tiles = [
        (x + 65536 * y, 5, len(shapes), background + 65536 * (needed or planes))
        for y in range(0, shape[0], 16)
        for x in range(0, shape[1], 16)
    ]
    result = run_stage(
        "optics/paint",
        (len(tiles), 1, 1),
        {
            "circle": circle,
            "origin": origin,
            "inverse_radius2": radius**-2,
            "pieces": len(distortion) - 3 if general else len(distortion),
            "sigma": sigma,
            "first": 2,
            "plane": 0,
        },
        {
            "primitives": rows.view(np.uint32),
            "corners": corners,
            "chosen": np.concatenate([np.full(5, 999), place, [998]]).astype(np.uint32),
            "materials": eight,
            "tiles": np.array([(999, 0, 0, 0), (999, 0, 0, 0), *tiles], np.uint32),
            "terms": shader_terms(distortion),
        },
        {"planes": (planes * shape[0] * shape[1] + 400, F32)},
        BX=shape[1],
        BY=shape[0],
        J=planes,
        AXIS=not general,
    )["planes"]
    assert unwritten(result[-400:]).all()
    return result[:-400].reshape(-1, *shape)


def reference(
    shapes,
    table,
    origin,
    shape,
    background=0,
    sigma=0.8,
    distortion=IDENTITY,
    radius=1e4,
    circle=(0.0, 0.0),
):
    rows = [
        {"kind": "polygon", "points": one.points, "material": one.material, "under": under}
        if isinstance(one, Polygon)
        else {
            "kind": "disc" if isinstance(one, Disc) else "rectangle",
            "centre": (one.cx, one.cy),
            "half_size": (one.radius,) if isinstance(one, Disc) else (one.half_w, one.half_h),
            "angle": None if isinstance(one, Disc) else one.angle_rad,
            "material": one.material,
            "under": under,
        }
        for one, under in zip(shapes, materials_under(shapes, background), strict=True)
    ]
    return paint(
        rows,
        table,
        background,
        origin_xy=origin,
        shape=shape,
        sigma=sigma,
        distortion=distortion,
        radius=radius,
        circle=circle,
    )


def check(shapes, table, *place, **more) -> np.ndarray:
    """Compare; return what the device painted."""
    found = on_device(shapes, table, *place, **more)
    curved = sum(
        0.1 * (more.get("sigma", 0.8) / one.radius) ** 2 for one in shapes if isinstance(one, Disc)
    )
    contrast = np.ptp(np.append(table, 0))  # also to the black beyond the rim
    expected = reference(shapes, table, *place, **more)
    assert_close(found, expected, atol=(2 * WEIGHT + curved) * contrast)
    return found


@pytest.mark.parametrize("angle", [0.0, 0.1, np.pi / 4, np.pi / 2, 2.5, -1.0])
def test_rectangles_at_any_angle(angle: float):
    found = check([Rect(-4.3, 6.1, 11.7, 6.2, angle, 1)], materials(2, 1), (-25.5, -13.5), (37, 45))
    assert np.ptp(found) > 0.5  # both materials are there


def test_thin_rectangles_keep_their_area():
    """A line a tenth of a sample wide: the sum over samples is its area."""
    table = np.array([[0.0], [1.0]])
    found = check([Rect(3.2, -1.7, 12.0, 0.05, 0.3, 1)], table, (-19.5, -19.5), (40, 45), sigma=1.0)
    # The alias of the sum is exp(-2 pi^2) = 3e-9; weights are good to 5e-4 in a hundred samples.
    assert found.sum() == pytest.approx(24 * 0.1, abs=100 * 4e-6 + 0.01 * 2.4)


@pytest.mark.parametrize("sigma", [0.8, 1.3])
def test_discs(sigma: float):
    found = check(
        [Disc(2.4, -3.3, 16.0, 1)], materials(2, 1), (-20.5, -22.5), (40, 47), sigma=sigma
    )
    assert np.ptp(found) > 0.5


def test_what_the_curvature_leaves():
    """The first-order term against the Gaussian's integral, over all distances: for large discs."""
    for ratio in (SMALL_DISC, 24.0, 40.0):
        r = np.linspace(max(ratio - 8, 0), ratio + 8, 200)
        exact = np.array([disc_coverage(np.array([x, 0.0]), ratio, np.eye(2)) for x in r])
        assert np.abs(ndtr(ratio - r - 0.5 / ratio) - exact).max() < 0.07 / ratio**2
        without = np.abs(ndtr(ratio - r) - exact).max()
        assert without > 0.19 / ratio  # a control: 0.4 / (2 R) without the term


def test_the_twins_disc_is_rices_integral():
    """int_0^R q exp(-(q^2 + r^2)/2) I_0(q r) dq (Rice 1945, eq. 3.10-11), at an angle."""
    for ratio, r in ((0.5, 0.0), (1.0, 1.2), (6.0, 5.0), (20.0, 20.5)):
        q = np.linspace(0, ratio, 20001)
        rice = np.trapezoid(q * np.exp(-((q - r) ** 2) / 2) * i0e(q * r), q)
        found = disc_coverage(r * np.array([0.6, -0.8]), ratio, np.eye(2))
        assert found == pytest.approx(rice, abs=2e-7)  # the trapezia: (R/20000)^2/12


@pytest.mark.parametrize("radius", [0.2, 0.6, 1.5, 4.0, 9.0])
def test_small_discs_under_a_map_that_shears(radius: float):
    """Far from the axis and between its directions, where the Gaussian is an oblique ellipse.

    Strips leave 3e-6, Phi twice 1e-6; a disc's coverage changes by at most 0.4 / s along a position
    that is off by 30 roundings of 200 samples, 4e-4, as in the header.
    """
    bend = {"distortion": pieces_of([0.95, -0.15]), "radius": 150.0}
    middle = np.array([91.3, 66.8])
    centre, jacobian = chief_ray_twin(middle, **bend)
    least = np.linalg.svd(jacobian, compute_uv=False)[-1]
    assert 0.6 < least < 0.7  # across it is 0.86
    disc = [Disc(*centre, radius, 1)]
    half = int(1.5 * radius + 5)
    origin, shape = tuple(middle.round() - half), (2 * half, 2 * half + 1)
    table = np.array([[0.0], [1.0]])
    found = on_device(disc, table, origin, shape, **bend, least_stretch=least)
    expected = reference(disc, table, origin, shape, **bend)
    assert expected.max() > 0.02
    assert_close(found, expected, atol=WEIGHT)


def test_a_disc_has_no_hole_where_a_sample_meets_its_centre():
    for off in (0.0, 1e-4, 1e-3, 0.02):
        disc = [Disc(2.0 + off, 3.0, 10.0, 1)]
        found = on_device(disc, np.array([[0.0], [1.0]]), (0.0, 0.0), (6, 5))
        assert_close(found, np.ones(found.shape), atol=WEIGHT)


def test_shapes_within_shapes_in_painters_order():
    stack = [
        Rect(0, 0, 24, 17, 0.2, 1),
        Disc(-4, 1, 14, 2),
        Rect(-4, 1, 7, 5, -0.5, 3),
        Rect(17, 3, 3, 4, 0.9, 2),
    ]
    table = materials(4, 3)
    found = check(stack, table, (-31.5, -20.5), (41, 63), background=3)
    turned = on_device(stack[::-1], table, (-31.5, -20.5), (41, 63), background=3)
    assert np.abs(found - turned).max() > 0.3  # a control: the order does matter


def test_outlines_that_are_nearer_than_the_gaussian_is_wide():
    """Two bars a sample apart are a wide bar with a gap: what is between them is no product."""
    table = materials(2, 1)
    place = (-9.5, -7.5), (17, 19)
    bars = on_device([Rect(x, 0.3, 2.0, 6.0, 0.0, 1) for x in (-2.5, 2.5)], table, *place)
    wide = Rect(0, 0.3, 4.5, 6.0, 0.0, 1)
    # The gap ends where the bar does, as near as a chart's outlines may come.
    gap = on_device([wide, Rect(0, 0.3, 0.5, 6.0 - 1e-6, 0.0, 0)], table, *place)
    assert_close(bars, gap, atol=4 * WEIGHT * np.ptp(table))


@pytest.mark.parametrize("planes", range(1, 9))
def test_planes_from_one_to_eight(planes: int):
    shapes = [Rect(1, 2, 6, 5, 0.3, 1), Rect(-3, -2, 4, 3, 0.1, 0)]
    check(shapes, materials(3, planes), (-9.5, -7.5), (17, 19), background=2)


@pytest.mark.parametrize("needed", range(1, 8))
def test_planes_that_a_tile_does_not_need_are_left_as_they_are(needed: int):
    shapes, table = [Rect(1, 2, 6, 5, 0.3, 1), Rect(-3, -2, 4, 3, 0.1, 0)], materials(3, 8)
    found = on_device(shapes, table, (-9.5, -7.5), (17, 19), 2, needed=needed)
    whole = on_device(shapes, table, (-9.5, -7.5), (17, 19), 2)
    assert_close(found[:needed], whole[:needed], atol=0)
    assert unwritten(found[needed:]).all()


def test_the_background_alone():
    table = materials(3, 2)
    found = on_device([], table, (-3.5, 8.5), (5, 33), background=2)
    assert_close(found, np.broadcast_to(table[2][:, None, None], found.shape), atol=2.0**-24)


def test_the_chart_is_warped_and_so_is_the_gaussian():
    """Off the axis, where the map shrinks by 20 % along the radius, and turns what is straight."""
    stack = [Rect(30, 20, 22, 14, 0.4, 1), Disc(31, 22, 11, 2)]
    place = ((14.5, 3.5), (43, 38))
    check(stack, materials(3, 2), *place, distortion=BENT, radius=55.0)
    # A control: the bound is below what the stretch of the Gaussian makes.
    round_blur = reference(stack, materials(3, 2), *place, distortion=BENT, radius=55.0, sigma=0.72)
    expected = reference(stack, materials(3, 2), *place, distortion=BENT, radius=55.0)
    assert np.abs(round_blur - expected).max() > 0.02


@pytest.mark.parametrize("cells", [3, 8])
def test_a_lens_without_an_axis_warps_the_gaussian_in_its_own_way(cells: int):
    """Shear and anamorphic stretch; and the rim of the image circle, about its own centre."""
    radius, circle = 50.0, (4.5, -2.5)
    terms = bent(cells, cells, radius, 0.2)
    stack = [Rect(22, 14, 22, 14, 0.4, 1), Disc(21, 12, 11, 2)]
    place = {"distortion": terms, "radius": radius, "circle": circle}
    # Positions take some 40 roundings of at most 0.4 radii and one of u itself: WEIGHT has more
    # than twice those 5e-5 samples.
    check(stack, 1 + materials(3, 2), (4.5, -6.5), (43, 58), **place)
    expected = reference(stack, 1 + materials(3, 2), (4.5, -6.5), (43, 58), **place)
    for wrong in (
        {"distortion": terms.swapaxes(0, 1)},
        {"distortion": terms[..., ::-1]},
        {"circle": circle[::-1]},
    ):
        off = reference(stack, 1 + materials(3, 2), (4.5, -6.5), (43, 58), **place | wrong)
        assert np.abs(off - expected).max() > 0.02


def test_beyond_the_image_circle_it_is_black():
    stack = [Rect(30, 20, 22, 14, 0.4, 1)]
    found = check(stack, 1 + materials(2, 6), (20.5, 10.5), (37, 40), radius=42.0)
    y, x = np.mgrid[:37, :40] + np.array([10.5, 20.5])[:, None, None]
    assert np.abs(found[:, np.hypot(x, y) > 42 + 6 * 0.8]).max() < 1e-6
    assert np.abs(found[:, np.hypot(x, y) < 42 - 6 * 0.8]).min() > 0.01


def nested(count: int, largest: float, smallest: float) -> list[Rect]:
    """Return rectangles one within another, each of another material than the one around it."""
    sizes = np.linspace(largest, smallest, count)
    return [Rect(7.3, 8.1, s, 0.9 * s, 0.35, 1 + k % 6) for k, s in enumerate(sizes)]


def test_as_many_shapes_as_one_likes():
    table = materials(7, 2)
    expected = reference(nested(129, 18, 1), table, (0.5, 0.5), (16, 16))
    found = on_device(nested(129, 18, 1), table, (0.5, 0.5), (16, 16))
    # Edges 0.14 samples apart: 12 lie within the Gaussian.
    assert_close(found, expected, atol=12 * WEIGHT * np.ptp(table))


def test_tiles_far_from_the_first_know_where_they_are():
    """The last of a hundred tiles in a row, and in a column, where the map stretches 1.9-fold."""
    table = np.array([[0.2], [1.0]])
    edge = 1.9 * 1590.0
    for shape, half_size in (((3, 1611), (edge, 1e4)), ((1611, 3), (1e4, edge))):
        rect = Rect(0.0, 0.0, *half_size, 0.0, 1)
        found = on_device([rect], table, (0.5, 0.5), shape, distortion=pieces_of([1.9]))[0]
        z = (1590 - (np.arange(1611) + 0.5)) / 0.8
        expected = np.broadcast_to(0.2 + 0.8 * ndtr(z), (3, 1611))
        # f32 at 3000 samples: 4 * 2^-24 * 3000 = 7e-4, over 1.5 of sigma, with a density of 0.4.
        assert_close(found if shape[0] == 3 else found.T, expected, atol=2e-4)


def test_the_term_of_the_curvature():
    """Discs just large enough for it; against the formula itself."""
    x = np.stack(np.meshgrid(np.arange(19), np.arange(17)), axis=-1) + 0.5
    r = np.hypot(*np.moveaxis(x - [9.2, 7.7], -1, 0))
    for radius in (6.5, 8.0):
        disc = [Disc(9.2, 7.7, radius, 1)]
        found = on_device(disc, np.array([[0.0], [1.0]]), (0.5, 0.5), (17, 19), sigma=0.4)[0]
        expected = ndtr((radius - r) / 0.4 - 0.5 * 0.4 / radius)
        # Phi to 1e-6; positions to 30 * 2^-24 * 30 samples, over 0.4 of sigma. The term is 1e-2.
        assert_close(found, expected, atol=6e-5)


def test_the_defaults_are_of_the_default_grid(device: Device):
    scale = Scale("test", DEFAULT_GRID, 1.0, 0.0, NO_KERNELS)
    stage = Paint(
        device, scene().source.placed(50.0), np.ones((4, 3)), scale, chief_ray_map(bank())
    )
    stage.release()
    ((plain, with_edges),) = stage.kernels
    assert Kernel("optics/paint").overrides == with_edges.overrides
    assert plain.overrides == with_edges.overrides | {"EDGES": False}
    assert plain.workgroup_size == (16, 4, 1)


LENS = bank(circle_um=100.0, distortion=-0.04)
GRID = SimGrid(48, 64, 4, 2, 256, 104, (2, 1))  # blocks of 48 samples, well beyond the sensor
PITCH_UM = 0.775


@pytest.mark.parametrize("count", [2, 8, 19])
def test_the_host_paints_blocks_of_the_real_plane(device: Device, count: int):
    """Planes by eights, and none that a block does not need."""
    chief_ray = chief_ray_map(LENS)
    chart = scene(shapes()).source.placed(48 * 1.55 / 2)
    coefficients = np.random.default_rng(count).uniform(-0.4, 0.4, (4, count))
    coefficients[:, :2] = [[1.0, 0.0], [0.3, 0.0], [0.5, 0.5], [0.2, -0.4]]
    stage = Paint(
        device, chart, coefficients, Scale("test", GRID, PITCH_UM, SIGMA, NO_KERNELS), chief_ray
    )
    for block in [(2, 3), (3, 2)]:
        stage.prepare([block])  # the second time the lists of both are made
        rec = Recording(device)
        out = rec.buffer("planes", (count, GRID.block[1], GRID.block[0]), F32)
        assert stage.needed[block] == count
        stage.record(rec, block, out)
        label = rec.download(out)
        found = rec.run()[label]
        samples = [
            Disc(s.cx / PITCH_UM, s.cy / PITCH_UM, s.radius / PITCH_UM, s.material)
            if isinstance(s, Disc)
            else Rect(
                s.cx / PITCH_UM,
                s.cy / PITCH_UM,
                s.half_w / PITCH_UM,
                s.half_h / PITCH_UM,
                s.angle_rad,
                s.material,
            )
            for s in chart.primitives
        ]
        origin = np.array(GRID.block_origin(block)) + 0.5 - GRID.centre
        expected = reference(
            samples,
            coefficients,
            origin,
            GRID.block[::-1],
            sigma=SIGMA,
            distortion=chief_ray.pieces,
            radius=chief_ray.radius_um / PITCH_UM,
        )
        assert np.ptp(expected) > 0.5
        # Discs of 7.2 samples and more, that is 9 sigma.
        assert_close(found, expected, atol=(2 * WEIGHT + 0.1 / 9**2) * 1.5)
    stage.release()


def material_planes(chart: Chart, block: tuple[int, int], margin: float) -> np.ndarray:
    """Return the materials in a block and `margin` samples around, by a dense look at the chart."""
    corner = np.array(GRID.block_origin(block)) - GRID.centre - margin
    x, y = (
        np.linspace(corner[axis], corner[axis] + GRID.block[axis] + 2 * margin, 120) * PITCH_UM
        for axis in (0, 1)
    )
    x, y = np.meshgrid(x, y)
    radius = np.hypot(x, y)
    ideal, inside = LENS.ideal_from_real(radius)
    return chart.material_at(x * ideal / radius, y * ideal / radius)[inside]


def test_blocks_know_which_shapes_and_planes_they_see():
    chart = scene(shapes()).source.placed(48 * 1.55 / 2)
    coefficients = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.5, 0.5, 0.0], [0.2, -0.4, 0.1]])
    seen, needed = primitives_by_block(chart, coefficients, GRID, PITCH_UM, chief_ray_map(LENS))
    assert set(seen) == set(needed) == set(np.ndindex(GRID.blocks))
    planes = np.array([0, 1, 2, 3])  # of each material
    for block, numbers in seen.items():
        assert list(numbers) == sorted(numbers)
        around = np.unique(material_planes(chart, block, 6 * SIGMA))  # what the Gaussian reaches
        drawn = {chart.primitives[n].material for n in numbers} | {chart.background}
        assert set(around) <= drawn
        assert needed[block] >= planes[around].max(initial=0)
        far = [
            n
            for n, shape in enumerate(chart.primitives)
            if min(shape.distance(*np.array(p)) for p in corners_um(block, 30.0)) > 60
        ]
        assert not set(far) & set(numbers)
    # Nothing but the black background lies outside the field: no planes, no shapes.
    assert needed[0, 0] == 0 and len(seen[0, 0]) == 0
    assert max(needed.values()) == 3 and len({*needed.values()}) > 2


def corners_um(block: tuple[int, int], spacing: float) -> list[tuple[float, float]]:
    origin = (np.array(GRID.block_origin(block)) - GRID.centre) * PITCH_UM
    steps = np.array(GRID.block) * PITCH_UM
    return [tuple(origin + steps * (i / 3, j / 3)) for i in range(4) for j in range(4)]


def test_a_chart_without_shapes_needs_its_backgrounds_planes():
    chart = scene(background=2).source.placed(50.0)
    coefficients = np.array([[1.0, 1.0], [1.0, 1.0], [0.5, 0.0], [1.0, 1.0]])
    seen, needed = primitives_by_block(chart, coefficients, GRID, PITCH_UM, chief_ray_map(LENS))
    assert set(needed.values()) == {0, 1} and not any(len(numbers) for numbers in seen.values())
    # None where no sample of the block, nor of its margin, lies within the image circle.
    radius_um = chief_ray_map(LENS).radius_um
    for block, planes in needed.items():
        corner = np.array(GRID.block_origin(block)) - GRID.centre
        line = [np.linspace(c - 8, c + b + 8, 200) for c, b in zip(corner, GRID.block, strict=True)]
        nearest = np.hypot(*np.meshgrid(*line)).min() * PITCH_UM
        assert planes == (nearest < radius_um) or abs(nearest - radius_um) < PITCH_UM


def test_tiles_know_their_ground_and_their_edges():
    """Painting only what is listed gives what painting all shapes gives, ground or not."""
    chief_ray = chief_ray_map(LENS)
    scale = Scale("test", GRID, PITCH_UM, SIGMA, NO_KERNELS)
    bars = tuple(Rect(0.3 * k - 1, 0.1, 0.05, 0.6, 0.3, 1 + k % 3) for k in range(7))
    inside = (Rect(0.0, 0.0, 1.2, 0.9, 0.02, 1), Disc(0.1, 0.1, 0.5, 2), Disc(0.15, 0.1, 0.4, 0))
    coefficients = np.array([[1.0, 0.0], [0.3, 0.0], [0.5, 0.5], [0.2, -0.4]])
    for primitives, fewest in ((shapes(), 1), (bars, 1), (inside, 2), ((), 1)):
        chart = scene(primitives).source.placed(48 * 1.55 / 2)
        seen, needed = primitives_by_block(chart, coefficients, GRID, PITCH_UM, chief_ray)
        tiles, chosen, ranges = tiles_by_block(
            chart, seen, seen, needed, scale=scale, chief_ray=chief_ray
        )
        assert sorted(ranges) == sorted(np.ndindex(GRID.blocks))
        assert sum(plain + edges for _, plain, edges in ranges.values()) == len(tiles)
        grounds = set()
        for block, (first, plain, edges) in ranges.items():
            for place, (corner, start, count, ground) in enumerate(tiles[first:][: plain + edges]):
                at = np.array([corner % 65536, corner // 65536])
                x, y = np.meshgrid(*(one + 0.5 + np.arange(16) for one in at))
                x, y = (
                    (one + start_ - centre) * PITCH_UM
                    for one, start_, centre in zip(
                        (x, y), GRID.block_origin(block), GRID.centre, strict=True
                    )
                )
                radius = np.hypot(x, y)
                assert ground // 65536 == needed[block]
                if place < plain:
                    assert count == 0
                    assert radius.max() < chief_ray.radius_um - 6 * SIGMA * PITCH_UM
                at_um = np.minimum(radius, chief_ray.radius_um)
                factor = LENS.ideal_from_real(at_um)[0] / at_um
                listed = chosen[start : start + count]
                # What is not listed has no edge within six sigma of any sample...
                for number in set(range(len(primitives))) - set(listed):
                    distance = chart.primitives[number].distance(x * factor, y * factor)
                    assert np.abs(distance).min() > 5.9 * SIGMA * PITCH_UM or np.any(
                        [
                            chart.primitives[later].distance(x * factor, y * factor).max()
                            < -5.9 * SIGMA * PITCH_UM
                            for later in range(number + 1, len(primitives))
                        ]
                    )
                assert list(listed) == sorted(listed)
                # ... and where no shape is listed the material is the ground everywhere.
                if not count:
                    found = np.unique(chart.material_at(x * factor, y * factor))
                    assert list(found) == [ground % 65536]
                    grounds.add(int(found[0]))
        # The control: shapes that cover tiles are there, and the background is.
        assert len(grounds) >= fewest


# Owen's T by six nodes is good to 2e-7, Phi to 1e-6; each corner has two sides: far below WEIGHT,
# which holds for their positions as for those of rectangles.
KITE = ((-9.3, 1.2), (2.1, -7.6), (8.8, 3.4), (-1.0, 9.7))


@pytest.mark.parametrize("size", [0.05, 0.3, 1.0, 4.0])
def test_polygons_of_any_size(size: float):
    points = tuple((size * x + 1.3, size * y - 0.4) for x, y in KITE)
    found = check([Polygon(points, 1)], materials(2, 1), (-14.5, -13.5), (31, 33))
    if size > 0.5:
        assert np.ptp(found) > 0.5  # both materials are there


def test_a_polygon_of_four_right_angles_is_a_rectangle():
    """Another way through the same shader, and samples exactly on corners and sides."""
    for angle, half in ((0.3, (11.7, 6.2)), (0.0, (5.0, 3.0))):
        rect = Rect(0.5, 0.5, *half, angle, 1)
        polygon = Polygon(tuple(map(tuple, rect.corners())), 1)
        table, place = np.array([[0.0], [1.0]]), ((-15.5, -11.5), (25, 33))
        assert_close(
            on_device([polygon], table, *place), on_device([rect], table, *place), atol=2e-5
        )


def test_sectors_that_touch_are_the_whole():
    """Twelve triangles about one corner, on a sample: nowhere is there a seam."""
    turn = 2 * np.pi * np.arange(13) / 12
    rim = np.stack([30 * np.cos(turn), 30 * np.sin(turn)], axis=1)
    sectors = [Polygon(((0.5, 0.5), tuple(a), tuple(b)), 1) for a, b in pairwise(rim)]
    found = on_device(sectors, np.array([[0.0], [1.0]]), (-11.5, -11.5), (24, 24))
    assert_close(found, np.ones(found.shape), atol=12 * 4e-6)


def test_polygons_under_a_map_that_shears():
    bend = {"distortion": pieces_of([0.95, -0.15]), "radius": 150.0}
    middle = np.array([91.3, 66.8])
    centre, _ = chief_ray_twin(middle, **bend)
    points = tuple((x + centre[0], y + centre[1]) for x, y in KITE)
    origin = tuple(middle.round() - 16)
    check([Polygon(points, 1)], materials(2, 1), origin, (33, 34), **bend)

"""Decentred and tilted elements: rays against closed forms and against lenses that did not move."""

import numpy as np
import pytest
from lens.made import lens, model

from gpusim.errors import UserError
from gpusim.lens.aim import aim, launch_field
from gpusim.lens.samples import sample_field, sample_rays
from gpusim.lens.surface import tilt_matrix
from gpusim.lens.system import build, first_order, geometry_of
from gpusim.lens.trace import trace
from gpusim.psf.compute import compute_bank

D_LINE = np.array([587.5618])


def doublets(**fields):
    """Return a stop between two singlets, all in air; no clear apertures."""
    rows = [
        {"radius": 40.0, "thickness": 4.0, **model(1.6)},
        {"radius": -90.0, "thickness": 6.0},
        {"radius": np.inf, "thickness": 5.0},
        {"radius": 50.0, "thickness": 4.0, "conic": -0.7, **model(1.7)},
        {"radius": -80.0, "asphere": {"a4": 1e-6}},
    ]
    return lens(rows, **{"stop": 3, "f_number": 6.0, "max_field_deg": 10.0} | fields)


def stop_points(system, count=40):
    """Return points all over the stop that have no symmetry."""
    rng = np.random.default_rng(3)
    r = system.stop_radius_mm * np.sqrt(rng.uniform(0, 1, count))
    phi = rng.uniform(0, 2 * np.pi, count)
    return r * np.cos(phi), r * np.sin(phi)


def sampled(prescription, degrees=0.0, shift=(0.0, 0.0), mirror=(1, 1)):
    """Return the rays of a field through the same points of the stop, moved or mirrored."""
    system = build(prescription)
    x, y = stop_points(system)
    x, y = mirror[0] * x + shift[0], mirror[1] * y + shift[1]
    return sample_rays(system, system.index(D_LINE), np.radians(degrees), x, y)


# What holds of rays through the same points of the stop: aiming is good to 1e-9 of its 2.9 mm, so
# landing points of rays with aberrations of 1 mm per mm to 1e-9 mm, the OPD to 1e-10 mm or so.
LANDING_MM = 3e-9
OPD_MM = 1e-9


def same(one, two, x=1, y=1, decentre=(0.0, 0.0)):
    """Check that two bundles are mirror images (x, y = 1 or -1), the second also decentred."""
    for a, b, tolerance in (
        (one.chief_x_mm, x * (two.chief_x_mm - decentre[0]), LANDING_MM),
        (one.chief_y_mm, y * (two.chief_y_mm - decentre[1]), LANDING_MM),
        (one.alpha, x * two.alpha, LANDING_MM),
        (one.beta, y * two.beta, LANDING_MM),
        (one.landing_x_mm, x * two.landing_x_mm, LANDING_MM),
        (one.landing_y_mm, y * two.landing_y_mm, LANDING_MM),
        (one.opd_mm, two.opd_mm, OPD_MM),
    ):
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(one.ok, two.ok)


def test_tilt_turns_the_axes_as_the_docstring_says():
    np.testing.assert_allclose(tilt_matrix((90, 0)) @ [0, 1, 0], [0, 0, 1], atol=1e-16)
    np.testing.assert_allclose(tilt_matrix((0, 90)) @ [0, 0, 1], [1, 0, 0], atol=1e-16)
    # First about x, then about the axis that y has become, which is z: x goes to y.
    np.testing.assert_allclose(tilt_matrix((90, 90)) @ [0, 0, 1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(tilt_matrix((90, 90)) @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("tilt", [(20.0, 0.0), (-35.0, 0.0), (0.0, 20.0), (0.0, -50.0)])
def test_a_tilted_plate_shifts_the_ray_by_the_closed_form(tilt):
    n, t = 1.5, 6.0
    rows = [
        {"radius": np.inf, "thickness": 3.0, **model(1.5)},
        {"radius": -60.0, "thickness": 20.0},
        {"radius": np.inf, "thickness": t, **model(n)},
        {"radius": np.inf},
    ]
    bundle = sampled(lens(rows).with_element_moved(3, 4, tilt_deg=tilt))
    a = np.radians(sum(tilt))
    index = build(lens(rows)).index(D_LINE)[3, 0]
    # Along the axis the ray meets the plate at the angle a (Smith, Modern Optical Engineering).
    shift = t * np.sin(a) * (1 - np.cos(a) / np.sqrt(index**2 - np.sin(a) ** 2))
    # ax > 0 points the plate's normal to -y, ay > 0 to +x: the ray is drawn to that side.
    x, y = (0.0, -shift) if tilt[0] else (shift, 0.0)
    assert bundle.chief_x_mm[0] == pytest.approx(x, abs=1e-13)  # some 50 roundings of 1e-15 mm
    assert bundle.chief_y_mm[0] == pytest.approx(y, abs=1e-13)
    assert abs(shift) > 0.5


@pytest.mark.parametrize("degrees", [0.0, 7.0])
def test_what_moves_the_other_way_gives_the_mirror_image(degrees):
    right, mirror_x, mirror_y = (
        doublets().with_element_moved(4, 5, decentre_mm=(sx * 0.3, sy * 0.2), tilt_deg=tilt)
        for sx, sy, tilt in ((1, 1, (1.5, -2.0)), (-1, 1, (1.5, 2.0)), (1, -1, (-1.5, -2.0)))
    )
    bundle = sampled(right, degrees)
    same(bundle, sampled(mirror_x, degrees, mirror=(-1, 1)), x=-1)
    same(bundle, sampled(mirror_y, -degrees, mirror=(1, -1)), y=-1)
    # And it did something.
    assert abs(bundle.chief_x_mm[0]) > 0.05
    with pytest.raises(AssertionError):
        same(bundle, sampled(doublets(), degrees))


def test_a_lens_decentred_as_a_whole_forms_the_same_image_elsewhere():
    decentre = (0.7, -0.4)
    moved = doublets().with_element_moved(1, 5, decentre_mm=decentre)
    # The two sides of the centred lens are folded together: compare rays with alpha >= 0.
    still, whole = sampled(doublets(), 6.0), sampled(moved, 6.0)
    side = np.sign(whole.alpha)
    folded = type(whole)(
        **vars(whole) | {"alpha": side * whole.alpha, "landing_x_mm": side * whole.landing_x_mm}
    )
    same(still, folded, decentre=decentre)


def test_a_decentred_element_is_a_centred_one_whose_rays_are_shifted():
    # Before the stop there is nothing: parallel light does not know where the stop is.
    dx, dy = 0.5, -0.3
    rows = [
        {"radius": np.inf, "thickness": 5.0},
        {"radius": 50.0, "thickness": 4.0, **model(1.7)},
        {"radius": -80.0},
    ]
    still = lens(rows, f_number=6.0)
    # A stop with a shift of its own makes the centred lens one of the whole pupil too.
    still_stop = still.with_element_moved(1, 1, decentre_mm=(-dx, -dy))
    moved = still.with_element_moved(2, 3, decentre_mm=(dx, dy))
    same(sampled(still_stop, 4.0), sampled(moved, 4.0), decentre=(dx, dy))


@pytest.mark.parametrize("degrees", [0.0, 5.0])
def test_a_lens_turned_about_its_first_vertex_sees_another_field(degrees):
    turn = 4.0  # about x: the axis points down, so that light from the field comes from farther up
    still = doublets()
    moved = still.with_element_moved(1, 5, tilt_deg=(turn, 0.0))
    bundles = []
    for prescription, field in ((still, degrees + turn), (moved, degrees)):
        geometry = geometry_of(prescription)
        index = build(still).index(D_LINE)
        x, y = stop_points(build(still))
        launch, found = launch_field(geometry, index, np.radians(field), 1e-9)
        assert found.all()
        px, py, found = aim(geometry, index, launch, x, y, tolerance_mm=1e-9)
        assert found.all()
        bundles.append(trace(geometry, index, launch, px, py))
    centred, turned = bundles
    rotation = tilt_matrix((turn, 0.0))
    # Aimed to 1e-9 mm at the stop.
    np.testing.assert_allclose(turned.own_x, centred.own_x, rtol=0, atol=1e-8)
    np.testing.assert_allclose(turned.own_y, centred.own_y, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        turned.direction, np.tensordot(rotation, centred.direction, 1), rtol=0, atol=1e-8
    )
    places = [np.stack([r.x, r.y, r.z]) for r in (centred, turned)]
    np.testing.assert_allclose(places[1], np.tensordot(rotation, places[0], 1), rtol=0, atol=1e-8)
    np.testing.assert_allclose(turned.path, centred.path, rtol=0, atol=1e-8)


def test_an_element_keeps_its_shape_when_it_moves():
    still = doublets()
    once = still.with_element_moved(1, 2, (0.1, 0.2), (10.0, -20.0))
    moved = once.with_element_moved(1, 4, (0.3, -0.2), (-7.0, 5.0))
    before, after = geometry_of(still), geometry_of(moved)

    def vertices(g):
        return np.column_stack([g.decentre, g.vertex_z])

    axis = [g.rotation[:, :, 2] for g in (before, after)]
    gap = [np.diff(vertices(g), axis=0) for g in (before, after)]
    # Surfaces 1, 2 and 3, 4 each moved together: distance, and angles of axes with it, remain.
    for i in (0, 2):
        assert np.linalg.norm(gap[1][i]) == pytest.approx(np.linalg.norm(gap[0][i]), abs=1e-14)
        for j in (i, i + 1):
            assert axis[1][j] @ gap[1][i] == pytest.approx(axis[0][j] @ gap[0][i], abs=1e-14)
    # The last surface did not move, nor did the image plane.
    np.testing.assert_allclose(vertices(after)[4], vertices(before)[4], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(after.rotation[4], np.eye(3))
    assert "surfaces 1 to 4 decentred by 0.3, -0.2 mm" in moved.history[-1]
    # Back the same way: nothing is left but rounding.
    back = once.with_element_moved(1, 2, (-0.1, -0.2)).surfaces[1]
    turned = tilt_matrix((10.0, -20.0)) @ [0, 0, 4.0]
    np.testing.assert_allclose(back.decentre_mm, turned[:2], rtol=0, atol=1e-14)


def test_the_image_plane_stays_where_it_was():
    rows = [
        {"radius": 40.0, "thickness": 4.0, **model(1.6)},
        {"radius": -90.0, "thickness": 60.0},
    ]
    still = lens(rows, focus="as-given")
    moved = still.with_element_moved(1, 2, tilt_deg=(10.0, 0.0))
    assert moved.surfaces[0].thickness == pytest.approx(4 * np.cos(np.radians(10)), rel=1e-15)
    assert build(moved).image_z_mm == pytest.approx(64.0, abs=1e-13)


def test_a_moved_lens_scales():
    moved = doublets().with_element_moved(4, 5, (0.3, 0.2), (1.5, -2.0))
    f = first_order(moved).efl_mm
    one, two = sampled(moved, 5.0), sampled(moved.scaled(2 * f), 5.0)
    np.testing.assert_allclose(two.chief_x_mm, 2 * one.chief_x_mm, rtol=1e-8)
    np.testing.assert_allclose(two.opd_mm, 2 * one.opd_mm, rtol=0, atol=OPD_MM)


def test_a_decentred_diaphragm_cuts_the_rays_that_it_should():
    moved = doublets().with_element_moved(3, 3, decentre_mm=(0.5, 0.0))
    system = build(moved)
    samples = sample_field(system, system.index(D_LINE), 0.0)
    # The whole pupil, centred on the stop's own vertex; of the last surface the aperture that the
    # centred beam needed clips one side of it.
    inside = samples.inside[0]
    assert samples.margin[-1, 0][inside].max() < 0
    assert (samples.alpha[0][inside] < 0).sum() > 100
    assert (samples.alpha[0][inside] > 0).sum() > 100
    geometry = system.geometry
    launch, _ = launch_field(geometry, system.index(D_LINE), 0.0, 1e-9)
    rays = trace(geometry, system.index(D_LINE), launch, np.zeros((1, 1)), np.zeros((1, 1)))
    assert rays.x[2, 0, 0] == pytest.approx(0.5, abs=1e-8)
    assert rays.own_x[2, 0, 0] == pytest.approx(0.0, abs=1e-8)


def test_a_bank_of_a_lens_without_symmetry_is_refused():
    moved = doublets().with_element_moved(4, 5, tilt_deg=(0.5, 0.0))
    with pytest.raises(UserError, match="symmetric") as caught:
        compute_bank(moved, [550.0], [0.0, 5.0], size=32)
    assert "surfaces.4" in caught.value.screen()
    assert "tilt_deg [0.5, 0.0]" in caught.value.screen()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0, 2), ["no such element", "0 to 2", "1 to 5"]),
        ((4, 3), ["no such element"]),
        ((4, 6), ["no such element"]),
        ((4, 5, (0.0, 0.0), (95.0, 0.0)), ["turned too far", "surfaces.4.tilt_deg"]),
    ],
)
def test_a_move_that_makes_no_lens_is_refused(arguments, words):
    with pytest.raises(UserError) as caught:
        doublets().with_element_moved(*arguments)
    for word in words:
        assert word in caught.value.screen()

"""Real rays against closed forms; failed rays are masked and never NaN."""

import numpy as np
import pytest
from lens.made import fisheye, lens, model

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.aim import aim, launch_field
from gpusim.lens.launch import Launch
from gpusim.lens.samples import sample_field, sample_rays
from gpusim.lens.surface import ASPHERE_POWERS
from gpusim.lens.system import build, first_order, indices
from gpusim.lens.trace import _meet, trace

D_LINE = np.array([587.5618])


def through_vertex(degrees=0.0):
    """Return a launch plane through the first vertex: on the axis, px and py are x and y there."""
    return Launch(np.radians(degrees), np.zeros((3, 1)))


def hyperbolic_singlet(n, f, f_number):
    """Plane, then the Cartesian oval of collimated light leaving glass: a hyperboloid.

    Descartes: conic constant -n^2 and radius -(n - 1) f focus without error at f from the vertex.
    """
    rows = [
        {"radius": np.inf, "thickness": 0.4 * f, **model(n)},
        {"radius": -(n - 1) * f, "conic": -n * n},
    ]
    return lens(rows, f_number=f_number, max_field_deg=1.0)


@pytest.mark.parametrize("f_number", [4.0, 1.5, 1.0])
def test_a_cartesian_surface_images_a_point_without_error(f_number):
    system = build(hyperbolic_singlet(1.5, 50.0, f_number))
    assert system.image_z_mm == pytest.approx(0.4 * 50 + 50, abs=1e-12)
    samples = sample_field(system, system.index(D_LINE), 0.0)
    inside = samples.inside
    assert inside.sum() > 400
    # Paths of 90 mm carry rounding of about 1e-13 mm for some ten operations: 1e-12 mm is 2e-6
    # waves.
    assert np.abs(samples.opd_mm[inside]).max() < 1e-12
    assert np.hypot(samples.landing_x_mm, samples.landing_y_mm)[inside].max() < 1e-11
    # Aplanatic it is not: the rays fill a disc of the aperture's size.
    assert np.hypot(samples.alpha, samples.beta)[inside].max() > 0.35 / f_number


def test_a_sphere_in_its_place_is_far_from_perfect():
    rows = [
        {"radius": np.inf, "thickness": 20.0, **model(1.5)},
        {"radius": -25.0},
    ]
    system = build(lens(rows, f_number=4.0))
    samples = sample_field(system, system.index(D_LINE), 0.0)
    assert np.abs(samples.opd_mm[samples.inside]).max() > 0.01


def test_spherical_aberration_of_a_sphere_is_the_closed_form():
    # Collimated light in glass meets a sphere of radius R at height h: sin i = h / R, n sin i =
    # sin i', and the ray crosses the axis R sin i' / sin(i' - i) from the sphere's centre.
    n, radius = 1.5, 25.0
    rows = [{"radius": np.inf, "thickness": 20.0, **model(n)}, {"radius": -radius}]
    system = build(lens(rows, f_number=4.0))
    index = system.index(D_LINE)
    h = np.array([[0.5, 2.0, 4.0, 6.0]])
    rays = trace(system.geometry, index, through_vertex(), np.zeros_like(h), h)
    slope = rays.direction[1] / rays.direction[2]
    crossing = rays.point[2] - rays.point[1] / slope
    i = np.arcsin(h / radius)
    bent = np.arcsin(n * h / radius)
    centre = 20.0 - radius
    # Two roundings of 1e-16 in the angles, amplified by 1 / tan(slope) = 50: 1e-11 mm.
    np.testing.assert_allclose(
        crossing, centre + radius * np.sin(bent) / np.sin(bent - i), rtol=0, atol=1e-10
    )


def test_path_length_follows_from_malus_and_dupin():
    # Through a plane-parallel plate at 30 deg every ray of a parallel beam has the same path from
    # the incident plane wave to an emergent plane wave, t (n cos i' - cos i) more than in air.
    n, t, theta = 1.5, 7.0, np.radians(30)
    plate = lens(
        [
            {"radius": np.inf, "thickness": t, **model(n)},
            {"radius": np.inf, "thickness": 10.0},
            {"radius": 50.0, "thickness": 2.0, **model(n)},
            {"radius": np.inf},
        ],
        max_field_deg=30.0,
    )
    system = build(plate)
    y = np.linspace(-4, 4, 7)[None]
    x = np.linspace(-2, 3, 7)[None]
    rays = trace(system.geometry, system.index(D_LINE), through_vertex(30), x, y, through=2)
    wave = rays.point[1] * np.sin(theta) + rays.point[2] * np.cos(theta)
    refracted = np.sqrt(1 - (np.sin(theta) / n) ** 2)
    expected = t * (n * refracted - np.cos(theta))
    np.testing.assert_allclose(rays.path - wave, expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(rays.direction[1], np.sin(theta), rtol=0, atol=1e-15)


def test_an_even_asphere_and_the_conic_that_it_equals_trace_alike():
    # A paraboloid is a conic with constant -1, or nothing but an r^2 term of 1 / (2 R).
    n, radius = 1.5, 30.0
    tail = {"radius": -80.0}
    conic = build(lens([{"radius": radius, "conic": -1.0, "thickness": 5.0, **model(n)}, tail]))
    even = build(
        lens(
            [
                {
                    "radius": np.inf,
                    "asphere": {"a2": 0.5 / radius},
                    "thickness": 5.0,
                    **model(n),
                },
                tail,
            ]
        )
    )
    assert even.image_z_mm == pytest.approx(conic.image_z_mm, rel=1e-14)  # r^2 carries power
    y = np.linspace(-9, 9, 13)[None]
    x = np.linspace(0, 4, 13)[None]
    one, two = (trace(s.geometry, s.index(D_LINE), through_vertex(12), x, y) for s in (conic, even))
    assert one.ok.all()
    assert two.ok.all()
    # Newton ends where its step is 1e-14 of the distance; 5 mm paths: 1e-13 mm.
    np.testing.assert_allclose(two.point, one.point, rtol=0, atol=1e-12)
    np.testing.assert_allclose(two.path, one.path, rtol=0, atol=1e-12)


def test_a_ray_that_misses_the_conic_meets_the_asphere():
    # The polynomial flattens a sphere of radius 2: at r = 1.5 its sag is 0.115. A ray at 60 deg
    # through that point passes the sphere's centre at a distance of 2.38.
    c, a2, r = 0.5, -0.25, 1.5
    sag = c * r * r / (1 + np.sqrt(1 - (c * r) ** 2)) + a2 * r * r
    direction = np.array([0.0, np.sin(np.radians(60)), np.cos(np.radians(60))])
    start = np.array([0.0, r, sag]) - 3.0 * direction
    coefficients = np.zeros(len(ASPHERE_POWERS))
    coefficients[0] = a2
    t, _, ok = _meet(start[:, None, None], direction[:, None, None], c, 0.0, coefficients)
    assert ok.all()
    # Newton ends within 1e-14 of the length, and 1e-10 is what the tracer promises.
    assert t.item() == pytest.approx(3.0, abs=1e-10)
    assert not _meet(start[:, None, None], direction[:, None, None], c, 0.0, 0 * coefficients)[2]


def test_higher_aspheric_terms_bend_rays_as_their_slope_says():
    # Nearly flat surface in air-glass: a ray parallel to the axis at height r is bent by
    # (n - 1) / n times the slope, to first order in the slope.
    n, r = 1.5, 2.0
    coefficients = {"a4": 1e-7, "a6": 3e-9, "a10": 1e-12}
    rows = [
        {"radius": np.inf, "asphere": coefficients, "thickness": 1.0, **model(n)},
        {"radius": -50.0},
    ]
    system = build(lens(rows))
    rays = trace(
        system.geometry,
        system.index(D_LINE),
        through_vertex(),
        np.zeros((1, 1)),
        np.full((1, 1), r),
        through=1,
    )
    slope = sum(int(k[1:]) * a * r ** (int(k[1:]) - 1) for k, a in coefficients.items())
    # The next order is slope^3 = 1e-16.
    assert rays.direction[1, 0, 0] == pytest.approx(-slope * (n - 1) / n, abs=1e-15)


@pytest.mark.parametrize("field", [0.0, 14.0, 22.0])
def test_aimed_rays_land_where_they_were_sent(double_gauss, field):
    system = build(double_gauss)
    index = system.index(np.array([400.0, 550.0, 700.0]))
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    radius = system.stop_radius_mm
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    launch, reached = launch_field(system.geometry, index, np.radians(field), 1e-9 * radius)
    px, py, found = aim(system.geometry, index, launch, x, y, tolerance_mm=1e-9 * radius)
    rays = trace(system.geometry, index, launch, px, py)
    assert reached.all()
    assert found.all()
    stop = system.geometry.stop
    miss = np.hypot(rays.x[stop] - x, rays.y[stop] - y)
    assert miss.max() < 1e-9 * radius  # what was asked for


@pytest.mark.parametrize("degrees", [0.0, 60.0, 90.0, 100.0])
def test_a_sphere_turns_a_ray_as_its_distance_from_the_centre_says(degrees):
    # A ray that passes the centre at distance p meets the sphere at sin i = p / R and is turned
    # towards the centre by i - i', whatever the direction that it comes from.
    n, radius = 1.5, 10.0
    system = build(lens([{"radius": radius, "thickness": 1.0, **model(n)}, {"radius": -50.0}]))
    launch = Launch(np.radians(degrees), np.array([[0.0], [0.0], [radius]]))
    p = np.linspace(2.0, 9.9, 9)[None]  # from 100 deg, less than 1.7 mm meets the back half
    rays = trace(system.geometry, system.index(D_LINE), launch, np.zeros_like(p), p, through=1)
    assert rays.ok.all()
    i = np.arcsin(p / radius)
    angle = launch.theta - (i - np.arcsin(np.sin(i) / n))
    # Roundings of 1e-16 in sines near 1 are 1e-15 in angles of up to 82 deg; ten operations.
    np.testing.assert_allclose(rays.direction[1], np.sin(angle), rtol=0, atol=1e-14)
    np.testing.assert_allclose(rays.direction[2], np.cos(angle), rtol=0, atol=1e-14)
    # From the plane through the centre back to the sphere: -sqrt(R^2 - p^2).
    np.testing.assert_allclose(rays.path, -np.sqrt(radius**2 - p**2), rtol=0, atol=1e-13)


def meridional(surfaces, y, u):
    """Trace one ray of the y-z plane through (radius, index behind, thickness), by angles alone.

    Returns its height and angle at the last vertex plane; the first vertex is at the origin.
    """
    z, n = 0.0, 1.0
    for radius, behind, thickness in surfaces:
        if np.isinf(radius):
            y = y - z * np.tan(u)
            u = np.arcsin(n / behind * np.sin(u))
            z = 0.0
        else:
            off = (radius - z) * np.sin(u) + y * np.cos(u)  # from the centre of the sphere
            along = (radius - z) * np.cos(u) - y * np.sin(u)
            t = along - np.sign(radius) * np.sqrt(radius**2 - off**2)
            y, z = y + t * np.sin(u), z + t * np.cos(u)
            i = np.arcsin(off / radius)
            u = u - i + np.arcsin(n / behind * np.sin(i))
        n, z = behind, z - thickness
    return y - z * np.tan(u), u


def test_chief_rays_of_a_fisheye_are_those_that_leave_the_centre_of_its_stop():
    # From the centre of the stop backwards to the object and forwards to the image, by angles: no
    # aiming, no launch plane, no vectors.
    system = build(fisheye())
    index = system.index(D_LINE)
    n = index[:, 0]
    rows = [(s.vertex_curvature, s.thickness) for s in system.prescription.surfaces]
    stop = system.geometry.stop
    radii = [1 / c if c else np.inf for c, _ in rows]
    last = system.image_z_mm - system.geometry.vertex_z[-1]
    gaps = [t for _, t in rows[:-1]] + [last]
    back = [(np.inf, 1.0, gaps[stop - 1])] + [
        (-radii[s], n[s], gaps[s - 1] if s else 0.0) for s in range(stop - 1, -1, -1)
    ]
    forth = [(radii[s], n[s + 1], gaps[s]) for s in range(stop, len(rows))]
    reached = []
    for u in (0.1, 0.3, 0.45, 0.5, 0.55):
        _, outside = meridional(back, 0.0, -u)
        height, _ = meridional(forth, 0.0, u)
        rays = sample_rays(system, index, -outside, np.zeros(1), np.zeros(1))
        # The miss at the stop, 1e-9 of its 0.3 mm, and some 50 roundings of 1e-15 mm.
        assert rays.chief_y_mm[0] == pytest.approx(height, abs=1e-9)
        reached.append(np.degrees(-outside))
    assert reached[0] < 30
    assert reached[-1] > 95


@pytest.mark.parametrize("field", [30.0, 90.0, 105.0])
def test_rays_of_a_fisheye_start_on_a_wavefront_and_land_where_they_were_sent(field):
    system = build(fisheye())
    index = system.index(np.array([450.0, 650.0]))
    radius = system.stop_radius_mm
    tolerance = 1e-9 * radius
    launch, reached = launch_field(system.geometry, index, np.radians(field), tolerance)
    assert reached.all()
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    x, y = np.append(radius * np.cos(angle), 0.0), np.append(radius * np.sin(angle), 0.0)
    px, py, found = aim(system.geometry, index, launch, x, y, tolerance_mm=tolerance)
    assert found.all()
    rays = trace(system.geometry, index, launch, px, py)
    assert rays.ok.all()
    stop = system.geometry.stop
    assert np.hypot(rays.x[stop] - x, rays.y[stop] - y).max() < tolerance
    # The chief ray starts where it meets the first surface, at the base.
    chief = np.array([rays.x[0], rays.y[0], rays.z[0]])[:, :, -1]
    np.testing.assert_allclose(chief, launch.base, rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.hypot(px, py)[:, -1], 0, atol=1e-8)
    starts = launch.points(px, py) - launch.base[:, :, None]
    np.testing.assert_allclose(np.einsum("cl,clr->lr", launch.direction, starts), 0, atol=1e-14)


def test_nothing_happens_at_90_deg():
    system = build(fisheye())
    index = system.index(D_LINE)
    fields = np.radians(np.linspace(88.0, 92.0, 9))
    zero = np.zeros(1)
    heights = [sample_rays(system, index, t, zero, zero).chief_y_mm[0] for t in fields]
    assert (np.diff(heights) > 0.01).all()
    # f sin(theta)-like: the fourth difference is h f (0.0087)^4 = 1e-8 mm.
    assert np.abs(np.diff(heights, 4)).max() < 1e-7


def test_failed_rays_are_masked_and_finite():
    # A ball of two hemispheres: rays beyond its radius miss it, rays beyond 3.6 mm are totally
    # reflected at its back.
    rows = [{"radius": 10.0, "thickness": 4.0, **model(1.9)}, {"radius": -10.0}]
    system = build(lens(rows, f_number=5.0))
    h = np.linspace(-14, 14, 57)[None]
    with np.errstate(all="raise", under="ignore"):
        rays = trace(system.geometry, system.index(D_LINE), through_vertex(), np.zeros_like(h), h)
    assert not rays.ok[np.abs(h) > 10].any()
    assert rays.ok[np.abs(h) < 3.6].all()
    assert not rays.ok[np.abs(h) > 3.6].any()
    for array in (rays.x, rays.y, rays.point, rays.direction, rays.path):
        assert np.isfinite(array).all()


def test_rays_beyond_an_asphere_are_masked_and_finite():
    # A polynomial that turns back steeply: Newton runs away there and overflows.
    rows = [
        {"radius": 10.0, "asphere": {"a16": -1e-7}, "thickness": 4.0, **model(1.9)},
        {"radius": -10.0, "asphere": {"a14": 1e-6}, "thickness": 4.0},
        {"radius": 30.0, "thickness": 4.0, **model(1.5)},
        {"radius": np.inf},
    ]
    system = build(lens(rows, stop_semi_diameter_mm=0.5, max_field_deg=0.0))
    h = np.linspace(-14, 14, 57)[None]
    rays = trace(system.geometry, system.index(D_LINE), through_vertex(40), h, h)
    assert not rays.ok[np.abs(h) > 8].any()
    for array in (rays.x, rays.y, rays.point, rays.direction, rays.path):
        assert np.isfinite(array).all()


def test_a_field_that_no_chief_ray_reaches_is_an_error():
    rows = [
        {"radius": 10.0, "thickness": 6.0, "semi_diameter": 9.0, **model(1.9)},
        {"radius": np.inf, "thickness": 6.0, "semi_diameter": 9.0},
        {"radius": np.inf},
    ]
    system = build(lens(rows, stop=3, f_number=8.0, max_field_deg=80.0))
    with pytest.raises(UserError, match="chief ray does not pass"):
        sample_rays(system, system.index(D_LINE), np.radians(80), np.zeros(1), np.zeros(1))


def test_cooke_triplet_has_the_focal_length_that_another_program_gives():
    # optiland 0.6.3 with Hikari's SK16: 49.99978 mm at 550 nm, as printed.
    lens_50mm = load_prescription("cooke-triplet")
    surfaces = list(lens_50mm.surfaces)
    for i in (0, 4):
        surfaces[i] = surfaces[i].model_copy(update={"glass": "HIKARI/SK16"})
    lens_50mm = lens_50mm.model_copy(update={"surfaces": tuple(surfaces)})
    assert first_order(lens_50mm, 550.0).efl_mm == pytest.approx(49.99978, abs=0.5e-5)


def test_chief_rays_of_the_double_gauss_agree_with_rayoptics(double_gauss):
    # rayoptics 0.9.8 with the same indices at 550 nm, f = 8.3 mm, f/2.8, image at the paraxial
    # focus of the d line: focal length and heights in mm, to the digits printed.
    lens_8mm = double_gauss.scaled(8.3).stopped(2.8).model_copy(update={"focus": "paraxial"})
    assert first_order(lens_8mm, 550.0).efl_mm == pytest.approx(8.297371280406264, rel=1e-13)
    system = build(lens_8mm)
    index = indices(lens_8mm, np.array([550.0]))
    for field, height in (
        (7, 1.018053065),
        (10, 1.460281325),
        (14, 2.059861002),
        (20, 2.988375866),
    ):
        samples = sample_rays(system, index, np.radians(field), np.zeros(1), np.zeros(1))
        assert samples.chief_y_mm[0] == pytest.approx(height, abs=2e-9)

"""Extreme lenses: a ray obeys Snell's law at every surface or is counted as failed; never NaN."""

import numpy as np
import pytest
from lens.made import lens, model

from gpusim.errors import UserError
from gpusim.lens.aim import aim, launch_field
from gpusim.lens.geometry import Geometry
from gpusim.lens.launch import Launch
from gpusim.lens.samples import sample_field, sample_rays
from gpusim.lens.surface import tilt_matrix
from gpusim.lens.system import build
from gpusim.lens.trace import trace
from gpusim.psf.compute import compute_bank

GREEN = np.array([550.0])


def wild(rng):
    """Return the geometry and the indices of four surfaces that nobody would make."""
    count = 4
    asphere = np.zeros((count, 15))
    if rng.random() < 0.5:
        asphere[rng.integers(count), :4] = rng.normal(size=4) * [0.02, 1e-3, 1e-5, 1e-7]
    moved = rng.random() < 0.5
    tilts = rng.uniform(-40, 40, (count, 2)) * moved
    geometry = Geometry(
        curvature=rng.uniform(-0.2, 0.2, count) * (rng.random(count) < 0.8),
        conic=rng.uniform(-3, 2, count) * (rng.random(count) < 0.5),
        asphere=asphere,
        vertex_z=np.cumsum(rng.uniform(0, 8, count)),
        stop=int(rng.integers(count)),
        decentre=rng.uniform(-2, 2, (count, 2)) * moved,
        rotation=np.array([tilt_matrix(tilt) for tilt in tilts]),
    )
    index = np.concatenate([[[1.0, 1.0]], rng.uniform(1.0, 2.0, (count, 2))])
    return geometry, index


def sag_and_normal(geometry, s, x, y):
    """Return the sag, 0 where there is none, and the unit normal of a surface, by its equation."""
    c, k, a = geometry.curvature[s], geometry.conic[s], geometry.asphere[s]
    r2 = x * x + y * y
    root = np.sqrt(1 - (1 + k) * c * c * r2)
    powers = np.arange(1, len(a) + 1)[:, None]
    sag = c * r2 / (1 + root) + (a[:, None] * r2**powers).sum(0)
    slope = 2 * (c / (2 * root) + (powers * a[:, None] * r2 ** (powers - 1)).sum(0))
    normal = np.stack([-slope * x, -slope * y, np.ones_like(x)])
    return sag, normal / np.linalg.norm(normal, axis=0)


def obeys_snell(geometry, index, launch, rays, line):
    """Check the points, directions and paths of the rays of one wavelength that passed."""
    good = rays.ok[line]
    before = np.broadcast_to(launch.direction[:, [line]], (3, good.sum()))
    places = np.stack([rays.x, rays.y, rays.z], axis=1)[:, :, line][:, :, good]
    count = len(places)
    path = rays.path[line, good].copy()
    for s in range(count):
        normal_own = sag_and_normal(
            geometry, s, rays.own_x[s, line, good], rays.own_y[s, line, good]
        )
        own = np.stack([rays.own_x[s, line, good], rays.own_y[s, line, good], normal_own[0]])
        vertex = np.array([*geometry.decentre[s], geometry.vertex_z[s]])
        # On the surface, to what the asphere's Newton accepts.
        on_surface = geometry.rotation[s] @ own + vertex[:, None]
        np.testing.assert_allclose(on_surface, places[s], rtol=0, atol=1e-9)
        normal = geometry.rotation[s] @ normal_own[1]
        if s + 1 < count:
            step = places[s + 1] - places[s]
            length = np.linalg.norm(step, axis=0)
            after = step / np.maximum(length, 1e-300)
            sense = np.sign((after * normal).sum(0))  # surfaces may cross: some steps go back
            clear = length > 1e-3  # the direction of a short step is all rounding
            after = after * sense
            path -= index[s + 1, line] * length * sense
        else:
            after, clear = rays.direction[:, line][:, good], np.ones(good.sum(), bool)
        miss = np.cross(index[s, line] * before - index[s + 1, line] * after, normal, axis=0)
        # Places are good to 1e-10 mm, over steps of 1e-3 mm or more.
        assert np.abs(miss[:, clear]).max(initial=0) < 1e-6
        assert ((before * normal).sum(0)[clear] > 0).all()
        before = after
    start = places[0] - path * launch.direction[:, [line]]
    on_plane = launch.direction[:, line] @ (start - launch.base[:, [line]])
    np.testing.assert_allclose(on_plane, 0, atol=1e-8)
    return good.sum()


def test_rays_through_wild_surfaces_obey_snell_or_are_marked():
    rng = np.random.default_rng(7)
    passed = failed = 0
    for _ in range(150):
        geometry, index = wild(rng)
        launch = Launch(rng.uniform(-2.1, 2.1), rng.uniform(-3, 3, (3, 2)))
        px, py = rng.uniform(-6, 6, (2, 2, 60))
        rays = trace(geometry, index, launch, px, py)
        for array in vars(rays).values():
            assert array is None or np.isfinite(array).all()  # crossings were not asked for
        np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=0), 1, rtol=0, atol=1e-12)
        for line in (0, 1):
            count = obeys_snell(geometry, index, launch, rays, line)
            passed += count
            if count > 10:
                kept = geometry, index, launch, rays, line
            failed += (~rays.ok[line]).sum()
    # The check can fail: it knows an index that is 1e-4 off.
    geometry, index, launch, rays, line = kept
    wrong = index.copy()
    wrong[1] += 1e-4
    with pytest.raises(AssertionError):
        obeys_snell(geometry, wrong, launch, rays, line)
    # The sample holds plenty of both.
    assert passed > 1000
    assert failed > 1000


def test_aiming_through_wild_surfaces_finds_the_point_or_says_that_it_did_not():
    rng = np.random.default_rng(8)
    reached = lost = 0
    for _ in range(12):
        geometry, index = wild(rng)
        theta = rng.uniform(-2.1, 2.1)
        launch, found = launch_field(geometry, index, theta, 1e-8)
        assert launch.theta == theta
        assert np.isfinite(launch.base).all()
        reached += found.sum()
        lost += (~found).sum()
        if not found.all():
            continue
        x, y = rng.uniform(-4, 4, (2, 12))
        px, py, aimed = aim(geometry, index, launch, x, y, tolerance_mm=1e-8)
        rays = trace(geometry, index, launch, px, py, through=geometry.stop + 1)
        miss = np.hypot(rays.own_x[-1] - x, rays.own_y[-1] - y)
        assert (miss[aimed] < 1e-8).all()
        assert rays.ok[aimed].all()
        assert np.isfinite(px).all()
        assert np.isfinite(py).all()
        reached += aimed.sum()
        lost += (~aimed).sum()
    assert reached > 20
    assert lost > 20


def test_a_chief_ray_that_is_totally_reflected_is_an_error():
    # Inside glass of index 1.8, light from 80 deg runs at 33.2 deg; a back turned by 10 deg more
    # reflects it, for sin(43.2 deg) > 1 / 1.8.
    rows = [
        {"radius": np.inf, "thickness": 5.0, **model(1.8)},
        {"radius": -30.0, "tilt_deg": [10.0, 0.0]},
    ]
    system = build(lens(rows, f_number=8.0, max_field_deg=80.0))
    index, zero = system.index(GREEN), np.zeros(1)
    assert sample_rays(system, index, np.radians(20), zero, zero).ok.all()
    with pytest.raises(UserError, match="chief ray does not pass the lens at 80 deg"):
        sample_rays(system, index, np.radians(80), zero, zero)


@pytest.mark.parametrize("degrees", [91.0, 119.0, -100.0])
def test_a_field_behind_a_flat_lens_is_an_error(degrees):
    rows = [{"radius": np.inf, "thickness": 5.0, **model(1.5)}, {"radius": -30.0}]
    system = build(lens(rows, max_field_deg=10.0))
    with pytest.raises(UserError, match="chief ray does not pass"):
        sample_field(system, system.index(GREEN), np.radians(degrees))


def test_rays_that_fail_within_the_stop_are_counted_in_the_bank():
    # A ball of index 1.9 whose marginal rays are totally reflected at its back, beyond 4 mm of its
    # radius of 10 mm; the stop is 4.4 mm: a sixth of its area.
    rows = [
        {"radius": np.inf, "thickness": 0.5},
        {"radius": 10.0, "thickness": 4.0, "semi_diameter": 9.0, **model(1.9)},
        {"radius": -10.0, "semi_diameter": 9.0},
    ]
    ball = lens(rows, stop_semi_diameter_mm=4.4, max_field_deg=2.0)
    system = build(ball)
    samples = sample_field(system, system.index(GREEN), 0.0)
    in_stop = samples.margin[-1] < 0
    assert (~samples.ok & in_stop).sum() == pytest.approx(in_stop.sum() / 6, rel=0.2)
    for name, array in vars(samples).items():
        # A lens without coatings loses nothing.
        assert name == "entering" or array is None or np.isfinite(array).all()
    bank = compute_bank(ball, [550.0], [0.0, 2.0], size=64, pitch_um=0.15)
    assert (bank.failed_rays[:, 0] > 50).all()
    for name in ("psf", "real_height_um", "relative_illumination", "fit_residual_waves"):
        assert np.isfinite(getattr(bank, name)).all()


def test_a_wavelength_that_no_light_of_passes_is_an_error(demo_lens):
    # Red passes a pinhole far off the axis that blue misses by lateral colour.
    rows = [
        {"radius": np.inf, "thickness": 2.0},
        {"radius": np.inf, "thickness": 30.0, "glass": "model", "nd": 1.7, "vd": 20.0},
        {"radius": -40.0, "thickness": 0.0},
        {"radius": np.inf, "thickness": 30.0, "semi_diameter": 9.15},
        {"radius": np.inf},
    ]
    wide = lens(rows, stop_semi_diameter_mm=0.02, max_field_deg=30.0)
    system = build(wide)
    index, zero = system.index(np.array([450.0, 650.0])), np.zeros(1)
    angles = np.radians(np.linspace(20, 30, 201))
    heights = np.array([sample_rays(system, index, t, zero, zero).margin[3, :, 0] for t in angles])
    split = np.flatnonzero((heights[:, 0] < -0.01) & (heights[:, 1] > 0.01))
    assert split.size
    with pytest.raises(UserError, match="no light passes"):
        sample_field(system, index, angles[split[0]])

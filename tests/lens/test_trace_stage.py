"""The tracer on the device against the float64 tracer `gpusim.lens.trace`, ray by ray.

Tolerances. A ray meets up to eleven surfaces with some 30 roundings each, of coordinates of up to
20 mm and of angles; most of them are small: ANGLE and PLACE_MM are 30 and 20 roundings in all. By
Fermat the path is right to second order: (5e-6 mm)^2 over gaps of 0.5 mm are 5e-11 mm, 1e-7 waves;
100 roundings of 2^-44 of paths of 50 mm are 3e-10 mm, 6e-7 waves at most. The oval's two
surfaces and 100 mm take a dozen roundings of 2^-47, 2e-8 waves, and on its axis no W to cover
them up. W belongs to the direction that the device found, so the reference is moved there along its
slope, minus the landing. Three roundings of the result: of W in mm, of 1 / lambda, of their
product.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from lens.made import lens, model
from lens.rays import LENSES, LINES, bound, exact
from optics.made import ULP

from gpusim.gpu import Device
from gpusim.lens.geometry import Geometry
from gpusim.lens.samples import field_launch
from gpusim.lens.system import System, build
from gpusim.lens.trace import trace
from gpusim.lens.tracer import ACROSS, GROUP, Beams, Traced, split, starts

ANGLE, PLACE_MM, WAVES = 2e-6, 2e-5, 7e-7
# The polynomial's a28 and a30 are below 1e-38 mm^(1-k), which f32 would flush: 1e-7 waves at the
# rim. In the unit of shaders/common/surface they are not.
EXACT = {"two ovals": 2e-8, "oval": 2e-8, "polynomial oval": 2e-8}
MADE = {}


def made(device: Device, name: str) -> tuple[System, Beams]:
    """Return a lens and its beams, made once for all tests."""
    if name not in MADE:
        make, fields = LENSES[name]
        system = make()
        MADE[name] = system, Beams(device, system, LINES, np.radians(fields))
    return MADE[name]


def across_stop(beams: Beams, size: float, seed: int = 1, count: int = 150) -> np.ndarray:
    """Return rays (P, R, 2) of every beam, spread over ``size`` times its entrance."""
    rng = np.random.default_rng(seed)
    wanted = rng.uniform(-size, size, (count, 2)) * beams.system.stop_radius_mm
    aim = beams.device.read(beams._pairs).reshape(beams.count, -1)[:, -4:]
    # The linear start of the aim will do: any rays will.
    return np.einsum("pka,rk->pra", aim.reshape(-1, 2, 2), wanted).astype(np.float32)


def check(beams: Beams, theta: float, p: np.ndarray, found: Traced, waves: float = WAVES) -> None:
    """Compare the rays of one field's beams, (L R), beam after beam."""
    lines = beams.wavelengths_nm
    count = len(p) // len(lines)
    for line in range(len(lines)):
        part = slice(line * count, (line + 1) * count)
        truth = exact(beams.system, lines[line : line + 1], theta, p[part])
        assert_close(found.failed_at[part], truth.failed_at[0], atol=0)
        assert_close(found.cosines[part], truth.cosines[0], atol=ANGLE)
        assert_close(found.landing_mm[part], truth.landing_mm[0], atol=PLACE_MM, rtol=ANGLE)
        # Heights are off by PLACE_MM, a share of 2 PLACE_MM / radius of their squares.
        smallest = min(beams.system.stop_radius_mm, beams.system.semi_diameter_mm.min())
        assert_close(found.reach[part], truth.reach[0], rtol=2 * PLACE_MM / smallest, atol=2e-6)
        off = found.cosines[part] - truth.cosines[0]
        moved = truth.opd_waves[0] - (truth.landing_mm[0] * off).sum(-1) / (1e-6 * lines[line])
        assert_close(found.opd_waves[part], moved, atol=waves + 3 * ULP * np.abs(moved))


@pytest.mark.parametrize("name", LENSES)
def test_rays_are_those_of_the_reference(device: Device, name: str):
    _, beams = made(device, name)
    p = across_stop(beams, 1.1)
    for number, theta in enumerate(beams.angles):
        of_field = range(number * len(LINES), (number + 1) * len(LINES))
        rays = p[list(of_field)].reshape(-1, 2)
        found = beams.trace(rays, np.repeat(of_field, p.shape[1]))
        assert (found.failed_at == 0).mean() > 0.8
        check(beams, float(theta), rays, found, EXACT.get(name, WAVES))


def test_the_comparison_finds_planted_errors(device: Device):
    _, beams = made(device, "double gauss")
    p = across_stop(beams, 1.1)[:2].reshape(-1, 2)
    found = beams.trace(p, np.repeat([0, 1], len(p) // 2))
    good = vars(found)
    check(beams, 0.0, p, Traced(**good))
    for name, error in {
        "opd_waves": 1e-5,
        "reach": 1e-4,
        "landing_mm": 3e-5,
        "cosines": 4e-6,
        "failed_at": 1,
    }.items():
        with pytest.raises(AssertionError, match="elements are bad"):
            check(beams, 0.0, p, Traced(**good | {name: good[name] + error}))


def test_the_chief_rays_have_no_opd_and_land_at_the_origin(device: Device):
    for name in LENSES:
        _, beams = made(device, name)
        found = beams.trace(np.zeros((beams.count, 2)), np.arange(beams.count))
        # Without W there is nothing to round but the path.
        assert_close(found.opd_waves, np.zeros(beams.count), atol=WAVES)
        assert_close(found.landing_mm, np.zeros((beams.count, 2)), atol=PLACE_MM)
        assert_close(found.cosines[:, 1], beams.chief_beta.ravel(), atol=ANGLE)


@dataclass(frozen=True)
class Held(System):
    """A system whose media are given, air or not."""

    media: tuple[float, ...]

    def index(self, wavelengths_nm: np.ndarray) -> np.ndarray:
        """Return the media at every wavelength."""
        return np.tile(np.array(self.media)[:, None], (1, len(wavelengths_nm)))


def held(curvature, vertex_z, stop, image_z, media) -> Held:
    count = len(curvature)
    shape = Geometry(
        curvature=np.array(curvature),
        conic=np.zeros(count),
        asphere=np.zeros((count, 15)),
        vertex_z=np.array(vertex_z),
        stop=stop,
        decentre=np.zeros((count, 2)),
        rotation=np.broadcast_to(np.eye(3), (count, 3, 3)),
    )
    return Held(None, shape, 0.5, np.full(count, np.inf), image_z, media)


def test_rays_that_run_against_z_between_surfaces_have_their_path(device: Device):
    # A bowl of little power before a strong one: at 100 deg rays go back by 0.9 mm between them.
    # They could not leave into air.
    system = held([0.1, 0.2, 0.0], [0.0, 5.0, 8.9], 2, 9.0, (1.0, 1.05, 2.4, 2.4))
    line, theta = LINES[:1], np.radians(100.0)
    beams = Beams(device, system, line, np.array([theta]))
    p = np.random.default_rng(4).uniform(-0.05, 0.05, (60, 2)).astype(np.float32)
    p[0] = 0.0  # the chief ray
    found = beams.trace(p, np.zeros(60, int))
    index = system.index(line)
    launch = field_launch(system, index, theta)
    rays = trace(system.geometry, index, launch, *p.astype(float).T[:, None])
    assert rays.ok.all()
    assert (rays.z[1] - rays.z[0] < -0.8).all()
    assert (found.failed_at == 0).all()
    to_plane = (system.image_z_mm - rays.point[2]) / rays.direction[2]
    lands = rays.point + to_plane * rays.direction
    to_chief = lands[:, :, :1] - rays.point
    path = rays.path + 2.4 * (to_chief * rays.direction).sum(axis=0)
    w = (path - path[:, :1])[0] / (1e-6 * line[0])
    off = found.cosines - rays.direction[:2, 0].T
    landing = (lands - lands[:, :, :1])[:2, 0].T
    moved = w - 2.4 * (landing * off).sum(-1) / (1e-6 * line[0])
    assert np.abs(w).max() > 0.3
    # The host takes the image to lie in air, which adds a piston here. Rays leave at 82 deg: what
    # is of second order grows with 1 / gamma^3 = 350.
    bound_ = 350 * WAVES + 3 * ULP * np.abs(found.opd_waves).max()
    assert_close(found.opd_waves - found.opd_waves[0], moved, atol=bound_)
    beams.release()


def test_a_ray_that_leaves_against_the_light_fails_at_the_last_surface(device: Device):
    # In glass, the stop at the centre of the last surface: the chief ray is not bent, and leaves at
    # 85 deg; rays beside it are turned beyond 90 deg on one side, and totally reflected far out.
    system = held([0.0, -0.2], [0.0, 5.0], 0, 6.0, (2.0, 2.0, 1.0))
    theta = np.radians(85.0)
    beams = Beams(device, system, LINES[:1], np.array([theta]))
    p = np.stack([np.zeros(101), np.linspace(-2.4, 2.4, 101)], axis=1).astype(np.float32)
    found = beams.trace(p, np.zeros(101, int))
    truth = exact(system, LINES[:1], theta, p)
    rays = trace(
        system.geometry,
        system.index(LINES[:1]),
        field_launch(system, system.index(LINES[:1]), theta),
        np.zeros((1, 101)),
        p[None, :, 1].astype(float),
    )
    assert (rays.ok[0] & (rays.direction[2, 0] <= 0)).sum() > 20
    assert_close(found.failed_at, truth.failed_at[0], atol=0)
    beams.release()


def crossing() -> System:
    """Return a lens whose surfaces cross 2.2 mm from the axis: beyond, light goes back a little."""
    rows = [
        {"radius": 5.0, "thickness": 0.5, **model(1.5)},
        {"radius": np.inf, "thickness": 2.0},
        {"radius": np.inf},
    ]
    return build(lens(rows, stop=3, stop_semi_diameter_mm=3.2, max_field_deg=0.0))


def test_where_surfaces_cross_the_path_is_negative(device: Device):
    system = crossing()
    beams = Beams(device, system, LINES, np.zeros(1))
    p = across_stop(beams, 1.0)[:1].repeat(2, axis=0).reshape(-1, 2)
    found = beams.trace(p, np.repeat([0, 1], len(p) // 2))
    assert (np.hypot(*p.T) > 2.3).mean() > 0.2
    check(beams, 0.0, p, found)
    beams.release()


def test_every_surface_can_lose_rays(device: Device):
    # 1 and 3: rays pass beside sphere and ellipsoid; 2 and 4: they are totally reflected.
    rows = [
        {"radius": 8.0, "thickness": 2.0, **model(1.3)},
        {"radius": -30.0, "thickness": 1.0},
        {"radius": 4.0, "conic": 1.0, "thickness": 1.5, **model(1.6)},
        {"radius": np.inf, "thickness": 1.0},
        {"radius": np.inf},
    ]
    system = build(lens(rows, stop=5, f_number=8.0, max_field_deg=0.0))
    beams = Beams(device, system, LINES[:1], np.zeros(1))
    p = np.random.default_rng(3).uniform(-9, 9, (3000, 2)).astype(np.float32)
    truth = exact(system, LINES[:1], 0.0, p).failed_at[0]
    found = beams.trace(p, np.zeros(3000, int))
    assert np.unique(truth).tolist() == [0, 1, 2, 3, 4]
    # Rays within 1e-5 of a border may fall on either side: 3000 hit it with a chance of 1 in 100.
    assert_close(found.failed_at, truth, atol=0)
    lost = truth > 0
    for values in (found.opd_waves, found.reach, found.landing_mm, found.cosines):
        assert (values[lost] == 0).all()
    assert (found.reach[~lost] > 0).all()
    beams.release()


def inputs(device: Device, beams: Beams, rays: np.ndarray) -> dict[str, np.ndarray]:
    return bound(device, beams) | {"rays": rays}


def params(beams: Beams, rays: int, across: int) -> dict[str, object]:
    geometry = beams.system.geometry
    return {
        "zero": 0,
        "terms": beams.terms,
        "per_unit2": beams.per_unit2,
        "surfaces": len(geometry.curvature),
        "stop": geometry.stop + 1,
        "rays": rays,
        "across": across,
        "inverse_stop2": beams.system.stop_radius_mm**-2.0,
    }


@pytest.mark.parametrize(("count", "across"), [(64, 1), (65, 1), (300, 2), (700, 3), (1, 5)])
def test_results_go_where_they_are_wanted_over_several_rows(device: Device, count, across):
    _, beams = made(device, "double gauss")
    # The last one passes beside the lens.
    p = np.resize(across_stop(beams, 1.1)[0], (count, 2)) * np.linspace(0.5, 1, count)[:, None]
    p[-1] = 50.0
    pair = np.arange(count) % beams.count
    to = np.random.default_rng(count).permutation(count + 7)[:count]
    groups = -(-count // GROUP)
    found = run_stage(
        "lens/trace",
        (min(groups, across), -(-groups // across), 1),
        params(beams, count, across),
        inputs(device, beams, starts(p, pair, to)),
        {name: ((count + 7, 4), np.float32) for name in ("opd", "directions")},
    )
    straight = beams.trace(p, pair)
    rest = np.setdiff1d(np.arange(count + 7), to)
    assert unwritten(found["opd"][rest]).all()
    assert unwritten(found["directions"][rest]).all()
    together = np.column_stack([straight.opd_waves, straight.reach, straight.landing_mm])
    assert_close(found["opd"][to], together, atol=0)
    assert_close(found["directions"][to, :2], straight.cosines.copy(), atol=0)
    assert_close(found["directions"][to, 2], straight.failed_at.astype(float), atol=0)
    assert_close(found["directions"][to, 3], np.zeros(count), atol=0)
    assert straight.failed_at[-1] > 0
    assert (straight.failed_at[:-1] == 0).all()


def test_the_host_dispatches_rows_that_adapters_allow():
    assert ACROSS <= 65535
    assert GROUP == 64


def test_numbers_are_split_into_two_parts_without_loss():
    values = np.array([[1 / 3, -np.pi], [1e-5 / 7, 0.0]])
    parts = split(values)
    assert parts.dtype == np.float32
    assert parts.shape == (2, 2, 2)
    # 24 bits and 24 more: half a unit of the 48th.
    assert_close(parts.astype(float).sum(axis=-1), values, rtol=2.0**-48)
    assert (np.abs(parts[..., 1]) <= np.abs(values) * ULP).all()


def test_starts_hold_bits_of_integers():
    rays = starts(np.array([[0.5, -1.5]]), np.array([3]), np.array([2**24 + 1]))
    assert rays.shape == (1, 4)
    assert rays[0, :2].tolist() == [0.5, -1.5]
    assert rays.view(np.uint32)[0, 2:].tolist() == [3, 2**24 + 1]

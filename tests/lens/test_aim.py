"""Aiming at the stop on the device, judged by the float64 tracer.

Tolerance. A ray counts as aimed within GOOD, 2e-5 of the stop's radius. Where it really meets the
stop differs from where f32 says by some ten roundings of coordinates of up to 15 mm: 2e-5 of the
0.44 mm of the fisheye's stop, the smallest here.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from lens.made import lens, model
from lens.rays import LENSES, LINES, bound

from gpusim.gpu import Device
from gpusim.lens.samples import field_launch
from gpusim.lens.system import System, build
from gpusim.lens.trace import trace
from gpusim.lens.tracer import Beams

GOOD, ROUNDING = 2e-5, 2e-5
MADE = {}


def made(device: Device, name: str) -> Beams:
    """Return the beams of a lens, made once for all tests."""
    if name not in MADE:
        make, fields = LENSES[name]
        MADE[name] = Beams(device, make(), LINES, np.radians(fields))
    return MADE[name]


def on_stop(system: System, line: float, theta: float, p: np.ndarray):
    """Return where rays meet the stop, in float64, and which do."""
    index = system.index(np.array([line]))
    launch = field_launch(system, index, theta)
    px, py = p.astype(float).T[:, None]
    rays = trace(system.geometry, index, launch, px, py, through=system.geometry.stop + 1)
    return np.stack([rays.x[-1, 0], rays.y[-1, 0]], axis=-1), rays.ok[0]


def misses(beams: Beams, wanted: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return by how much rays (P, R, 2) miss what was wanted, in stop radii; infinite: all."""
    found = []
    for pair, rays in enumerate(p):
        field, line = divmod(pair, len(beams.wavelengths_nm))
        at, ok = on_stop(beams.system, beams.wavelengths_nm[line], float(beams.angles[field]), rays)
        miss = np.hypot(*(at - wanted).T) / beams.system.stop_radius_mm
        found.append(np.where(ok, miss, np.inf))
    return np.array(found)


def disc(radius: float, count: int = 130, seed: int = 2) -> np.ndarray:
    """Return points of the stop, a few of them at its middle and on its axes."""
    rng = np.random.default_rng(seed)
    r, phi = radius * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    points = np.stack([r * np.cos(phi), r * np.sin(phi)], axis=-1)
    points[:5] = np.array([[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]]) * radius
    return points.astype(np.float32).astype(float)


@pytest.mark.parametrize("name", ["double gauss", "phone", "fisheye"])
def test_rays_meet_the_stop_where_they_were_sent(device: Device, name: str):
    beams = made(device, name)
    wanted = disc(1.05 * beams.system.stop_radius_mm)
    p, miss = beams.aim(wanted)
    assert p.shape == (beams.count, len(wanted), 2)
    assert (miss >= 0).all()
    assert (miss < GOOD).all()
    real = misses(beams, wanted, p)
    assert real.max() < GOOD + ROUNDING
    assert_close(miss, real, atol=ROUNDING)
    # Rays of another field miss by more.
    others = misses(beams, wanted, np.roll(p, len(LINES), axis=0))
    assert np.median(others) > 10 * (GOOD + ROUNDING)
    # The chief ray's search starts where it is: at the base of the launch plane.
    assert np.abs(p[:, 0]).max() < ROUNDING * beams.system.stop_radius_mm


def in_turns(device: Device, beams: Beams, wanted: np.ndarray, turns: int) -> np.ndarray:
    """Return what the shader finds in so many turns, (P, R, 4)."""
    params = {
        "terms": beams.terms,
        "per_unit2": beams.per_unit2,
        "stop": beams.system.geometry.stop + 1,
        "rays": len(wanted),
        "radius": beams.system.stop_radius_mm,
    }
    return run_stage(
        "lens/aim",
        (-(-len(wanted) // 64), beams.count, 1),
        params,
        bound(device, beams) | {"wanted": wanted.astype(np.float32)},
        {"aimed": ((beams.count, len(wanted), 4), np.float32)},
        TURNS=turns,
    )["aimed"]


def test_where_the_stop_is_a_plane_before_the_lens_the_start_is_the_end(device: Device):
    # The stop is the first surface: stop points go linearly with the launch plane's.
    beams = made(device, "phone")
    wanted = disc(beams.system.stop_radius_mm)
    found = in_turns(device, beams, wanted, 1)
    assert (found[..., 2] >= 0).all()
    assert misses(beams, wanted, found[..., :2]).max() < ROUNDING
    assert np.ptp(found[2, :, 1]) < 0.98 * np.ptp(found[0, :, 1])  # seen from 20 deg


def test_what_counts_as_a_hit_is_a_share_of_the_stops_radius(device: Device):
    # A stop of 20 mm: roundings of 20 mm are 1e-6 mm, 6e-8 of it.
    beams = made(device, "oval")
    wanted = disc(beams.system.stop_radius_mm)
    p, miss = beams.aim(wanted)
    assert (miss >= 0).all()
    assert misses(beams, wanted, p).max() < 1e-6


@pytest.mark.parametrize("name", ["double gauss", "fisheye"])
def test_newton_converges_as_newton_does(device: Device, name: str):
    # From a start that is 1e-2 of the stop off, or 0.1 at 105 deg, its square and the square of
    # that remain, and 1e-3 of it at each turn from the differences.
    beams = made(device, name)
    wanted = disc(beams.system.stop_radius_mm)
    assert (in_turns(device, beams, wanted, 1)[..., 2] < 0).mean() > 0.5
    assert (in_turns(device, beams, wanted, 4)[..., 2] >= 0).all()


def strong() -> System:
    """Return a ball's front with a stop far behind its focus: only a third reaches it straight.

    Height h of a ray and where it meets the stop: 30 mm behind, -1.5 h near the axis, but -7.6 mm
    for h = 3.2, by sin i = h / 4, sin i' = sin i / 1.5. From 7.5 mm on the linear start misses the
    ball.
    """
    rows = [
        {"radius": 4.0, "thickness": 30.0, **model(1.5)},
        {"radius": np.inf, "thickness": 1.0, **model(1.5)},
        {"radius": np.inf, "thickness": 10.0},
    ]
    return build(lens(rows, stop=2, stop_semi_diameter_mm=7.6, max_field_deg=0.0, focus="as-given"))


def test_a_start_that_misses_is_drawn_to_the_chief_ray(device: Device):
    system = strong()
    beams = Beams(device, system, LINES, np.zeros(1))
    angle = np.linspace(0, 2 * np.pi, 70, endpoint=False)
    wanted = 7.55 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    aim = device.read(beams._pairs).reshape(2, -1)[0, -4:].reshape(2, 2)
    assert not on_stop(system, LINES[0], 0.0, wanted @ aim)[1].any()
    p, miss = beams.aim(wanted)
    assert (miss >= 0).all()
    assert misses(beams, wanted, p).max() < GOOD + ROUNDING
    beams.release()


def test_points_that_no_ray_reaches_are_flagged(device: Device):
    system = strong()
    beams = Beams(device, system, LINES, np.zeros(1))
    # The ray that grazes the ball, h = 4, is the last one: sin i' = 1 / 1.5.
    refracted = np.arcsin(1 / 1.5)
    farthest = 4 - 26 * np.tan(np.pi / 2 - refracted)
    near = np.array([[0.0, 1.0], [5.0, 0.0]])
    far = np.array([[0.0, 1.02 * farthest], [-2 * farthest, 0.0], [1e3, 1e3]])
    _, miss = beams.aim(np.concatenate([near, far]))
    assert (miss[:, :2] >= 0).all()
    assert_close(miss[:, 2:], np.full((2, 3), -1.0), atol=0)
    beams.release()


@pytest.mark.parametrize("count", [1, 63, 64, 65, 130])
def test_every_ray_of_every_beam_is_written(device: Device, count: int):
    beams = made(device, "double gauss")
    wanted = disc(beams.system.stop_radius_mm)[:count].astype(np.float32)
    found = run_stage(
        "lens/aim",
        (-(-count // 64), 3, 1),
        {
            "terms": beams.terms,
            "per_unit2": beams.per_unit2,
            "stop": beams.system.geometry.stop + 1,
            "rays": count,
            "radius": beams.system.stop_radius_mm,
        },
        bound(device, beams) | {"wanted": wanted},
        {"aimed": ((4, count, 4), np.float32)},
    )["aimed"]
    p, miss = beams.aim(wanted)
    assert unwritten(found[3]).all()
    assert_close(found[:3, :, :2], p[:3], atol=0)
    assert_close(found[:3, :, 2], miss[:3].copy(), atol=0)
    assert_close(found[:3, :, 3], np.zeros((3, count)), atol=0)

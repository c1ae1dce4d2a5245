"""The launch plane: E + p_x e1 + p_y e2, along d, for fields to and beyond 90 deg.

Tolerance: a product and a sum of numbers of up to 40 mm: 2 roundings of that. Directions from a
point of the object are a sum, a product, a root and a quotient of numbers up to 1.4: 5 roundings.
"""

import numpy as np
import pytest
from harness import assert_close, wgsl_eval
from optics.made import ULP

from gpusim.lens.launch import Launch

# The include brings a surface along, which nothing meets here.
SURFACES = "var<private> surfaces: array<Surface, 1>; var<private> aspheres: array<vec2f, 1>;"


def launched(theta, base, p, distance=np.inf):
    """Return where rays start and where they go, for arrays of the same length."""

    def pair(values):
        return ("vec2f", np.stack([values, np.full(len(values), 3e-9)], axis=-1))

    inputs = {
        "sine": pair(np.sin(theta)),
        "cosine": pair(np.cos(theta)),
        "start_y": pair(base[:, 0]),
        "start_z": pair(base[:, 1]),
        "vergence": ("vec2f", np.stack([np.full(len(p), 1 / distance), np.zeros(len(p))], axis=-1)),
        "p": ("vec2f", p),
    }
    statements = """
        var pair: Pair;
        pair.sine = sine;
        pair.cosine = cosine;
        pair.start_y = start_y;
        pair.start_z = start_z;
        pair.vergence = vergence;
        let ray = launched(pair, p);"""
    return [
        wgsl_eval(
            "launch",
            expression,
            inputs,
            returns="vec4f",
            declarations=SURFACES,
            statements=statements,
            params={"terms": 1, "per_unit2": 1.0},
        ).astype(float)
        for expression in ("vec4f(ray.at, select(0.0, 1.0, ray.ok))", "vec4f(ray.along, 0.0)")
    ]


@pytest.mark.parametrize("distance", [7.0, 50.0, 600.0, 1e9])
def test_rays_come_from_a_point_of_the_object(distance):
    # Planted: without the root, or with the plane's e2 the other way round, 1e-3 and more at 50 mm.
    rng = np.random.default_rng(2)
    theta = np.radians(rng.uniform(-60, 60, 100))
    base, p = rng.uniform(-5, 5, (2, 100, 2)).astype(np.float32).astype(float)
    _, along = launched(theta, base, p, distance)
    for row in range(100):
        chief = np.array([0.0, np.sin(theta[row]), np.cos(theta[row])])
        at = np.array([0.0, *base[row]])
        launch = Launch(theta[row], at[:, None], source=at - distance * chief)
        point, direction, path = launch.rays(p[row, :1, None], p[row, 1:, None])
        assert_close(along[row, :3], direction[:, 0, 0], atol=5 * ULP)
        way = point[:, 0, 0] - launch.source
        # By the difference itself, which loses digits: of 1e9 mm all but 1e-7 mm.
        far = np.linalg.norm(way) - distance
        np.testing.assert_allclose(path[0, 0], far, rtol=0, atol=4e-16 * distance + 1e-14)
        np.testing.assert_allclose(np.cross(way, direction[:, 0, 0]) / distance, 0, atol=1e-12)


def test_rays_start_on_the_plane_of_their_field():
    rng = np.random.default_rng(1)
    degrees = np.repeat([0.0, 30.0, 90.0, 105.0, -20.0], 20)
    theta = np.radians(degrees)
    base = rng.uniform(-9, 9, (100, 2)).astype(np.float32).astype(float)
    p = rng.uniform(-9, 9, (100, 2)).astype(np.float32).astype(float)
    at, along = launched(theta, base, p)
    assert (at[:, 3] == 1).all()
    for row in range(100):
        launch = Launch(theta[row], np.array([[0.0], [base[row, 0]], [base[row, 1]]]))
        start = launch.points(p[row, :1, None], p[row, 1:, None])[:, 0, 0]
        assert_close(at[row, :3], start, atol=2 * 40 * ULP)
        assert_close(along[row, :3], launch.direction[:, 0], atol=ULP)
    # All points lie in the plane: perpendicular to the field, whatever p is.
    off = at[:, 1:3] - base
    across = (off * np.stack([np.sin(theta), np.cos(theta)], axis=-1)).sum(axis=1)
    assert_close(across, np.zeros(100), atol=4 * 40 * ULP)

"""The launch plane: E + p_x e1 + p_y e2, along d, for fields to and beyond 90 deg.

Tolerance: a product and a sum of numbers of up to 40 mm: 2 roundings of that.
"""

import numpy as np
from harness import assert_close, wgsl_eval
from optics.made import ULP

from gpusim.lens.trace import Launch

# The include brings a surface along, which nothing meets here.
SURFACES = "var<private> surfaces: array<Surface, 1>; var<private> aspheres: array<vec2f, 1>;"


def launched(theta, base, p):
    """Return where rays start and where they go, for arrays of the same length."""

    def pair(values):
        return ("vec2f", np.stack([values, np.full(len(values), 3e-9)], axis=-1))

    inputs = {
        "sine": pair(np.sin(theta)),
        "cosine": pair(np.cos(theta)),
        "start_y": pair(base[:, 0]),
        "start_z": pair(base[:, 1]),
        "p": ("vec2f", p),
    }
    statements = """
        var pair: Pair;
        pair.sine = sine;
        pair.cosine = cosine;
        pair.start_y = start_y;
        pair.start_z = start_z;
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
        assert_close(along[row, :3], launch.direction, atol=ULP)
    # Of the plane: perpendicular to the field, whatever p is.
    off = at[:, 1:3] - base
    across = (off * np.stack([np.sin(theta), np.cos(theta)], axis=-1)).sum(axis=1)
    assert_close(across, np.zeros(100), atol=4 * 40 * ULP)

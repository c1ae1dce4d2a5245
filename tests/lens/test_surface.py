"""One surface, on the device: the point lies on ray and surface, and Snell's law holds there.

Judged by the equations themselves, in float64, not by another tracer. Tolerances: rays start within
12 mm of the vertex, coordinates have 24 bits: 20 roundings of 12 mm are 1.5e-5 mm for the point.
Its normal is off by that times the curvature of at most 0.5/mm, and by ten roundings of numbers up
to 3: in Snell's law, with indices up to 2, 2e-5.
"""

from dataclasses import dataclass, field

import numpy as np
import pytest
from harness import assert_close, wgsl_eval
from optics.made import ULP
from sampling import one_in

POINT, SNELL = 20 * 12 * ULP, 2e-5
TERMS = 15
UNIT = 4.0  # mm, of the polynomials


@dataclass(frozen=True)
class Shape:
    """A surface: curvature, conic constant, gap before it, coefficients a2, a4 ..."""

    c: float = 0.0
    conic: float = 0.0
    gap: float = 3.0
    a: dict[int, float] = field(default_factory=dict)

    def sag(self, r2: np.ndarray) -> np.ndarray:
        """Return the sag where x^2 + y^2 = r2."""
        root = np.sqrt(1 - (1 + self.conic) * self.c**2 * r2)
        return self.c * r2 / (1 + root) + sum(a * r2 ** (k // 2) for k, a in self.a.items())

    def slope(self, r: np.ndarray) -> np.ndarray:
        """Return the derivative of the sag with respect to r."""
        root = np.sqrt(1 - (1 + self.conic) * self.c**2 * r**2)
        return self.c * r / root + sum(k * a * r ** (k - 1) for k, a in self.a.items())


SHAPES = {
    "plane": Shape(),
    "convex": Shape(1 / 8, gap=2.0),
    "concave": Shape(-1 / 8, gap=-1.0),
    "ellipsoid": Shape(1 / 9, 0.4),
    "oblate": Shape(-1 / 12, 1.5),
    "paraboloid": Shape(1 / 7, -1.0),
    "hyperboloid": Shape(-1 / 6, -3.0, 1.0),
    "asphere": Shape(1 / 10, -0.7, 2.5, {4: 4e-4, 6: -8e-6, 30: 2e-21}),
    "nothing but a polynomial": Shape(0.0, 0.0, 2.0, {2: 0.04, 4: -3e-4}),
    "flat but for its conic": Shape(1 / 3, -1.0, 2.0, {2: -1 / 6, 4: 1e-3}),
    "steep": Shape(1 / 6.5, 0.0, 3.5, {4: 1e-4}),
    "bowl undone": Shape(0.42, -1.0, 2.0, {2: -0.2735, 4: -0.0029, 30: 1e-17}),
    "convex asphere": Shape(1 / 8, 0.0, 2.0, {4: 1e-7}),
    "one term": Shape(0.0, 0.0, 2.0, {2: 0.05}),
    "hollow asphere": Shape(-1 / 9, 0.3, 1.0, {2: 0.01, 8: 3e-7}),
}
NAMES = list(SHAPES)


def declarations() -> str:
    """Return the shapes as the globals that the include reads."""

    def number(x: float) -> str:
        return f"f32({float(np.float32(x))!r})"

    rows, terms = [], []
    for shape in SHAPES.values():
        count = max(shape.a, default=0) // 2
        parts = [shape.c, 1 + shape.conic, shape.gap]
        pairs = ", ".join(f"vec2f({number(x)}, 0.0)" for x in parts)
        rows.append(f"Surface({pairs}, 0.0, {count}u)")
        terms += [
            f"vec2f({number(shape.a.get(2 * k + 2, 0.0) * UNIT ** (2 * k + 2))}, 0.0)"
            for k in range(TERMS)
        ]
    return (
        f"var<private> surfaces: array<Surface, {len(rows)}> = array({', '.join(rows)});\n"
        f"var<private> aspheres: array<vec2f, {len(terms)}> = array({', '.join(terms)});"
    )


def bend(name: str, at: np.ndarray, along: np.ndarray, ratio: np.ndarray, ok: bool = True):
    """Return where rays are and go behind a surface, and which are ok."""
    inputs = {"at": ("vec3f", at), "along": ("vec3f", along), "ratio": ("f32", ratio)}
    call = f"let ray = bend(Ray(at, along, {str(ok).lower()}), {NAMES.index(name)}u, ratio);"
    there, goes = (
        wgsl_eval(
            "surface",
            expression,
            inputs,
            returns="vec4f",
            declarations=declarations(),
            statements=call,
            params={"terms": TERMS, "per_unit2": UNIT**-2.0},
        ).astype(float)
        for expression in ("vec4f(ray.at, select(0.0, 1.0, ray.ok))", "vec4f(ray.along, 0.0)")
    )
    return there[:, :3], goes[:, :3], there[:, 3] == 1


def unit(vectors: np.ndarray) -> np.ndarray:
    vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors.astype(np.float32).astype(float)


def rays(seed: int, count: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Return rays that start up to 2.5 mm high, within 3 mm of the vertex, up to 23 deg steep."""
    rng = np.random.default_rng(seed)
    at = rng.uniform(-1, 1, (count, 3)) * [1.8, 1.8, 1.0] + [0, 0, 1.0]
    slopes = rng.uniform(-0.3, 0.3, (count, 2))
    return at.astype(np.float32).astype(float), unit(np.column_stack([slopes, np.ones(count)]))


def normals(shape: Shape, points: np.ndarray) -> np.ndarray:
    r = np.hypot(*points[:, :2].T)
    slope = shape.slope(r) / np.where(r > 0, r, 1)
    return unit(np.column_stack([-slope * points[:, 0], -slope * points[:, 1], np.ones(len(r))]))


@pytest.mark.parametrize("name", [name for name in NAMES if name != "bowl undone"])
@pytest.mark.parametrize("ratio", one_in(2, [1 / 1.8, 1.1]))
def test_rays_meet_the_surface_and_obey_snell(name: str, ratio: float):
    shape = SHAPES[name]
    at, along = rays(NAMES.index(name))
    ratio = float(np.float32(ratio))
    there, goes, ok = bend(name, at, along, np.full(len(at), ratio))
    assert ok.all()
    # On the ray: what is across it vanishes. Coordinates count from the new vertex.
    way = there - (at - [0, 0, shape.gap])
    across = way - (way * along).sum(axis=1, keepdims=True) * along
    assert_close(across, 0 * across, atol=POINT)
    # On the surface, on the sheet of the vertex.
    sag = shape.sag((there[:, :2] ** 2).sum(axis=1))
    assert_close(there[:, 2], sag, atol=POINT * 2)
    # n1 d x N = n2 d' x N; forwards; d' of length 1.
    normal = normals(shape, there)
    assert_close(np.cross(goes, normal), ratio * np.cross(along, normal), atol=SNELL)
    assert ((goes * normal).sum(axis=1) > 0).all()
    assert_close((goes**2).sum(axis=1), np.ones(len(goes)), atol=2e-6)
    # The checks see a point that is not on the surface, and a ray that is not bent.
    with pytest.raises(AssertionError, match="elements are bad"):
        assert_close(there[:, 2] + 4e-5, sag, atol=POINT * 2)
    with pytest.raises(AssertionError, match="elements are bad"):
        assert_close(np.cross(along, normal), ratio * np.cross(along, normal), atol=SNELL)


def test_newton_starts_where_the_surface_is_not_where_its_conic_is():
    # A deep bowl whose polynomial takes it back, and a wall from 4 mm on: where steep rays meet
    # the bowl, if they do, Newton's method does not come down the wall in time.
    shape = SHAPES["bowl undone"]
    rng = np.random.default_rng(21)
    at = rng.uniform(-1, 1, (2000, 3)) * [2, 2, 1] + [0, 0, 1.0]
    slopes = rng.uniform(-0.7, 0.7, (2000, 2))
    there = at[:, :2] + slopes * (shape.gap - at[:, 2:])
    near = np.hypot(*there.T) < 2.8
    at = at[near].astype(np.float32).astype(float)
    along = unit(np.column_stack([slopes, np.ones(2000)])[near])
    there, _, ok = bend("bowl undone", at, along, np.full(len(at), 0.6))
    assert len(at) > 800
    assert ok.all()
    assert_close(there[:, 2], shape.sag((there[:, :2] ** 2).sum(axis=1)), atol=2 * POINT)


def test_a_ray_that_has_failed_stays_as_it_was():
    at, along = rays(20, 10)
    there, goes, ok = bend("convex", at, along, np.full(10, 0.7), ok=False)
    assert not ok.any()
    assert_close(there, at - [0, 0, 2.0], atol=3 * ULP)
    assert_close(goes, along.copy(), atol=0)


def parallel(height: np.ndarray, degrees: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return rays of the y-z plane at distances ``height`` from a point 1 mm before the vertex."""
    u = np.radians(degrees)
    height = np.asarray(height, float)[:, None]
    at = np.array([0, 0, 1.0]) + height * [0, np.cos(u), -np.sin(u)]
    return at.astype(np.float32).astype(float), unit(
        np.tile([0, np.sin(u), np.cos(u)], (len(height), 1))
    )


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("convex", 7.999, 8.001),  # beside the sphere
        ("concave", 7.999, 8.001),
        ("ellipsoid", 9 / 1.4**0.5 - 0.001, 9 / 1.4**0.5 + 0.001),
        ("oblate", 12 / 2.5**0.5 - 0.001, 12 / 2.5**0.5 + 0.001),
        ("hollow asphere", 9 / 1.3**0.5 - 0.01, 9 / 1.3**0.5 + 0.01),  # its conic ends there
    ],
)
def test_a_ray_beside_the_surface_misses_it(name: str, low: float, high: float):
    heights = np.array([low, -low, high, -high, 1.2 * high, 3 * high])
    at, along = parallel(heights)
    there, goes, ok = bend(name, at, along, np.full(6, 0.5))
    assert ok.tolist() == [True, True, False, False, False, False]
    assert_close(goes[2:], along[2:].copy(), atol=0)
    assert_close(there[2:], at[2:] - [0, 0, SHAPES[name].gap], atol=3 * 12 * ULP)


def test_a_paraboloid_has_no_edge():
    at, along = parallel(np.array([12.0, -12.0]))
    there, _, ok = bend("paraboloid", at, along, np.full(2, 0.5))
    assert ok.all()
    assert_close(there[:, 2], np.full(2, 144 / 14), atol=POINT)


@pytest.mark.parametrize("degrees", [60.0, 100.0, -100.0])
def test_rays_from_the_side_meet_the_hemisphere_of_the_vertex(degrees: float):
    # A sphere of 8 mm, its centre 9 mm behind the rays' common point: seen from 100 deg, rays meet
    # its front half where they pass its centre at more than 8 sin(10 deg), on the near side.
    shape = SHAPES["convex"]
    u = np.radians(degrees)
    p = np.linspace(-7.9, 7.9, 80)
    centre = np.array([0, 0, 8.0 + shape.gap])
    at = centre + p[:, None] * [0, np.cos(u), -np.sin(u)] - 9 * np.array([0, np.sin(u), np.cos(u)])
    at = at.astype(np.float32).astype(float)
    along = unit(np.tile([0, np.sin(u), np.cos(u)], (80, 1)))
    there, goes, ok = bend("convex", at, along, np.full(80, 1 / 1.8))
    meets = centre + p[:, None] * [0, np.cos(u), -np.sin(u)]
    meets = meets - np.sqrt(64 - p[:, None] ** 2) * np.array([0, np.sin(u), np.cos(u)])
    front = meets[:, 2] < centre[2]
    assert (ok == front).all()
    assert 5 < front.sum() <= 80
    # Grazing points move 3 times as far as the ray.
    assert_close(there[front], (meets - [0, 0, shape.gap])[front], atol=4 * POINT)
    normal = normals(shape, there[front])
    bound = SNELL / np.maximum(normal[:, 2:], 0.05)
    crossed = np.cross(along[front], normal) / 1.8
    assert_close(np.cross(goes[front], normal), crossed, atol=np.broadcast_to(bound, crossed.shape))


@pytest.mark.parametrize("degrees", [70.0, 90.0, 100.0])
def test_rays_from_the_side_meet_an_asphere(degrees: float):
    # As above, on a sphere with a breath of r^4: where the plane of the vertex is no start.
    shape = SHAPES["convex asphere"]
    u = np.radians(degrees)
    p = np.linspace(2.5, 7.0, 40)
    side, way = np.array([0, np.cos(u), -np.sin(u)]), np.array([0, np.sin(u), np.cos(u)])
    at = np.array([0, 0, 8.0 + shape.gap]) + p[:, None] * side - 9 * way
    at = at.astype(np.float32).astype(float)
    there, _, ok = bend("convex asphere", at, unit(np.tile(way, (40, 1))), np.full(40, 1 / 1.8))
    assert ok.all()
    r2 = (there[:, :2] ** 2).sum(axis=1)
    steep = 1 + np.abs(shape.slope(np.sqrt(r2)))
    assert_close(there[:, 2], shape.sag(r2), atol=POINT * steep)
    # On the near side: the sphere's own point, but for 1e-7 8^4 mm of sag and a slope of 3.
    near = p[:, None] * side - np.sqrt(64 - p[:, None] ** 2) * way + [0, 0, 8.0]
    assert_close(there, near, atol=np.broadcast_to(2e-3 * steep[:, None] ** 2, near.shape))


@pytest.mark.parametrize("name", ["plane", "convex", "nothing but a polynomial"])
def test_light_that_comes_from_behind_does_not_pass(name: str):
    at, along = rays(30, 40)
    _, _, ok = bend(name, at, -along, np.full(40, 0.9))
    assert not ok.any()


def test_beyond_the_critical_angle_rays_are_totally_reflected():
    critical = np.degrees(np.arcsin(1 / 1.5))
    for degrees in (critical - 0.01, critical + 0.01, -critical + 0.01, -critical - 0.01, 80.0):
        at, along = parallel(np.array([0.0, 1.0]), degrees)
        _, goes, ok = bend("plane", at, along, np.full(2, 1.5))
        assert ok.all() == (abs(degrees) < critical)
        assert ok.any() == ok.all()
        if not ok.any():
            assert_close(goes, along.copy(), atol=0)


@pytest.mark.parametrize("c", [1, -1])
def test_of_two_intersections_the_one_nearest_the_vertex_counts(c: int):
    # A ray across a hyperboloid that meets its other sheet first, or its own far away.
    name = "convex" if c > 0 else "concave"
    shape = SHAPES[name]
    at = np.array([[0.0, 0.0, 40.0], [0.0, 0.0, -40.0], [1.0, 0.0, 12.0]])
    there, _, ok = bend(name, at, unit(np.tile([0.0, 0.0, 1.0], (3, 1))), np.full(3, 0.6))
    assert ok.all()
    sag = shape.sag(np.array([0.0, 0.0, 1.0]))
    assert_close(there[:, 2], sag, atol=4 * POINT)


def test_newton_that_does_not_arrive_is_a_failure():
    # A polynomial that turns up steeply: at 5 mm its slope is 30 * 2e-21 * 5^29 = 11.
    at, along = parallel(np.linspace(0, 9.9, 200), 25.0)
    there, _, ok = bend("asphere", at, along, np.full(200, 0.6))
    shape = SHAPES["asphere"]
    assert 20 < ok.sum() < 200
    sag = shape.sag((there[ok, :2] ** 2).sum(axis=1))
    # What counts as met: 1e-5 of the way, and the rounding of steep slopes.
    steep = 1 + np.abs(shape.slope(np.hypot(*there[ok, :2].T)))
    assert_close(there[ok, 2], sag, atol=(2e-5 * 20 + POINT) * steep)
    assert np.isfinite(there).all()


def test_a_ray_that_starts_on_an_asphere_meets_it_there():
    # Without a way, what counts as met is a share of the sag: 1e-5, a hundred roundings of it.
    shape = SHAPES["asphere"]
    y = np.linspace(0.0, 4.5, 3000)
    at = np.stack([0 * y, y, shape.sag(y**2) + shape.gap], axis=1).astype(np.float32).astype(float)
    there, _, ok = bend(
        "asphere", at, unit(np.tile([0.0, 0.1, 1.0], (3000, 1))), np.full(3000, 0.6)
    )
    assert ok.all()
    # A slope of up to 2 makes of a rounding across three along.
    assert_close(there, at - [0, 0, shape.gap], atol=4 * POINT)


def test_a_ray_that_passes_close_by_an_asphere_misses_it():
    # z = y^2 / 20, and rays along its tangent at 4 mm, e outside it: what counts as met is 1e-5 of
    # 12 mm, 1.2e-4 mm. Newton then jumps about the closest point, within a few e of the surface.
    shape = SHAPES["one term"]
    e = np.linspace(5e-4, 8e-3, 300)
    along = unit(np.array([[0.0, 1.0, 0.4]]))
    at = np.array([[0.0, 4.0, 0.8 + shape.gap]]) - 8 * along - e[:, None] * [0, 0, 1]
    at = at.astype(np.float32).astype(float)
    _, _, ok = bend("one term", at, np.repeat(along, 300, axis=0), np.full(300, 0.6))
    assert not ok.any()
    # On the other side they meet it.
    at[:, 2] += 0.5
    assert bend("one term", at, np.repeat(along, 300, axis=0), np.full(300, 1 / 1.6))[2].all()


def test_how_far_a_point_lies_from_a_surface():
    rng = np.random.default_rng(9)
    q = rng.uniform(-4, 4, (200, 3)).astype(np.float32)
    for name in ("asphere", "paraboloid", "steep"):
        q[:, :2] *= 0.7
        found = wgsl_eval(
            "surface",
            f"gap_at({NAMES.index(name)}u, q)",
            {"q": ("vec3f", q)},
            declarations=declarations(),
            params={"terms": TERMS, "per_unit2": UNIT**-2.0},
        ).astype(float)
        at = q.astype(float)
        sag = SHAPES[name].sag((at[:, :2] ** 2).sum(axis=1))
        assert_close(found, np.abs(at[:, 2] - sag), atol=POINT)


def test_the_polynomial_and_its_slope():
    # Values and derivatives by NumPy's polynomials in r^2; Horner's rule: 2 roundings a term.
    shape = SHAPES["asphere"]
    r2 = np.linspace(0, 40, 200).astype(np.float32)
    found = wgsl_eval(
        "surface",
        f"polynomial({NAMES.index('asphere')}u, r2)",
        {"r2": ("f32", r2)},
        returns="vec2f",
        declarations=declarations(),
        params={"terms": TERMS, "per_unit2": UNIT**-2.0},
    ).astype(float)
    coefficients = np.zeros(TERMS + 1)
    coefficients[[k // 2 for k in shape.a]] = [float(np.float32(a)) for a in shape.a.values()]
    line = np.polynomial.Polynomial(coefficients)
    amount = np.polynomial.Polynomial(np.abs(coefficients))
    r2 = r2.astype(float)
    assert_close(found[:, 0], line(r2), atol=2 * TERMS * ULP * amount(r2))
    assert_close(found[:, 1], line.deriv()(r2), atol=3 * TERMS * ULP * amount.deriv()(r2))

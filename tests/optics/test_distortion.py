"""The chief-ray map of the shaders, against SciPy's piecewise polynomials.

Tolerance of d: the place s takes three roundings, of at most n, and d changes by its slope over n
from one whole number to the next; Horner's scheme six more, of sums that are at most the sum of
|coefficient|. u = x + x d takes two.
"""

import numpy as np
import pytest
from harness import assert_close, wgsl_eval
from optics.made import ULP
from scipy.interpolate import CubicSpline

RNG = np.random.default_rng(67)
RADIUS = 300.0
X = RNG.uniform(-230, 230, (4000, 2)).astype(np.float32)  # to 1.08 of the radius


def spline(count: int) -> CubicSpline:
    """Return a wild d: it changes by 0.2 over a piece or two, and falls as well as it rises."""
    return CubicSpline(np.linspace(0, 1, count + 1), RNG.uniform(-0.1, 0.1, count + 1))


def pieces(d: CubicSpline) -> np.ndarray:
    count = len(d.x) - 1
    return (d.c[::-1].T / float(count) ** np.arange(4)).astype(np.float32)


def evaluated(table: np.ndarray, member: str, returns: str) -> np.ndarray:
    inputs = {
        "x": ("vec2f", X),
        "inverse": ("f32", np.full(len(X), RADIUS**-2)),
    }
    numbers = ", ".join(f"vec4f({', '.join(repr(float(one)) for one in row)})" for row in table)
    terms = f"var<private> terms: array<vec4f, {len(table)}> = array({numbers});"
    expression = f"ideal_point(x, inverse, {float(len(table))}).{member}"
    return wgsl_eval("distortion", expression, inputs, returns=returns, declarations=terms)


@pytest.mark.parametrize("count", [1, 2, 7, 32])
def test_the_ideal_point_and_its_jacobian(count: int):
    d = spline(count)
    table = pieces(d)
    inverse = float(np.float32(RADIUS**-2))
    x = X.astype(np.float64)

    def ideal(points: np.ndarray) -> np.ndarray:
        rho2 = np.minimum(np.sum(points**2, axis=1) * inverse, 1.0)
        return points * (1 + d(rho2))[:, None]

    # The table's own rounding is one more of each coefficient.
    amount = np.abs(table).sum(axis=1).max()
    steepest = np.abs(d(np.linspace(0, 1, 999), 1)).max()
    off = ULP * (3 * steepest + 7 * amount)
    found = evaluated(table, "u", "vec2f")
    assert_close(found, ideal(x), atol=off * np.abs(x).max() + 2 * ULP * 1.5 * np.abs(x).max())
    # The slope's place is off likewise, and it changes by its own slope; factors 2, 3 and n of the
    # coefficients; it counts by 2 rho^2.
    bends = np.abs(d(np.linspace(0, 1, 999), 2)).max()
    off += 2 * ULP * (3 * bends + 10 * 3 * count * amount) + 2 * ULP
    step = 1e-3  # of a central difference: step^2 / 6 of a third derivative of 600 / R^2, and more
    lit = np.hypot(*x.T) < RADIUS - 2 * step
    assert lit.mean() > 0.9
    for axis in (0, 1):
        away = np.eye(2)[axis] * step
        numeric = (ideal(x + away) - ideal(x - away)) / (2 * step)
        column = evaluated(table, f"jacobian[{axis}]", "vec2f")
        assert_close(column[lit], numeric[lit], atol=off + 1e-6)


def test_beyond_the_circle_d_is_that_of_the_rim():
    d = spline(5)
    x = X.astype(np.float64)
    beyond = np.hypot(*x.T) > RADIUS * 1.001
    found = evaluated(pieces(d), "u", "vec2f")[beyond]
    assert beyond.sum() > 20
    assert_close(found, x[beyond] * (1 + d(1.0)), atol=20 * ULP * 400)

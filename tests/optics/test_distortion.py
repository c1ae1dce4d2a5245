"""The chief-ray map of the shaders, against NumPy's polynomials.

Tolerance of g and of its slope: Horner's scheme in f32 takes two roundings a step, 16 in all with
the argument's own, each of sums that are at most the sum of |coefficient| (r2 <= 1.2, and its
powers): 20 * 2^-24 sum |c_k| r2^k.
"""

import numpy as np
from harness import assert_close, wgsl_eval
from optics.made import ULP

RNG = np.random.default_rng(67)
COEFFICIENTS = RNG.uniform(-1, 1, 8).astype(np.float32)
RADIUS = 300.0
X = RNG.uniform(-230, 230, (4000, 2)).astype(np.float32)  # to 1.08 of the radius


def evaluated(member: str, returns: str) -> np.ndarray:
    count = len(X)
    inputs = {
        "x": ("vec2f", X),
        "inverse": ("f32", np.full(count, RADIUS**-2)),
        "low": ("vec4f", np.broadcast_to(COEFFICIENTS[:4], (count, 4))),
        "high": ("vec4f", np.broadcast_to(COEFFICIENTS[4:], (count, 4))),
    }
    expression = f"ideal_point(x, inverse, low, high).{member}"
    return wgsl_eval("distortion", expression, inputs, returns=returns)


def polynomial() -> tuple[np.polynomial.Polynomial, np.polynomial.Polynomial, np.ndarray]:
    """Return g, the sum of its terms' amounts, and r2."""
    coefficients = COEFFICIENTS.astype(np.float64)
    r2 = np.sum(X.astype(np.float64) ** 2, axis=1) * float(np.float32(RADIUS**-2))
    return np.polynomial.Polynomial(coefficients), np.polynomial.Polynomial(abs(coefficients)), r2


def test_the_ideal_point():
    g, amount, r2 = polynomial()
    bound = 21 * ULP * amount(r2)[:, None] * np.abs(X)
    assert_close(evaluated("u", "vec2f"), X * g(r2)[:, None], atol=bound)


def test_the_jacobian_is_that_of_the_point():
    """Against differences of the host's float64 map."""
    g, amount, r2 = polynomial()
    x = X.astype(np.float64)
    inverse = float(np.float32(RADIUS**-2))

    def ideal(points: np.ndarray) -> np.ndarray:
        return points * g(np.sum(points**2, axis=1) * inverse)[:, None]

    # The slope's coefficients k c_k take one more rounding each, and five factors follow: 28
    # roundings of at most 2 sum k |c_k| r2^k, with 21 of g.
    bound = ULP * (21 * amount(r2) + 2 * 28 * r2 * amount.deriv()(r2))
    step = 1e-3  # error of a central difference: step^2 u''' / 6, below 1e-9
    for axis in (0, 1):
        away = np.eye(2)[axis] * step
        numeric = (ideal(x + away) - ideal(x - away)) / (2 * step)
        found = evaluated(f"jacobian[{axis}]", "vec2f")
        assert_close(found, numeric, atol=bound[:, None] + 1e-8)

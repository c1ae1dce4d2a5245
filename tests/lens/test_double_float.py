"""Numbers of two f32: exact where they must be, else to 2^-44, against integers and fractions.

Exact: the error terms of a sum and of a product of two f32 are f32 themselves, as long as nothing
underflows. Sums and products of pairs lose what lies below the low part's rounding; "to 2^-44" is
what the stages count on. In units of u = 2^-24 (one rounding), relative: df_add of numbers of one
sign 3 u^2 (two roundings of the low parts and the last one), df_multiply 7 u^2 (roundings of two
products, their sum, its sum with the error; a.y b.y left out; the last one), df_square likewise
5 u^2, df_sqrt 8 u^2 (the correction is good to a few u of u; the left-out square of it 0.5 u^2).
All below 16 u^2 = 2^-44. A sum that cancels is bounded by the parts: 2^-44 (|a| + |b|).
"""

from fractions import Fraction

import numpy as np
import pytest
from harness import assert_close, wgsl_eval

U = 2.0**-24
COUNT = 4000


def evaluate(expression: str, a: np.ndarray, b: np.ndarray, kind: str) -> np.ndarray:
    inputs = {"a": (kind, a), "b": (kind, b)}
    return wgsl_eval("double_float", expression, inputs, returns="vec2f", params={"zero": 0})


def singles(seed: int, exponents: int) -> np.ndarray:
    """Return f32 of full 24 bits, both signs, magnitudes over 2^+-exponents."""
    rng = np.random.default_rng(seed)
    mantissa = rng.integers(1 << 23, 1 << 24, COUNT) * rng.choice([-1.0, 1.0], COUNT)
    return np.ldexp(mantissa, rng.integers(-exponents, exponents + 1, COUNT) - 24)


def pairs(seed: int, exponents: int = 12) -> np.ndarray:
    """Return numbers of 48 bits as (n, 2) f32: the low part within half a unit of the high."""
    high = singles(seed, exponents)
    low = high * np.random.default_rng(seed + 1).uniform(-U, U, COUNT) / 2
    return np.stack([high, low], axis=1).astype(np.float32).astype(float)


def exact(pair: np.ndarray) -> list[Fraction]:
    return [Fraction(float(high)) + Fraction(float(low)) for high, low in pair]


def check(found: np.ndarray, wanted: list[Fraction], scale: list[Fraction] | None = None) -> None:
    """Demand 2^-44 of the scale (of the result), and a low part that only refines the high one."""
    scale = wanted if scale is None else scale
    error = [float(abs(f - w)) for f, w in zip(exact(found), wanted, strict=True)]
    bound = 2.0**-44 * np.array([float(abs(s)) for s in scale])
    assert_close(np.array(error), np.zeros(len(error)), atol=bound)
    # One unit, not half: df_sqrt and sums that cancel may leave the low part at a whole one.
    assert (np.abs(found[:, 1]) <= 2 * U * np.abs(found[:, 0])).all()


@pytest.mark.parametrize("function", ["two_sum", "integer_sum"])
@pytest.mark.parametrize("exponents", [0, 12, 30])
def test_two_sum_is_exact(exponents: int, function: str):
    a, b = singles(1, exponents), singles(2, exponents)
    found = evaluate(f"{function}(a, b)", a, b, "f32").astype(float)
    assert exact(found) == exact(np.stack([a, b], axis=1))
    assert_close(found[:, 0], (a + b).astype(np.float32).astype(float), atol=0)
    # Numbers of the same size that cancel to nothing but their last bits, and to zero.
    near = np.nextafter(a.astype(np.float32), np.float32(0)).astype(float)
    for other in (-near, -a):
        found = evaluate(f"{function}(a, b)", a, other, "f32")
        assert exact(found) == exact(np.stack([a, other], axis=1))


def test_quick_two_sum_is_exact_where_the_first_is_the_larger():
    a, b = singles(3, 20), singles(4, 20)
    a, b = np.where(np.abs(a) >= np.abs(b), [a, b], [b, a])
    found = evaluate("quick_two_sum(a, b)", a, b, "f32").astype(float)
    assert exact(found) == exact(np.stack([a, b], axis=1))
    assert_close(found[:, 0], (a + b).astype(np.float32).astype(float), atol=0)


@pytest.mark.parametrize("function", ["two_product", "integer_product"])
@pytest.mark.parametrize("exponents", [0, 12, 30])
def test_two_product_is_exact(exponents: int, function: str):
    a, b = singles(5, exponents), singles(6, exponents)
    found = evaluate(f"{function}(a, b)", a, b, "f32").astype(float)
    wanted = [Fraction(float(p)) * Fraction(float(q)) for p, q in zip(a, b, strict=True)]
    assert exact(found) == wanted
    assert_close(found[:, 0], (a * b).astype(np.float32).astype(float), atol=0)


@pytest.mark.parametrize("apart", range(22, 29))
def test_integers_round_ties_to_even_and_below_powers_of_two(apart: int):
    """The smaller number lies about half a last bit of the larger, which may be a power of two."""
    a = np.repeat([1.0, 1 + 2 * U, 1 + 4 * U, 2 - 2 * U], 10)
    b = np.array([1.0, 1 + 2 * U, 1.5, 2 - 2 * U, 0.0]) * 2.0**-apart
    b = np.tile([*b, *-b], 4)
    for one, other in ((a, b), (b, a), (-a, b)):
        found = evaluate("integer_sum(a, b)", one, other, "f32")
        assert exact(found) == exact(np.stack([one, other], axis=1))
        expected = one.astype(np.float32) + other.astype(np.float32)
        assert_close(found[:, 0].astype(float), expected.astype(float), atol=0)


def test_integers_keep_zeros_infinities_and_nan():
    a = np.array([0.0, 0.0, 3.0, np.inf, -np.inf, np.nan, 2e38, 1e-30])
    b = np.array([0.0, -2.0, 0.0, 1.0, 1e30, 1.0, 3e38, 1e-30])
    with np.errstate(over="ignore", under="ignore"):
        a32, b32 = a.astype(np.float32), b.astype(np.float32)
        wanted = a32 + b32, a32 * b32
    for name, expected in zip(("integer_sum", "integer_product"), wanted, strict=True):
        found = evaluate(f"{name}(a, b)", a, b, "f32")[:, 0]
        assert np.array_equal(found, expected, equal_nan=True)


def test_the_halves_of_a_number_have_twelve_bits():
    a = singles(7, 30)
    found = evaluate("vec2f(upper_half(a), a - upper_half(a))", a, a, "f32").astype(float)
    assert_close(found.sum(axis=1), a, atol=0)
    for half in found.T:
        mantissa = np.abs(np.ldexp(np.frexp(half)[0], 12))
        assert_close(mantissa, np.round(mantissa), atol=0)


def test_the_hidden_sum_is_the_sum():
    a, b = singles(8, 30), singles(9, 30)
    found = evaluate("vec2f(pin(a), pin(b))", a, b, "f32")
    assert_close(found.astype(float), np.stack([a, b], axis=1), atol=0)


@pytest.mark.parametrize("exponents", [0, 6, 30])
def test_sums(exponents: int):
    a, b = pairs(10, exponents), pairs(20, exponents)
    p, q = exact(a), exact(b)
    wanted = [x + y for x, y in zip(p, q, strict=True)]
    parts = [abs(x) + abs(y) for x, y in zip(p, q, strict=True)]
    found = evaluate("df_add(a, b)", a, b, "vec2f")
    error = [float(abs(f - w)) for f, w in zip(exact(found), wanted, strict=True)]
    bound = 2.0**-44 * np.array([float(part) for part in parts])
    assert_close(np.array(error), np.zeros(COUNT), atol=bound)
    same_sign = a[:, 0] * b[:, 0] > 0
    check(found[same_sign], [w for w, same in zip(wanted, same_sign, strict=True) if same])


def test_a_sum_whose_high_parts_cancel_keeps_the_low_parts():
    a = pairs(30)
    b = np.stack([-a[:, 0], pairs(40)[:, 1] * 2.0**-12], axis=1)
    b = b.astype(np.float32).astype(float)
    found = evaluate("df_add(a, b)", a, b, "vec2f").astype(float)
    # What is left is one sum of two f32: a rounding.
    assert_close(found.sum(axis=1), a[:, 1] + b[:, 1], rtol=2 * U)
    assert np.abs(a[:, 1] + b[:, 1]).min() > 0


def test_products():
    a, b = pairs(50), pairs(60)
    wanted = [x * y for x, y in zip(exact(a), exact(b), strict=True)]
    check(evaluate("df_multiply(a, b)", a, b, "vec2f"), wanted)


def test_squares():
    a = pairs(70)
    check(evaluate("df_square(a)", a, a, "vec2f"), [x * x for x in exact(a)])


def test_square_roots():
    a = pairs(80, 24)
    a *= np.sign(a[:, :1])
    found = evaluate("df_sqrt(a)", a, a, "vec2f")
    # (r + e)^2 = r^2 + 2 r e: an error of 2^-44 in the root is one of 2^-43 in its square.
    check_square = [x * x for x in exact(found)]
    error = [float(abs(s - w) / w) for s, w in zip(check_square, exact(a), strict=True)]
    assert_close(np.array(error), np.zeros(COUNT), atol=2.0**-43)


def test_the_checks_find_a_lost_low_part():
    """Rounded to f32 and with the low part of one factor lost, both are out of tolerance."""
    a, b = pairs(50), pairs(60)
    wanted = [x * y for x, y in zip(exact(a), exact(b), strict=True)]
    for planted in ("vec2f(a.x * b.x, 0.0)", "df_multiply(a, vec2f(b.x, 0.0))"):
        with pytest.raises(AssertionError, match="elements are bad"):
            check(evaluate(planted, a, b, "vec2f"), wanted)

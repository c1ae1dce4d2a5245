"""Complex numbers, on integers of eleven bits: products and sums are exact in f32, fused or not."""

import numpy as np
from harness import assert_close, wgsl_eval

A, B = np.random.default_rng(61).integers(-2047, 2048, (2, 5000, 2)).astype(np.float64)


def pairs(z: np.ndarray) -> np.ndarray:
    return np.stack([z.real, z.imag], axis=1)


def of(*inputs: np.ndarray) -> dict:
    return {name: ("vec2f", values) for name, values in zip("ab", inputs, strict=False)}


def test_the_product():
    exact = (A @ [1, 1j]) * (B @ [1, 1j])
    assert_close(
        wgsl_eval("complex", "cmul(a, b)", of(A, B), returns="vec2f"), pairs(exact), atol=0
    )


def test_the_conjugate():
    exact = np.conj(A @ [1, 1j])
    assert_close(wgsl_eval("complex", "conj(a)", of(A), returns="vec2f"), pairs(exact), atol=0)


def test_i_times():
    exact = 1j * (A @ [1, 1j])
    assert_close(wgsl_eval("complex", "times_i(a)", of(A), returns="vec2f"), pairs(exact), atol=0)


def together(z: np.ndarray, w: np.ndarray) -> np.ndarray:
    return np.concatenate([pairs(z), pairs(w)], axis=1)


def test_pairs():
    z, w, b = A @ [1, 1j], A[::-1] @ [1, 1j], B @ [1, 1j]
    given = {"p": ("vec4f", together(z, w)), "b": ("vec2f", B)}
    for call, exact in {
        "pair_mul(p, b)": (z * b, w * b),
        "pair_conj(p)": (z.conj(), w.conj()),
        "pair_times_i(p)": (1j * z, 1j * w),
    }.items():
        found = wgsl_eval("complex", call, given, returns="vec4f")
        assert_close(found, together(*exact), atol=0)

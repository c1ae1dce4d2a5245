"""Transforms of four and eight numbers, against the sum that defines them.

fft4 only adds: exact on integers. fft8, tolerance of a result: three additions of fft4 and after
it, one more before the product with cos(pi/4), the product and the constant itself: 6 roundings of
sums that are at most S, the sum of all |parts|: 6 * 2^-24 S, and one for their second order.
"""

import numpy as np
from harness import assert_close, wgsl_eval
from optics.made import ULP


def inputs(count: int, n: int) -> np.ndarray:
    """Return (count, 2 n) integers: parts of n complex numbers."""
    return np.random.default_rng(n).integers(-1000, 1001, (count, 2 * n)).astype(np.float64)


def transformed(parts: np.ndarray) -> np.ndarray:
    """Return X[k] = sum_n x[n] exp(-2 pi i n k / N), as parts."""
    z = parts[:, ::2] + 1j * parts[:, 1::2]
    n = z.shape[1]
    result = z @ np.exp(-2j * np.pi * np.outer(np.arange(n), np.arange(n)) / n)
    return np.stack([result.real, result.imag], axis=2).reshape(parts.shape)


def on_device(call: str, struct: str, parts: np.ndarray) -> np.ndarray:
    names = "abcd"[: parts.shape[1] // 4]
    given = {
        name: ("vec4f", parts[:, 4 * place : 4 * place + 4]) for place, name in enumerate(names)
    }
    values = ", ".join(f"{name}.{half}" for name in names for half in ("xy", "zw"))
    return np.concatenate(
        [
            wgsl_eval(
                "octet",
                f"vec4f(f.v{2 * place}, f.v{2 * place + 1})",
                given,
                returns="vec4f",
                statements=f"let f = {call}({struct.format(values)});",
            )
            for place in range(len(names))
        ],
        axis=1,
    )


def test_four():
    parts = inputs(2000, 4)
    exact = np.round(transformed(parts))  # whole numbers, up to the rounding of the roots of one
    assert_close(on_device("fft4", "{}", parts), exact, atol=0)


def test_eight():
    parts = inputs(2000, 8)
    bound = 7 * ULP * np.abs(parts).sum(axis=1, keepdims=True)
    found = on_device("fft8", "Octet({})", parts)
    assert_close(found, transformed(parts), atol=np.broadcast_to(bound, parts.shape))

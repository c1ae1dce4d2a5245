"""Transforms of four and eight pairs of numbers, against the sum that defines them.

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


def on_device(call: str, struct: str, parts: np.ndarray) -> list[np.ndarray]:
    """Return the transforms of the numbers, and of the numbers in the opposite order."""
    n = parts.shape[1] // 2
    given = {
        name: ("vec4f", parts[:, 4 * place : 4 * place + 4])
        for place, name in enumerate("abcd"[: n // 2])
    }
    numbers = [f"{name}.{half}" for name in given for half in ("xy", "zw")]
    pairs = [f"vec4f({one}, {other})" for one, other in zip(numbers, numbers[::-1], strict=True)]
    found = [
        wgsl_eval(
            "octet",
            f"f.v{place}",
            given,
            returns="vec4f",
            statements=f"let f = {call}({struct.format(', '.join(pairs))});",
        )
        for place in range(n)
    ]
    return [
        np.concatenate([pair[:, half] for pair in found], axis=1) for half in (np.s_[:2], np.s_[2:])
    ]


def both(parts: np.ndarray) -> list[np.ndarray]:
    opposite = parts.reshape(len(parts), -1, 2)[:, ::-1].reshape(parts.shape)
    return [transformed(parts), transformed(opposite)]


def test_four():
    parts = inputs(2000, 4)
    for found, exact in zip(on_device("fft4", "{}", parts), both(parts), strict=True):
        # Whole numbers, up to the rounding of the roots of one.
        assert_close(found, np.round(exact), atol=0)


def test_eight():
    parts = inputs(2000, 8)
    bound = 7 * ULP * np.abs(parts).sum(axis=1, keepdims=True)
    for found, exact in zip(on_device("fft8", "Octet({})", parts), both(parts), strict=True):
        assert_close(found, exact, atol=np.broadcast_to(bound, parts.shape))

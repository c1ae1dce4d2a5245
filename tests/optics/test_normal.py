"""The normal distribution function, over all that a chart's edges ask for.

Tolerance 1e-6, as the shader states: the approximation is good to 1.5e-7 / 2 (Abramowitz & Stegun
7.1.26 halved); its polynomial, at most 0.5 in sum, takes some ten roundings, and exp of an argument
x^2 <= 7 is good to (3 + 2 x^2) 2^-23 (WGSL) times what remains of it, below 5e-7.
"""

import numpy as np
from harness import assert_close, wgsl_eval
from scipy.special import ndtr


def phi(z: np.ndarray) -> np.ndarray:
    return wgsl_eval("normal", "normal_cdf(z)", {"z": ("f32", z)})


def test_it_is_the_normal_distribution_function():
    z = np.linspace(-8, 8, 64001).astype(np.float32)
    assert_close(phi(z), ndtr(z.astype(np.float64)), atol=1e-6)


def test_the_tails_are_empty_and_full():
    far = np.array([6.0, 9.0, 13.0, 40.0, 1e4, 1e15], np.float32)
    # Phi(-6) = 1e-9; the approximation's error is relative there, and exp(-18) = 1.5e-8.
    assert phi(-far).max() < 2e-9 and phi(-far).min() >= 0
    assert_close(phi(far), np.ones(6), atol=0)


def test_both_sides_mirror():
    z = np.linspace(0.001, 6, 3001).astype(np.float32)
    # 1 - tail is rounded to half a step of the numbers below 1.
    assert_close(phi(z) + phi(-z).astype(np.float64), np.ones(z.size), atol=2.0**-25)

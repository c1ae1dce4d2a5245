"""cos and sin of whole turns, over every argument that stages give, against float64.

Tolerance, in units of 2^-24: the angle, at most pi/4, carries the rounding of 2 pi and its own,
1.2; the sum of the series one half where it ends and as much within; the first terms left out 0.4.
In all 2.6, which is the head's 1.5e-7. Arguments are f32 and lose nothing: x - n/4 is exact.
"""

import numpy as np
import pytest
from harness import assert_close, wgsl_eval

PROMISED = 1.5e-7


def turn(x: np.ndarray) -> np.ndarray:
    return wgsl_eval("turn", "turn(x)", {"x": ("f32", x)}, returns="vec2f").astype(float)


def exact(x: np.ndarray) -> np.ndarray:
    angle = 2 * np.pi * np.mod(x, 1.0)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("whole", [0, 1, -1, 37, -4096, 2**20, -(2**20)])
def test_a_turn_and_many(whole: int):
    # Steps of 2^-3 at 2^20 and of 2^-12 otherwise: x and x + 1/2 are f32 exactly.
    step = 2.0**-3 if abs(whole) == 2**20 else 2.0**-11
    x = whole + np.arange(-1, 1 + step, step)
    assert_close(turn(x), exact(x), atol=PROMISED)


def test_it_is_smooth_over_the_seams():
    x = np.random.default_rng(1).uniform(-2, 2, 20000).astype(np.float32).astype(float)
    assert_close(turn(x), exact(x), atol=PROMISED)
    # The largest errors lie where the nearest quarter changes.
    seams = np.float32(np.arange(-2, 2, 0.25) + 0.125)
    x = np.concatenate([np.nextafter(seams, np.float32(9)), np.nextafter(seams, np.float32(-9))])
    assert_close(turn(x), exact(x.astype(float)), atol=PROMISED)


def test_quarters_are_exact():
    found = turn(np.array([0.0, 0.25, 0.5, 0.75, 1.0, -0.25, -0.5]))
    wanted = np.array([[1, 0], [0, 1], [-1, 0], [0, -1], [1, 0], [0, -1], [-1, 0]], float)
    assert_close(found, wanted, atol=0)


def test_the_tolerance_finds_a_missing_term():
    x = np.linspace(-0.5, 0.5, 101)
    planted = turn(x) + 2.5e-7
    with pytest.raises(AssertionError, match="elements are bad"):
        assert_close(planted, exact(np.float32(x).astype(float)), atol=PROMISED)

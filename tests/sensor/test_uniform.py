"""Uniform numbers from words, over all edges of the words and at random.

Tolerance: a conversion, an addition and an exact scaling: relative 2 * 2^-24; a conversion may take
the other neighbour (WGSL, "Floating Point Conversion"), which doubles its share: 3 * 2^-24. Two
levels in unit64: 4.
"""

import numpy as np
from harness import assert_close, wgsl_eval

ULP = 2.0**-24


def every_edge() -> np.ndarray:
    rng = np.random.default_rng(3)
    powers = 2 ** np.arange(33, dtype=np.int64)
    near = np.concatenate([powers + step for step in (-2, -1, 0, 1, 2)])
    words = np.concatenate([near, 2**32 - near, 2**31 + near, 2**31 - near, np.arange(64)])
    words = words[(words >= 0) & (words < 2**32)]
    return np.append(words, rng.integers(0, 2**32, 50_000)).astype(np.uint32)


def in_fours(words: np.ndarray) -> tuple[str, np.ndarray]:
    """Return words as an input of the functions, four at a time, the last ones repeated."""
    return "vec4u", np.append(words, words[-(-words.size % 4) :][: -words.size % 4]).reshape(-1, 4)


def evaluate(call: str, **words: np.ndarray) -> np.ndarray:
    inputs = {name: in_fours(values) for name, values in words.items()}
    found = wgsl_eval("uniform", call, inputs, returns="vec4f").ravel()
    return found[: next(iter(words.values())).size]


def middle(words: np.ndarray) -> np.ndarray:
    return (words.astype(np.float64) + 0.5) / 2**32


def test_unit_is_the_middle_of_its_cell():
    words = every_edge()
    unit = evaluate("unit(w)", w=words)
    assert_close(unit, middle(words), rtol=3 * ULP)


def test_unit64_keeps_its_digits_where_the_high_word_is_small():
    rng = np.random.default_rng(4)
    low = every_edge()
    high = rng.choice([0, 1, 2, 3, 100, 2**20, 2**31, 2**32 - 1], low.size).astype(np.uint32)
    unit = evaluate("unit64(high, low)", high=high, low=low)
    assert_close(unit, (high + middle(low)) / 2**32, rtol=4 * ULP)


def test_centred_keeps_its_digits_near_zero():
    words = every_edge()
    centred = evaluate("centred(w)", w=words)
    exact = (words.astype(np.int64) - 2**31 + 0.5) / 2**32
    assert_close(centred, exact, rtol=3 * ULP)


def test_edge_keeps_its_digits_at_both_ends():
    words = every_edge()
    edge = evaluate("edge(w)", w=words)
    exact = (np.minimum(words, 2**32 - 1 - words.astype(np.int64)) + 0.5) / 2**32
    assert_close(edge, exact, rtol=3 * ULP)

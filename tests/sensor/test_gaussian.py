"""Normal deviates of words: against SciPy's quantile of the normal law in float64.

Tolerance, relative: the fits 1e-7 and 4e-7; of log near 1 the absolute error 2^-21 times the
slope 0.16 of the polynomial over its value, 0.8e-7, elsewhere 3 ULP of at most 22 times 0.3 / 18 or
less; the last two steps of the polynomial and the product, six roundings; the word's own
3 * 2^-24: 1e-6 in all.
"""

import numpy as np
from harness import assert_close, wgsl_eval
from scipy.special import ndtri


def gaussian(words: np.ndarray) -> np.ndarray:
    fours = {"w": ("vec4u", words.reshape(-1, 4))}
    return wgsl_eval("gaussian", "gaussian(w)", fours, returns="vec4f").ravel()


def exact(words: np.ndarray) -> np.ndarray:
    """Return the quantile from the nearer end, where float64 keeps its digits."""
    near = np.minimum(words, 2**32 - 1 - words.astype(np.int64))
    return np.where(words < 2**31, 1, -1) * ndtri((near + 0.5) / 2**32)


def every_part() -> np.ndarray:
    rng = np.random.default_rng(5)
    ends = np.concatenate([np.arange(2000), (2.0 ** rng.uniform(0, 31, 50_000)).astype(np.int64)])
    split = np.round(2**32 * (1 - np.sqrt(1 - np.exp(-5))) / 2) + np.arange(-1000, 1000)
    middle = 2**31 - 1 - np.arange(2000)
    lower = np.concatenate([ends, split, middle, rng.integers(0, 2**31, 100_000)])
    return np.concatenate([lower, 2**32 - 1 - lower]).astype(np.uint32)


def test_deviates_are_quantiles_everywhere():
    words = every_part()
    assert_close(gaussian(words), exact(words), rtol=1e-6)


def test_a_deviate_does_not_depend_on_its_neighbours():
    words = np.random.default_rng(6).permutation(every_part())
    order = np.random.default_rng(7).permutation(words.size)
    assert_close(gaussian(words[order]), gaussian(words)[order], atol=0)


def test_the_central_fit_ends_where_it_was_made_to_end():
    t = np.array([[np.nextafter(np.float32(5), np.float32(0)), 5, np.float32(5.0000005), 22]])
    central = wgsl_eval(
        "gaussian",
        "select(vec4f(0.0), vec4f(1.0), gaussian_is_central(t))",
        {"t": ("vec4f", t.astype(np.float32))},
        returns="vec4f",
    )
    assert_close(central, np.array([[1.0, 1.0, 0.0, 0.0]]), atol=0)

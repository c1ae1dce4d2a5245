"""Normal deviates of words: against SciPy's quantile of the normal law in float64.

Tolerance, relative: the fit 1e-7 (Wichura 1988); log within 3 ULP, halved by the square root; of
each of the two polynomials the last two steps, four roundings: 1e-7 + 1.5 * 2^-23 + 8 * 2^-24 =
8e-7, and the word's own 3 * 2^-24: 1e-6.
"""

import numpy as np
from harness import assert_close, wgsl_eval
from scipy.special import ndtri


def gaussian(words: np.ndarray) -> np.ndarray:
    return wgsl_eval("gaussian", "gaussian(w)", {"w": ("u32", words)})


def exact(words: np.ndarray) -> np.ndarray:
    """Return the quantile from the nearer end, where float64 keeps its digits."""
    near = np.minimum(words, 2**32 - 1 - words.astype(np.int64))
    return np.where(words < 2**31, 1, -1) * ndtri((near + 0.5) / 2**32)


def test_deviates_are_quantiles_everywhere():
    rng = np.random.default_rng(5)
    ends = np.concatenate([np.arange(2000), (2.0 ** rng.uniform(0, 31, 50_000)).astype(np.int64)])
    split = np.round((0.5 - 0.425) * 2**32).astype(np.int64) + np.arange(-1000, 1000)
    middle = 2**31 - 1 - np.arange(2000)
    lower = np.concatenate([ends, split, middle, rng.integers(0, 2**31, 100_000)])
    words = np.concatenate([lower, 2**32 - 1 - lower]).astype(np.uint32)
    assert_close(gaussian(words), exact(words), rtol=1e-6)


def test_the_central_fit_ends_where_it_was_made_to_end():
    split = np.float32(0.425)
    q = np.array(
        [split, -split, np.nextafter(split, np.float32(1)), -np.nextafter(split, np.float32(1)), 0]
    )
    central = wgsl_eval(
        "gaussian", "select(0.0, 1.0, gaussian_is_central(q))", {"q": ("f32", q.astype(np.float32))}
    )
    assert_close(central, np.array([1.0, 1.0, 0.0, 0.0, 1.0]), atol=0)

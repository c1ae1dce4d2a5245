"""Poisson counts: each step against float64, the counts word for word, and their law.

Covered: sums down to probabilities of 2^-60 on either side; the expansion wherever it is used;
the switches between them; the ends of all loops; the law by exact quantiles, chi-square and
z-tests from a mean of 1e-6 to 1e9.
"""

import numpy as np
import pytest
from harness import assert_close, wgsl_eval
from scipy.special import gammainc, gammaincc, ndtr, pdtr, pdtrc
from scipy.stats import binomtest, chi2, norm

from gpusim.reference import noise as reference

F32 = np.float32
ULP = 2.0**-24
# Fixed seeds make every statistic below a constant. The level says how unlikely it may be: 1e-3
# for a whole test; for n statistics in it each gets 1 - (1 - 1e-3)^(1/n) (Sidak).
LEVEL = 1e-3


def sidak(n: int) -> float:
    return 1 - (1 - LEVEL) ** (1 / n)


def evaluate(expression: str, returns: str = "f32", statements: str = "", **inputs) -> np.ndarray:
    kinds = {"f": "f32", "u": "u32", "i": "i32"}
    typed = {
        name: (kinds[a.dtype.kind] if a.ndim == 1 else f"vec{a.shape[1]}{a.dtype.kind}", a)
        for name, a in inputs.items()
    }
    return wgsl_eval("poisson", expression, typed, returns=returns, statements=statements)


def fours(array: np.ndarray) -> np.ndarray:
    return array.reshape(-1, 4)


def by_sums(mean: np.ndarray, words: np.ndarray) -> np.ndarray:
    """Return poisson_by_sums() of (n,) means below 85 and (n, 2) words, n a multiple of 4."""
    words = words.astype(np.uint32)
    call = "poisson_by_sums(mean, high, low, vec4<bool>(true))"
    parts = {"mean": fours(mean), "high": fours(words[:, 0]), "low": fours(words[:, 1])}
    return evaluate(call, "vec4f", **parts).ravel()


def counts(mean: np.ndarray, seed: int = 1, frame: int = 5) -> np.ndarray:
    """Return poisson() at pixels 0, 1, 2 ... of row 9; as many as means, a multiple of 4."""
    quad = np.arange(mean.size // 4, dtype=np.uint32)
    counter = f"vec4u(quad, 9u, {frame}u, PURPOSE_SHOT)"
    call = f"poisson(mean, {counter}, vec2u({seed}u, 7u))"
    return evaluate(call, "vec4i", mean=fours(mean), quad=quad).ravel()


def expected_counts(mean: np.ndarray, seed: int = 1, frame: int = 5) -> np.ndarray:
    col = np.arange(mean.size)
    return reference.poisson(mean, np.full_like(col, 9), col, frame, seed + (7 << 32))


def distance_of_step(count, other, mean, u, rest) -> np.ndarray:
    """Return how far u lies from the step between two neighbouring counts, of its smaller tail."""
    step = np.minimum(count, other)
    return np.where(u < 0.5, np.abs(pdtr(step, mean) / u - 1), np.abs(pdtrc(step, mean) / rest - 1))


def test_constants():
    names = ("POISSON_SPLIT", "POISSON_TERMS", "POISSON_LOWEST", "f32(POISSON_NEAR)")
    values = evaluate(f"vec4f({', '.join(names)})", "vec4f", x=F32([0]))[0]
    own = (reference.SUMS_BELOW, 64.0, reference.SUMS_BEYOND, reference.NEAR_END)
    assert_close(values, np.array(own), rtol=ULP)


def test_thresholds_hold_on_their_own_side():
    """Each decision that changes the method, not the result, is fixed at and beside its bound."""

    def at(bound: float) -> np.ndarray:
        bound = F32(bound)
        return np.array([np.nextafter(bound, F32(0)), bound, np.nextafter(bound, F32(1))], F32)

    for call, bound, holds in (
        ("poisson_in_tail(x)", 2.0**-8, [1, 0, 0]),
        ("poisson_is_negligible(x)", 1e-26, [1, 1, 0]),
    ):
        assert_close(evaluate(f"select(0.0, 1.0, {call})", x=at(bound)), np.array(holds), atol=0)
    words = np.array([[2**20 - 1, 2**20, 2**32 - 2**20, 2**32 - 2**20 - 1]], np.uint32)
    near = evaluate("select(vec4f(0.0), vec4f(1.0), poisson_near_end(w))", "vec4f", w=words)
    assert_close(near, np.array([[1.0, 0.0, 1.0, 0.0]]), atol=0)


# --- sums: means below 10, and far below larger ones ---


def test_sums_give_the_quantile_in_both_tails():
    """The count is right wherever u lies further than 4e-6 of itself from a step of the law.

    A probability is a sum of terms, smallest first; each has up to 60 multiplications and divisions
    of 3.5 ULP together, whose errors do not line up, and exp 3 + 2 * 10 ULP: 60 * 2^-24.
    """
    rng = np.random.default_rng(11)
    n = 200_000
    means = F32([0, 1e-12, 1e-6, 1e-3, 0.1, 1, 5, 9.9, np.nextafter(F32(10), F32(0))])
    mean = rng.choice(means, n)
    small = 2.0 ** -rng.uniform(1, 60, n)  # the smaller of u and 1 - u
    high = np.floor(small * 2**32)
    words = np.stack([high, np.floor((small * 2**32 - high) * 2**32)], axis=1).astype(np.uint32)
    words = np.where(rng.random((n, 1)) < 0.5, words, ~words)
    found = by_sums(mean, words)
    expected = reference.poisson_quantile(mean.astype(float), words)
    wrong = np.flatnonzero(found != expected)
    exact = mean[wrong].astype(float)
    u, rest = reference.tails(words[wrong])
    step = np.minimum(found, expected)[wrong]
    distance = np.minimum(np.abs(pdtrc(step, exact) / rest - 1), np.abs(pdtr(step, exact) / u - 1))
    assert np.all(np.abs(found - expected)[wrong] == 1)
    assert np.all(distance < 60 * ULP)
    assert wrong.size < 20  # of 200 000: chance lets u come so near to a step now and then
    assert len(np.unique(expected)) > 30


def test_sums_hold_far_below_larger_means():
    """Where the expansion ends: 0.7 sqrt(mean) sigmas below means of up to 82, 6.4 sigmas."""
    rng = np.random.default_rng(12)
    mean = rng.uniform(10, 82, 100_000).astype(F32)
    u = ndtr(-0.7 * np.sqrt(mean.astype(float))) * 2.0 ** -rng.uniform(0, 5, mean.size)
    high = np.floor(u * 2**32)
    words = np.stack([high, np.floor((u * 2**32 - high) * 2**32)], axis=1).astype(np.uint32)
    found, expected = by_sums(mean, words), reference.poisson_quantile(mean.astype(float), words)
    wrong = found != expected
    tails = reference.tails(words[wrong])
    distance = distance_of_step(found[wrong], expected[wrong], mean[wrong].astype(float), *tails)
    # As above, with exp 3 + 2 * 82 ULP of 2^-23
    assert np.all(distance < (60 + 334) * ULP)
    assert wrong.sum() < 20
    assert len(np.unique(expected)) > 15


@pytest.mark.parametrize("mean", [1e-6, 1e-3])
def test_no_small_probability_is_lost(mean: float):
    """One electron comes exactly for 1 - u < 1 - exp(-mean), down to the low word of u."""
    mean = F32(mean)
    exact = -np.expm1(-float(mean)) * 2**32
    high = int(exact)
    low = int((exact - high) * 2**32)
    # The step lies at this low word, to 60 * 2^-24 of 1 - u (as above).
    reach = int(60 * ULP * exact * 2**32)
    for away, count in ((-2 * reach, 1), (2 * reach, 0)):
        word = high * 2**32 + low + away
        words = ~np.tile(np.array([[word >> 32, word & 0xFFFFFFFF]], np.uint32), (4, 1))
        assert_close(by_sums(np.full(4, mean), words), np.full(4, count), atol=0)


def test_a_uniform_on_a_step_of_the_sum_takes_the_next_count():
    mean = np.linspace(0.01, 0.6, 20_000, dtype=F32)
    step = evaluate("exp(-mean)", mean=mean).astype(float) * 2**32  # whole from 2^31 up
    words = np.stack([step.astype(np.int64), np.zeros(step.size, np.int64)], axis=1)
    assert np.all(words[:, 0] == step)
    assert_close(by_sums(mean, words), np.ones(mean.size), atol=0)


def test_a_uniform_on_a_step_of_the_tail_takes_the_lower_count():
    mean = np.linspace(1e-13, 1.1e-13, 50_000, dtype=F32)
    # As the tail is summed: terms 1 and 2 forward, then 2 + 1 backward.
    sum_ = evaluate(
        "t2 + t2 * (2.0 / mean)",
        statements="let t2 = exp(-mean) * (mean / 1.0) * (mean / 2.0);",
        mean=mean,
    )
    low = np.floor(sum_.astype(float) * 2**64)
    hit = F32(low) + F32(0.5) == F32(sum_.astype(float) * 2**64)
    words = ~np.stack([np.zeros_like(low), low], axis=1)[hit].astype(np.uint32)
    many = len(words) // 4 * 4
    assert many > 100
    assert_close(by_sums(mean[hit][:many], words[:many]), np.zeros(many), atol=0)


def test_loops_of_the_sums_end_whatever_the_mean():
    mean = F32([1000, 50, 80, 0])
    words = np.array([[2**31, 0], [~(2**23), ~0], [~(2**23), ~0], [~0, ~0]]) & 0xFFFFFFFF
    # exp(-1000) = 0: no sum reaches 1/2. P(X = 64 | 50) = 0.008 > 2^-9. exp(-80) is negligible.
    assert_close(by_sums(mean, words), np.array([63.0, 64.0, 0.0, 0.0]), atol=0)


def test_what_is_not_wanted_is_not_summed():
    mean, word = np.full((1, 4), 5, F32), np.full((1, 4), 2**31, np.uint32)
    for wanted in ("true, false, true, false", "false, false, false, true"):
        call = f"poisson_by_sums(mean, w, w, vec4<bool>({wanted}))"
        expected = [[5.0 * (one == "true") for one in wanted.split(", ")]]
        assert_close(evaluate(call, "vec4f", mean=mean, w=word), np.array(expected), atol=0)


# --- the expansion: means from 10 up ---


def test_the_expansion_is_the_quantile_of_real_counts():
    """The x of P(X < x) = Phi(w), by SciPy's incomplete gamma functions, over all w of a word.

    From means of 1e5 up to 4.4 sigmas only: farther out SciPy 1.17 takes series that it cuts short.
    """
    rng = np.random.default_rng(13)
    n = 100_000
    mean = np.exp(rng.uniform(np.log(10), np.log(1e7), n)).astype(F32)
    exact = mean.astype(float)
    lowest = np.maximum(-0.7 * np.sqrt(exact), np.where(exact < 1e5, -6.34, -4.4))
    s = (rng.uniform(lowest, np.where(exact < 1e5, 6.34, 4.4)) / np.sqrt(exact)).astype(F32)
    call = evaluate("poisson_expansion(mean, s)", "vec4f", mean=fours(mean), s=fours(s)).ravel()
    x = np.floor(exact) + call
    w = s.astype(float) * np.sqrt(exact)
    upper = w > 0
    # The smaller tail, and its slope by differences.
    tail = np.where(upper, gammainc(x, exact), gammaincc(x, exact))
    slope = np.where(upper, gammainc(x + 1e-2, exact), gammaincc(x + 1e-2, exact)) - tail
    missed = (tail - ndtr(-np.abs(w))) / (slope / 1e-2)
    # The fits: 2e-6 at 10, less beyond, and 8e-8 + 12 roundings of the way from the mean; c0.
    way = np.abs(call) + 1
    tolerance = 2e-6 * 10 / exact + 7e-7 + (8e-8 + 12 * ULP) * way
    # Differences over 0.01 know the slope to 1 % in the far tail of small means.
    assert np.all(np.abs(missed) < 1.02 * tolerance)
    assert np.sqrt(np.mean((missed / way) ** 2)) < 3e-7


MIXED = F32(
    [0, 1e-3, 0.3, 1, 3, 7.5, 9.9, np.nextafter(F32(10), F32(0)), 10, 10.05, 11.4, 30, 300.7, 5000]
)


@pytest.mark.parametrize("frame", [5, 6])
def test_counts_are_those_of_the_reference(frame: int):
    """Word for word, over all switches; otherwise only where u is as near to a step as rounding."""
    mean = np.random.default_rng(14).permutation(np.tile(MIXED, 8000))
    found, expected = counts(mean, frame=frame), expected_counts(mean, frame=frame)
    wrong = found != expected
    assert np.abs(found - expected).max() <= 1
    # An error of the deviate or of x moves the step by 1e-6 of the way from the mean, 4 sigmas at
    # most here: a share of 8e-6 sqrt(mean) differs, of 5000 6e-4, and of 300 a quarter of that.
    assert wrong.sum() < 1.5 * 6e-4 * 8000
    assert wrong[mean < 1000].sum() < 5


def test_the_second_word_decides_where_the_first_is_too_coarse():
    """Means whose step from 0 to 1 electron halves the cell of a pixel's first word."""
    col = np.arange(2**20)
    row, key = np.full_like(col, 9), 1 + (7 << 32)
    first = ~reference.shared_word(row, col, 5, reference.SHOT, key)
    chosen = first < 2**17  # one in 32 768; the step is known to 60 * 2^-24 of 2^17: half a cell
    mean = np.where(chosen, -np.log1p(-(first + 0.5) / 2**32), 0).astype(F32)
    found = counts(mean)[chosen]
    expected = reference.poisson(mean[chosen], row[chosen], col[chosen], 5, key)
    assert_close(found, expected, atol=0)
    assert found.size > 20 and 0.2 < found.mean() < 0.8


def test_large_counts_are_quantiles_of_their_words():
    """Up to 1e7: no count further from the quantile than rounding moves u, 2e-5 of its tail."""
    mean = np.exp(np.random.default_rng(15).uniform(np.log(1e4), np.log(1e7), 60_000)).astype(F32)
    exact = mean.astype(float)
    found, col = counts(mean, seed=3), np.arange(mean.size)
    high = reference.shared_word(np.full_like(col, 9), col, 5, reference.SHOT, 3 + (7 << 32))
    words = np.stack([high, np.full_like(high, 2**31)], axis=-1)
    u, rest = reference.tails(words)
    # u lies between the law's steps before and after the count.
    low = np.where(u < 0.5, pdtr(found - 1, exact) / u, rest / pdtrc(found - 1, exact))
    high = np.where(u < 0.5, u / pdtr(found, exact), pdtrc(found, exact) / rest)
    # w^2 times the deviate's 1e-6, w up to 4.5 here
    assert max(low.max(), high.max()) < 1 + 2e-5


def test_the_seed_reaches_the_counts():
    for mean in (3, 30):
        same = counts(np.full(1000, mean, F32), 1) == counts(np.full(1000, mean, F32), 2)
        assert same.mean() < 0.3


# --- the law ---


def chi_square(found: np.ndarray, mean: float) -> float:
    """Return the p-value of Pearson's test against the Poisson law, cells of 20 or more."""
    n = found.size
    reach = 6 * np.sqrt(mean) + 8
    cuts, total = [], 0.0
    for cut in np.unique(np.floor(np.linspace(max(mean - reach, 0), mean + reach, 300))):
        below = pdtr(cut, mean)
        if n * (below - total) >= 20 and n * (1 - below) >= 20:
            cuts.append(cut)
            total = below
    expected = n * np.diff([0, *pdtr(cuts, mean), 1])
    observed = np.histogram(found, [-1, *(np.array(cuts) + 0.5), np.inf])[0]
    return float(chi2.sf(((observed - expected) ** 2 / expected).sum(), len(cuts)))


LAW = [1e-3, 0.1, 1, 5, 9.9, 10, 10.1, 30, 1e3, 1e5, 1e7]


def test_the_law_by_chi_square():
    level = sidak(len(LAW))
    for mean in LAW:
        found = counts(np.full(2**20, mean, F32), seed=21)
        assert chi_square(found, float(F32(mean))) > level, mean


def test_a_law_that_is_a_little_off_is_found_out():
    """The control: a mean that is off by 1 %, where the counts are few, and by 0.1 sigma."""
    for mean, other in ((1.0, 1.01), (30.0, 30.1), (1e5, 1e5 + 30)):
        found = counts(np.full(2**20, mean, F32), seed=21)
        assert chi_square(found, other) < LEVEL / len(LAW)


def test_a_mean_of_a_millionth():
    n = 2**22
    found = counts(np.full(n, 1e-6, F32), seed=22)
    assert set(np.unique(found)) <= {0, 1}
    assert binomtest(int(found.sum()), n, -np.expm1(-1e-6)).pvalue > LEVEL
    assert found.sum() > 0


def test_mean_and_variance():
    means = [*LAW, 1e8, 1e9]
    bound = norm.isf(sidak(2 * len(means)) / 2)
    for mean in means:
        exact = float(F32(mean))
        found = counts(np.full(2**20, mean, F32), seed=23) - exact
        n = found.size
        assert abs(found.mean()) < bound * np.sqrt(exact / n), mean
        # Var of (X - mean)^2 is mean + 2 mean^2 (the fourth central moment is mean + 3 mean^2)
        assert abs((found**2).mean() - exact) < bound * np.sqrt((exact + 2 * exact**2) / n), mean


def test_no_count_is_lost_where_f32_has_gaps():
    """Around 1e8 f32 holds every eighth integer; the counts take all of them alike."""
    found = counts(np.full(2**18, 1e8, F32), seed=24)
    observed = np.bincount(found % 8, minlength=8)
    statistic = ((observed - 2**15) ** 2 / 2**15).sum()
    assert chi2.sf(statistic, 7) > LEVEL


def test_the_switch_of_methods_does_not_show():
    """One word gives one count just below and at a mean of 10, but for words on a step."""
    below, at = (
        counts(np.full(2**20, mean, F32), seed=25) for mean in (np.nextafter(F32(10), F32(0)), 10)
    )
    # Steps move by 1e-6 of a mean between the two, 4e-6 in rounding, and pass few of the words.
    assert (below != at).sum() < 2**20 * 2e-5
    assert np.abs(below - at).max() <= 1

"""Poisson counts: each step against float64, the counts word for word, and their law.

Covered: inversion down to probabilities of 2^-60 on either side; every piece of the probability;
proposals and ratios of the rejection; the switch between the methods; the ends of all loops; the
law by chi-square and z-tests from a mean of 1e-6 to 1e9; that the proposals cover the law
(reference only).
"""

import numpy as np
import pytest
from harness import assert_close, wgsl_eval
from scipy.special import gammaln, pdtr, pdtrc, xlog1py
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


def counts(mean: np.ndarray, seed: int = 1, draw: int = 0) -> np.ndarray:
    """Return poisson() at pixels 0, 1, 2 ... of row 9, frame 5."""
    col = np.arange(mean.size, dtype=np.uint32)
    counter = f"vec4u(col, 9u, 5u, PURPOSE_SHOT + {draw}u)"
    return evaluate(f"poisson(mean, {counter}, vec2u({seed}u, 7u))", "i32", mean=mean, col=col)


def expected_counts(mean: np.ndarray, seed: int = 1, draw: int = 0) -> np.ndarray:
    col = np.arange(mean.size)
    return reference.poisson(mean, np.full_like(col, 9), col, 5, seed + (7 << 32), draw)


def test_constants():
    names = ("POISSON_SPLIT", "POISSON_TERMS", "POISSON_TAIL", "f32(POISSON_DRAWS)")
    values = evaluate(f"vec4f({', '.join(names)})", "vec4f", x=F32([0]))[0]
    assert_close(values, np.array([10.0, 64.0, 2.0**-8, 16.0]), atol=0)


def test_thresholds_hold_on_their_own_side():
    """Each decision that changes the method, not the result, is fixed at and beside its bound."""

    def at(bound: float) -> np.ndarray:
        bound = F32(bound)
        return np.array([np.nextafter(bound, F32(0)), bound, np.nextafter(bound, F32(1))], F32)

    for call, bound, holds in (
        ("poisson_in_tail(x)", 2.0**-8, [1, 0, 0]),
        ("poisson_is_negligible(x)", 1e-26, [1, 1, 0]),
        ("deviance_series_holds(x)", 0.3334, [1, 1, 0]),
        ("deviance_series_holds(-x)", 0.3334, [1, 1, 0]),
        ("poisson_accepts(PoissonTrial(0.0, x), 0x7FFFFFFFu)", 0.5, [0, 1, 1]),
    ):
        assert_close(evaluate(f"select(0.0, 1.0, {call})", x=at(bound)), np.array(holds), atol=0)


# --- inversion, means below 10 ---


def test_inversion_gives_the_quantile_in_both_tails():
    """The count is right wherever V lies further than 4e-6 of itself from a step of the law.

    A probability is a sum of terms, smallest first; each has up to 60 multiplications and divisions
    of 3.5 ULP together, whose errors do not line up, and exp 3 + 2 * 10 ULP: 60 * 2^-24.
    """
    rng = np.random.default_rng(11)
    n = 200_000
    means = F32([0, 1e-12, 1e-6, 1e-3, 0.1, 1, 5, 9.9, np.nextafter(F32(10), F32(0))])
    mean = rng.choice(means, n)
    small = 2.0 ** -rng.uniform(1, 60, n)  # the smaller of V and 1 - V
    high = np.floor(small * 2**32)
    words = np.stack([high, np.floor((small * 2**32 - high) * 2**32)], axis=1).astype(np.uint32)
    words = np.where(rng.random((n, 1)) < 0.5, words, ~words)
    found = evaluate("poisson_by_inversion(mean, w)", mean=mean, w=words)
    expected = reference.poisson_quantile(mean.astype(float), words)
    wrong = np.flatnonzero(found != expected)
    step = np.minimum(found, expected)[wrong]
    upper, lower = (
        (w[:, 0] + (w[:, 1] + 0.5) / 2**32) / 2**32 for w in (words[wrong], (~words)[wrong])
    )
    exact = mean[wrong].astype(float)
    distance = np.minimum(
        np.abs(upper / pdtrc(step, exact) - 1), np.abs(lower / pdtr(step, exact) - 1)
    )
    assert np.all(np.abs(found - expected)[wrong] == 1)
    assert np.all(distance < 60 * ULP)
    assert wrong.size < 20  # of 200 000: chance lets V come so near to a step now and then
    assert len(np.unique(expected)) > 30


@pytest.mark.parametrize("mean", [1e-6, 1e-3])
def test_no_small_probability_is_lost(mean: float):
    """One electron comes exactly for V < 1 - exp(-mean), down to the low word of V."""
    mean = F32(mean)
    exact = -np.expm1(-float(mean)) * 2**32
    high = int(exact)
    low = int((exact - high) * 2**32)
    # The step lies at this low word, to 60 * 2^-24 of V (as above).
    reach = int(60 * ULP * exact * 2**32)
    for away, count in ((-2 * reach, 1), (2 * reach, 0)):
        word = high * 2**32 + low + away
        words = np.array([[word >> 32, word & 0xFFFFFFFF]], np.uint32)
        found = evaluate("poisson_by_inversion(mean, w)", mean=F32([mean]), w=words)
        assert_close(found, np.array([count]), atol=0)


def test_a_uniform_on_a_step_of_the_sum_takes_the_next_count():
    mean = np.linspace(0.01, 0.6, 20_000, dtype=F32)
    step = evaluate("exp(-mean)", mean=mean).astype(float) * 2**32  # whole from 2^31 up
    lower = step.astype(np.int64)
    words = np.stack([~lower & 0xFFFFFFFF, np.full_like(lower, 0xFFFFFFFF)], axis=1)
    found = evaluate("poisson_by_inversion(mean, w)", mean=mean, w=words.astype(np.uint32))
    assert np.all(lower == step)
    assert_close(found, np.ones(mean.size), atol=0)


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
    words = np.stack([np.zeros_like(low), low], axis=1)[hit].astype(np.uint32)
    assert hit.sum() > 100
    found = evaluate("poisson_by_inversion(mean, w)", mean=mean[hit], w=words)
    assert_close(found, np.zeros(hit.sum()), atol=0)


def test_loops_of_the_inversion_end_whatever_the_mean():
    mean = F32([1000, 50, 80])
    words = np.array([[2**31, 0], [2**23, 0], [2**23, 0]], np.uint32)  # V = 1/2, 2^-9, 2^-9
    found = evaluate("poisson_by_inversion(mean, w)", mean=mean, w=words)
    # exp(-1000) = 0: no sum reaches 1/2. P(X = 64 | 50) = 0.008 > 2^-9. exp(-80) is negligible.
    assert_close(found, np.array([64.0, 64.0, 0.0]), atol=0)


# --- rejection, means from 10 up ---


def test_stirling_error_is_right_from_one_up():
    k = np.unique(np.append(np.arange(1, 400), np.geomspace(400, 1e9, 300).round()))
    exact = gammaln(k + 1) - (k + 0.5) * np.log(k) + k - 0.5 * np.log(2 * np.pi)
    # From 30 up that difference of large numbers is worse than the series' next term, 1e-3 / k^7.
    series = 1 / (12 * k) - 1 / (360 * k**3) + 1 / (1260 * k**5)
    exact = np.where(k < 30, exact, series)
    # The fit is right to 4e-8; a division of at most 2.5 ULP: 0.081 * 2.5 * 2^-23 = 2.4e-8
    assert_close(evaluate("stirling_error(k)", k=F32(k)), exact, atol=7e-8)
    far = k > 50  # there the fit is exact
    assert_close(evaluate("stirling_error(k)", k=F32(k[far])), exact[far], rtol=10 * ULP)


def neighbourhood(n: int, sigmas: float, seed: int) -> tuple[np.ndarray, ...]:
    """Return means from 10 to 1e7 with counts around them: mean, k, k + 1 - mean."""
    rng = np.random.default_rng(seed)
    mean = np.exp(rng.uniform(np.log(10), np.log(1e7), n)).astype(F32).astype(float)
    k = np.floor(mean + rng.uniform(-sigmas, sigmas, n) * np.sqrt(mean))
    k = np.maximum(k, 0)
    return mean, k, k + 1 - mean


def test_the_series_of_the_deviance():
    w = np.linspace(0, 0.3334**2, 10_000, dtype=F32)
    exact = sum(w.astype(float) ** j / (2 * j + 3) for j in range(25))
    # The fit, and the two roundings of the last step: 4.3e-7 + 2 * 2^-24
    assert_close(evaluate("deviance_series(w)", w=w), exact, rtol=6e-7)


def test_deviance_is_right_without_cancellation():
    mean, k, d = neighbourhood(100_000, 8, 12)
    n = k + 1
    exact = xlog1py(n, d / mean) - d
    found = evaluate("deviance(k, mean, d)", k=F32(n), mean=F32(mean), d=F32(d))
    # Series: nine roundings of v, w, d and the products, and 1/7 of the fit's 4.3e-7: 12 * 2^-24 of
    # the result. Beyond it: log 3 ULP and a product, of which at most 2/3 cancel.
    v = d / (n + mean)
    rtol = np.where(np.abs(v) < 0.333, 12 * ULP, 40 * ULP)
    assert_close(found, exact, rtol=rtol, atol=4 * ULP * np.abs(v) * np.abs(d))
    assert (np.abs(v) > 0.34).sum() > 1000


def test_probability_is_right():
    mean, k, d = neighbourhood(100_000, 7, 13)
    exact = np.exp(reference.poisson_log_probability(k, mean))
    found = evaluate("poisson_probability(k, mean, d)", k=F32(k), mean=F32(mean), d=F32(d))
    # exp: 3 + 2 |x| ULP, and its argument's own error, 40 * 2^-24 of itself (deviance), |x| <= 40
    deviance = -np.log(exact * np.sqrt(2 * np.pi * mean)) + 1
    inside = exact > 1e-14
    rtol = 16 * ULP + 44 * ULP * np.abs(deviance)
    assert_close(found[inside], exact[inside], rtol=rtol[inside])
    assert (k[inside] == 0).sum() > 50


def test_proposals_and_ratios_are_those_of_the_paper():
    rng = np.random.default_rng(14)
    n = 200_000
    mean = np.exp(rng.uniform(np.log(10), np.log(1e7), n)).astype(F32)
    word = rng.integers(0, 2**32, n).astype(np.uint32)
    count, ratio = reference.poisson_trial(mean.astype(float), word)
    offset = evaluate("poisson_trial(mean, w).offset", mean=mean, w=word)
    found = evaluate("poisson_trial(mean, w).ratio", mean=mean, w=word)
    miss = offset + np.floor(mean.astype(float)) - count
    # The proposal before floor() is right to 10 * 2^-24 of itself: so many fall on the other side
    # of an integer.
    size = np.abs(count - mean)
    assert np.all(np.abs(miss) <= 1 + 10 * ULP * size)
    assert (miss != 0).sum() <= 5 + 3 * np.minimum(10 * ULP * size, 1).sum()
    same = miss == 0
    # As test_probability_is_right, and the hat: 12 * 2^-24
    rtol = 28 * ULP + 44 * ULP * np.abs(np.log(np.maximum(ratio, 1e-14)))
    assert_close(np.where(same, found, 0), np.where(same, ratio, 0), rtol=rtol, atol=1e-14)
    assert (found == 0)[count < 0].all()
    assert (count < 0).sum() > 10


def test_proposals_cover_the_law():
    """The acceptance ratio never exceeds 1, and what it accepts adds up: the law is exact."""
    words = np.arange(0, 2**32, 2**15, dtype=np.uint32)
    for mean in np.concatenate([np.linspace(10, 20, 101), np.geomspace(20, 1e7, 60)]):
        _, ratio = reference.poisson_trial(np.float64(mean), words)
        assert ratio.max() <= 1
        b = 0.931 + 2.53 * np.sqrt(mean)
        # The mean ratio is the integral of the law over the hat: alpha.
        assert abs(ratio.mean() * (1.1315 + 1.1328 / (b - 3.4)) - 1) < 1e-3


MIXED = F32(
    [0, 1e-3, 0.3, 1, 3, 7.5, 9.9, np.nextafter(F32(10), F32(0)), 10, 10.05, 11.4, 30, 300.7, 5000]
)


@pytest.mark.parametrize("draw", [0, 14, 15, 16])
def test_counts_are_those_of_the_reference(draw: int):
    """Word for word, over the switch and to the end of the draws, where the mean is returned."""
    mean = np.tile(MIXED, 4000)
    found, expected = counts(mean, draw=draw), expected_counts(mean, draw=draw)
    # Only a uniform within 1e-5 of an acceptance ratio, or a proposal as near to an integer, may
    # fall otherwise.
    assert (found != expected).sum() <= 5
    assert np.abs(found - expected).max() <= 10 * np.sqrt(5000)


def test_the_seed_reaches_the_counts():
    mean = np.full(1000, 30, F32)
    assert (counts(mean, seed=1) != counts(mean, seed=2)).mean() > 0.8


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
    """Counts just below and at a mean of 10 have one law: Smirnov's test on two samples."""
    below, at = (
        np.sort(counts(np.full(2**20, mean, F32), seed=25))
        for mean in (np.nextafter(F32(10), F32(0)), 10)
    )
    k = np.arange(60)
    distance = (
        np.abs(np.searchsorted(below, k, "right") - np.searchsorted(at, k, "right")).max() / 2**20
    )
    # Asymptotic level exp(-n D^2) * 2, conservative on integers
    assert distance < np.sqrt(np.log(2 / LEVEL) / 2**20)

// Poisson counts, exact in law for any mean, from the words of Philox.
#include "philox"
#include "uniform"

const POISSON_SPLIT = 10.0;        // e-; transformed rejection holds from 10 up (Hoermann 1993, section 4)
const POISSON_TERMS = 64.0;        // P(X >= 64) = 4e-30 at a mean of 10, far below the smallest uniform, 2^-65
const POISSON_TAIL = 0.00390625;   // 2^-8
const POISSON_DRAWS = 16u;         // two trials a draw, at a mean of 10 each fails with 0.252: P(all fail) = 7e-20

// Where sums from 0 up would lose the tail of the distribution in rounding.
fn poisson_in_tail(upper: f32) -> bool {
    return upper < POISSON_TAIL;
}

// Terms up to this cannot matter beside the smallest uniform.
fn poisson_is_negligible(term: f32) -> bool {
    return term <= 1e-26;
}

// Mean below POISSON_SPLIT: the count k with P(X < k) <= 1 - V < P(X <= k), V = (words + 1/2) / 2^64.
// Probabilities are summed from the end that is nearer, smallest first, so that small ones keep their digits.
fn poisson_by_inversion(mean: f32, words: vec2u) -> f32 {
    let upper = unit64(words);
    let lower = unit64(~words);
    var k = 0.0;
    var term = exp(-mean);
    var sum = term;
    if (!poisson_in_tail(upper)) {
        while (lower >= sum && k < POISSON_TERMS) {
            k += 1.0;
            term *= mean / k;
            sum += term;
        }
        return k;
    }
    while (!poisson_is_negligible(term) && k < POISSON_TERMS) {
        k += 1.0;
        term *= mean / k;
    }
    sum = term;
    while (upper >= sum && k > 0.0) {
        term *= k / mean;
        k -= 1.0;
        sum += term;
    }
    return k;
}

// log k! = log(sqrt(2 pi k) (k/e)^k) + stirling_error(k), k >= 1: Stieltjes' continued fraction
// (Abramowitz & Stegun 6.1.48), its last two numbers fitted to k = 1 and 2; error below 4e-8.
fn stirling_error(k: f32) -> f32 {
    return 0.083333333 / (k + 0.033333333 / (k + 0.2437932 / (k + 0.28751355 / k)));
}

fn deviance_series_holds(v: f32) -> bool {
    return abs(v) <= 0.3334;
}

// (atanh(v) / v - 1) / w, w = v^2, where that holds: 1/3 + w/5 + w^2/7 ... as a cubic, minimax, relative error 4.3e-7.
fn deviance_series(w: f32) -> f32 {
    return ((0.134499831 * w + 0.141146145) * w + 0.200039072) * w + 0.333333201;
}

// k log(k / mean) + mean - k with d = k - mean given apart (Loader 2000, "Fast and accurate computation of binomial
// probabilities", section 3): with v = d / (k + mean), log(k / mean) = 2 atanh(v), whose first term cancels exactly.
// Beyond |v| = 1/3 there is little cancellation, and the ratio lies outside 1/2..2, where log holds 3 ULP.
fn deviance(k: f32, mean: f32, d: f32) -> f32 {
    let v = d / (k + mean);
    if (deviance_series_holds(v)) {
        let w = v * v;
        return v * (d + 2.0 * k * w * deviance_series(w));
    }
    return k * log(k / mean) - d;
}

// P(X = k): by p(k) = p(k+1) (k+1) / mean, so that Stirling's form starts at 1; d = k + 1 - mean given apart.
fn poisson_probability(k: f32, mean: f32, d: f32) -> f32 {
    let n = k + 1.0;
    return exp(-stirling_error(n) - deviance(n, mean, d)) * sqrt(n * 0.15915494) / mean;   // 1 / (2 pi)
}

struct PoissonTrial {
    offset: f32,   // proposed count - floor(mean): exact where the count itself has no f32
    ratio: f32,    // accept with this probability
}

// Mean from POISSON_SPLIT up: one proposal of the transformed rejection PTRS (Hoermann 1993, "The transformed
// rejection method for generating Poisson random variables"), without its squeezes: eight lanes rarely agree on them.
// His 1.1239 lets the ratio reach 1.0057 near mean 12, a deviation of 7e-7 in law; 1.1315 keeps it below 1 everywhere.
fn poisson_trial(mean: f32, word: u32) -> PoissonTrial {
    let b = 0.931 + 2.53 * sqrt(mean);
    let a = -0.059 + 0.02483 * b;
    let inverse_alpha = 1.1315 + 1.1328 / (b - 3.4);
    let s = edge(word);
    let whole = floor(mean);
    let part = fract(mean);   // written mean - whole, lavapipe adds the mean first and loses its part
    let offset = floor((2.0 * a / s + b) * centred(word) + part + 0.43);
    let k = whole + offset;
    if (k < 0.0) {
        return PoissonTrial(offset, 0.0);
    }
    let probability = poisson_probability(k, mean, offset + 1.0 - part);
    return PoissonTrial(offset, probability * (a / (s * s) + b) / inverse_alpha);
}

fn poisson_accepts(trial: PoissonTrial, word: u32) -> bool {
    return unit(word) <= trial.ratio;
}

// The count for this counter, 0 <= mean < 2^31.
fn poisson(mean: f32, counter: vec4u, key: vec2u) -> i32 {
    for (var c = counter; (c.w & DRAW_MASK) < POISSON_DRAWS; c.w++) {
        let words = philox(c, key);
        if (mean < POISSON_SPLIT) {
            return i32(poisson_by_inversion(mean, words.xy));
        }
        let first = poisson_trial(mean, words.x);
        if (poisson_accepts(first, words.y)) {
            return i32(floor(mean)) + i32(first.offset);
        }
        let second = poisson_trial(mean, words.z);
        if (poisson_accepts(second, words.w)) {
            return i32(floor(mean)) + i32(second.offset);
        }
    }
    return i32(floor(mean));
}

// Poisson counts by inversion, exact in law for any mean: the count of the uniform number u is k with
// P(X < k) < u <= P(X <= k). Four pixels at a time, which share the words of one call of the generator.
#include "philox"
#include "gaussian"

const POISSON_SPLIT = 10.0;        // e-; the expansion holds from 10 up ...
const POISSON_LOWEST = -0.7;       // ... and from this distance from the mean, as sqrt(mean) has it; farther down, sums do
const POISSON_TERMS = 64.0;        // P(X >= 64) = 4e-30 at a mean of 10, far below the smallest uniform, 2^-65
const POISSON_TAIL = 0.00390625;   // 2^-8
const POISSON_NEAR = 0x100000u;    // 2^20: nearer to an end than this a second word makes u finer than 2^-21 of itself

// Where sums from 0 up would lose the tail of the distribution in rounding.
fn poisson_in_tail(upper: f32) -> bool {
    return upper < POISSON_TAIL;
}

// Terms up to this cannot matter beside the smallest uniform.
fn poisson_is_negligible(term: f32) -> bool {
    return term <= 1e-26;
}

// Where the words are too few for their distance from 0 or 1.
fn poisson_near_end(words: vec4u) -> vec4<bool> {
    return min(words, ~words) < vec4u(POISSON_NEAR);
}

// The count for u = lower by sums from 0 up, where wanted; mean below 85, so that exp(-mean) is a normal number.
fn poisson_from_below(mean: vec4f, lower: vec4f, wanted: vec4<bool>) -> vec4f {
    var k = vec4f(0.0);
    var term = exp(-mean);
    var sum = term;
    for (var next = 1.0; next < POISSON_TERMS; next += 1.0) {
        let beyond = wanted & (lower >= sum);
        if (!any(beyond)) {
            break;
        }
        k = select(k, vec4f(next), beyond);
        term *= mean * (1.0 / next);
        sum += term;
    }
    return k;
}

// The count for u = 1 - upper, by sums from the end, smallest first, so that small probabilities keep their digits.
fn poisson_from_above(mean: f32, upper: f32) -> f32 {
    var k = 0.0;
    var term = exp(-mean);
    while (!poisson_is_negligible(term) && k < POISSON_TERMS) {
        k += 1.0;
        term *= mean / k;
    }
    var sum = term;
    while (upper >= sum && k > 0.0) {
        term *= k / mean;
        k -= 1.0;
        sum += term;
    }
    return k;
}

// The count by sums, where wanted: u = (high + (low + 1/2) / 2^32) / 2^32.
fn poisson_by_sums(mean: vec4f, high: vec4u, low: vec4u, wanted: vec4<bool>) -> vec4f {
    let upper = unit64(~high, ~low);
    var k = poisson_from_below(mean, unit64(high, low), wanted);
    for (var i = 0u; i < 4u; i++) {
        if (wanted[i] && poisson_in_tail(upper[i])) {
            k[i] = poisson_from_above(mean[i], upper[i]);
        }
    }
    return k;
}

// x - floor(mean), where P(X < x) = Phi(sqrt(mean) s), continued to real x by the incomplete gamma function:
//   x = mean + mean s g(s) + c0(s) + c1(s) / mean + c2(s) / mean^2
// after Temme 1979 ("The asymptotic expansion of the incomplete gamma functions") and Giles 2016 (ACM TOMS 42(1) 7,
// algorithm 955, section 2): with r = 1 + s g(s), s^2 / 2 = 1 - r + r log r and c0 = log(s sqrt(r) / (r - 1)) / log r.
// g and c0 are minimax polynomials over -0.7 .. 2.01, to 8e-8 and 7e-7; c1 and c2 are fitted to exact x at means from
// 10 to 400, so that x errs by 2e-6 at most: less than its rounding. mean >= POISSON_SPLIT.
fn poisson_expansion(mean: vec4f, s: vec4f) -> vec4f {
    let g = ((((((((4.7715986e-6 * s - 3.8551500e-5) * s + 1.3447990e-4) * s - 2.9528278e-4) * s + 5.7660984e-4) * s
        - 1.3201484e-3) * s + 3.6958935e-3) * s - 1.3889865e-2) * s + 0.16666736) * s + 1.0;
    let c0 = (((((((2.3878428e-5 * s - 1.7248454e-4) * s + 5.2402509e-4) * s - 9.8417458e-4) * s + 1.6833723e-3) * s
        - 3.4804557e-3) * s + 8.6294344e-3) * s - 2.7781515e-2) * s + 0.33333379;
    let c1 = ((((((4.1060154e-4 * s - 2.5313885e-3) * s + 6.1273209e-3) * s - 8.1945121e-3) * s + 9.1556138e-3) * s
        - 1.2322251e-2) * s + 1.7148376e-2) * s - 1.9777839e-2;
    let c2 = (-1.3230186e-3 * s + 2.3311624e-3) * s - 4.4366871e-4;
    // fract(), as lavapipe takes mean - floor(mean) apart and adds the mean first, which loses its part.
    return mean * s * g + (fract(mean) + c0 + (c1 + c2 / mean) / mean);
}

// The counts of the pixels 4 counter.x .. + 3, 0 <= mean < 2^31. u comes from one word a pixel, and near its ends,
// where sums need it, from a second.
fn poisson(mean: vec4f, counter: vec4u, key: vec2u) -> vec4i {
    let words = philox(counter, key);
    let large = max(mean, vec4f(POISSON_SPLIT));
    let s = gaussian(words) * inverseSqrt(large);
    let expands = (mean >= vec4f(POISSON_SPLIT)) & (s >= vec4f(POISSON_LOWEST));
    let whole = floor(mean);
    var offset = floor(poisson_expansion(large, s));
    if (!all(expands)) {
        var low = vec4u(0x80000000u);
        let near = poisson_near_end(words) & !expands;
        if (any(near)) {
            low = select(low, philox(counter + vec4u(0u, 0u, 0u, 1u), key), near);
        }
        offset = select(poisson_by_sums(mean, words, low, !expands) - whole, offset, expands);
    }
    return vec4i(whole) + vec4i(offset);
}

// Sums and products of two f32 with their rounding errors, vec2f(rounded, error), by integers alone: for adapters whose
// driver takes rounding errors of f32 for zero (gpusim/gpu/exact.py). The same numbers as two_sum and two_product of
// double_float.wgsl, which an adapter that rounds to nearest gets from f32. A number is m 2^k, m an integer of 24 bits; sums
// and products are integers of 50 bits at most, in two u32, which are rounded to 24 bits, ties to even (IEEE 754, 4.3.1).
// Numbers too small for a normal f32 are 0. Infinities and NaN stay what they are; their errors mean nothing.

const SIGN = 0x80000000u;
const INFINITE = 0x7F800000u;

// m 2^k with a sign bit, m <= 2^24.
fn of_integer(m: u32, sign: u32, k: i32) -> f32 {
    let bits = bitcast<u32>(f32(m));
    let exponent = i32(bits >> 23u) + k;
    let fraction = select(bits & 0x7FFFFFu, 0u, exponent >= 255);
    let number = sign | (u32(clamp(exponent, 0, 255)) << 23u) | fraction;
    return bitcast<f32>(select(number, 0u, m == 0u || exponent <= 0));
}

// (high 2^32 + low) 2^k with a sign bit, rounded, and what that leaves; high < 2^18.
fn rounded(high: u32, low: u32, sign: u32, k: i32) -> vec2f {
    let top = select(firstLeadingBit(low | 1u), 32u + firstLeadingBit(high | 1u), high > 0u);
    let cut = max(top, 23u) - 23u;   // bits, up to 26; where there are none, high is 0
    let kept = (high << (32u - max(cut, 1u))) | (low >> cut);
    let rest = low & ((1u << cut) - 1u);
    let middle = (1u << cut) >> 1u;
    let up = cut > 0u && (rest > middle || (rest == middle && (kept & 1u) == 1u));
    return vec2f(
        of_integer(kept + select(0u, 1u, up), sign, k + i32(cut)),
        of_integer(select(rest, (1u << cut) - rest, up), select(sign, sign ^ SIGN, up), k),
    );
}

// The 24 bits of a number that is no subnormal: those are 0.
fn significand(bits: u32) -> u32 {
    return select((bits & 0x7FFFFFu) | 0x800000u, 0u, (bits & INFINITE) == 0u);
}

fn exponent_of(bits: u32) -> i32 {
    return i32((bits & INFINITE) >> 23u);
}

fn integer_sum(a: f32, b: f32) -> vec2f {
    let swap = (bitcast<u32>(b) & ~SIGN) > (bitcast<u32>(a) & ~SIGN);
    let p = bitcast<u32>(select(a, b, swap));   // the larger
    let q = bitcast<u32>(select(b, a, swap));
    let apart = exponent_of(p) - exponent_of(q);
    let n = significand(q);
    // m 2^apart +- n in two words, - n as its complement.
    let m = significand(p);
    let shift = u32(min(apart, 25));
    let opposite = ((p ^ q) & SIGN) != 0u && n > 0u;
    let shifted = m << shift;
    let low = shifted + select(n, 0u - n, opposite);
    let carry = select(0u, 1u, low < shifted);
    let high = select(m >> (32u - max(shift, 1u)), 0u, shift == 0u) + carry + select(0u, 0xFFFFFFFFu, opposite);
    let sum = rounded(high, low, p & SIGN, exponent_of(q) - 150);
    // Less than a quarter of the larger one's last bit changes nothing, even below a power of two.
    let as_they_are = vec2f(bitcast<f32>(p), select(bitcast<f32>(q), 0.0, n == 0u));
    return select(sum, as_they_are, n == 0u || apart > 25 || exponent_of(p) == 255);
}

fn integer_product(a: f32, b: f32) -> vec2f {
    let p = bitcast<u32>(a);
    let q = bitcast<u32>(b);
    // By halves of 12 bits: (c 2^12 + d) (e 2^12 + f).
    let m = significand(p);
    let n = significand(q);
    let c = m >> 12u;
    let d = m & 0xFFFu;
    let e = n >> 12u;
    let f = n & 0xFFFu;
    let across = c * f + d * e;   // < 2^25
    let low = d * f + (across << 12u);
    let carry = select(0u, 1u, low < d * f);
    let upper = c * e;
    let sum = low + (upper << 24u);
    let high = (upper >> 8u) + (across >> 20u) + carry + select(0u, 1u, sum < low);
    let product = rounded(high, sum, (p ^ q) & SIGN, exponent_of(p) + exponent_of(q) - 300);
    return select(product, vec2f(a * b, 0.0), exponent_of(p) == 255 || exponent_of(q) == 255);
}

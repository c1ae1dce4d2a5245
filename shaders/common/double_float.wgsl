// Sums and products of numbers held as an unevaluated sum of two f32, 48 bits together, vec2f(high, low):
// two_sum (Knuth 1969), products of halves of 12 bits (Dekker 1971; here cut by a mask, so that no
// multiplication is needed and nothing depends on fma being fused or not).
//
// Depends on the globals: params.zero, u32, always 0. A compiler may take (a + b) - a for b, and lavapipe does;
// an exclusive or with a number that it cannot know hides the sum from it. Where one finds out even so, INTEGERS has the
// same sums and products made by integers (gpusim/gpu/exact.py tries both on each adapter).
#include "integer_float"

override INTEGERS: bool = false;

fn pin(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ params.zero);
}

// The upper 12 bits of a number; the rest of it has 12 bits too.
fn upper_half(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) & 0xFFFFF000u);
}

// a + b exactly.
fn two_sum(a: f32, b: f32) -> vec2f {
    if (INTEGERS) {
        return integer_sum(a, b);
    }
    let s = pin(a + b);
    let v = pin(s - a);
    return vec2f(s, (a - (s - v)) + (b - v));
}

// a + b exactly where |a| >= |b|.
fn quick_two_sum(a: f32, b: f32) -> vec2f {
    if (INTEGERS) {
        return integer_sum(a, b);
    }
    let s = pin(a + b);
    return vec2f(s, b - (s - a));
}

// a b exactly.
fn two_product(a: f32, b: f32) -> vec2f {
    if (INTEGERS) {
        return integer_product(a, b);
    }
    let p = pin(a * b);
    let c = upper_half(a);
    let d = a - c;
    let e = upper_half(b);
    let f = b - e;
    return vec2f(p, ((c * e - p) + c * f + d * e) + d * f);
}

fn df_add(a: vec2f, b: vec2f) -> vec2f {
    let s = two_sum(a.x, b.x);
    return quick_two_sum(s.x, s.y + (a.y + b.y));
}

fn df_multiply(a: vec2f, b: vec2f) -> vec2f {
    let p = two_product(a.x, b.x);
    return quick_two_sum(p.x, p.y + (a.x * b.y + a.y * b.x));
}

fn df_square(a: vec2f) -> vec2f {
    let p = two_product(a.x, a.x);
    return quick_two_sum(p.x, p.y + 2.0 * a.x * a.y);
}

// One step of Newton from the square root of the high part: good to 2^-44, a >= 0.
fn df_sqrt(a: vec2f) -> vec2f {
    let root = sqrt(a.x);
    let left = df_add(a, -two_product(root, root));
    return quick_two_sum(root, select(0.0, 0.5 * left.x / root, root > 0.0));
}

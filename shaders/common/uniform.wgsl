// Uniform numbers from random words, formed so that no small probability is lost in f32: each is right to
// 2^-23 of itself, and never 0 or 1 (a word w stands for the middle of its cell, (w + 1/2) / 2^32).

const CELL = 2.3283064365386963e-10;   // 2^-32

// In (0, 1]; relative precision near 0.
fn unit(words: vec4u) -> vec4f {
    return (vec4f(words) + 0.5) * CELL;
}

// The same from 64 bits.
fn unit64(high: vec4u, low: vec4u) -> vec4f {
    return (vec4f(high) + unit(low)) * CELL;
}

// unit(words) - 1/2 in [-1/2, 1/2]; relative precision near 0.
fn centred(words: vec4u) -> vec4f {
    return (vec4f(bitcast<vec4i>(words ^ vec4u(0x80000000u))) + 0.5) * CELL;
}

// Distance of unit(words) from the nearer of 0 and 1, in (0, 1/2]; relative precision near 0. (Signed integers, which
// these are, become f32 in one instruction of most processors.)
fn edge(words: vec4u) -> vec4f {
    return (vec4f(bitcast<vec4i>(min(words, ~words))) + 0.5) * CELL;
}

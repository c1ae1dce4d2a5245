// Uniform numbers from random words, formed so that no small probability is lost in f32: each is right to
// 2^-23 of itself, and never 0 or 1 (a word w stands for the middle of its cell, (w + 1/2) / 2^32).

const CELL = 2.3283064365386963e-10;   // 2^-32

// In (0, 1]; relative precision near 0.
fn unit(word: u32) -> f32 {
    return (f32(word) + 0.5) * CELL;
}

// The same from 64 bits, x the high word.
fn unit64(words: vec2u) -> f32 {
    return (f32(words.x) + unit(words.y)) * CELL;
}

// unit(word) - 1/2 in [-1/2, 1/2]; relative precision near 0.
fn centred(word: u32) -> f32 {
    return (f32(bitcast<i32>(word ^ 0x80000000u)) + 0.5) * CELL;
}

// Distance of unit(word) from the nearer of 0 and 1, in (0, 1/2]; relative precision near 0.
fn edge(word: u32) -> f32 {
    return unit(min(word, ~word));
}

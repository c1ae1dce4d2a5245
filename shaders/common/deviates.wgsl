// Standard normal deviates of pixels, rows and columns, from the generator's counters.
#include "philox"
#include "gaussian"

// For the pixels 4 quad .. + 3 of a row.
fn of_pixels(quad: u32, row: u32, frame: u32, purpose: u32, key: vec2u) -> vec4f {
    return gaussian(philox(vec4u(quad, row, frame, purpose), key));
}

// For the columns 4 quad .. + 3, alike in all rows.
fn of_columns(quad: u32, frame: u32, purpose: u32, key: vec2u) -> vec4f {
    return of_pixels(quad, 0u, frame, purpose, key);
}

// For a row, alike in all its pixels: the first word of the call of quad 0.
fn of_row(row: u32, frame: u32, purpose: u32, key: vec2u) -> f32 {
    return of_pixels(0u, row, frame, purpose, key).x;
}

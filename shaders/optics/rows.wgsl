// First half of the space-variant convolution: forward transform of every row of one source block.
//
// A block of BY x BX samples of each coefficient plane a_j lies between four PSF nodes. With s the position
// between the left and the right node (0..1), the real rows a_j (1 - s) and a_j s share one complex transform:
//   spectra[j, y, k] = sum_x a_j[y, x] ((1 - s(x)) + i s(x)) exp(-2 pi i k x / T),   s(x) = first_s + x step_s
// planes (J, BY, BX) in the planes' own unit -> spectra (J, BY, T), same unit.
// Dispatch: (BY, planes that the block needs, 1) workgroups of LANES = T/8 invocations, one row each.
#include "line_fft"

override T: u32 = 512u;           // transform length, samples
override LANES: u32 = 64u;        // T/8
override FIRST_RADIX: u32 = 8u;   // 2, 4 or 8: T = FIRST_RADIX 8^k
override BX: u32 = 336u;          // block width, samples
override BY: u32 = 336u;          // block height, samples

struct Params {
    first_s: f32,
    step_s: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> planes: array<f32>;
@group(0) @binding(3) var<storage, read_write> spectra: array<vec2f>;

var<workgroup> sh_line: array<vec2f, T>;

fn weighted(row: u32, x: u32) -> vec2f {
    let a = select(0.0, planes[row * BX + min(x, BX - 1u)], x < BX);
    let s = params.first_s + f32(x) * params.step_s;
    return vec2f(a * (1.0 - s), a * s);
}

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let row = group.y * BY + group.x;
    let v = line_fft(Octet(
        weighted(row, t),
        weighted(row, t + LANES),
        weighted(row, t + 2u * LANES),
        weighted(row, t + 3u * LANES),
        weighted(row, t + 4u * LANES),
        weighted(row, t + 5u * LANES),
        weighted(row, t + 6u * LANES),
        weighted(row, t + 7u * LANES),
    ), t);
    let d = row * T + t;
    spectra[d] = v.v0;
    spectra[d + LANES] = v.v1;
    spectra[d + 2u * LANES] = v.v2;
    spectra[d + 3u * LANES] = v.v3;
    spectra[d + 4u * LANES] = v.v4;
    spectra[d + 5u * LANES] = v.v5;
    spectra[d + 6u * LANES] = v.v6;
    spectra[d + 7u * LANES] = v.v7;
}

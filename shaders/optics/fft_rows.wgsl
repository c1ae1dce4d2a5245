// First half of the space-variant convolution: forward transform of every row of one source block.
//
// A block of BY x BX samples of each coefficient plane a_j lies between four PSF nodes. With s the position
// between the left and the right node (0..1), the real rows a_j (1 - s) and a_j s share one complex transform:
//   spectra[j, y, k] = sum_x a_j[y, x] ((1 - s(x)) + i s(x)) exp(-2 pi i k x / T),   s(x) = first_s + x step_s
// planes (J, BY, BX) in the planes' own unit -> spectra (J, BY, T), same unit. Where a lens is symmetric, a block on the far
// side of an axis is convolved as the mirror image of the block that uses the same nodes: its rows, or the samples of each
// row, are read from the end.
// Dispatch: (ceil(BY/2), planes that the block needs, 1) workgroups of LANES = T/8 invocations, two rows each.
#include "line_fft"

override T: u32 = 512u;           // transform length, samples
override LANES: u32 = 64u;        // T/8
override FIRST_RADIX: u32 = 8u;   // 2, 4 or 8: T = FIRST_RADIX 8^k
override BX: u32 = 336u;          // block width, samples
override BY: u32 = 336u;          // block height, samples

struct Params {
    first_s: f32,
    step_s: f32,
    mirrored: vec2u,              // 1 where the block is read from its end, x and y
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> planes: array<f32>;
@group(0) @binding(3) var<storage, read_write> spectra: array<vec2f>;

var<workgroup> sh_line: array<vec4f, T>;

// Where a row of a plane is read.
fn source_row(row: u32) -> u32 {
    let y = row % BY;
    return row - y + select(y, BY - 1u - y, params.mirrored.y == 1u);
}

// Two rows: a (1 - s) and a s each.
fn weighted(row: u32, next: u32, x: u32) -> vec4f {
    if (x >= BX) {
        return vec4f(0.0);
    }
    let s = params.first_s + f32(x) * params.step_s;
    let from_ = select(x, BX - 1u - x, params.mirrored.x == 1u);
    let a = planes[source_row(row) * BX + from_];
    let b = planes[source_row(next) * BX + from_];
    return vec4f(a * (1.0 - s), a * s, b * (1.0 - s), b * s);
}

fn keep(row: u32, next: u32, k: u32, pair: vec4f) {
    spectra[row * T + k] = pair.xy;
    if (next != row) {
        spectra[next * T + k] = pair.zw;
    }
}

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let row = group.y * BY + 2u * group.x;
    let next = select(row, row + 1u, 2u * group.x + 1u < BY);  // none after the last of an odd number
    let v = line_fft(Octet(
        #repeat k 8
        weighted(row, next, t + ${k}u * LANES),
        #end
    ), t, 0u, T, FIRST_RADIX);
    #repeat k 8
    keep(row, next, t + ${k}u * LANES, v.v${k});
    #end
}

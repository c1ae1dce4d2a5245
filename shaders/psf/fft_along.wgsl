// Transform of the pupil along beta, two rows at a time, at the columns xi of the PSF that are wanted:
//   G[n, i] = sum_j field[i, j] exp(2 pi i j n / T),   n = -N/2 .. N/2 - 1
// up to a phase that depends on n alone, which the intensity does not see.
// field (P, A, T) -> lines (P, N, A).
// Dispatch: (ceil(A/2), P, 1) workgroups of LANES = T/8 invocations.
#include "line_fft"

override T: u32 = 1024u;      // transform length
override LANES: u32 = 128u;   // T/8
override FIRST_RADIX: u32 = 2u;
override N: u32 = 256u;       // columns of the PSF

struct Params {
    rows: u32,                // A
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> field: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> lines: array<vec2f>;

var<workgroup> sh_line: array<vec4f, T>;

fn two(pair: u32, row: u32, j: u32) -> vec4f {
    let at = (pair * params.rows + row) * T + j;
    let other = select(at, at + T, row + 1u < params.rows);
    return vec4f(field[at], field[other]);
}

fn keep(pair: u32, row: u32, k: u32, value: vec4f) {
    // The forward transform has exp(-2 pi i j k / T): n = -k.
    let column = (T - k + N / 2u) % T;
    if (column < N) {
        let at = (pair * N + column) * params.rows + row;
        lines[at] = value.xy;
        if (row + 1u < params.rows) {
            lines[at + 1u] = value.zw;
        }
    }
}

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let pair = group.y;
    let row = 2u * group.x;
    let v = line_fft(Octet(
        #repeat k 8
        two(pair, row, t + ${k}u * LANES),
        #end
    ), t, 0u, T, FIRST_RADIX);
    #repeat k 8
    keep(pair, row, t + ${k}u * LANES, v.v${k});
    #end
}

// Transform along alpha, two columns of the PSF at a time, and the intensity:
//   I[m, n] = |sum_i G[n, i] exp(2 pi i (i + 1/2) m / T)|^2
// Mirrored: i = -A .. A - 1, G[n, -1-i] = G[n, i], for m = 0 .. N/2; the PSF is as symmetric in eta as the pupil in
// alpha. Else: i = 0 .. A - 1, m = -N/2 .. N/2 - 1; where the rows begin is a phase that the intensity does not see.
// lines (P, N, A) -> intensity (P, N/2 + 1, N), or (P, N, N).
// Dispatch: (N/2, P, 1) workgroups of LANES = T/8 invocations.
#include "line_fft"

override T: u32 = 1024u;      // transform length, at least the rows of both halves
override LANES: u32 = 128u;   // T/8
override FIRST_RADIX: u32 = 2u;
override N: u32 = 256u;       // columns of the PSF, even
override MIRRORED: bool = true;

struct Params {
    rows: u32,                // A
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> lines: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> intensity: array<f32>;

var<workgroup> sh_line: array<vec4f, T>;

fn two(pair: u32, column: u32, t: u32) -> vec4f {
    let i = select(t, min(t, T - 1u - t), MIRRORED);
    if (i >= params.rows) {
        return vec4f(0.0);
    }
    let at = (pair * N + column) * params.rows + i;
    return vec4f(lines[at], lines[at + params.rows]);
}

fn keep(pair: u32, column: u32, k: u32, value: vec4f) {
    // The forward transform has exp(-2 pi i i k / T): m = -k, which is as good as k where the PSF is symmetric.
    let row = select((T - k + N / 2u) % T, k, MIRRORED);
    let rows = select(N, N / 2u + 1u, MIRRORED);
    if (row < rows) {
        let at = (pair * rows + row) * N + column;
        intensity[at] = dot(value.xy, value.xy);
        intensity[at + 1u] = dot(value.zw, value.zw);
    }
}

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let pair = group.y;
    let column = 2u * group.x;
    let v = line_fft(Octet(
        #repeat k 8
        two(pair, column, t + ${k}u * LANES),
        #end
    ), t, 0u, T, FIRST_RADIX);
    keep(pair, column, t, v.v0);
    keep(pair, column, t + LANES, v.v1);
    keep(pair, column, t + 2u * LANES, v.v2);
    keep(pair, column, t + 3u * LANES, v.v3);
    keep(pair, column, t + 4u * LANES, v.v4);
    if (!MIRRORED) {  // else the rest lies beyond T/2, and N is at most T
        keep(pair, column, t + 5u * LANES, v.v5);
        keep(pair, column, t + 6u * LANES, v.v6);
        keep(pair, column, t + 7u * LANES, v.v7);
    }
}

// Last step of the space-variant convolution: inverse transform in x at the photosites, and overlap-add
// of the block's window into the planes of the CFA sites.
//
//   F_s[q] = sum over k = q (mod M) of X_s[k],  X_s[T-k] = conj X_s[k] because both planes are real
//   rates[site, origin_y + m, origin_x + n] += sum_q F_s[q] exp(2 pi i q n / M)
// Two sites share one complex transform: F_s + i F_s'.
// folded (S, T/2+1, M) electrons/s -> rates (S, rows, cols) electrons/s.
// Dispatch: (M, ceil(S/2), 1) workgroups of LANES invocations: one lattice row of two sites each.
// Blocks are added one after another, in a fixed order, so that tiles repeat the same sums bit for bit.
#include "line_ifft"

override T: u32 = 512u;           // transform length, samples
override LANES: u32 = 64u;        // T/8
override M: u32 = 128u;           // T/D, photosites of one site across the window
override S: u32 = 4u;             // sites of the CFA period
override SCRATCH: u32 = 256u;     // 2 M

const LINES = 1u;                 // lines that line_ifft inverts together

struct Params {
    origin: vec2i,                // (x, y) of the window's first photosite in the planes
    size: vec2i,                  // (columns, rows) of the planes
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> folded: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> rates: array<f32>;

var<workgroup> sh_line: array<vec2f, SCRATCH>;

fn half_spectrum(site: u32, k: u32, m: u32) -> vec2f {
    return folded[(site * (T / 2u + 1u) + k) * M + m];
}

fn folded_bin(site: u32, q: u32, m: u32) -> vec2f {
    var sum = vec2f(0.0);
    for (var k = q; k < T; k += M) {
        if (k <= T / 2u) {
            sum += half_spectrum(site, k, m);
        } else {
            sum += conj(half_spectrum(site, T - k, m));
        }
    }
    return sum;
}

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let m = group.x;
    let site = 2u * group.y;
    let paired = site + 1u < S;
    for (var q = t; q < M; q += LANES) {
        var bin = folded_bin(site, q, m);
        if (paired) {
            bin += times_i(folded_bin(site + 1u, q, m));
        }
        sh_line[q] = bin;
    }
    workgroupBarrier();
    let here = line_ifft(t);
    let y = params.origin.y + i32(m);
    if (y < 0 || y >= params.size.y) {
        return;
    }
    for (var n = t; n < M; n += LANES) {
        let x = params.origin.x + i32(n);
        if (x >= 0 && x < params.size.x) {
            let value = sh_line[here + n];
            let i = (i32(site) * params.size.y + y) * params.size.x + x;
            rates[i] += value.x;
            if (paired) {
                rates[i + params.size.x * params.size.y] += value.y;
            }
        }
    }
}

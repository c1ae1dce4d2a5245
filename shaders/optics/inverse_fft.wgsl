// Last step of the space-variant convolution: fold of the frequencies in x onto those of the photosites, inverse transform
// there, and overlap-add of the block's window into the planes of the CFA sites.
//
//   rates[site, origin_y + step_y m, origin_x + step_x n] += sum_q sum_d F_s[q + d M] exp(2 pi i q n / M),  F_s[T-k] = conj F_s[k], F_s[T/2] = 0
// Two sites share one complex transform, F_s + i F_s', and two of those share the lanes.
// folded (ceil(S/2), M, T/2, 2) electrons/s -> rates (S, rows, cols) electrons/s.
// Only those photosites of the window are added that the block's light reaches: beyond them lie rounding errors.
// Dispatch: (ceil(seen_y/D), ceil(S/4), 1) workgroups of LANES invocations: D rows of photosites of four sites each.
// Blocks are added one after another, in a fixed order, so that tiles repeat the same sums bit for bit.
#include "line_fft"

override T: u32 = 512u;           // transform length, samples
override LANES: u32 = 64u;        // T/8
override D: u32 = 4u;             // samples from a photosite to the next of the same site
override M: u32 = 128u;           // T/D, photosites of one site across the window
override SITE_RADIX: u32 = 2u;    // 2, 4 or 8: M = SITE_RADIX 8^k
override S: u32 = 4u;             // sites of the CFA period, or channels of all pixels

struct Params {
    origin: vec2i,                // (x, y) of the window's first photosite in the planes
    step: vec2i,                  // 1, or -1 where the block was convolved as its mirror image
    size: vec2i,                  // (columns, rows) of the planes
    seen: vec2u,                  // photosites of the window that are added, in x and y
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> folded: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> rates: array<f32>;

var<workgroup> sh_line: array<vec4f, T>;

// conj(F_s + i F_s') of two sites at bin q: the inverse transform is the conjugate of the conjugate's forward one.
fn bin(pair: u32, q: u32, m: u32) -> vec2f {
    let line = (pair * M + m) * (T / 2u);
    var sum = vec4f(0.0);
    for (var k = q; k < T; k += M) {
        if (k < T / 2u) {
            sum += folded[line + k];
        } else if (k > T / 2u) {
            sum += pair_conj(folded[line + T - k]);
        }
    }
    return vec2f(sum.x - sum.w, -sum.y - sum.z);
}

// With one or two sites the second pair is read past the end, and not used.
fn bins(pair: u32, q: u32, m: u32) -> vec4f {
    return vec4f(bin(pair, q, m), bin(pair + 1u, q, m));
}

fn add(site: u32, n: u32, m: u32, pair: vec4f) {
    let x = params.origin.x + params.step.x * i32(n);
    let y = params.origin.y + params.step.y * i32(m);
    if (n >= params.seen.x || m >= params.seen.y || x < 0 || x >= params.size.x || y < 0 || y >= params.size.y) {
        return;
    }
    let plane = params.size.x * params.size.y;
    let i = (i32(site) * params.size.y + y) * params.size.x + x;
    rates[i] += pair.x;
    if (S % 4u == 0u || site + 1u < S) {
        rates[i + plane] -= pair.y;
    }
    if (S % 4u == 0u || site + 2u < S) {
        rates[i + 2 * plane] += pair.z;
    }
    if (S % 4u == 0u || site + 3u < S) {
        rates[i + 3 * plane] -= pair.w;
    }
}

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let slot = t / (M / 8u);
    let lane = t % (M / 8u);
    let m = group.x * D + slot;
    let site = 4u * group.y;
    let v = line_fft(Octet(
        #repeat k 8
        bins(2u * group.y, lane + ${k}u * M / 8u, m),
        #end
    ), lane, slot * M, M, SITE_RADIX);
    #repeat k 8
    add(site, lane + ${k}u * M / 8u, m, v.v${k});
    #end
}

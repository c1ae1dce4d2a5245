// Second half of the space-variant convolution, for the column frequencies kx = q (mod M) of one source block:
// forward transform in y with the weights of the upper and lower PSF nodes, product with the channel kernels of
// the four nodes, sum over planes and nodes, fold of both spectra onto the photosites, inverse transform in y.
//
//   A_0 = (Z[k] + conj Z[T-k]) / 2,  A_1 = (Z[k] - conj Z[T-k]) / 2i     rows weighted for left, right node
//   X_c[ky, kx] = sum_j sum_n H_n[j, kx, c, ky] sum_y A_j,nx[y, kx] r_ny(y) exp(-2 pi i ky y / T)
//   r_0 = 1 - s(y), r_1 = s(y), s(y) = first_s + y step_s
//   F_site[p, q] = sum over kx = q, ky = p (mod M) of X_c(site)[ky, kx] exp(2 pi i (ky o_y + kx o_x) / T),  M = T/D
//   folded[site, q, m] = sum_p F_site[p, q] exp(2 pi i p m / M)
// Where the PSFs are sums of modes (shaders/optics/modes), NODES = 2: there are no weights in y and no lower nodes, `planes`
// are pairs of lines, and the left and right node's kernels are those of a pair's two lines. NODES = 1: of a single line.
// Columns kx > T/2 are mirrored: X[ky, kx] = conj X[T-ky, T-kx], because the result is real.
// Photosite m of a site lies D m + o samples after the block's window; (o_x, o_y) are multiples of STEP below D
// (for D = 8 of an even STEP).
// spectra (planes, BY, T), kernels (planes, T/2+1, LANES/8, C, 4, 8, 2) per node [electrons/s per unit
// of the plane, divided by T^2], ky = (2 a + b) LANES + 8 g + l at [.., g, c, a, l, b]: what eight lanes load lies together.
// -> folded (ceil(S/2), M/2+1, M, 2) electrons/s: sites 2 p and 2 p + 1 side by side.
// Dispatch: (M/2+1, 1, 1) workgroups of LANES = T/8 invocations; of more than four channels once for each four of them, from
// `first` on. Then each site has a kernel of its own, and a dispatch makes the sites of its kernels.
#include "line_fft"

override T: u32 = 512u;           // transform length, samples
override LANES: u32 = 64u;        // T/8
override FIRST_RADIX: u32 = 8u;   // 2, 4 or 8: T = FIRST_RADIX 8^k
override BY: u32 = 336u;          // block height, samples
override C: u32 = 3u;             // channels in the kernels
override D: u32 = 4u;             // samples from a photosite to the next of the same site: 1, 2, 4 or 8
override M: u32 = 128u;           // T/D
override SITE_RADIX: u32 = 2u;    // 2, 4 or 8: M = SITE_RADIX 8^k
override PERIOD: u32 = 2u;        // CFA period: sites = PERIOD^2, site = PERIOD row + column
override STEP: u32 = 2u;          // samples from a site to the next; 0 where every site has kernels of its own
override PAIRS: u32 = 2u;         // ceil(PERIOD^2 / 2)
override NODES: u32 = 4u;         // 4, or 2 or 1 lines of modes

struct Params {
    first_s: f32,
    step_s: f32,
    planes: u32,                  // coefficient planes that the block needs
    first: u32,                   // of the channels of this dispatch
    site_channels: vec4u,         // channel of each site, four bits a site: site s in word s/8, bits 4 (s%8)
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> spectra: array<vec2f>;
@group(0) @binding(3) var<storage, read> kernels_00: array<vec4f>;  // left, upper node
@group(0) @binding(4) var<storage, read> kernels_10: array<vec4f>;  // right, upper
@group(0) @binding(5) var<storage, read> kernels_01: array<vec4f>;  // left, lower
@group(0) @binding(6) var<storage, read> kernels_11: array<vec4f>;  // right, lower
@group(0) @binding(7) var<storage, read_write> folded: array<vec4f>;

var<workgroup> sh_line: array<vec4f, T>;

// Eight frequencies of one channel.
struct Sum {
    v0: vec2f, v1: vec2f, v2: vec2f, v3: vec2f,
    v4: vec2f, v5: vec2f, v6: vec2f, v7: vec2f,
}

// Row spectra of one sample of column kx: (A_0, A_1) for the left and the right node.
fn sides(j: u32, kx: u32, y: u32) -> vec4f {
    if (y >= BY) {
        return vec4f(0.0);
    }
    let line = (j * BY + y) * T;
    if (NODES == 1u) {
        return vec4f(spectra[line + kx], 0.0, 0.0);
    }
    let z = 0.5 * spectra[line + kx];
    let mirror = 0.5 * conj(spectra[line + (T - kx) % T]);
    return vec4f(z + mirror, -times_i(z - mirror));
}

fn upper_weight(y: u32) -> f32 {
    if (NODES != 4u) {
        return 1.0;
    }
    return 1.0 - params.first_s - f32(y) * params.step_s;
}

// Both numbers of x times those of the left and the right node's kernels.
fn product(x: vec4f, left: vec2f, right: vec2f) -> vec2f {
    return cmul(x.xy, left) + cmul(x.zw, right);
}

fn add_upper(sum: Sum, x: Octet, i: u32) -> Sum {
    let l0 = kernels_00[i];
    let l1 = kernels_00[i + 8u];
    let l2 = kernels_00[i + 16u];
    let l3 = kernels_00[i + 24u];
    if (NODES == 1u) {
        return Sum(
            sum.v0 + cmul(x.v0.xy, l0.xy), sum.v1 + cmul(x.v1.xy, l0.zw),
            sum.v2 + cmul(x.v2.xy, l1.xy), sum.v3 + cmul(x.v3.xy, l1.zw),
            sum.v4 + cmul(x.v4.xy, l2.xy), sum.v5 + cmul(x.v5.xy, l2.zw),
            sum.v6 + cmul(x.v6.xy, l3.xy), sum.v7 + cmul(x.v7.xy, l3.zw),
        );
    }
    let r0 = kernels_10[i];
    let r1 = kernels_10[i + 8u];
    let r2 = kernels_10[i + 16u];
    let r3 = kernels_10[i + 24u];
    return Sum(
        sum.v0 + product(x.v0, l0.xy, r0.xy), sum.v1 + product(x.v1, l0.zw, r0.zw),
        sum.v2 + product(x.v2, l1.xy, r1.xy), sum.v3 + product(x.v3, l1.zw, r1.zw),
        sum.v4 + product(x.v4, l2.xy, r2.xy), sum.v5 + product(x.v5, l2.zw, r2.zw),
        sum.v6 + product(x.v6, l3.xy, r3.xy), sum.v7 + product(x.v7, l3.zw, r3.zw),
    );
}

fn add_lower(sum: Sum, x: Octet, i: u32) -> Sum {
    let l0 = kernels_01[i];
    let l1 = kernels_01[i + 8u];
    let l2 = kernels_01[i + 16u];
    let l3 = kernels_01[i + 24u];
    let r0 = kernels_11[i];
    let r1 = kernels_11[i + 8u];
    let r2 = kernels_11[i + 16u];
    let r3 = kernels_11[i + 24u];
    return Sum(
        sum.v0 + product(x.v0, l0.xy, r0.xy), sum.v1 + product(x.v1, l0.zw, r0.zw),
        sum.v2 + product(x.v2, l1.xy, r1.xy), sum.v3 + product(x.v3, l1.zw, r1.zw),
        sum.v4 + product(x.v4, l2.xy, r2.xy), sum.v5 + product(x.v5, l2.zw, r2.zw),
        sum.v6 + product(x.v6, l3.xy, r3.xy), sum.v7 + product(x.v7, l3.zw, r3.zw),
    );
}

// exp(2 pi i k / T)
fn phase(k: u32) -> vec2f {
    return conj(twiddle[k % T]);
}

fn channel_of(site: u32) -> u32 {
    return (params.site_channels[site / 8u] >> (4u * (site % 8u))) & 15u;
}

// Store or add one folded frequency: bin p of the pair, or its mirror image.
fn put(pair: u32, q: u32, p: u32, value: vec4f, mirrored: bool, first: bool) {
    let bin = select(p, (M - p) % M, mirrored);
    let at = (pair * (M / 2u + 1u) + q) * M + bin;
    var v = select(value, pair_conj(value), mirrored);
    if (!first) {
        v += folded[at];
    }
    folded[at] = v;
}

// Turn the pair's spectra to sites at (o_x, o_y) and (o_x + STEP, o_y).
fn turned(x: vec4f, k: u32, more: u32) -> vec4f {
    return vec4f(cmul(x.xy, phase(k)), cmul(x.zw, phase(k + more)));
}

// Shift a pair of sites' spectra to (o_x, o_y) and (o_x + STEP, o_y), fold the T frequencies onto M = T/D, and
// add them to `folded`. across = kx o_x, more = kx STEP.
fn fold(x: Octet, pair: u32, q: u32, t: u32, o_y: u32, across: u32, mirrored: bool, first: bool, more: u32) {
    // From one of the frequencies that fall on one another to the next, the shift turns them by a part of the period.
    let w1 = phase(M * o_y);
    let w2 = phase(2u * M * o_y);
    let w3 = phase(3u * M * o_y);
    let k = t * o_y + across;
    let step = LANES * o_y;
    if (D == 2u) {
        put(pair, q, t, turned(x.v0 + pair_mul(x.v4, w1), k, more), mirrored, first);
        put(pair, q, t + LANES, turned(x.v1 + pair_mul(x.v5, w1), k + step, more), mirrored, first);
        put(pair, q, t + 2u * LANES, turned(x.v2 + pair_mul(x.v6, w1), k + 2u * step, more), mirrored, first);
        put(pair, q, t + 3u * LANES, turned(x.v3 + pair_mul(x.v7, w1), k + 3u * step, more), mirrored, first);
    } else if (D == 4u) {
        let even = x.v0 + pair_mul(x.v2, w1) + pair_mul(x.v4, w2) + pair_mul(x.v6, w3);
        let odd = x.v1 + pair_mul(x.v3, w1) + pair_mul(x.v5, w2) + pair_mul(x.v7, w3);
        put(pair, q, t, turned(even, k, more), mirrored, first);
        put(pair, q, t + LANES, turned(odd, k + step, more), mirrored, first);
    } else if (D == 8u) {
        let low = x.v0 + pair_mul(x.v1, w1) + pair_mul(x.v2, w2) + pair_mul(x.v3, w3);
        let high = x.v4 + pair_mul(x.v5, w1) + pair_mul(x.v6, w2) + pair_mul(x.v7, w3);
        // Sites lie an even number of samples apart here: half the period turns nothing.
        put(pair, q, t, turned(low + high, k, more), mirrored, first);
    } else {
        // One sample a photosite: no site is shifted.
        put(pair, q, t, x.v0, mirrored, first);
        put(pair, q, t + LANES, x.v1, mirrored, first);
        put(pair, q, t + 2u * LANES, x.v2, mirrored, first);
        put(pair, q, t + 3u * LANES, x.v3, mirrored, first);
        put(pair, q, t + 4u * LANES, x.v4, mirrored, first);
        put(pair, q, t + 5u * LANES, x.v5, mirrored, first);
        put(pair, q, t + 6u * LANES, x.v6, mirrored, first);
        put(pair, q, t + 7u * LANES, x.v7, mirrored, first);
    }
}

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let q = group.x;
    let first_pair = select(0u, params.first / 2u, C > 4u);
    let end_pair = select(PAIRS, min(first_pair + 2u, PAIRS), C > 4u);
    let r0 = upper_weight(t);
    let r1 = upper_weight(t + LANES);
    let r2 = upper_weight(t + 2u * LANES);
    let r3 = upper_weight(t + 3u * LANES);
    let r4 = upper_weight(t + 4u * LANES);
    let r5 = upper_weight(t + 5u * LANES);
    let r6 = upper_weight(t + 6u * LANES);
    let r7 = upper_weight(t + 7u * LANES);
    for (var n = 0u; n < D; n++) {
        let k = q + n * M;
        let mirrored = k > T / 2u;
        let kx = select(k, T - k, mirrored);
        // Sum(): without it, wgpu 0.32 leaves the variable as the last turn of the loop left it.
        var sum_0 = Sum();
        var sum_1 = Sum();
        var sum_2 = Sum();
        var sum_3 = Sum();
        for (var j = 0u; j < params.planes; j++) {
            let i = (j * (T / 2u + 1u) + kx) * C * (T / 2u) + (t / 8u * C + params.first) * 32u + t % 8u;
            let a0 = sides(j, kx, t);
            let a1 = sides(j, kx, t + LANES);
            let a2 = sides(j, kx, t + 2u * LANES);
            let a3 = sides(j, kx, t + 3u * LANES);
            let a4 = sides(j, kx, t + 4u * LANES);
            let a5 = sides(j, kx, t + 5u * LANES);
            let a6 = sides(j, kx, t + 6u * LANES);
            let a7 = sides(j, kx, t + 7u * LANES);
            let b0 = a0 * r0;
            let b1 = a1 * r1;
            let b2 = a2 * r2;
            let b3 = a3 * r3;
            let b4 = a4 * r4;
            let b5 = a5 * r5;
            let b6 = a6 * r6;
            let b7 = a7 * r7;
            let upper = line_fft(Octet(b0, b1, b2, b3, b4, b5, b6, b7), t, 0u, T, FIRST_RADIX);
            sum_0 = add_upper(sum_0, upper, i);
            if (C > 1u) { sum_1 = add_upper(sum_1, upper, i + 32u); }
            if (C > 2u) { sum_2 = add_upper(sum_2, upper, i + 64u); }
            if (C > 3u) { sum_3 = add_upper(sum_3, upper, i + 96u); }
            if (NODES == 4u) {
                let lower = line_fft(
                    Octet(a0 - b0, a1 - b1, a2 - b2, a3 - b3, a4 - b4, a5 - b5, a6 - b6, a7 - b7),
                    t, 0u, T, FIRST_RADIX,
                );
                sum_0 = add_lower(sum_0, lower, i);
                if (C > 1u) { sum_1 = add_lower(sum_1, lower, i + 32u); }
                if (C > 2u) { sum_2 = add_lower(sum_2, lower, i + 64u); }
                if (C > 3u) { sum_3 = add_lower(sum_3, lower, i + 96u); }
            }
        }
        for (var pair = first_pair; pair < end_pair; pair++) {
            let site = 2u * pair;
            let even = channel_of(site) - params.first;
            let odd = channel_of(site + 1u) - params.first;
            var x = sum_0;
            if (C > 1u && even == 1u) { x = sum_1; }
            if (C > 2u && even == 2u) { x = sum_2; }
            if (C > 3u && even == 3u) { x = sum_3; }
            var y = sum_0;
            if (C > 1u && odd == 1u) { y = sum_1; }
            if (C > 2u && odd == 2u) { y = sum_2; }
            if (C > 3u && odd == 3u) { y = sum_3; }
            let o_x = (site % PERIOD) * STEP;
            let o_y = (site / PERIOD) * STEP;
            fold(Octet(
                vec4f(x.v0, y.v0), vec4f(x.v1, y.v1), vec4f(x.v2, y.v2), vec4f(x.v3, y.v3),
                vec4f(x.v4, y.v4), vec4f(x.v5, y.v5), vec4f(x.v6, y.v6), vec4f(x.v7, y.v7),
            ), pair, q, t, o_y, kx * o_x, mirrored, n == 0u, kx * STEP);
        }
        storageBarrier();
    }
    // D pairs of lines at a time, M/8 lanes each.
    let slot = t / (M / 8u);
    let lane = t % (M / 8u);
    for (var next = first_pair; next < end_pair; next += D) {
        let pair = next + slot;
        let there = (min(pair, PAIRS - 1u) * (M / 2u + 1u) + q) * M + lane;
        let x = Octet(
            pair_conj(folded[there]),
            pair_conj(folded[there + M / 8u]),
            pair_conj(folded[there + 2u * M / 8u]),
            pair_conj(folded[there + 3u * M / 8u]),
            pair_conj(folded[there + 4u * M / 8u]),
            pair_conj(folded[there + 5u * M / 8u]),
            pair_conj(folded[there + 6u * M / 8u]),
            pair_conj(folded[there + 7u * M / 8u]),
        );
        let y = line_fft(x, lane, slot * M, M, SITE_RADIX);
        if (pair < end_pair) {
            folded[there] = pair_conj(y.v0);
            folded[there + M / 8u] = pair_conj(y.v1);
            folded[there + 2u * M / 8u] = pair_conj(y.v2);
            folded[there + 3u * M / 8u] = pair_conj(y.v3);
            folded[there + 4u * M / 8u] = pair_conj(y.v4);
            folded[there + 5u * M / 8u] = pair_conj(y.v5);
            folded[there + 6u * M / 8u] = pair_conj(y.v6);
            folded[there + 7u * M / 8u] = pair_conj(y.v7);
        }
    }
}

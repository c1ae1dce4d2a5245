// Second half of the space-variant convolution, for one column frequency kx of one source block:
// forward transform in y with the weights of the upper and lower PSF nodes, product with the channel
// kernels of the four nodes, sum over planes and nodes, and inverse transform in y taken only at the
// photosites (fold of the spectrum).
//
//   A_0 = (Z[k] + conj Z[T-k]) / 2,  A_1 = (Z[k] - conj Z[T-k]) / 2i     rows weighted for left, right node
//   X_c[ky, kx] = sum_j sum_n H_n[j, kx, c, ky] sum_y A_j,nx[y, kx] r_ny(y) exp(-2 pi i ky y / T)
//   r_0 = 1 - s(y), r_1 = s(y), s(y) = first_s + y step_s
//   folded[site, kx, m] = sum_ky X_c(site)[ky, kx] exp(2 pi i (ky (D m + o_y) + kx o_x) / T),  m < M = T/D
// Photosite m of a site lies D m + o samples after the block's window; (o_x, o_y) are multiples of STEP below D.
// spectra (planes, BY, T), kernels (planes, T/2+1, C, 4, LANES, 2) per node [electrons/s per unit
// of the plane, divided by T^2], ky = (2 a + b) LANES + lane at [.., a, lane, b],
// -> folded (S, T/2+1, M) electrons/s.
// Dispatch: (T/2+1, 1, 1) workgroups of LANES = T/8 invocations.
#include "line_fft"
#include "line_ifft"

override T: u32 = 512u;           // transform length, samples
override LANES: u32 = 64u;        // T/8
override FIRST_RADIX: u32 = 8u;   // 2, 4 or 8: T = FIRST_RADIX 8^k
override BY: u32 = 336u;          // block height, samples
override C: u32 = 3u;             // channels in the kernels, 1 to 4
override D: u32 = 4u;             // samples from a photosite to the next of the same site: 1, 2, 4 or 8
override M: u32 = 128u;           // T/D
override PERIOD: u32 = 2u;        // CFA period: sites = PERIOD^2, site = PERIOD row + column
override STEP: u32 = 2u;          // samples from a site to the next; 0 where every site has kernels of its own
override LINES: u32 = 4u;         // sites that are inverted together; divides PERIOD^2
override SCRATCH: u32 = 1024u;    // max(T, 2 LINES M)

struct Params {
    first_s: f32,
    step_s: f32,
    planes: u32,                  // coefficient planes that the block needs
    site_channels: vec4u,         // channel of each site, four bits a site: site s in word s/8, bits 4 (s%8)
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> spectra: array<vec2f>;
@group(0) @binding(3) var<storage, read> kernels_00: array<vec4f>;  // left, upper node
@group(0) @binding(4) var<storage, read> kernels_10: array<vec4f>;  // right, upper
@group(0) @binding(5) var<storage, read> kernels_01: array<vec4f>;  // left, lower
@group(0) @binding(6) var<storage, read> kernels_11: array<vec4f>;  // right, lower
@group(0) @binding(7) var<storage, read_write> folded: array<vec2f>;

var<workgroup> sh_line: array<vec2f, SCRATCH>;

// Row spectra of one sample of column kx: (A_0, A_1) for the left and the right node.
fn sides(j: u32, kx: u32, y: u32) -> vec4f {
    if (y >= BY) {
        return vec4f(0.0);
    }
    let line = (j * BY + y) * T;
    let z = 0.5 * spectra[line + kx];
    let mirror = 0.5 * conj(spectra[line + (T - kx) % T]);
    return vec4f(z + mirror, -times_i(z - mirror));
}

fn upper_weight(y: u32) -> f32 {
    return 1.0 - params.first_s - f32(y) * params.step_s;
}

fn multiply_add(sum: Octet, x: Octet, h: Octet) -> Octet {
    return Octet(
        sum.v0 + cmul(x.v0, h.v0),
        sum.v1 + cmul(x.v1, h.v1),
        sum.v2 + cmul(x.v2, h.v2),
        sum.v3 + cmul(x.v3, h.v3),
        sum.v4 + cmul(x.v4, h.v4),
        sum.v5 + cmul(x.v5, h.v5),
        sum.v6 + cmul(x.v6, h.v6),
        sum.v7 + cmul(x.v7, h.v7),
    );
}

fn kernel_00(i: u32) -> Octet {
    let a = kernels_00[i];
    let b = kernels_00[i + LANES];
    let c = kernels_00[i + 2u * LANES];
    let d = kernels_00[i + 3u * LANES];
    return Octet(a.xy, a.zw, b.xy, b.zw, c.xy, c.zw, d.xy, d.zw);
}

fn kernel_10(i: u32) -> Octet {
    let a = kernels_10[i];
    let b = kernels_10[i + LANES];
    let c = kernels_10[i + 2u * LANES];
    let d = kernels_10[i + 3u * LANES];
    return Octet(a.xy, a.zw, b.xy, b.zw, c.xy, c.zw, d.xy, d.zw);
}

fn kernel_01(i: u32) -> Octet {
    let a = kernels_01[i];
    let b = kernels_01[i + LANES];
    let c = kernels_01[i + 2u * LANES];
    let d = kernels_01[i + 3u * LANES];
    return Octet(a.xy, a.zw, b.xy, b.zw, c.xy, c.zw, d.xy, d.zw);
}

fn kernel_11(i: u32) -> Octet {
    let a = kernels_11[i];
    let b = kernels_11[i + LANES];
    let c = kernels_11[i + 2u * LANES];
    let d = kernels_11[i + 3u * LANES];
    return Octet(a.xy, a.zw, b.xy, b.zw, c.xy, c.zw, d.xy, d.zw);
}

// exp(2 pi i k / T)
fn phase(k: u32) -> vec2f {
    return conj(twiddle[k % T]);
}

// Shift to a site at (o_x, o_y), then fold the T frequencies onto M = T/D and leave them in sh_line from `d` on.
fn fold(x: Octet, kx: u32, t: u32, o_x: u32, o_y: u32, d: u32) {
    let k = t * o_y + kx * o_x;
    let step = LANES * o_y;
    let p0 = cmul(x.v0, phase(k));
    let p1 = cmul(x.v1, phase(k + step));
    let p2 = cmul(x.v2, phase(k + 2u * step));
    let p3 = cmul(x.v3, phase(k + 3u * step));
    let p4 = cmul(x.v4, phase(k + 4u * step));
    let p5 = cmul(x.v5, phase(k + 5u * step));
    let p6 = cmul(x.v6, phase(k + 6u * step));
    let p7 = cmul(x.v7, phase(k + 7u * step));
    if (D == 2u) {
        sh_line[d + t] = p0 + p4;
        sh_line[d + t + LANES] = p1 + p5;
        sh_line[d + t + 2u * LANES] = p2 + p6;
        sh_line[d + t + 3u * LANES] = p3 + p7;
    } else if (D == 4u) {
        sh_line[d + t] = p0 + p2 + p4 + p6;
        sh_line[d + t + LANES] = p1 + p3 + p5 + p7;
    } else if (D == 8u) {
        sh_line[d + t] = p0 + p1 + p2 + p3 + p4 + p5 + p6 + p7;
    } else {
        sh_line[d + t] = p0;
        sh_line[d + t + LANES] = p1;
        sh_line[d + t + 2u * LANES] = p2;
        sh_line[d + t + 3u * LANES] = p3;
        sh_line[d + t + 4u * LANES] = p4;
        sh_line[d + t + 5u * LANES] = p5;
        sh_line[d + t + 6u * LANES] = p6;
        sh_line[d + t + 7u * LANES] = p7;
    }
}

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let kx = group.x;
    var sum_0: Octet;
    var sum_1: Octet;
    var sum_2: Octet;
    var sum_3: Octet;
    let r0 = upper_weight(t);
    let r1 = upper_weight(t + LANES);
    let r2 = upper_weight(t + 2u * LANES);
    let r3 = upper_weight(t + 3u * LANES);
    let r4 = upper_weight(t + 4u * LANES);
    let r5 = upper_weight(t + 5u * LANES);
    let r6 = upper_weight(t + 6u * LANES);
    let r7 = upper_weight(t + 7u * LANES);
    for (var j = 0u; j < params.planes; j++) {
        let i = (j * (T / 2u + 1u) + kx) * C * (T / 2u) + t;
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
        var left = line_fft(Octet(b0.xy, b1.xy, b2.xy, b3.xy, b4.xy, b5.xy, b6.xy, b7.xy), t);
        sum_0 = multiply_add(sum_0, left, kernel_00(i));
        if (C > 1u) { sum_1 = multiply_add(sum_1, left, kernel_00(i + T / 2u)); }
        if (C > 2u) { sum_2 = multiply_add(sum_2, left, kernel_00(i + T)); }
        if (C > 3u) { sum_3 = multiply_add(sum_3, left, kernel_00(i + 3u * T / 2u)); }
        var right = line_fft(Octet(b0.zw, b1.zw, b2.zw, b3.zw, b4.zw, b5.zw, b6.zw, b7.zw), t);
        sum_0 = multiply_add(sum_0, right, kernel_10(i));
        if (C > 1u) { sum_1 = multiply_add(sum_1, right, kernel_10(i + T / 2u)); }
        if (C > 2u) { sum_2 = multiply_add(sum_2, right, kernel_10(i + T)); }
        if (C > 3u) { sum_3 = multiply_add(sum_3, right, kernel_10(i + 3u * T / 2u)); }
        let c0 = a0 - b0;
        let c1 = a1 - b1;
        let c2 = a2 - b2;
        let c3 = a3 - b3;
        let c4 = a4 - b4;
        let c5 = a5 - b5;
        let c6 = a6 - b6;
        let c7 = a7 - b7;
        left = line_fft(Octet(c0.xy, c1.xy, c2.xy, c3.xy, c4.xy, c5.xy, c6.xy, c7.xy), t);
        sum_0 = multiply_add(sum_0, left, kernel_01(i));
        if (C > 1u) { sum_1 = multiply_add(sum_1, left, kernel_01(i + T / 2u)); }
        if (C > 2u) { sum_2 = multiply_add(sum_2, left, kernel_01(i + T)); }
        if (C > 3u) { sum_3 = multiply_add(sum_3, left, kernel_01(i + 3u * T / 2u)); }
        right = line_fft(Octet(c0.zw, c1.zw, c2.zw, c3.zw, c4.zw, c5.zw, c6.zw, c7.zw), t);
        sum_0 = multiply_add(sum_0, right, kernel_11(i));
        if (C > 1u) { sum_1 = multiply_add(sum_1, right, kernel_11(i + T / 2u)); }
        if (C > 2u) { sum_2 = multiply_add(sum_2, right, kernel_11(i + T)); }
        if (C > 3u) { sum_3 = multiply_add(sum_3, right, kernel_11(i + 3u * T / 2u)); }
    }
    for (var first = 0u; first < PERIOD * PERIOD; first += LINES) {
        workgroupBarrier();
        for (var site = first; site < first + LINES; site++) {
            let channel = (params.site_channels[site / 8u] >> (4u * (site % 8u))) & 15u;
            var x = sum_0;
            if (C > 1u && channel == 1u) { x = sum_1; }
            if (C > 2u && channel == 2u) { x = sum_2; }
            if (C > 3u && channel == 3u) { x = sum_3; }
            fold(x, kx, t, (site % PERIOD) * STEP, (site / PERIOD) * STEP, (site - first) * M);
        }
        workgroupBarrier();
        let here = line_ifft(t);
        for (var i = t; i < LINES * M; i += LANES) {
            let site = first + i / M;
            folded[(site * (T / 2u + 1u) + kx) * M + i % M] = sh_line[here + i];
        }
    }
}

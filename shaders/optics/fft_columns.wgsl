// Second part of the space-variant convolution, for one column frequency kx of one source block to an invocation: forward
// transform in y with the weights of the upper and lower PSF nodes, product with the channel kernels of the four nodes, sum
// over planes and nodes, inverse transform in y at the photosites.
//
//   A_0 = (Z[k] + conj Z[T-k]) / 2,  A_1 = (Z[k] - conj Z[T-k]) / 2i     rows weighted for left, right node
//   X_c[ky, kx] = sum_j sum_n H_n[j, kx, c, ky] sum_y A_j,nx[y, kx] r_ny(y) exp(-2 pi i ky y / T)
//   r_0 = 1 - s(y), r_1 = s(y), s(y) = first_s + y step_s
//   folded[site, m, kx] = exp(2 pi i kx o_x / T) sum_ky X_c(site)[ky, kx] exp(2 pi i ky (D m + o_y) / T)
// Where the PSFs are sums of modes (shaders/optics/modes), NODES = 2: there are no weights in y and no lower nodes, `planes`
// are pairs of lines, and the left and right node's kernels are those of a pair's two lines. NODES = 1: of a single line.
// Photosite m of a site lies D m + o samples after the block's window; (o_x, o_y) are multiples of STEP below D. Where a
// block is convolved as its mirror image (shaders/optics/fft_rows), sites lie the other way round.
//
// T = 16 16 E: with y = n + 16 r + 256 e and ky = E (p + 16 q) + g, the sums over e (turned by g y / T), r and q are taken in
// that order, for one g after another. Between r and q, and between q and p on the way back, sixteen times sixteen numbers
// wait in `lines`: each is stored and loaded once, which is what costs on lavapipe; arithmetic hides behind it. The
// inverse transform over q keeps only those results on which photosites lie: nothing else is left of the fold onto them.
// Three kernels of this file do that, for a function of all its memory accesses takes the compilers of software drivers more
// than twice as long as the three together: PHASE 0 makes the sums over r, 1 those over q, the products and the inverse over q,
// 2 the rest. Overrides are what shapes the code; lengths and counts are params, so that few kernels serve all grids.
// spectra (planes, height, T), kernels (planes, T/16, E, 16, C, 8, 8, 2) per node [electrons/s per unit of the plane, divided
// by T^2]: [j, kx/8, g, p, c, q/2, kx%8, q%2], what eight lanes load lies together
// -> folded (ceil(S/2), T/D, T/2, 2) electrons/s: sites 2 i and 2 i + 1 side by side. Kernels have no frequency kx = T/2.
// Dispatch: (T/16, 1, 1) workgroups of 8 invocations; PHASE 0, then 1, then 2. With more than four
// channels PHASE 1 runs once for each four of them, from `first` on. Then each site has a kernel of its own, and a dispatch makes
// the sites of its kernels.
#include "sixteen"
#include "texels"

override PHASE: u32 = 0u;
override TIMES: u32 = 2u;         // E = T/256, 1, 2 or 4: for PHASE 0 and 2; a param too, whose loops stay loops
override C: u32 = 3u;             // channels of a dispatch, at most 4: for PHASE 1
override D: u32 = 4u;             // samples from a photosite to the next of the same site, 1, 2, 4, 8 or 16: for PHASE 1 and 2
override NODES: u32 = 4u;         // 4, or 2 or 1 lines of modes: for PHASE 0 and 1

struct Params {
    first_s: f32,
    step_s: f32,
    planes: u32,                  // coefficient planes that the block needs
    first: u32,                   // of the channels of this dispatch
    mirrored: vec2u,              // 1 where the block is its mirror image, x and y
    channels: u32,                // in the kernels
    pairs: vec2u,                 // of sites, that this dispatch makes: the first, and the one after the last
    site_slots: u32,              // of `lines`, of each column: ceil(sites / 2) E 16/D 17
    height: u32,                  // of a block, samples
    times: u32,                   // E = T/256: 1, 2 or 4
    period: u32,                  // CFA period: sites = period^2, site = period row + column
    site_step: u32,               // samples from a site to the next; 0 where every site has kernels of its own
    site_channels: vec4u,         // channel of each site, four bits a site: site s in word s/8, bits 4 (s%8)
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> spectra: array<vec2f>;
@group(0) @binding(3) var kernels_00: texture_2d<f32>;  // left, upper node
@group(0) @binding(4) var kernels_10: texture_2d<f32>;  // right, upper
@group(0) @binding(5) var kernels_01: texture_2d<f32>;  // left, lower
@group(0) @binding(6) var kernels_11: texture_2d<f32>;  // right, lower
@group(0) @binding(7) var<storage, read_write> lines: array<vec4f>;   // [kx/8, slot, kx%8]
@group(0) @binding(8) var<storage, read_write> folded: array<vec4f>;

// Slots of sixteen times sixteen numbers: 17 apart, for a power of two would fall on few sets of the cache.
const SQUARE = 16u * 17u;

// One channel, by q.
alias Sum = array<vec2f, 16>;

// For the upper and for the lower nodes: (left, right) each.
struct Weighted { upper: vec4f, lower: vec4f, }

// T, a power of two.
fn length_of_lines() -> u32 {
    return 256u * params.times;
}

// exp(-2 pi i k / T)
fn turn(k: u32) -> vec2f {
    return twiddle[k & (length_of_lines() - 1u)];
}

// Row spectra of one sample of column kx: (A_0, A_1) for the left and the right node.
fn sides(j: u32, kx: u32, y: u32) -> vec4f {
    let line = (j * params.height + y) * length_of_lines();
    let left = spectra[line + kx];
    var result = vec4f(left, 0.0, 0.0);
    if (NODES != 1u) {
        let z = 0.5 * left;
        let mirror = 0.5 * conj(spectra[line + ((length_of_lines() - kx) & (length_of_lines() - 1u))]);
        result = vec4f(z + mirror, -times_i(z - mirror));
    }
    return result;
}

// A row turned by w.
fn weighted(j: u32, kx: u32, y: u32, w: vec2f) -> Weighted {
    var a = vec4f(0.0);
    if (y < params.height) {
        a = sides(j, kx, y);
    }
    if (TIMES > 1u) {
        a = pair_mul(a, w);
    }
    var lower = vec4f(0.0);
    if (NODES == 4u) {
        lower = a * (params.first_s + f32(y) * params.step_s);
    }
    return Weighted(a - lower, lower);
}

// Adds row y, and y + 256 where there are that many; `beyond` is the turn from the one to the other.
fn put(upper: ptr<function, Sixteen>, lower: ptr<function, Sixteen>, r: u32, j: u32, kx: u32, y: u32, g: u32, beyond: vec2f) {
    var w = vec2f(1.0, 0.0);
    if (TIMES > 1u) {
        w = turn(g * y);
    }
    let this_ = weighted(j, kx, y, w);
    (*upper)[r] += this_.upper;
    (*lower)[r] += this_.lower;
    if (TIMES > 1u) {
        let that = weighted(j, kx, y + 256u, cmul(w, beyond));
        (*upper)[r] += that.upper;
        (*lower)[r] += that.lower;
    }
}

// Adds the rows y + 16 r.
fn put_all(upper: ptr<function, Sixteen>, lower: ptr<function, Sixteen>, j: u32, kx: u32, y: u32, g: u32, beyond: vec2f) {
    #repeat k 16
    put(upper, lower, ${k}u, j, kx, y + ${16 * k}u, g, beyond);
    #end
}

// Sixteen numbers, `step` slots apart.
fn keep(v: ptr<function, Sixteen>, at: u32, step: u32) {
    #repeat k 16
    lines[at + ${k}u * step * 8u] = (*v)[${k}];
    #end
}

fn load(v: ptr<function, Sixteen>, at: u32, step: u32) {
    #repeat k 16
    (*v)[${k}] = lines[at + ${k}u * step * 8u];
    #end
}

// Frequencies q and q + 1 of (left, right), times their kernels.
fn add(sum: ptr<function, Sum>, x: ptr<function, Sixteen>, q: u32, left: vec4f, right: vec4f) {
    (*sum)[q] += cmul((*x)[q].xy, left.xy) + cmul((*x)[q].zw, right.xy);
    (*sum)[q + 1u] += cmul((*x)[q + 1u].xy, left.zw) + cmul((*x)[q + 1u].zw, right.zw);
}

fn right_upper(i: u32) -> vec4f {
    if (NODES == 1u) {
        return vec4f(0.0);
    }
    return texel(kernels_10, i);
}

fn add_upper(sum: ptr<function, Sum>, x: ptr<function, Sixteen>, i: u32) {
    #repeat k 8
    add(sum, x, ${2 * k}u, texel(kernels_00, i + ${k}u * 8u), right_upper(i + ${k}u * 8u));
    #end
}

fn add_lower(sum: ptr<function, Sum>, x: ptr<function, Sixteen>, i: u32) {
    #repeat k 8
    add(sum, x, ${2 * k}u, texel(kernels_01, i + ${k}u * 8u), texel(kernels_11, i + ${k}u * 8u));
    #end
}

// Two channels side by side.
fn pair_up(v: ptr<function, Sixteen>, a: ptr<function, Sum>, b: ptr<function, Sum>) {
    #repeat k 16
    (*v)[${k}] = vec4f((*a)[${k}], (*b)[${k}]);
    #end
}

// Samples from the first site to a site, along x and y.
fn offset_x(site: u32) -> u32 {
    let k = site % params.period;
    return select(k, params.period - 1u - k, params.mirrored.x == 1u) * params.site_step;
}

fn offset_y(site: u32) -> u32 {
    let k = site / params.period % params.period;
    return select(k, params.period - 1u - k, params.mirrored.y == 1u) * params.site_step;
}

fn channel_of(site: u32) -> u32 {
    return (params.site_channels[site / 8u] >> (4u * (site % 8u))) & 15u;
}

// Photosite row r + o_y of the channels of two sites, of the first two channels and the last two.
fn rows_of(low: ptr<function, Sixteen>, high: ptr<function, Sixteen>, r: u32, even: u32, odd: u32, o_y: u32) -> vec4f {
    var x = (*low)[r];
    var y = (*high)[r];
    if (D > 1u && o_y == 1u) { x = (*low)[r + 1u]; y = (*high)[r + 1u]; }
    if (D > 2u && o_y == 2u) { x = (*low)[r + 2u]; y = (*high)[r + 2u]; }
    if (D > 2u && o_y == 3u) { x = (*low)[r + 3u]; y = (*high)[r + 3u]; }
    if (D > 4u && o_y == 4u) { x = (*low)[r + 4u]; y = (*high)[r + 4u]; }
    if (D > 4u && o_y == 6u) { x = (*low)[r + 6u]; y = (*high)[r + 6u]; }
    if (D > 8u && o_y == 8u) { x = (*low)[r + 8u]; y = (*high)[r + 8u]; }
    if (D > 8u && o_y == 12u) { x = (*low)[r + 12u]; y = (*high)[r + 12u]; }
    var result = vec4f(x.xy, x.xy);
    if (C > 1u && even == 1u) { result.x = x.z; result.y = x.w; }
    if (C > 2u && even == 2u) { result.x = y.x; result.y = y.y; }
    if (C > 3u && even == 3u) { result.x = y.z; result.y = y.w; }
    if (C > 1u && odd == 1u) { result.z = x.z; result.w = x.w; }
    if (C > 2u && odd == 2u) { result.z = y.x; result.w = y.y; }
    if (C > 3u && odd == 3u) { result.z = y.z; result.w = y.w; }
    return result;
}

// Photosites m .. of a pair of sites, 16/D apart, turned to where the sites lie in x.
fn store(v: ptr<function, Sixteen>, at: u32, even: vec2f, odd: vec2f) {
    #repeat k 16
    store_one((*v)[${k}], ${k}u, at, even, odd);
    #end
}

fn store_one(x: vec4f, t: u32, at: u32, even: vec2f, odd: vec2f) {
    folded[at + t * (16u / D) * (length_of_lines() / 2u)] = vec4f(cmul(x.xy, even), cmul(x.zw, odd));
}

// Adds numbers turned by exp(2 pi i g y / T), y = 16 t + `first`.
fn add_turned(sum: ptr<function, Sixteen>, v: ptr<function, Sixteen>, g: u32, first: u32) {
    #repeat k 16
    (*sum)[${k}] += pair_mul((*v)[${k}], conj(turn(g * (first + 16u * ${k}u))));
    #end
}

// Slots of a column: those of the sites, then those of the planes.
fn slots_of_sites(kx: u32) -> u32 {
    return kx / 8u * (params.site_slots + params.times * params.planes * 2u * SQUARE) * 8u + kx % 8u;
}

// Slots of the planes, of g.
fn slots_of_planes(kx: u32, g: u32) -> u32 {
    return slots_of_sites(kx) + (params.site_slots + g * params.planes * 2u * SQUARE) * 8u;
}

// The planes' columns, of the left and the right node: sums over e and r.
fn forward(kx: u32) {
    for (var j = 0u; j < params.planes; j++) {
        for (var n = 0u; n < 16u; n++) {
            let w = turn(params.times * n);
            let w2 = turn(2u * params.times * n);
            let w4 = turn(4u * params.times * n);
            let w8 = turn(8u * params.times * n);
            for (var g = 0u; g < params.times; g++) {
                let beyond = turn(256u * g);
                var upper = Sixteen();
                var lower = Sixteen();
                if (TIMES == 4u) {
                    for (var e = 0u; e < params.times; e += 2u) {
                        put_all(&upper, &lower, j, kx, n + 256u * e, g, beyond);
                    }
                } else {
                    put_all(&upper, &lower, j, kx, n, g, beyond);
                }
                let at = slots_of_planes(kx, g) + (2u * j * SQUARE + n) * 8u;
                sixteen(&upper);
                turn_sixteen(&upper, w, w2, w4, w8);
                keep(&upper, at, 17u);
                if (NODES == 4u) {
                    sixteen(&lower);
                    turn_sixteen(&lower, w, w2, w4, w8);
                    keep(&lower, at + SQUARE * 8u, 17u);
                }
            }
        }
    }
}

// Sums over q, the products, and the inverse over q.
fn products(kx: u32) {
    let base = slots_of_sites(kx);
    for (var i = 0u; i < 16u * params.times; i++) {
        let g = i / 16u;
        let p = i % 16u;
        let forward = slots_of_planes(kx, g);
        // Sum(): without it, wgpu 0.32 leaves variables as the last turn of the loop left them.
        var sum_0 = Sum();
        var sum_1 = Sum();
        var sum_2 = Sum();
        var sum_3 = Sum();
        for (var j = 0u; j < params.planes; j++) {
            let k = ((((j * (length_of_lines() / 16u) + kx / 8u) * params.times + g) * 16u + p) * params.channels + params.first) * 64u + kx % 8u;
            let at = forward + (2u * j * SQUARE + 17u * p) * 8u;
            var x: Sixteen;
            load(&x, at, 1u);
            sixteen(&x);
            add_upper(&sum_0, &x, k);
            if (C > 1u) { add_upper(&sum_1, &x, k + 64u); }
            if (C > 2u) { add_upper(&sum_2, &x, k + 128u); }
            if (C > 3u) { add_upper(&sum_3, &x, k + 192u); }
            if (NODES == 4u) {
                load(&x, at + SQUARE * 8u, 1u);
                sixteen(&x);
                add_lower(&sum_0, &x, k);
                if (C > 1u) { add_lower(&sum_1, &x, k + 64u); }
                if (C > 2u) { add_lower(&sum_2, &x, k + 128u); }
                if (C > 3u) { add_lower(&sum_3, &x, k + 192u); }
            }
        }
        var low: Sixteen;
        var high: Sixteen;
        let w = conj(turn(params.times * p));
        let w2 = conj(turn(2u * params.times * p));
        let w4 = conj(turn(4u * params.times * p));
        let w8 = conj(turn(8u * params.times * p));
        pair_up(&low, &sum_0, &sum_1);
        sixteen_back(&low);
        turn_sixteen(&low, w, w2, w4, w8);
        if (C > 2u) {
            pair_up(&high, &sum_2, &sum_3);
            sixteen_back(&high);
            turn_sixteen(&high, w, w2, w4, w8);
        }
        for (var pair = params.pairs.x; pair < params.pairs.y; pair++) {
            let site = 2u * pair;
            let even = channel_of(site) - params.first;
            let odd = channel_of(site + 1u) - params.first;
            let o_y = offset_y(site);
            let at = base + (((pair * params.times + g) * (16u / D)) * 17u + p) * 8u;
            lines[at] = rows_of(&low, &high, 0u, even, odd, o_y);
            #repeat k 15
            if (${k + 1}u < 16u / D) { lines[at + ${k + 1}u * 17u * 8u] = rows_of(&low, &high, ${k + 1}u * D, even, odd, o_y); }
            #end
        }
    }
}

// The rest of the inverse.
fn inverse(kx: u32) {
    let base = slots_of_sites(kx);
    for (var pair = params.pairs.x; pair < params.pairs.y; pair++) {
        let site = 2u * pair;
        let o_y = offset_y(site);
        let even = conj(turn(kx * offset_x(site)));
        let odd = conj(turn(kx * offset_x(site + 1u)));
        for (var r = 0u; r < 16u / D; r++) {
            let at = base + (pair * params.times * (16u / D) + r) * 17u * 8u;
            let to = (pair * (length_of_lines() / D) + r) * (length_of_lines() / 2u) + kx;
            var v: Sixteen;
            if (TIMES == 1u) {
                load(&v, at, 1u);
                sixteen_back(&v);
                store(&v, to, even, odd);
            } else {
                for (var e = 0u; e < params.times; e++) {
                    var sum = Sixteen();
                    for (var g = 0u; g < params.times; g++) {
                        load(&v, at + g * (16u / D) * 17u * 8u, 1u);
                        sixteen_back(&v);
                        add_turned(&sum, &v, g, D * r + o_y + 256u * e);
                    }
                    store(&sum, to + e * (256u / D) * (length_of_lines() / 2u), even, odd);
                }
            }
        }
    }
}

@compute @workgroup_size(8, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (PHASE == 0u) {
        forward(id.x);
    } else if (PHASE == 1u) {
        products(id.x);
    } else {
        inverse(id.x);
    }
}

// Space-variant convolution by a sum over taps, for small supports: what one source block gives to each photosite.
//
//   rates[site, m] += sum_j sum_d a_j[i] sum_n w_n(i) H_n[j, site, d],   i = u - d, u = D m + o - R
// i counts the samples of the block, (u_x, u_y) is where the photosite lies, d runs from LOW to HIGH along both axes and
// w_n are the bilinear weights of the block's four PSF nodes at the *source* sample: s (1 - t) ..., with
// s = first_s + i_x step_s between the left and the right node, t = first_t + i_y step_t between the upper and the lower.
// Along a line of taps t is fixed, and s(i) = s(p) + e step_s with e = i - p counted from the sample p under the first of
// an invocation's places: with left and right interpolated in t,
//   sum_e a (left + e step_s (right - left)) + s(p) sum_e a (right - left)
// is the same sum with one load of the source and two multiply-adds a tap instead of four.
//
// An invocation computes eight photosites along x of two places: sites beside one another, or, where photosites lie less
// than a vec4f apart (D < 4), every second or fourth photosite of one. Place c lies offset(c) samples from p.
// The sources of the eight stay in registers and move on by one as the taps do: one vec4f of the source, and eight of the
// taps, are loaded for 128 multiply-adds (8 to 15 GFLOP/s on lavapipe with 2 cores; one photosite to an invocation, 13 times
// less: tools/record.md).
//
// planes (J, BY, BX); taps (J, DOWN, places / COLUMNS, LINES, GROUPS, COLUMNS, 4) per node: line l, number n of the last
// three axes stand for d_y = HIGH - l and d_x = offset(c) - 4 first_group - n, zero where no such tap is.
// -> rates (S, rows, cols) electrons/s.
// Dispatch: (eights of photosites, line by line, in workgroups of 64; DOWN places / COLUMNS; 1).
// Blocks are added one after another, in a fixed order, so that tiles repeat the same sums bit for bit.

override EIGHTS: u32 = 16u;       // of photosites in a line
override BX: u32 = 336u;          // block width, samples: a multiple of 4
override BY: u32 = 336u;          // block height, samples
override R: u32 = 88u;            // from the window's first sample to the block's: a multiple of 4 and of D
override D: u32 = 4u;             // samples from a photosite to the next of the same site: 1, 2, 4 or 8
override STRIDE: u32 = 4u;        // samples from one of the eight to the next: the larger of D and 4
override PERIOD: u32 = 2u;        // sites side by side: site = PERIOD row + column
override DOWN: u32 = 2u;          // and below one another
override STEP: u32 = 2u;          // samples from a site to the next; 0 where the taps hold the sites' places
override PLACES: u32 = 2u;        // PERIOD STRIDE / D
override COLUMNS: u32 = 2u;       // places of an invocation: 2, or 1 where there is no more
override HIGH: i32 = 7;           // last tap
override LINES: u32 = 16u;        // taps along one axis
override GROUPS: u32 = 5u;        // vec4f in a line of taps: a multiple of STRIDE / 4

struct Params {
    first_s: f32,
    step_s: f32,
    first_t: f32,
    step_t: f32,
    planes: u32,                  // coefficient planes that the block needs
    first_line: u32,              // lines of photosites of the window, and how many
    lines: u32,
    origin: vec2i,                // (x, y) of the window's first photosite in the planes of the sites
    size: vec2i,                  // (columns, rows) of the planes of the sites
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> planes: array<vec4f>;
@group(0) @binding(2) var<storage, read> taps_00: array<vec4f>;  // left, upper node
@group(0) @binding(3) var<storage, read> taps_10: array<vec4f>;  // right, upper
@group(0) @binding(4) var<storage, read> taps_01: array<vec4f>;  // left, lower
@group(0) @binding(5) var<storage, read> taps_11: array<vec4f>;  // right, lower
@group(0) @binding(6) var<storage, read_write> rates: array<f32>;

// Four taps of a line, of one place.
struct Taps {
    own: vec4f,                   // left + e step_s (right - left)
    slope: vec4f,                 // right - left
}

fn source(line: u32, v: i32) -> vec4f {
    // Before the block, v is negative and wraps: one comparison for both ends. What is read there is not used.
    return select(vec4f(0.0), planes[line + u32(v)], u32(v) < BX / 4u);
}

// e: of the first of the four taps
fn taps(i: u32, t: f32, e: i32) -> Taps {
    let left = mix(taps_00[i], taps_01[i], t);
    let slope = mix(taps_10[i], taps_11[i], t) - left;
    return Taps(left + slope * (params.step_s * (f32(e) + vec4f(0.0, 1.0, 2.0, 3.0))), slope);
}

// Sums of both places: own, own, slope, slope.
fn gathered(a: vec4f, x: Taps, y: Taps) -> vec4f {
    return vec4f(dot(a, x.own), dot(a, y.own), dot(a, x.slope), dot(a, y.slope));
}

fn add(place: u32, row: u32, n: u32, line: u32, own: f32, slope: f32) {
    let x = params.origin.x + i32(n * (STRIDE / D) + place / PERIOD);
    if (x < 0 || x >= params.size.x) {
        return;
    }
    let y = params.origin.y + i32(line);
    let site = row * PERIOD + place % PERIOD;
    let s = params.first_s + params.step_s * f32(i32(STRIDE * n) - i32(R));
    rates[(i32(site) * params.size.y + y) * params.size.x + x] += own + s * slope;
}

fn put(place: u32, row: u32, n: u32, line: u32, sum: vec4f) {
    add(place, row, n, line, sum.x, sum.z);
    if (COLUMNS == 2u) {
        add(place + 1u, row, n, line, sum.y, sum.w);
    }
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let m = params.first_line + id.x / EIGHTS;
    if (m >= params.first_line + params.lines) {
        return;
    }
    let n = 8u * (id.x % EIGHTS);
    let place = id.y % (PLACES / COLUMNS) * COLUMNS;
    let row = id.y / (PLACES / COLUMNS);
    // Among the sources that the first of the eight photosites gathers: the first line, and the first vec4f.
    let top = i32(D * m + row * STEP) - i32(R) - HIGH;
    let offset = i32(place / PERIOD * D + place % PERIOD * STEP);
    let first_group = (offset - HIGH) >> 2u;
    let start = i32(STRIDE / 4u * n) + first_group - i32(R / 4u);
    let first = u32(max(0, -top));
    let last = u32(clamp(i32(BY) - top, 0, i32(LINES)));
    #repeat k 8
    var sum_${k} = vec4f(0.0);
    #end
    for (var j = 0u; j < params.planes; j++) {
        for (var line = first; line < last; line++) {
            let y = u32(top + i32(line));
            let t = params.first_t + f32(y) * params.step_t;
            let from_block = (j * BY + y) * (BX / 4u);
            let weights = (((j * DOWN + row) * (PLACES / COLUMNS) + place / COLUMNS) * LINES + line) * GROUPS;
            for (var part = 0u; part < STRIDE / 4u; part++) {
                let v = start + i32(part);
                var a0 = source(from_block, v);
                #repeat k 6
                var a${k + 1} = source(from_block, v + i32(${k + 1}u * STRIDE / 4u));
                #end
                for (var g = part; g < GROUPS; g += STRIDE / 4u) {
                    let a7 = source(from_block, start + i32(g + 7u * STRIDE / 4u));
                    let i = (weights + g) * COLUMNS;
                    let e = 4 * (first_group + i32(g));
                    let x = taps(i, t, e);
                    var z = x;
                    if (COLUMNS == 2u) {
                        z = taps(i + 1u, t, e);
                    }
                    #repeat k 8
                    sum_${k} += gathered(a${k}, x, z);
                    #end
                    #repeat k 7
                    a${k} = a${k + 1};
                    #end
                }
            }
        }
    }
    #repeat k 8
    put(place, row, n + ${k}u, m, sum_${k});
    #end
}

// Smear of a CCD: mean electrons that light makes in packets on their way along the column, before the shot noise:
//   smeared[r, c] = min(mean[r, c] + weight passed(r), limit)
//   PASSED 0, interline: passed = sum_i rate[i, c]. The vertical registers are clocked while the next frame is exposed, so that
//     each packet has been in every row of the column: above its own while its well was empty, then below (Kodak 1999).
//   PASSED 1, frame transfer: passed = sum_{i < r} rate[i, c], the rows on the way to the read-out at row 0.
//   PASSED 2, frame transfer, cleared by shifting before the exposure: passed = sum_{i != r} rate[i, c].
// Rows that hold no photosite (overscan) have rate 0 and are passed through like the others. weight is the time in each
// row, of interline sensors times the share of the light that reaches the register. The rates are not clipped: a photosite
// that is full goes on leaking. Sums of rates have 48 bits (double_float), for the sun in the column and what lies beside it.
// Units: rate electrons/s, weight s, mean, limit and smeared electrons.
// In: rate, mean (rows, cols), whole columns. Out: smeared (rows, cols). sums (pieces + 1, cols) is scratch.
// Three dispatches, by STEP, in pieces of 32 rows (whole columns by one invocation each took twice as long: rows are far
// apart in memory): 0, the sum of each piece; 1, the sum before each piece and that of the column; 2, the packets.
// Dispatch: ceil(cols/64) x pieces workgroups of 64, for STEP 1 ceil(cols/64). Lavapipe, 2 cores: see tools/bench.py smear.
#include "double_float"

override PASSED: u32 = 0u;
override STEP: u32 = 0u;

const PIECE = 32u;   // rows

struct Params {
    rows: u32,
    cols: u32,
    weight: f32,
    limit_e: f32,
    zero: u32,   // 0, see double_float.wgsl
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rate: array<f32>;
@group(0) @binding(2) var<storage, read> mean: array<f32>;
@group(0) @binding(3) var<storage, read_write> sums: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> smeared: array<f32>;

// A sum and a number more; its errors are gathered in the low part.
fn plus(sum: vec2f, x: f32) -> vec2f {
    let s = two_sum(sum.x, x);
    return vec2f(s.x, sum.y + s.y);
}

fn scan(col: u32, pieces: u32) {
    var before = vec2f(0.0);
    for (var piece = 0u; piece < pieces; piece++) {
        let at = piece * params.cols + col;
        let here = sums[at];
        sums[at] = before;
        before = df_add(before, here);
    }
    sums[pieces * params.cols + col] = before;
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let col = id.x;
    if (col >= params.cols) {
        return;
    }
    let pieces = (params.rows + PIECE - 1u) / PIECE;
    if (STEP == 1u) {
        scan(col, pieces);
        return;
    }
    let total = sums[pieces * params.cols + col];
    var sum = vec2f(0.0);
    if (STEP == 2u && PASSED == 1u) {
        sum = sums[id.y * params.cols + col];
    }
    let cols = params.cols;
    let weight = params.weight;
    let limit_e = params.limit_e;
    let end = min((id.y + 1u) * PIECE, params.rows) * cols;
    for (var at = id.y * PIECE * cols + col; at < end; at += cols) {
        if (STEP == 0u) {
            sum = plus(sum, rate[at]);
            continue;
        }
        var passed = total.x;
        if (PASSED == 1u) {
            passed = sum.x + sum.y;
            sum = plus(sum, rate[at]);
        } else if (PASSED == 2u) {
            passed = two_sum(total.x, -rate[at]).x + total.y;   // the low part last: not lost beside the sun
        }
        smeared[at] = min(mean[at] + weight * passed, limit_e);
    }
    if (STEP == 0u) {
        sums[id.y * params.cols + col] = quick_two_sum(sum.x, sum.y);
    }
}

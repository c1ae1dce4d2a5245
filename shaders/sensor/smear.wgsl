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
// In: rate, mean (rows, cols), whole columns. Out: smeared (rows, cols).
// Dispatch: ceil(cols/32) workgroups of 32 x 8: 32 columns, each in eight parts. Lavapipe, 2 cores: see tools/bench.py smear.
#include "double_float"

override PASSED: u32 = 0u;

const WIDTH = 32u;
const PARTS = 8u;

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
@group(0) @binding(3) var<storage, read_write> smeared: array<f32>;

var<workgroup> sh_sums: array<vec2f, 256>;

@compute @workgroup_size(32, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let height = (params.rows + PARTS - 1u) / PARTS;
    let first = min(local.y * height, params.rows);
    let last = min(first + height, params.rows);
    let inside = id.x < params.cols;
    var sum = vec2f(0.0);
    if (inside) {
        for (var row = first; row < last; row++) {
            sum = df_add(sum, vec2f(rate[row * params.cols + id.x], 0.0));
        }
    }
    sh_sums[local.y * WIDTH + local.x] = sum;
    workgroupBarrier();
    if (!inside) {
        return;
    }
    var before = vec2f(0.0);
    var total = vec2f(0.0);
    for (var part = 0u; part < PARTS; part++) {
        if (part == local.y) {
            before = total;
        }
        total = df_add(total, sh_sums[part * WIDTH + local.x]);
    }
    for (var row = first; row < last; row++) {
        let at = row * params.cols + id.x;
        var passed = total;
        if (PASSED == 1u) {
            passed = before;
            before = df_add(before, vec2f(rate[at], 0.0));
        } else if (PASSED == 2u) {
            passed = df_add(total, vec2f(-rate[at], 0.0));
        }
        smeared[at] = min(mean[at] + params.weight * passed.x, params.limit_e);
    }
}

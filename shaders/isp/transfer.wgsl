// Transfer curve of an output space: from light to what is stored.
//   y = slope x up to the cut; above, (1 + offset) x^power - offset      (IEC 61966-2-1 for sRGB; ITU-R BT.2020, table 4)
// Light is clipped to 0 to 1 before: colours outside the space are not shown.
// Units: light, 1 is white. In and out: light (fours of samples).
// Dispatch: ceil(fours/64) workgroups of 64, up to 65535 along x and the rest along y, four samples each.

struct Params {
    fours: u32,
    wide: u32,           // invocations along x
    slope: f32,
    cut: f32,
    offset: f32,
    power: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> light: array<vec4f>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let at = id.y * params.wide + id.x;
    if (at >= params.fours) {
        return;
    }
    let x = clamp(light[at], vec4f(0.0), vec4f(1.0));
    let curved = (1.0 + params.offset) * pow(max(x, vec4f(params.cut)), vec4f(params.power)) - params.offset;
    light[at] = select(curved, params.slope * x, x <= vec4f(params.cut));
}

// White balance: each site's light over what white makes there, and at most 1, so that saturation is white.
//   light = min(light gain[site], 1)
// Units: light relative to saturation of the channel that saturates first. In and out: light (rows, cols), cols a
// multiple of 4. In: gain (PY, PX), of each site of the filter pattern.
// Dispatch: ceil(cols/64) x ceil(rows/16) workgroups of 16 x 16, four pixels of a row each.

override PY: u32;                       // rows and columns of the filter pattern
override PX: u32;

struct Params {
    rows: u32,
    fours: u32,     // cols/4
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> gain: array<f32>;
@group(0) @binding(2) var<storage, read_write> light: array<vec4f>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.fours || id.y >= params.rows) {
        return;
    }
    let at = id.y * params.fours + id.x;
    let row = id.y % PY * PX;
    let col = 4u * id.x;
    let gains = vec4f(gain[row + col % PX], gain[row + (col + 1u) % PX], gain[row + (col + 2u) % PX], gain[row + (col + 3u) % PX]);
    light[at] = min(light[at] * gains, vec4f(1.0));
}

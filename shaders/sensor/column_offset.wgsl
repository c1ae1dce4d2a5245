// Column offsets: what the converter of each column adds, the same in every frame.
//   offset[c] = sigma z,   z ~ N(0, 1), keyed by the sensor's serial number and the column on the chip
// Units: digital numbers.
// Out: offset (cols): the columns from col0.
// Dispatch: ceil((col0 mod 4 + cols)/256) workgroups of 64, four neighbouring columns each, which share a call of the
// generator.
#include "philox"
#include "gaussian"

struct Params {
    serial: vec2u,   // serial number, low and high word
    col0: u32,
    cols: u32,
    sigma_dn: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> offset: array<f32>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let quad = params.col0 / 4u + id.x;
    let offsets = params.sigma_dn * gaussian(philox(vec4u(quad, 0u, 0u, PURPOSE_COLUMN), params.serial));
    for (var i = 0u; i < 4u; i++) {
        let col = 4u * quad + i - params.col0;   // wraps to a huge number left of the first column
        if (col < params.cols) {
            offset[col] = offsets[i];
        }
    }
}

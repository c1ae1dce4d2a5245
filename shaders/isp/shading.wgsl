// Lens shading: light times the gain that makes an even surface even, a polynomial of the distance from the optical axis.
//   gain = 1 + k0 r^2 + k1 r^4 + k2 r^6 + k3 r^8 + k4 r^10    (DNG specification 1.4, chapter 7, FixVignetteRadial)
// r: from the axis to the pixel's middle, over that of the farthest corner of the frame.
// Units: light relative to saturation; places in pixels. In and out: light (rows, cols); cols is a multiple of 4.
// Dispatch: ceil(cols/64) x ceil(rows/16) workgroups of 16 x 16, four pixels of a row each.

struct Params {
    rows: u32,
    fours: u32,          // cols/4
    axis: vec2f,         // x, y of the axis from the middle of the first pixel
    per_pixel: f32,      // 1 / distance of the farthest corner
    k0: f32,
    k1: f32,
    k2: f32,
    k3: f32,
    k4: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> light: array<vec4f>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.fours || id.y >= params.rows) {
        return;
    }
    let x = (f32(4u * id.x) + vec4f(0.0, 1.0, 2.0, 3.0) - params.axis.x) * params.per_pixel;
    let y = (f32(id.y) - params.axis.y) * params.per_pixel;
    let s = x * x + y * y;
    let gain = 1.0 + s * (params.k0 + s * (params.k1 + s * (params.k2 + s * (params.k3 + s * params.k4))));
    light[id.y * params.fours + id.x] *= gain;
}

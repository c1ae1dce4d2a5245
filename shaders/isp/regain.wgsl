// Guided demosaicing, last of four stages: colours of their differences from the guide.
//   planes = planes + guide
// Units: light relative to saturation. In: guide (rows, cols). In and out: planes (colours, rows, cols).
// Dispatch: ceil(cols/16) x ceil(rows/16) workgroups of 16 x 16, one pixel each.

struct Params {
    rows: u32,
    cols: u32,
    colours: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> guide: array<f32>;
@group(0) @binding(2) var<storage, read_write> planes: array<f32>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.cols || id.y >= params.rows) {
        return;
    }
    let at = id.y * params.cols + id.x;
    for (var colour = 0u; colour < params.colours; colour++) {
        planes[colour * params.rows * params.cols + at] += guide[at];
    }
}

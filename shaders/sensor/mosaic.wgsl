// Samples the colour filter array: at each pixel the rate of its own site, plus uniform veiling glare.
//   rate[r, c] = max(plane[site][r div PY, c div PX], 0) + glare[site],   site = (r mod PY) PX + c mod PX
// No light is negative: in black parts transforms leave rounding errors of both signs.
// r, c count from the sensor's first pixel, so that a tile keeps the phase of the filter array.
// Units: electrons per second and pixel, in and out.
// In: planes (PY PX, plane_rows, plane_cols), whose sample (0, 0) is filter cell (cell_row0, cell_col0) of the sensor;
// glare (PY PX). Out: rate (rows, cols), the rectangle of pixels from (row0, col0); the planes must cover it.
// Dispatch: ceil(cols/16) x ceil(rows/16) workgroups of 16 x 16, one pixel each. Lavapipe, 2 cores: 199 MP/s.

override PY: u32;   // rows and columns of the filter pattern
override PX: u32;

struct Params {
    row0: u32,
    col0: u32,
    rows: u32,
    cols: u32,
    cell_row0: u32,
    cell_col0: u32,
    plane_rows: u32,
    plane_cols: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> planes: array<f32>;
@group(0) @binding(2) var<storage, read> glare: array<f32>;
@group(0) @binding(3) var<storage, read_write> rate: array<f32>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.cols || id.y >= params.rows) {
        return;
    }
    let row = params.row0 + id.y;
    let col = params.col0 + id.x;
    let site = (row % PY) * PX + col % PX;
    let cell = (site * params.plane_rows + row / PY - params.cell_row0) * params.plane_cols
        + col / PX - params.cell_col0;
    rate[id.y * params.cols + id.x] = max(planes[cell], 0.0) + glare[site];
}

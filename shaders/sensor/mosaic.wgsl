// Samples the colour filter array: at each pixel the rate of its own plane, plus uniform veiling glare.
//   rate[r, c] = max(plane[p][r div P, c div P], 0) + glare[s],   (p, s) = sites[r mod PY, c mod PX]
// No light is negative: in black parts transforms leave rounding errors of both signs.
// r, c count from the sensor's first pixel, so that a tile keeps the phase of the filter array. P is the filter pattern's
// period, where there is a plane for each of its sites, or 1: a plane for each channel.
// Units: electrons per second and pixel, in and out.
// In: planes (planes, plane_rows, plane_cols), whose sample (0, 0) is pixel (P cell_row0, P cell_col0) of the sensor;
// glare (sites of the pattern); sites (PY, PX). Out: rate (rows, cols), the rectangle of pixels from (row0, col0); the
// planes must cover it.
// Dispatch: ceil(cols/64) x PY ceil(rows/(16 PY)) workgroups of 64. An invocation takes 16 pixels of one site, one below
// the other: what it needs to know of the site, it finds once. Lavapipe, 2 cores: 500 MP/s,
// 1.2 to 1.4 times as long as copying (one pixel to an invocation, 4 to 5 times).

override P: u32 = 1u;
override PY: u32;   // rows and columns of `sites`; PY is a multiple of P
override PX: u32;

const ROWS = 16u;   // of an invocation

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
@group(0) @binding(3) var<storage, read> sites: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> rate: array<f32>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let first = id.y / PY * PY * ROWS + id.y % PY;
    if (id.x >= params.cols || first >= params.rows) {
        return;
    }
    let row = params.row0 + first;
    let col = params.col0 + id.x;
    let site = sites[row % PY * PX + col % PX];
    let light = glare[site.y];
    var cell = (site.x * params.plane_rows + row / P - params.cell_row0) * params.plane_cols
        + col / P - params.cell_col0;
    var at = first * params.cols + id.x;
    let count = min((params.rows - first + PY - 1u) / PY, ROWS);
    for (var i = 0u; i < count; i++) {
        rate[at] = max(planes[cell], 0.0) + light;
        cell += PY / P * params.plane_cols;
        at += PY * params.cols;
    }
}

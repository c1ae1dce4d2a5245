// The field in the pupil on the grid of the transform: A exp(2 pi i W), and what it holds.
//
// W and reach come from the nodes by cubic interpolation (Lagrange, four nodes each way). A is the share of the cell
// inside every aperture, reach < 1, whose edge is taken as straight within the cell; times the amplitude that enters
// there and that stop, surfaces and glass pass of it, exp(-exponent), interpolated like W.
// A shift of the image plane moves the chief ray's point along the chief ray, (0, beta_c / gamma_c, 1) per mm:
//   W += focus (gamma + beta beta_c / gamma_c - 1 / gamma_c) / lambda
// nodes (P, NA, NB): see wavefront; exponent (P, NA, NB)
// -> field (P, A, T), cell (i, j) at alpha = (i + 1/2) cell, beta = centre + (j - T/2 + 1/2) cell
// -> sums (P, A, 2), over j: of the light, share exp(-2 exponent); of the light whose ray lands beyond `fold`, so that
// the transform folds it back.
// Dispatch: (A, P, 1) workgroups of 64 invocations, each a row.
#include "grid"
#include "turn"

override T: u32 = 1024u;      // transform length

struct Params {
    na: u32,
    nb: u32,
    fold_um: f32,
    focus_mm: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grids: array<Grid>;
@group(0) @binding(2) var<storage, read> nodes: array<vec2f>;
@group(0) @binding(3) var<storage, read> exponent: array<f32>;
@group(0) @binding(4) var<storage, read_write> field: array<vec2f>;
@group(0) @binding(5) var<storage, read_write> sums: array<vec2f>;

var<workgroup> sh_sums: array<vec2f, 64>;

// Weights of the nodes -1, 0, 1, 2 at t in 0..1.
fn weights(t: f32) -> vec4f {
    let a = t + 1.0;
    let b = t - 1.0;
    let c = t - 2.0;
    return vec4f(-t * b * c, 3.0 * a * b * c, -3.0 * a * t * c, a * t * b) / 6.0;
}

// Their derivatives.
fn slopes(t: f32) -> vec4f {
    return vec4f(
        (6.0 - 3.0 * t) * t - 2.0,
        (9.0 * t - 12.0) * t - 3.0,
        (6.0 - 9.0 * t) * t + 6.0,
        3.0 * t * t - 1.0,
    ) / 6.0;
}

// Share of the unit square about the origin where a u + b v < h: a straight edge leaves beyond it either a corner,
// a triangle, or a strip whose mean width counts.
fn half_plane_share(h: f32, a: f32, b: f32) -> f32 {
    let wide = max(abs(a), abs(b));
    let narrow = min(abs(a), abs(b));
    let corner = 0.5 * (wide + narrow) - abs(h);
    if (corner <= 0.0) {
        return select(0.0, 1.0, h > 0.0);
    }
    var beyond = 0.5 - abs(h) / wide;
    if (corner < narrow) {
        beyond = 0.5 * (corner / wide) * (corner / narrow);
    }
    return select(beyond, 1.0 - beyond, h > 0.0);
}

struct Cell {
    field: vec2f,
    sums: vec2f,
}

fn cell_at(pair: u32, i: u32, j: u32) -> Cell {
    let grid = grids[pair];
    let at = grid.cell * (vec2f(f32(i), f32(j) - 0.5 * f32(T)) + 0.5) + vec2f(0.0, grid.centre);
    let x = (at - grid.first) / grid.step;
    let low = floor(x);
    let size = vec2f(f32(params.na), f32(params.nb));
    if (low.x + 2.0 >= size.x || low.y < 1.0 || low.y + 2.0 >= size.y) {
        return Cell();
    }
    let wa = weights(x.x - low.x);
    let wb = weights(x.y - low.y);
    let sa = slopes(x.x - low.x);
    let sb = slopes(x.y - low.y);
    var value = vec2f(0.0);
    var along_a = vec2f(0.0);
    var along_b = vec2f(0.0);
    var lost = 0.0;
    var missing = false;
    for (var m = 0u; m < 4u; m++) {
        let column = i32(low.x) + i32(m) - 1;
        let row = (pair * params.na + u32(select(column, -1 - column, column < 0))) * params.nb + u32(low.y) - 1u;
        let n0 = nodes[row];
        let n1 = nodes[row + 1u];
        let n2 = nodes[row + 2u];
        let n3 = nodes[row + 3u];
        let line = wb.x * n0 + wb.y * n1 + wb.z * n2 + wb.w * n3;
        value += wa[m] * line;
        along_a += sa[m] * line;
        along_b += wa[m] * (sb.x * n0 + sb.y * n1 + sb.z * n2 + sb.w * n3);
        lost += wa[m] * dot(wb, vec4f(exponent[row], exponent[row + 1u], exponent[row + 2u], exponent[row + 3u]));
        missing = missing || any(vec4f(n0.y, n1.y, n2.y, n3.y) == vec4f(0.0));
    }
    if (missing) {
        return Cell();
    }
    let per_cell = grid.cell / grid.step;
    let share = half_plane_share(1.0 - value.y, along_a.y * per_cell.x, along_b.y * per_cell.y);
    let gamma = sqrt(max(1.0 - dot(at, at), 1e-6));
    let chief = grid.chief_beta / sqrt(1.0 - grid.chief_beta * grid.chief_beta);
    let farther = gamma + at.y * chief - sqrt(1.0 + chief * chief);
    let slope = vec2f(along_a.x, along_b.x) / (grid.step * grid.waves_per_mm)
        + params.focus_mm * (vec2f(0.0, chief) - at / gamma);
    let folds = any(1e3 * abs(slope) > vec2f(params.fold_um));
    let w = value.x + params.focus_mm * farther * grid.waves_per_mm;
    let passed = exp(-lost);
    let light = share * passed * passed;
    return Cell(share * passed * turn(w), vec2f(light, select(0.0, light, folds)));
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) t: u32) {
    let row = group.y * groups.x + group.x;
    var sum = vec2f(0.0);
    for (var j = t; j < T; j += 64u) {
        let cell = cell_at(group.y, group.x, j);
        field[row * T + j] = cell.field;
        sum += cell.sums;
    }
    sh_sums[t] = sum;
    workgroupBarrier();
    if (t == 0u) {
        var all_ = vec2f(0.0);
        for (var k = 0u; k < 64u; k++) {
            all_ += sh_sums[k];
        }
        sums[row] = all_;
    }
}

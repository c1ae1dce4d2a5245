// The field in the pupil on the grid of the transform: A exp(2 pi i W), and what it holds.
//
// W and reach come from the nodes by cubic interpolation (Lagrange, four nodes each way). A is the share of the cell
// inside every aperture, reach < 1, whose edge is taken as straight within the cell; times the amplitude that enters
// there and that stop, surfaces and glass pass of it, exp(-exponent), interpolated like W.
// A shift of the image plane moves the chief ray's point along the chief ray c, (alpha_c, beta_c) / gamma_c per mm:
//   W += focus (gamma + (alpha alpha_c + beta beta_c) / gamma_c - 1 / gamma_c) / lambda
// A ray that lands farther out than `fold` would come back into the window, as the transform is periodic. It counts
// less from `fade` on, and from `fold` not at all: smoothly, so that what is left out ends in no rim that diffracts.
// Cells of a row share their alpha: the nodes are interpolated along it once for the row, and along beta for each cell.
// nodes (P, NA, NB): see wavefront; exponent (P, NA, NB)
// -> field (P, A, T), cell (i, j) at alpha = origin + (i + 1/2) cell, beta = origin + (j - T/2 + 1/2) cell
// -> sums (P, A, 2), over j: of the light, share exp(-2 exponent), wherever it lands; of that which lands beyond `fold`.
// Dispatch: (A, P, 1) workgroups of 64 invocations, each a row.
#include "grid"
#include "turn"

override T: u32 = 1024u;      // transform length
override NB: u32 = 128u;      // nodes along beta
override MIRRORED: bool = true; // the pupil's other half mirrors alpha > 0: node -1 - i is node i

struct Params {
    na: u32,
    fade_um: f32,
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
// What the nodes say at the row's own alpha, at each beta of theirs: W, reach and their derivatives by the spacing of
// alpha; the exponent, and 1 where a node has no ray.
var<workgroup> sh_nodes: array<vec4f, NB>;
var<workgroup> sh_lost: array<vec2f, NB>;

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

// 1 until 0 and 0 from 1 on, two times differentiable.
fn left_over(t: vec2f) -> vec2f {
    let s = clamp(t, vec2f(0.0), vec2f(1.0));
    return 1.0 - s * s * s * (10.0 + s * (6.0 * s - 15.0));
}

struct Cell {
    field: vec2f,
    sums: vec2f,
}

// Whether nodes lie on both sides of alpha, the one below it at `low`.
fn surrounded(low: f32) -> bool {
    return low + 2.0 < f32(params.na) && (MIRRORED || low >= 1.0);
}

// Interpolate the nodes to alpha, x steps from the first.
fn interpolate_row(pair: u32, x: f32, t: u32) {
    let low = floor(x);
    if (!surrounded(low)) {
        return;
    }
    let w = weights(x - low);
    let s = slopes(x - low);
    for (var n = t; n < NB; n += 64u) {
        var value = vec4f(0.0);
        var lost = vec2f(0.0);
        for (var m = 0u; m < 4u; m++) {
            let column = i32(low) + i32(m) - 1;
            let at = (pair * params.na + u32(select(column, -1 - column, column < 0))) * NB + n;
            let node = nodes[at];
            value += vec4f(w[m] * node, s[m] * node);
            lost += vec2f(w[m] * exponent[at], select(0.0, 1.0, node.y == 0.0));
        }
        sh_nodes[n] = value;
        sh_lost[n] = lost;
    }
}

fn cell_at(grid: Grid, at: vec2f) -> Cell {
    let x = (at - grid.first) / grid.step;
    let low = floor(x);
    if (!surrounded(low.x) || low.y < 1.0 || low.y + 2.0 >= f32(NB)) {
        return Cell();
    }
    let w = weights(x.y - low.y);
    let s = slopes(x.y - low.y);
    let n = u32(low.y) - 1u;
    let n0 = sh_nodes[n];
    let n1 = sh_nodes[n + 1u];
    let n2 = sh_nodes[n + 2u];
    let n3 = sh_nodes[n + 3u];
    let value = w.x * n0 + w.y * n1 + w.z * n2 + w.w * n3;
    let along_b = s.x * n0.xy + s.y * n1.xy + s.z * n2.xy + s.w * n3.xy;
    let lost = w.x * sh_lost[n] + w.y * sh_lost[n + 1u] + w.z * sh_lost[n + 2u] + w.w * sh_lost[n + 3u];
    if (sh_lost[n].y + sh_lost[n + 1u].y + sh_lost[n + 2u].y + sh_lost[n + 3u].y > 0.0) {
        return Cell();
    }
    let per_cell = grid.cell / grid.step;
    let share = half_plane_share(1.0 - value.y, value.w * per_cell.x, along_b.y * per_cell.y);
    let gamma = sqrt(max(1.0 - dot(at, at), 1e-6));
    let chief = grid.chief / sqrt(1.0 - dot(grid.chief, grid.chief));
    let farther = gamma + dot(at, chief) - sqrt(1.0 + dot(chief, chief));
    let slope = vec2f(value.z, along_b.x) / (grid.step * grid.waves_per_mm)
        + params.focus_mm * (chief - at / gamma);
    let lands_um = 1e3 * abs(slope);
    let folds = any(lands_um > vec2f(params.fold_um));
    let kept = left_over((lands_um - params.fade_um) / (params.fold_um - params.fade_um));
    let waves = value.x + params.focus_mm * farther * grid.waves_per_mm;
    let passed = exp(-lost.x);
    let light = share * passed * passed;
    return Cell(share * passed * kept.x * kept.y * turn(waves), vec2f(light, select(0.0, light, folds)));
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) t: u32) {
    let row = group.y * groups.x + group.x;
    let grid = grids[group.y];
    let alpha = grid.cell * (f32(group.x) + 0.5) + grid.origin.x;
    interpolate_row(group.y, (alpha - grid.first.x) / grid.step.x, t);
    workgroupBarrier();
    // Software drivers run a cell to its end wherever it lies, but not a loop that is over: cells that the nodes do not
    // surround are left out here, and not in cell_at alone (lavapipe: twice as fast with half of the cells).
    let first = 0.5 * f32(T) - 0.5 + (grid.first.y - grid.origin.y) / grid.cell;
    let node = grid.step.y / grid.cell;
    let begin = 64u * (u32(clamp(first + node - 1.0, 0.0, f32(T))) / 64u);  // a lane's own cells stay its own
    let end = u32(clamp(first + f32(NB - 2u) * node + 2.0, 0.0, f32(T)));
    for (var j = t; j < T; j += 64u) {
        field[row * T + j] = vec2f(0.0);
    }
    var sum = vec2f(0.0);
    for (var j = begin + t; j < end; j += 64u) {
        let cell = cell_at(grid, vec2f(alpha, grid.cell * (f32(j) - 0.5 * f32(T) + 0.5) + grid.origin.y));
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

// Samples up to three coefficient planes of a raster scene on one block of the sim grid, on the real image plane.
//
// The continuous radiance is the cubic spline through the raster's samples (Unser 1999, eq. 3):
//   a(u) = sum_k c_k beta3(u_x - k_x) beta3(u_y - k_y),   u(x) by the chief-ray map
// with the spline coefficients c computed on the host in float64. Beyond the raster its border value goes on.
// SIDE x SIDE points share a patch of 6 x 6 coefficients, loaded once; places and weights serve all planes. A point reads 4 x 4,
// so in x and in y its u must lie within 1 of that of the points' middle.
// The raster is never finer than the sim grid. Where distortion squeezes it until it is, the sample is a weighted sum
// over points `step` apart in x and y, a low-pass (SQUEEZED), and these share patches; else samples do.
// Where u(x) falls on the raster's samples there is no spline (SPLINE false): the coefficients are samples, and taken as
// they are.
// Beyond the image circle the planes are black.
// Radiance is preserved: the value is carried, not spread.
// Units: x in sim samples from the optical axis; u in raster samples; output planes (J, BY, BX), from plane `plane` on.
// Dispatch: ceil(a b / 64) workgroups of 64 invocations, n x n samples each, by lines of a = ceil(BX / n); b = ceil(BY / n) lines.
// n = SIDE, or 1 if SQUEEZED.
#include "b_spline"
#include "chief_ray"

override BX: u32 = 336u;  // block width, samples
override BY: u32 = 336u;  // block height, samples
override AXIS: bool = true;  // the chief-ray map is that of a lens with an axis, see common/chief_ray
override DISTORTION: bool = true;  // the ideal and the real image differ
override SPLINE: bool = true;
override SQUEEZED: bool = false;
override SIDE: u32 = 4u;  // 2 where SQUEEZED
override PLANES: u32 = 1u;  // 1 to 3

struct Params {
    circle: vec2f,            // centre of the image circle
    origin: vec2f,            // sample (0, 0) of the block
    centre: vec2f,            // the optical axis in raster samples (sample 0 at 0)
    size: vec2i,              // raster columns, rows
    first: vec2i,             // column and row of the raster with which `coefficients` begins
    cols: i32,                // columns of `coefficients`
    inverse_radius2: f32,     // of that circle
    pieces: f32,              // of the chief-ray map, see common/chief_ray
    scale: f32,               // raster samples per sim sample
    plane: u32,               // the first
    reach: i32,               // points to each side of the sample
    step: f32,                // from point to point, sim samples; 1 where they are samples
}

@group(0) @binding(0) var<uniform> params: Params;
// Each plane (rows, cols): what the block sees of the raster. Beyond PLANES they are not read.
@group(0) @binding(1) var<storage, read> coefficients: array<f32>;
@group(0) @binding(2) var<storage, read> coefficients_1: array<f32>;
@group(0) @binding(3) var<storage, read> coefficients_2: array<f32>;
@group(0) @binding(4) var<storage, read> terms: array<vec4f>;        // of the chief-ray map, see common/chief_ray
@group(0) @binding(5) var<storage, read> weights: array<f32>;        // (2 reach + 2), sum 1, the last 0
@group(0) @binding(6) var<storage, read_write> planes: array<f32>;

// A line of the patch, or the column of its lines' sums: six coefficients of each plane.
struct Line {
    #repeat k 6
    c${k}: vec3f,
    #end
}

struct Patch {
    first: vec2f,   // u where the first of the three cells begins in which points may lie, in x and in y
    #repeat k 6
    l${k}: Line,
    #end
}

struct Weights {
    low: vec3f,
    high: vec3f,
}

// The spline goes on mirrored about the first and last sample.
fn mirror(k: i32, n: i32) -> i32 {
    return max(min(abs(k), 2 * (n - 1) - abs(k)), 0);
}

fn at_each(k: i32) -> vec3f {
    var found = vec3f(coefficients[k], 0.0, 0.0);
    if (PLANES > 1u) { found.y = coefficients_1[k]; }
    if (PLANES > 2u) { found.z = coefficients_2[k]; }
    return found;
}

fn load_line(first: vec2i, row: i32) -> Line {
    let at = (mirror(first.y + row, params.size.y) - params.first.y) * params.cols - params.first.x;
    return Line(
        #repeat k 6
        at_each(at + mirror(first.x + ${k}, params.size.x)),
        #end
    );
}

fn ideal(x: vec2f) -> vec2f {
    return clamp(params.centre + params.scale * chief_ray(x).u, vec2f(0.0), vec2f(params.size - 1));
}

// The patch of SIDE x SIDE points, the first at x.
fn load_patch(x: vec2f) -> Patch {
    let cell = floor(ideal(x + 0.5 * params.step * f32(SIDE - 1u))) - 1.0;
    let first = vec2i(cell) - 1;
    return Patch(
        cell,
        #repeat k 6
        load_line(first, ${k}),
        #end
    );
}

// Among the six coefficients around the cells first, first + 1 and first + 2; those of u's cell, the others 0.
fn weights_of(u: f32, first: f32) -> Weights {
    let cell = clamp(floor(u) - first, 0.0, 2.0);
    let w = cubic_weights(u - (first + cell));
    return Weights(
        select(select(vec3f(0.0, 0.0, w.x), vec3f(0.0, w.xy), cell == 1.0), w.xyz, cell == 0.0),
        select(select(w.yzw, vec3f(w.zw, 0.0), cell == 1.0), vec3f(w.w, 0.0, 0.0), cell == 0.0),
    );
}

fn sum_of(w: Weights, line: Line) -> vec3f {
    return w.low.x * line.c0 + w.low.y * line.c1 + w.low.z * line.c2
        + w.high.x * line.c3 + w.high.y * line.c4 + w.high.z * line.c5;
}

fn radiance(x: vec2f, around: Patch) -> vec3f {
    let off = x - params.circle;
    let lit = select(0.0, 1.0, dot(off, off) * params.inverse_radius2 <= 1.0);
    let u = ideal(x);
    if (!SPLINE) {
        let nearest = vec2i(round(u)) - params.first;
        return lit * at_each(nearest.y * params.cols + nearest.x);
    }
    let wx = weights_of(u.x, around.first.x);
    return lit * sum_of(weights_of(u.y, around.first.y), Line(
        #repeat k 6
        sum_of(wx, around.l${k}),
        #end
    ));
}

fn low_passed(x: vec2f) -> vec3f {
    let side = i32(SIDE);
    var sum = vec3f(0.0);
    for (var j = -params.reach; j <= params.reach; j += side) {
        for (var i = -params.reach; i <= params.reach; i += side) {
            let corner = x + params.step * vec2f(f32(i), f32(j));
            let around = load_patch(corner);
            for (var n = 0; n < side; n++) {
                var row = vec3f(0.0);
                for (var m = 0; m < side; m++) {
                    let point = corner + params.step * vec2f(f32(m), f32(n));
                    row += weights[params.reach + i + m] * radiance(point, around);
                }
                sum += weights[params.reach + j + n] * row;
            }
        }
    }
    return sum;
}

fn store(at: vec2u, found: vec3f) {
    if (at.x >= BX || at.y >= BY) {
        return;
    }
    let to = (params.plane * BY + at.y) * BX + at.x;
    planes[to] = found.x;
    if (PLANES > 1u) {
        planes[to + BY * BX] = found.y;
    }
    if (PLANES > 2u) {
        planes[to + 2u * BY * BX] = found.z;
    }
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let n = select(SIDE, 1u, SQUEEZED);
    let across = (BX + n - 1u) / n;
    let corner = n * vec2u(id.x % across, id.x / across);
    let x = params.origin + vec2f(corner);
    if (SQUEEZED) {
        store(corner, low_passed(x));
        return;
    }
    let around = load_patch(x);
    for (var j = 0u; j < SIDE; j++) {
        for (var i = 0u; i < SIDE; i++) {
            let at = vec2u(i, j);
            store(corner + at, radiance(x + vec2f(at), around));
        }
    }
}

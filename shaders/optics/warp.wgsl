// Samples one coefficient plane of a raster scene on one block of the sim grid, on the real image plane.
//
// The continuous radiance is the cubic spline through the raster's samples (Unser 1999, eq. 3):
//   a(u) = sum_k c_k beta3(u_x - k_x) beta3(u_y - k_y),   u(x) by the chief-ray map
// with the spline coefficients c computed on the host in float64. Beyond the raster its border value goes on.
// The raster is never finer than the sim grid. Where distortion squeezes it until it is, the sample is a weighted sum
// over points `step` apart in x and y, a low-pass (SQUEEZED; the loop alone takes 2.5 times as long where reach is 0).
// Where u(x) falls on the raster's samples there is no spline (SPLINE false): `coefficients` are samples, and taken as
// they are.
// Beyond the image circle the plane is black.
// Radiance is preserved: the value is carried, not spread.
// Units: x in sim samples from the optical axis; u in raster samples; output planes (J, BY, BX), plane `plane`.
// Dispatch: ceil(BX/16) x ceil(BY/16) workgroups of 16 x 16, one sample each.
#include "b_spline"
#include "chief_ray"

override BX: u32 = 336u;  // block width, samples
override BY: u32 = 336u;  // block height, samples
override DEGREE: u32 = 0u;  // of the chief-ray map of a lens without an axis; 0: it has one
override DISTORTION: bool = true;  // the ideal and the real image differ
override SPLINE: bool = true;
override SQUEEZED: bool = false;

struct Params {
    g_low: vec4f,             // chief-ray map, see common/chief_ray
    g_high: vec4f,
    circle: vec2f,            // centre of the image circle
    origin: vec2f,            // sample (0, 0) of the block
    centre: vec2f,            // the optical axis in raster samples (sample 0 at 0)
    size: vec2i,              // raster columns, rows
    first: vec2i,             // column and row of the raster with which `coefficients` begins
    cols: i32,                // columns of `coefficients`
    inverse_radius2: f32,
    scale: f32,               // raster samples per sim sample
    plane: u32,
    reach: i32,               // points to each side of the sample
    step: f32,                // from point to point, sim samples
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> coefficients: array<f32>;   // (rows, cols): of the raster what the block sees
@group(0) @binding(2) var<storage, read> terms: array<vec2f>;        // of the chief-ray map, see common/chief_ray
@group(0) @binding(3) var<storage, read> weights: array<f32>;        // (2 reach + 1), sum 1
@group(0) @binding(4) var<storage, read_write> planes: array<f32>;

// The spline goes on mirrored about the first and last sample.
fn mirror(k: i32, n: i32) -> i32 {
    return max(min(abs(k), 2 * (n - 1) - abs(k)), 0);
}

fn row_sum(first: vec2i, row: i32, weights: vec4f) -> f32 {
    let at = (mirror(first.y + row, params.size.y) - params.first.y) * params.cols - params.first.x;
    return dot(weights, vec4f(
        coefficients[at + mirror(first.x, params.size.x)],
        coefficients[at + mirror(first.x + 1, params.size.x)],
        coefficients[at + mirror(first.x + 2, params.size.x)],
        coefficients[at + mirror(first.x + 3, params.size.x)],
    ));
}

fn radiance(x: vec2f) -> f32 {
    let off = x - params.circle;
    let lit = select(0.0, 1.0, dot(off, off) * params.inverse_radius2 <= 1.0);
    let u = clamp(params.centre + params.scale * chief_ray(x).u, vec2f(0.0), vec2f(params.size - 1));
    if (!SPLINE) {
        let nearest = vec2i(round(u)) - params.first;
        return lit * coefficients[nearest.y * params.cols + nearest.x];
    }
    let cell = floor(u);
    let wx = cubic_weights(u.x - cell.x);
    let wy = cubic_weights(u.y - cell.y);
    let first = vec2i(cell) - 1;
    return lit * dot(wy, vec4f(
        row_sum(first, 0, wx),
        row_sum(first, 1, wx),
        row_sum(first, 2, wx),
        row_sum(first, 3, wx),
    ));
}

fn low_passed(x: vec2f) -> f32 {
    var sum = 0.0;
    for (var j = -params.reach; j <= params.reach; j++) {
        var row = 0.0;
        for (var i = -params.reach; i <= params.reach; i++) {
            row += weights[params.reach + i] * radiance(x + params.step * vec2f(f32(i), f32(j)));
        }
        sum += weights[params.reach + j] * row;
    }
    return sum;
}

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= BX || id.y >= BY) {
        return;
    }
    let x = params.origin + vec2f(id.xy);
    let to = (params.plane * BY + id.y) * BX + id.x;
    if (SQUEEZED) {
        planes[to] = low_passed(x);
    } else {
        planes[to] = radiance(x);
    }
}

// Adds the light that lands far from where it belongs to the photosites: the halo, known on a coarse grid of its own.
//
//   rates[site, y, x] += sum_ab c[channel, i + a, j + b] beta3(v - a) beta3(u - b),   u, v = step (pixel centre) + offset
//
// c: coefficients of cubic B-splines through the halo's samples; (i, j) is the sample below and left of (v, u).
// Units: step in coarse samples per pixel, offset in coarse samples; coefficients and rates in electrons/s.
// coefficients (C, size_y, size_x) -> rates (S, rows, cols), of the rectangle.
// The place is worked out from the pixel's number on the sensor, so that tiles repeat the same sums bit for bit.
// Dispatch: (ceil(cols/16), ceil(rows/16), S) workgroups of 16 x 16 invocations, one photosite each.
#include "b_spline"

override S: u32 = 4u;         // planes: CFA sites, PERIOD^2, or the channels of all pixels, where PERIOD is 1
override PERIOD: u32 = 2u;

struct Params {
    origin: vec2u,            // (x, y) of the rectangle's first CFA cell
    size: vec2u,              // (columns, rows) of the planes
    first: vec2u,             // (x, y) of the first coarse sample that is given
    given: vec2u,             // (columns, rows) of the coarse samples
    step: f32,
    pad: f32,
    offset: vec2f,            // (x, y) of the first pixel's centre
    site_channels: vec4u,     // channel of each site, four bits a site: site s in word s/8, bits 4 (s%8)
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> coefficients: array<f32>;
@group(0) @binding(2) var<storage, read_write> rates: array<f32>;

fn row_sum(at: u32, weights: vec4f) -> f32 {
    return weights.x * coefficients[at] + weights.y * coefficients[at + 1u]
        + weights.z * coefficients[at + 2u] + weights.w * coefficients[at + 3u];
}

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (any(id.xy >= params.size)) {
        return;
    }
    let site = id.z;
    let pixel = (params.origin + id.xy) * PERIOD + vec2u(site % PERIOD, site / PERIOD % PERIOD);
    let at = vec2f(pixel) * params.step + params.offset;
    let cell = floor(at);
    let wx = cubic_weights(at.x - cell.x);
    let wy = cubic_weights(at.y - cell.y);
    let channel = (params.site_channels[site / 8u] >> (4u * (site % 8u))) & 15u;
    let corner = vec2u(cell) - 1u - params.first;
    let line = (channel * params.given.y + corner.y) * params.given.x + corner.x;
    let width = params.given.x;
    let sum = wy.x * row_sum(line, wx) + wy.y * row_sum(line + width, wx)
        + wy.z * row_sum(line + 2u * width, wx) + wy.w * row_sum(line + 3u * width, wx);
    rates[(site * params.size.y + id.y) * params.size.x + id.x] += sum;
}

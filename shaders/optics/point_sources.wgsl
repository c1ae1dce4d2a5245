// Adds the light of a photograph's highlights to the photosites. Each is a small square of even radiance, far brighter than
// what is around it; in transforms of f32 its rounding errors would drown the shadows, so it is summed pixel by pixel:
//
//   rates[site, y, x] += sum_i max(0, sum_m a_im H_i(v))
//   v = (pixel - highlight_i), turned into the meridional frame
//   H_i(v) = sum_ab c_i[a, b] beta3(v_x - b) beta3(v_y - a)
//
// H_i, of channel and spectrum: the PSF convolved with the pixel aperture and with the square, per unit of spectral radiance.
// Its spline coefficients c end in zeros at the border and go on so. There are two splines: a fine one is taken near the chief
// ray, and beyond one of coarser samples. Cubics between the fields of a lens may lie below 0: what that makes of a highlight's
// light is not, for no highlight takes light away.
// Every pixel takes its highlights in the order of the list, so that tiles repeat the same sums bit for bit.
// Units: positions in pixels, kernels in samples of their own, a in units of the scene's spectra, rates in electrons/s.
// kernels (kernels, C, fours, NEAR^2 + FAR^2, 4): c, fine ones first, row sagittal, column tangential, four spectra side by side;
// the chief ray is at NEAR/2 and at FAR/2.
// Highlights near to each other share one: lavapipe takes its time to load, not to add.
// rates (S, rows, cols), of the rectangle.
// The sensor is cut into squares of 16 x 16 CFA cells, of each of which the host has listed the highlights within reach.
// Dispatch: (squares across, down, S) workgroups of 16 x 16, one photosite each, from square `first` on.
#include "b_spline"
#include "texels"

override S: u32 = 4u;         // planes: CFA sites, PERIOD^2, or the channels of all pixels, where PERIOD is 1
override PERIOD: u32 = 2u;
override C: u32 = 3u;         // colour channels that the kernels are of; sites with numbers beyond take no light
override NEAR: u32;           // sides of a kernel's two parts, samples
override FAR: u32;

struct Params {
    first: vec2u,             // (x, y) of the dispatch's first square
    origin: vec2i,            // (x, y) of the rectangle's first CFA cell
    size: vec2i,              // (columns, rows) of the planes
    across: u32,              // squares across the sensor
    fours: u32,               // ceil(M/4) for M spectra of the scene; a param, so that the loop stays a loop
    reach2: f32,              // squared distance beyond which kernels hold nothing, fine samples
    near2: f32,               // squared distance up to which fine samples are taken, fine samples
    step: f32,                // fine samples from one coarse one to the next
    site_channels: vec4u,     // channel of each site, four bits a site: site s in word s/8, bits 4 (s%8)
}

struct Highlight {
    pixel: vec2i,             // column, row of the pixel in which its centre lies
    place: vec2f,             // of the centre in it, from the pixel's centre
    axis: vec2f,              // the radial unit vector, times a kernel's fine samples per pixel
    kernel: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> highlights: array<Highlight>;
@group(0) @binding(2) var<storage, read> radiance: array<vec4f>;  // (highlights, fours)
@group(0) @binding(3) var<storage, read> starts: array<u32>;     // of each square's list in `near`, and the end of the last
@group(0) @binding(4) var<storage, read> near: array<u32>;
@group(0) @binding(5) var kernels: texture_2d<f32>;              // see `texels`
@group(0) @binding(6) var<storage, read_write> rates: array<f32>;

fn channel_of(site: u32) -> u32 {
    return (params.site_channels[site / 8u] >> (4u * (site % 8u))) & 15u;
}

fn row_sum(at: u32, weights: vec4f) -> vec4f {
    return weights.x * texel(kernels, at) + weights.y * texel(kernels, at + 1u)
        + weights.z * texel(kernels, at + 2u) + weights.w * texel(kernels, at + 3u);
}

// Light of one highlight on a pixel of a channel, electrons/s.
fn light(i: u32, pixel: vec2i, channel: u32) -> f32 {
    let h = highlights[i];
    let d = vec2f(pixel - h.pixel) - h.place;
    let v = vec2f(dot(h.axis, d), h.axis.x * d.y - h.axis.y * d.x);
    if (dot(v, v) > params.reach2) {
        return 0.0;
    }
    let near = dot(v, v) <= params.near2;
    let side = select(FAR, NEAR, near);
    let at = select(v / params.step, v, near) + f32(side / 2u);
    let cell = floor(at);
    let wx = cubic_weights(at.x - cell.x);
    let wy = cubic_weights(at.y - cell.y);
    let corner = select(NEAR * NEAR, 0u, near) + u32(cell.y - 1.0) * side + u32(cell.x - 1.0);
    var sum = 0.0;
    for (var q = 0u; q < params.fours; q++) {
        let first = ((h.kernel * C + channel) * params.fours + q) * (NEAR * NEAR + FAR * FAR) + corner;
        let spread = wy.x * row_sum(first, wx) + wy.y * row_sum(first + side, wx)
            + wy.z * row_sum(first + 2u * side, wx) + wy.w * row_sum(first + 3u * side, wx);
        sum += dot(radiance[i * params.fours + q], spread);
    }
    return max(sum, 0.0);
}

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let square = params.first + group.xy;
    let cell = vec2i(16u * square + local.xy);
    let at = cell - params.origin;
    if (any(at < vec2i(0)) || any(at >= params.size)) {
        return;
    }
    let site = group.z;
    let pixel = cell * i32(PERIOD) + vec2i(i32(site % PERIOD), i32(site / PERIOD % PERIOD));
    let channel = channel_of(site);
    if (channel >= C) {
        return;
    }
    let list = square.y * params.across + square.x;
    var sum = 0.0;
    for (var n = starts[list]; n < starts[list + 1u]; n++) {
        sum += light(near[n], pixel, channel);
    }
    rates[(i32(site) * params.size.y + at.y) * params.size.x + at.x] += sum;
}

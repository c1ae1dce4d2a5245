// Paints a chart onto one block of the sim grid, on the real image plane, low-passed by a Gaussian.
//
// The chart is a list of primitives on the ideal (distortion-free) plane, painted in order over a background:
//   a(x) <- a(x) + (m - a(x)) w(u(x)),   w = the primitive's indicator convolved with the Gaussian
// The Gaussian has standard deviation `sigma` samples on the *real* plane; along the unit vector e of the ideal
// plane that is sigma |M^T e|, M = du/dx. Rectangle: product of two differences of Phi (exact for every angle).
// Disc: Phi((R - r)/s - s/(2R)): to first order in s/R the curved edge drifts inward by s^2/(2R), the f'/r term of
// the heat equation in polar coordinates; what is left is below 0.1 (s/R)^2 for R > 4 s.
// Beyond the image circle the plane is black, its rim low-passed likewise.
// The kernels of the convolution divide the Gaussian out again: it only keeps the samples free of aliases.
// Units: samples from the optical axis; coefficients in radiance units of the basis.
// Output planes (J, BY, BX). Dispatch: ceil(BX/16) x ceil(BY/16) workgroups of 16 x 16, one sample each.
#include "normal"
#include "distortion"

override BX: u32 = 336u;  // block width, samples
override BY: u32 = 336u;  // block height, samples
override J: u32 = 3u;     // coefficient planes, 1 to 8

const DISC = 1u;          // kind of primitive; 0 is a rectangle
const REACH = 6.0;        // standard deviations; Phi(-6) = 1e-9
const TILE = 16.0;        // side of a workgroup's tile, samples
const LISTED = 64u;       // primitives listed at a time: a tile of 8 pixels sees fewer of a legible chart

struct Params {
    g_low: vec4f,             // chief-ray map, see common/distortion
    g_high: vec4f,
    origin: vec2f,            // sample (0, 0) of the block
    inverse_radius2: f32,
    sigma: f32,
    first: u32,               // the block's primitives in `chosen`
    count: u32,
    background: u32,          // material
}

struct Primitive {
    centre: vec2f,
    half_size: vec2f,         // a disc has its radius in x
    axis: vec2f,              // unit vector of the rectangle's width
    kind: u32,
    material: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> primitives: array<Primitive>;
@group(0) @binding(2) var<storage, read> chosen: array<u32>;
@group(0) @binding(3) var<storage, read> materials: array<vec4f>;   // two per material: up to 8 coefficients
@group(0) @binding(4) var<storage, read_write> planes: array<f32>;

var<workgroup> sh_list: array<u32, LISTED>;
var<workgroup> sh_count: u32;
var<workgroup> sh_next: u32;
var<workgroup> sh_background: u32;

// sigma along the unit vector e of the ideal plane: sigma |M^T e|
fn width_along(e: vec2f, x: vec2f, p: IdealPoint) -> f32 {
    return params.sigma * length(p.g * e + p.dg * dot(x, e) * x);
}

fn slab(distance: f32, half_width: f32, width: f32) -> f32 {
    return normal_cdf((half_width - distance) / width) - normal_cdf((-half_width - distance) / width);
}

fn coverage(shape: Primitive, x: vec2f, p: IdealPoint) -> f32 {
    let d = p.u - shape.centre;
    if (shape.kind == DISC) {
        // At the very centre any direction does.
        let width = width_along(normalize(select(d, shape.axis, all(d == vec2f(0.0)))), x, p);
        return normal_cdf((shape.half_size.x - length(d)) / width - 0.5 * width / shape.half_size.x);
    }
    let across = vec2f(-shape.axis.y, shape.axis.x);
    return slab(dot(d, shape.axis), shape.half_size.x, width_along(shape.axis, x, p))
        * slab(dot(d, across), shape.half_size.y, width_along(across, x, p));
}

// Distance from a primitive's outline: exact or too small outside, exact or too large in amount inside (negative).
fn outline_distance(shape: Primitive, u: vec2f) -> f32 {
    let d = u - shape.centre;
    if (shape.kind == DISC) {
        return length(d) - shape.half_size.x;
    }
    let across = vec2f(-shape.axis.y, shape.axis.x);
    return max(abs(dot(d, shape.axis)) - shape.half_size.x, abs(dot(d, across)) - shape.half_size.y);
}

// One invocation lists the primitives whose edge the workgroup's tile sees, from `first` on, and returns where it stopped.
// In the first list, one that covers the whole tile becomes its background and empties the list.
fn list_primitives(first: u32, centre: IdealPoint) -> u32 {
    // From the tile's centre to its corners, and the Gaussian's reach: the map stretches less than twofold.
    let margin = 2.0 * (0.5 * length(vec2f(TILE)) + REACH * params.sigma);
    var i = first;
    sh_count = 0u;
    while (i < params.first + params.count && sh_count < LISTED) {
        let distance = outline_distance(primitives[chosen[i]], centre.u);
        if (distance < -margin && first == params.first) {
            sh_background = primitives[chosen[i]].material;
            sh_count = 0u;
        } else if (distance < margin) {
            sh_list[sh_count] = chosen[i];
            sh_count++;
        }
        i++;
    }
    return i;
}

@compute @workgroup_size(16, 16, 1)
fn main(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let x = params.origin + vec2f(id.xy);
    let p = ideal_point(x, params.inverse_radius2, params.g_low, params.g_high);
    let middle = params.origin + TILE * (vec2f(group.xy) + 0.5) - 0.5;
    let centre = ideal_point(middle, params.inverse_radius2, params.g_low, params.g_high);
    if (lane == 0u) {
        sh_background = params.background;
        sh_next = list_primitives(params.first, centre);
    }
    workgroupBarrier();
    var low = materials[2u * sh_background];
    var high = materials[2u * sh_background + 1u];
    for (;;) {
        for (var i = 0u; i < sh_count; i++) {
            let shape = primitives[sh_list[i]];
            let w = coverage(shape, x, p);
            low += w * (materials[2u * shape.material] - low);
            high += w * (materials[2u * shape.material + 1u] - high);
        }
        if (workgroupUniformLoad(&sh_next) >= params.first + params.count) {
            break;
        }
        if (lane == 0u) {
            sh_next = list_primitives(sh_next, centre);
        }
        workgroupBarrier();
    }
    if (id.x >= BX || id.y >= BY) {
        return;
    }
    // Beyond the image circle, rho2 = 1, no light arrives.
    let rim = inverseSqrt(params.inverse_radius2) - length(x);
    let lit = normal_cdf(rim / params.sigma);
    low *= lit;
    high *= lit;
    let at = id.y * BX + id.x;
    planes[at] = low.x;
    if (J > 1u) { planes[at + BX * BY] = low.y; }
    if (J > 2u) { planes[at + 2u * BX * BY] = low.z; }
    if (J > 3u) { planes[at + 3u * BX * BY] = low.w; }
    if (J > 4u) { planes[at + 4u * BX * BY] = high.x; }
    if (J > 5u) { planes[at + 5u * BX * BY] = high.y; }
    if (J > 6u) { planes[at + 6u * BX * BY] = high.z; }
    if (J > 7u) { planes[at + 7u * BX * BY] = high.w; }
}

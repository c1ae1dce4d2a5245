// Paints a chart onto one block of the sim grid, on the real image plane, low-passed by a Gaussian.
//
// The chart is a list of primitives on the ideal (distortion-free) plane over a background. Each lies all in one material, n:
//   a(x) = background + sum (m - n) w(u(x)),   w = the primitive's indicator convolved with the Gaussian
// This sum is the chart convolved with the Gaussian, however near to one another outlines are.
// The Gaussian has standard deviation `sigma` samples on the *real* plane; along the unit vector e of the ideal
// plane that is sigma |M^T e|, M = du/dx. Rectangle: product of two differences of Phi (exact for every angle).
// Disc: Phi((R - r)/s - s/(2R)): to first order in s/R the curved edge drifts inward by s^2/(2R), the f'/r term of
// the heat equation in polar coordinates; what is left is below 0.07 (s/R)^2 for R > 16 s. A small disc is cut into strips:
// over q = R sin t, the Gaussian's density at q times its share in the strip's height 2 R cos t. The integrand goes on
// periodically, so that the sum over n middles converges like a Fourier series.
// Polygon: in samples in which the Gaussian is round and of width 1, about the sample: 1 inside, less for each side the Gaussian's
// integral over what lies beyond it, seen from here, by Owen's T (Owen 1956, eq. 2.1 and 3.1; DiDonato & Hageman 1982).
// Beyond the image circle the plane is black, its rim low-passed likewise.
// The kernels of the convolution divide the Gaussian out again: it only keeps the samples free of aliases.
// Units: samples from the optical axis; coefficients in radiance units of the basis.
// The block is painted in tiles of 16 x 16 samples, of each of which the host has listed the primitives with an edge in it.
// Output planes (J, BY, BX), of which a dispatch paints up to eight, from `plane` on. Dispatch: one workgroup of 16 x 4 a tile, four samples an invocation, which
// share the loads of the primitives; tiles with edges and tiles without apart.
#include "normal"
#include "chief_ray"

override BX: u32 = 336u;       // block width, samples
override BY: u32 = 336u;       // block height, samples
override J: u32 = 3u;          // coefficient planes of the dispatch, 1 to 8
override EDGES: bool = true;   // the tiles see edges, of primitives or of the image circle
override AXIS: bool = true;     // the chief-ray map is that of a lens with an axis, see common/chief_ray
override DISTORTION: bool = true;   // the ideal and the real image differ

const DISC = 1u;               // kind of primitive; 0 is a rectangle
const SMALL_DISC = 2u;
const POLYGON = 3u;

struct Params {
    circle: vec2f,            // centre of the image circle
    origin: vec2f,            // sample (0, 0) of the block
    inverse_radius2: f32,     // of that circle
    pieces: f32,              // of the chief-ray map, see common/chief_ray
    sigma: f32,
    first: u32,               // of the dispatch's tiles
    plane: u32,               // the first
}

struct Primitive {
    centre: vec2f,
    half_size: vec2f,         // a disc has its radius in x, a small one its number of strips n in y; a polygon: its first corner, their number
    axis: vec2f,              // unit vector of the rectangle's width; of a small disc cos(pi/n), sin(pi/n)
    kind: u32,
    step: u32,                // row of `materials`: m - n
}

struct Tile {
    corner: u32,              // x + 65536 y of its first sample in the block
    first: u32,               // its primitives in `chosen`
    count: u32,
    ground: u32,              // material under them + 65536 times the planes that the block needs
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> primitives: array<Primitive>;
@group(0) @binding(2) var<storage, read> chosen: array<u32>;
@group(0) @binding(3) var<storage, read> materials: array<vec4f>;   // two a row: the dispatch's coefficients; then steps
@group(0) @binding(4) var<storage, read> tiles: array<Tile>;
@group(0) @binding(5) var<storage, read> terms: array<vec4f>;       // of the chief-ray map, see common/chief_ray
@group(0) @binding(6) var<storage, read> corners: array<vec2f>;     // of polygons, clockwise as seen, from their centres
@group(0) @binding(7) var<storage, read_write> planes: array<f32>;

// sigma along the unit vector e of the ideal plane: sigma |M^T e|
fn width_along(e: vec2f, p: IdealPoint) -> f32 {
    return params.sigma * length(e * p.jacobian);
}

fn slab(distance: f32, half_width: f32, width: f32) -> f32 {
    return normal_cdf((half_width - distance) / width) - normal_cdf((-half_width - distance) / width);
}

// Other shapes have no strips: of a branch, lavapipe runs both sides.
fn strips(shape: Primitive, d: vec2f, jacobian: mat2x2f) -> f32 {
    const ROOT_TWO_PI = 2.5066282746310002;
    let count = select(0u, u32(shape.half_size.y), shape.kind == SMALL_DISC);
    // The Gaussian's covariance on the ideal plane, sigma^2 M M^T, by the rows of sigma M.
    let along_x = params.sigma * (vec2f(1.0, 0.0) * jacobian);
    let along_y = params.sigma * (vec2f(0.0, 1.0) * jacobian);
    let width = length(along_x);
    let slope = dot(along_x, along_y) / (width * width);
    let rest = abs(along_x.x * along_y.y - along_x.y * along_y.x) / width;  // width in y at given x
    // cos and sin of t, from the middle of the first strip on.
    var t = vec2f(sqrt(0.5 - 0.5 * shape.axis.x), -sqrt(0.5 + 0.5 * shape.axis.x));
    var sum = 0.0;
    for (var k = 0u; k < count; k++) {
        let q = shape.half_size.x * t.y - d.x;
        let half_height = shape.half_size.x * t.x;
        let z = q / width;
        sum += exp(-0.5 * z * z) * half_height * slab(d.y + slope * q, half_height, rest);
        t = vec2f(t.x * shape.axis.x - t.y * shape.axis.y, t.y * shape.axis.x + t.x * shape.axis.y);
    }
    return sum * 3.1415926535897932 / (ROOT_TWO_PI * width * max(f32(count), 1.0));
}

fn slope(scale: f32, most: f32, share: f32) -> f32 {
    let x = most * share;
    let square = 1.0 + x * x;
    return exp(scale * square) / square;
}

// Owen's T(h, k / h), h and k >= 0: the share of a round Gaussian of width 1 in the part beyond h of the triangle of angle atan(k / h).
fn beyond(h: f32, k: f32) -> f32 {
    // Gauss-Legendre over the slope x from 0 to the smaller quotient, at most 1; the other by Owen's eq. 2.3.
    let large = max(max(h, k), 1e-20);
    let most = min(h, k) / large;
    let scale = -0.5 * large * large;
    let sum = 0.46791393457269104 * (slope(scale, most, 0.3806904069584015) + slope(scale, most, 0.6193095930415985))
        + 0.36076157304813866 * (slope(scale, most, 0.16939530676686776) + slope(scale, most, 0.8306046932331322))
        + 0.17132449237917036 * (slope(scale, most, 0.033765242898423986) + slope(scale, most, 0.9662347571015760));
    let near = sum * most * 0.07957747154594767;  // 1 / (4 pi)
    let past_h = normal_cdf(-h);
    let past_k = normal_cdf(-k);
    return select(near, 0.5 * (past_h + past_k) - past_h * past_k - near, k > h);
}

// Other shapes have no sides, as above.
fn sides(shape: Primitive, d: vec2f, jacobian: mat2x2f) -> f32 {
    let polygon = shape.kind == POLYGON;
    let count = select(0u, u32(shape.half_size.y), polygon);
    let first = select(0u, u32(shape.half_size.x), polygon);
    let m = params.sigma * jacobian;
    let inverse = mat2x2f(m[1].y, -m[0].y, -m[1].x, m[0].x) * (1.0 / (m[0].x * m[1].y - m[0].y * m[1].x));
    var inside = 1.0;
    var sum = 0.0;
    var a = round_place(corners[first + max(count, 1u) - 1u] - d, inverse);
    for (var k = 0u; k < count; k++) {
        let b = round_place(corners[first + k] - d, inverse);
        let e = normalize(b - a);
        // From the nearer corner: two sides that meet there see it at one and the same place.
        let near = select(b, a, dot(a, a) < dot(b, b));
        let depth = near.x * e.y - near.y * e.x;
        let start = dot(a, e);
        let end = dot(b, e);
        let part = sign(end) * beyond(abs(depth), abs(end)) - sign(start) * beyond(abs(depth), abs(start));
        sum += select(-part, part, depth >= 0.0);
        inside = select(0.0, inside, depth >= 0.0);
        a = b;
    }
    return clamp(inside - sum, 0.0, 1.0);
}

// A corner where the Gaussian is round and of width 1; never at its very middle, where a side has no direction.
fn round_place(from_sample: vec2f, inverse: mat2x2f) -> vec2f {
    let v = inverse * from_sample;
    return select(v, vec2f(1e-6, 0.0), dot(v, v) < 1e-12);
}

fn coverage(shape: Primitive, p: IdealPoint) -> f32 {
    let d = p.u - shape.centre;
    if (shape.kind == POLYGON) {
        return sides(shape, d, p.jacobian);
    }
    if (shape.kind == SMALL_DISC) {
        return strips(shape, d, p.jacobian);
    }
    if (shape.kind == DISC) {
        // At the very centre any direction does.
        let width = width_along(normalize(select(d, shape.axis, all(d == vec2f(0.0)))), p);
        return normal_cdf((shape.half_size.x - length(d)) / width - 0.5 * width / shape.half_size.x);
    }
    let across = vec2f(-shape.axis.y, shape.axis.x);
    return slab(dot(d, shape.axis), shape.half_size.x, width_along(shape.axis, p))
        * slab(dot(d, across), shape.half_size.y, width_along(across, p));
}

struct Sample {
    at: vec2u,
    x: vec2f,
    ideal: IdealPoint,
    low: vec4f,
    high: vec4f,
}

fn begin(at: vec2u, low: vec4f, high: vec4f) -> Sample {
    let x = params.origin + vec2f(at);
    return Sample(at, x, chief_ray(x), low, high);
}

fn painted(s: Sample, shape: Primitive, low: vec4f, high: vec4f) -> Sample {
    let w = coverage(shape, s.ideal);
    return Sample(s.at, s.x, s.ideal, s.low + w * low, s.high + w * high);
}

// Beyond the image circle no light arrives.
fn lit(s: Sample) -> Sample {
    let rim = inverseSqrt(params.inverse_radius2) - length(s.x - params.circle);
    let share = normal_cdf(rim / params.sigma);
    return Sample(s.at, s.x, s.ideal, share * s.low, share * s.high);
}

// `needed` of the dispatch's planes. It comes with the tile: of a branch on params alone, lavapipe compiles a new shader for each
// dispatch (4 ms).
fn keep(s: Sample, needed: u32) {
    if (s.at.x >= BX || s.at.y >= BY) {
        return;
    }
    let d = (params.plane * BY + s.at.y) * BX + s.at.x;
    if (needed > 0u) { planes[d] = s.low.x; }
    if (J > 1u && needed > 1u) { planes[d + BX * BY] = s.low.y; }
    if (J > 2u && needed > 2u) { planes[d + 2u * BX * BY] = s.low.z; }
    if (J > 3u && needed > 3u) { planes[d + 3u * BX * BY] = s.low.w; }
    if (J > 4u && needed > 4u) { planes[d + 4u * BX * BY] = s.high.x; }
    if (J > 5u && needed > 5u) { planes[d + 5u * BX * BY] = s.high.y; }
    if (J > 6u && needed > 6u) { planes[d + 6u * BX * BY] = s.high.z; }
    if (J > 7u && needed > 7u) { planes[d + 7u * BX * BY] = s.high.w; }
}

@compute @workgroup_size(16, 4, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let tile = tiles[params.first + group.x];
    let at = vec2u(tile.corner % 65536u, tile.corner / 65536u) + local.xy;
    let ground = 2u * (tile.ground % 65536u);
    let needed = max(tile.ground / 65536u, params.plane) - params.plane;
    var a = begin(at, materials[ground], materials[ground + 1u]);
    var b = begin(at + vec2u(0u, 4u), a.low, a.high);
    var c = begin(at + vec2u(0u, 8u), a.low, a.high);
    var d = begin(at + vec2u(0u, 12u), a.low, a.high);
    if (EDGES) {
        for (var i = 0u; i < tile.count; i++) {
            let shape = primitives[chosen[tile.first + i]];
            let low = materials[2u * shape.step];
            let high = materials[2u * shape.step + 1u];
            a = painted(a, shape, low, high);
            b = painted(b, shape, low, high);
            c = painted(c, shape, low, high);
            d = painted(d, shape, low, high);
        }
        a = lit(a);
        b = lit(b);
        c = lit(c);
        d = lit(d);
    }
    keep(a, needed);
    keep(b, needed);
    keep(c, needed);
    keep(d, needed);
}

// Trace real rays through the lens: where they go in f32, their optical path in double float.
//
// By Fermat's principle the path is stationary in the points where the ray meets the surfaces: points that are
// 1e-5 mm off, as those of f32 are, change it by 1e-12 mm. So only the path is summed with 48 bits,
//   path = n_0 l + sum_s n_s |P_s+1 - P_s| + n_S (R - P_S) . (alpha, beta, gamma),   l = (P_1 - E) . d
// from infinity, and from a point of the object, O = E - D d, the same as a difference in which nothing cancels:
//   l = |P_1 - O| - |E - O| = g + t^2 / D / (1 + g / D + sqrt((1 + g / D)^2 + t^2 / D^2)),
//   g = (P_1 - E) . d,   t^2 = |P_1 - E|^2 - g^2
// of points that lie on the surfaces to 48 bits: x and y of f32 and the sag that belongs to them. R is where the
// chief ray lands; W = path - path of the chief ray is Debye's OPD (gpusim/lens/wavefront.py).
// rays (R) of (p_x, p_y) [mm on the launch plane], pair, where to write the result
// -> opd: W [waves], reach: the largest (h / clear semi-diameter)^2 of the surfaces and the stop, 0 where the ray failed,
//    landing x and y [mm from the chief ray's point]
// -> directions: alpha, beta, 1 + surface where the ray failed (0: none), 0.
// Dispatch: workgroups of 64 invocations, at most 65535 across, as many rows as it takes.
#include "launch"
#include "double_float"

struct Params {
    zero: u32,
    terms: u32,
    per_unit2: f32,
    surfaces: u32,            // S
    stop: u32,                // surfaces up to the stop, itself counted
    rays: u32,                // R
    across: u32,              // workgroups in a row of the dispatch
    inverse_stop2: f32,       // of the stop's radius, 1/mm^2
}

struct Start {
    p: vec2f,
    pair: u32,
    to: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> surfaces: array<Surface>;
@group(0) @binding(2) var<storage, read> aspheres: array<vec2f>;
@group(0) @binding(3) var<storage, read> indices: array<vec2f>;
@group(0) @binding(4) var<storage, read> pairs: array<Pair>;
@group(0) @binding(5) var<storage, read> rays: array<Start>;
@group(0) @binding(6) var<storage, read_write> opd: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> directions: array<vec4f>;

// Sag at (x, y), with 48 bits; z within f32's rounding of it.
fn exact_sag(s: u32, at: vec3f) -> vec2f {
    let r2 = df_add(two_product(at.x, at.x), two_product(at.y, at.y));
    let t = r2 * params.per_unit2;  // exact: a power of two
    var sum = vec2f(0.0);
    for (var k = surfaces[s].terms; k > 0u; k--) {
        sum = df_add(df_multiply(sum, t), aspheres[s * params.terms + k - 1u]);
    }
    sum = df_multiply(sum, t);
    // One step of Newton on c (r^2 + (1 + conic) z^2) - 2 z = 0, the conic alone.
    let c = surfaces[s].curvature;
    let z = at.z - sum.x;
    let square = df_multiply(surfaces[s].bulge, two_product(z, z));
    let left = df_add(df_multiply(c, df_add(r2, square)), vec2f(-2.0 * z, 0.0));
    let conic = quick_two_sum(z, 0.5 * left.x / (1.0 - c.x * surfaces[s].bulge.x * z));
    return df_add(conic, sum);
}

// How much longer the way from a point of the object is than its part along the chief ray: see above.
fn beyond_plane(g: vec2f, t2: vec2f, vergence: vec2f) -> vec2f {
    let above = df_multiply(t2, vergence);
    let along = df_add(vec2f(1.0, 0.0), df_multiply(g, vergence));
    let below = df_add(along, df_sqrt(df_add(df_square(along), df_multiply(above, vergence))));
    let ratio = above.x / below.x;  // and one step of Newton
    let left = df_add(above, -df_multiply(vec2f(ratio, 0.0), below));
    return quick_two_sum(ratio, left.x / below.x);
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = (group.y * params.across + group.x) * 64u + local;
    if (i >= params.rays) {
        return;
    }
    let start = rays[i];
    let pair = pairs[start.pair];
    var ray = launched(pair, start.p);
    var path = vec2f(0.0);
    var sag_before: vec2f;
    var before: vec2f;
    var reach = 1e-30;            // 0 is kept for failures
    var failed = 0.0;
    for (var s = 0u; s < params.surfaces; s++) {
        let n = indices[pair.first_index + s];
        let next = bend(ray, s, n.x / indices[pair.first_index + s + 1u].x);
        if (ray.ok && !next.ok) {
            failed = f32(s + 1u);
        }
        let z = exact_sag(s, next.at);
        var leg: vec2f;
        if (s == 0u) {
            let y = df_add(vec2f(next.at.y, 0.0), -pair.start_y);
            let dz = df_add(z, -pair.start_z);
            leg = df_add(df_multiply(y, pair.sine), df_multiply(dz, pair.cosine));
            if (pair.vergence.x > 0.0) {
                let square = df_add(two_product(next.at.x, next.at.x), df_add(df_square(y), df_square(dz)));
                leg = df_add(leg, beyond_plane(leg, df_add(square, -df_square(leg)), pair.vergence));
            }
        } else {
            let dx = two_sum(next.at.x, -before.x);
            let dy = two_sum(next.at.y, -before.y);
            let dz = df_add(surfaces[s].gap, df_add(z, -sag_before));
            leg = df_sqrt(df_add(df_add(df_square(dx), df_square(dy)), df_square(dz)));
            // Beyond where surfaces cross, it goes back; rays of fisheyes may go to z < 0 all the same.
            leg = select(leg, -leg, dot(vec3f(dx.x, dy.x, dz.x), ray.along) < 0.0);
        }
        path = df_add(path, df_multiply(n, leg));
        ray = next;
        before = ray.at.xy;
        sag_before = z;
        reach = max(reach, dot(before, before) * surfaces[s].inverse_semi2);
        if (s + 1u == params.stop) {
            reach = max(reach, dot(before, before) * params.inverse_stop2);
        }
    }
    let alpha = ray.along.x;
    let beta = ray.along.y;
    let gamma = df_sqrt(df_add(vec2f(1.0, 0.0), -df_add(two_product(alpha, alpha), two_product(beta, beta))));
    let to_x = vec2f(-before.x, 0.0);
    let to_y = df_add(pair.image_y, vec2f(-before.y, 0.0));
    let to_z = df_add(pair.image_z, -sag_before);
    let across = df_add(df_multiply(to_x, vec2f(alpha, 0.0)), df_multiply(to_y, vec2f(beta, 0.0)));
    let last = df_add(across, df_multiply(to_z, gamma));
    path = df_add(path, df_multiply(indices[pair.first_index + params.surfaces], last));
    let w = df_add(path, -pair.chief_path);
    let far = to_z.x / gamma.x;
    if (failed == 0.0 && ray.along.z <= 0.0) {
        failed = f32(params.surfaces);  // it does not go to the image
    }
    if (failed > 0.0) {
        opd[start.to] = vec4f(0.0);
        directions[start.to] = vec4f(0.0, 0.0, failed, 0.0);
        return;
    }
    opd[start.to] = vec4f(w.x * pair.waves_per_mm, reach, far * alpha - to_x.x, far * beta - to_y.x);
    directions[start.to] = vec4f(alpha, beta, 0.0, 0.0);
}

// Aim real rays at points of the stop surface, by Newton's method in f32, one invocation a ray.
//
//   p <- p - J^-1 (stop(p) - wanted),   J by differences of 1e-3 of the stop's radius
// A ray that does not arrive is drawn half-way to the chief ray, p = 0.
// wanted (R) [mm] -> aimed (P R) of (p_x, p_y) [mm on the launch plane], miss [of the stop's radius; -1: not found], 0.
// Dispatch: (ceil(R/64), P, 1) workgroups, P pairs of field and wavelength.
#include "launch"

override TURNS: u32 = 12u;    // a start within the beam takes 3 to 5

struct Params {
    terms: u32,
    per_unit2: f32,
    stop: u32,                // surfaces up to the stop, itself counted
    rays: u32,                // R
    radius: f32,              // of the stop, mm
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> surfaces: array<Surface>;
@group(0) @binding(2) var<storage, read> aspheres: array<vec2f>;
@group(0) @binding(3) var<storage, read> indices: array<vec2f>;
@group(0) @binding(4) var<storage, read> pairs: array<Pair>;
@group(0) @binding(5) var<storage, read> wanted: array<vec2f>;
@group(0) @binding(6) var<storage, read_write> aimed: array<vec4f>;

const GOOD = 2e-5;            // of the stop's radius: 100 roundings of the ray's way

// Where the ray meets the stop; z is 1 where it does, else 0.
fn at_stop(pair: Pair, p: vec2f) -> vec3f {
    var ray = launched(pair, p);
    for (var s = 0u; s < params.stop; s++) {
        let n = pair.first_index + s;
        ray = bend(ray, s, indices[n].x / indices[n + 1u].x);
    }
    return vec3f(ray.at.xy, select(0.0, 1.0, ray.ok));
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.rays) {
        return;
    }
    let pair = pairs[id.y];
    let goal = wanted[id.x];
    let step = 1e-3 * params.radius;
    var p = goal.x * pair.aim.xy + goal.y * pair.aim.zw;
    var best = vec3f(p, 1.0);
    for (var turn = 0u; turn < TURNS; turn++) {
        let here = at_stop(pair, p);
        let right = at_stop(pair, p + vec2f(step, 0.0));
        let up = at_stop(pair, p + vec2f(0.0, step));
        let miss = here.xy - goal;
        let far = length(miss) / params.radius;
        if (here.z > 0.0 && far < best.z) {
            best = vec3f(p, far);
        }
        if (here.z > 0.0 && far < 0.1 * GOOD) {
            break;
        }
        let a = (right.xy - here.xy) / step;
        let b = (up.xy - here.xy) / step;
        let det = a.x * b.y - a.y * b.x;
        let usable = here.z * right.z * up.z > 0.0 && det > 1e-6;  // the stop is not mirrored
        let shift = vec2f(b.y * miss.x - b.x * miss.y, a.x * miss.y - a.y * miss.x) / det;
        p = select(0.5 * p, p - shift, usable);
    }
    aimed[id.y * params.rays + id.x] = vec4f(best.xy, select(-1.0, best.z, best.z < GOOD), 0.0);
}

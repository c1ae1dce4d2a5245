// The wavefront at the nodes of a grid in direction cosines, from rays that leave the lens close to them.
// A ray lands where W falls off: dW/d(alpha, beta) = -landing, so that to first order
//   W(node) = W(ray) + landing . (direction of the ray - node) / lambda
// What is left, half the second derivative times the square of the difference, is below 1e-6 waves for 1e-4. A ray
// that leaves more than half a step off its node says nothing of it.
// opd, directions (P, NA, NB): see trace -> nodes (P, NA, NB): W [waves], reach [0: no ray].
// Dispatch: (ceil(NB/64), NA, P) workgroups.
#include "grid"

struct Params {
    na: u32,
    nb: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grids: array<Grid>;
@group(0) @binding(2) var<storage, read> opd: array<vec4f>;
@group(0) @binding(3) var<storage, read> directions: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> nodes: array<vec2f>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.nb) {
        return;
    }
    let grid = grids[id.z];
    let node = grid.first + vec2f(id.yx) * grid.step;
    let i = (id.z * params.na + id.y) * params.nb + id.x;
    let miss = directions[i].xy - node;
    let reach = select(0.0, opd[i].y, all(abs(miss) < 0.5 * grid.step));
    nodes[i] = vec2f(opd[i].x + dot(opd[i].zw, miss) * grid.waves_per_mm, reach);
}

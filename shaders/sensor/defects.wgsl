// Defects: pixels of a list, changed in place:
//   plane[at] = min(keep plane[at] + add, limit)
// Mean electrons, before the noise: a dead pixel keeps no light (keep 0, add its dark signal), a hot one has
// dark current of its own (keep 1). After read-out a stuck pixel gives the same number always (keep 0).
// Units: electrons. at: place in the plane (rows, cols), row by row, each once.
// In: at, keep, add (count). In and out: plane.
// Dispatch: ceil(count/64) workgroups of 64, one pixel of the list each.

struct Params {
    count: u32,
    limit_e: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> at: array<u32>;
@group(0) @binding(2) var<storage, read> keep: array<f32>;
@group(0) @binding(3) var<storage, read> add: array<f32>;
@group(0) @binding(4) var<storage, read_write> plane: array<f32>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.count) {
        return;
    }
    let place = at[id.x];
    plane[place] = min(keep[id.x] * plane[place] + add[id.x], params.limit_e);
}

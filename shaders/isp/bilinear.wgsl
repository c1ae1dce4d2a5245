// Demosaicing of any filter array: each colour at a pixel is the mean of its sites around, weighted by a tent.
//   weight = (REACH - |rows away|)(REACH - |columns away|);   a site keeps the value of its own colour
// For a 2 x 2 pattern and REACH 2 that is bilinear interpolation. Sites outside the frame do not count; where that leaves a
// colour without any, at the rim, its tent has FAR in place of REACH.
// One dispatch does up to four colours, more take several.
// Units: light relative to saturation. In: light (rows, cols), of which the frame is the rectangle from first to before
// last; own (PY, PX): of each site of the pattern a 1 for its colour and 0 for the others. Out: planes (colours, rows,
// cols), COLOURS of them from begin on; pixels outside the frame are not written.
// Dispatch: ceil(cols/16) x ceil(rows/16) workgroups of 16 x 16, one pixel each.

override PY: u32;                       // rows and columns of the filter pattern
override PX: u32;
override REACH: i32;
override FAR: i32;
override COLOURS: u32;                  // of this dispatch, up to 4

struct Params {
    rows: u32,
    cols: u32,
    first: vec2i,        // row and column of the frame's first pixel
    last: vec2i,         // and behind its last one
    begin: u32,          // first of the planes that are written
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> light: array<f32>;
@group(0) @binding(2) var<storage, read> own: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> planes: array<f32>;

struct Found {
    sums: vec4f,
    weights: vec4f,
}

// This function depends on the following global declarations: params, light, own.
fn gathered(row: i32, col: i32, reach: i32) -> Found {
    var found = Found(vec4f(0.0), vec4f(0.0));
    for (var y = max(row - reach + 1, params.first.x); y < min(row + reach, params.last.x); y++) {
        let site = u32(y) % PY * PX;
        let across = f32(reach - abs(y - row));
        for (var x = max(col - reach + 1, params.first.y); x < min(col + reach, params.last.y); x++) {
            let weight = across * f32(reach - abs(x - col)) * own[site + u32(x) % PX];
            found.sums += weight * light[u32(y) * params.cols + u32(x)];
            found.weights += weight;
        }
    }
    return found;
}

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let row = i32(id.y);
    let col = i32(id.x);
    if (row < params.first.x || row >= params.last.x || col < params.first.y || col >= params.last.y) {
        return;
    }
    let near = gathered(row, col, REACH);
    let lacks = (near.weights == vec4f(0.0)) & (vec4u(0u, 1u, 2u, 3u) < vec4u(COLOURS));
    var mean = near.sums / max(near.weights, vec4f(1e-6));
    if (any(lacks)) {
        // A frame smaller than the pattern may lack a colour: it is black there.
        let beyond = gathered(row, col, FAR);
        mean = select(mean, beyond.sums / max(beyond.weights, vec4f(1e-6)), lacks);
    }
    let at = id.y * params.cols + id.x;
    let here = own[id.y % PY * PX + id.x % PX];
    let found = select(mean, vec4f(light[at]), here > vec4f(0.5));
    for (var colour = 0u; colour < COLOURS; colour++) {
        planes[(params.begin + colour) * params.rows * params.cols + at] = found[colour];
    }
}

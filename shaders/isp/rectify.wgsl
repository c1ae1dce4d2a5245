// Distortion and lateral colour undone: each pixel of the picture is taken from where its light fell, for each plane.
//   d = (x - cx, y - cy) / m;   s = d . d;   source = c + m (d (k0 + k1 s + k2 s^2 + k3 s^3) + t)
//   t = (2 t0 dx dy + t1 (s + 2 dx^2), 2 t1 dx dy + t0 (s + 2 dy^2))      (DNG specification 1.4, chapter 7, WarpRectilinear)
// m: from the axis to the farthest corner of the frame. Between samples: cubic convolution of 4 x 4, a = -1/2 (Keys 1981).
// Samples beyond the frame are as its rim; a pixel whose source lies more than half a pixel beyond it is black.
// Units: light, 1 is white; places in pixels, their middles at whole numbers. In: planes (COLOURS, rows, cols), rows first on
// of the frame, its columns from left on; maps (COLOURS, 2): k of each plane, and its t and zeros. Out: rectified (COLOURS,
// made, cols), rows from begin on; columns as those of planes.
// Dispatch: ceil(cols/16) x ceil(made/16) workgroups of 16 x 16, one pixel each.

override COLOURS: u32;

struct Params {
    rows: u32,           // of planes
    cols: u32,
    made: u32,           // rows of rectified
    first: f32,          // row of the frame, of the first one of planes
    left: f32,           // column of the frame, of the first one of planes and rectified
    begin: f32,          // row of the frame, of the first one of rectified
    axis: vec2f,         // x, y in the frame
    frame: vec2f,        // columns and rows
    unit: f32,           // m
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> planes: array<f32>;
@group(0) @binding(2) var<storage, read> maps: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> rectified: array<f32>;

fn weights(t: f32) -> vec4f {
    let t2 = t * t;
    let t3 = t2 * t;
    return vec4f(-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2);
}

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.cols || id.y >= params.made) {
        return;
    }
    let d = (vec2f(f32(id.x) + params.left, f32(id.y) + params.begin) - params.axis) / params.unit;
    let s = dot(d, d);
    for (var colour = 0u; colour < COLOURS; colour++) {
        let k = maps[2u * colour];
        let t = maps[2u * colour + 1u];
        let across = 2.0 * d.x * d.y;
        let bent = vec2f(t.x * across + t.y * (s + 2.0 * d.x * d.x), t.y * across + t.x * (s + 2.0 * d.y * d.y));
        let at = params.axis + params.unit * (d * (k.x + s * (k.y + s * (k.z + s * k.w))) + bent);
        let out = (colour * params.made + id.y) * params.cols + id.x;
        let off = abs(at - 0.5 * (params.frame - 1.0));
        if (any(off > 0.5 * params.frame)) {
            rectified[out] = 0.0;
            continue;
        }
        let whole = floor(at);
        let x = weights(at.x - whole.x);
        let y = weights(at.y - whole.y);
        var sum = 0.0;
        for (var down = 0; down < 4; down++) {
            // The frame's rim first, then what planes have of it.
            let row = clamp(whole.y + f32(down - 1), 0.0, params.frame.y - 1.0) - params.first;
            let line = (colour * params.rows + u32(clamp(row, 0.0, f32(params.rows - 1u)))) * params.cols;
            var along = 0.0;
            for (var right = 0; right < 4; right++) {
                let col = clamp(whole.x + f32(right - 1), 0.0, params.frame.x - 1.0) - params.left;
                along += x[right] * planes[line + u32(clamp(col, 0.0, f32(params.cols - 1u)))];
            }
            sum += y[down] * along;
        }
        rectified[out] = sum;
    }
}

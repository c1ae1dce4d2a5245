// Guided demosaicing of any filter array, second of four stages: its most frequent colour at every pixel, of which the other
// colours differ by little that is fine.
//   d = light - mean,   difference = (1 - SHARE) d + SHARE <d>,   guide = light - difference
// Mean is that of the guiding colour by the tent of `bilinear`, <d> that of the pixel's own colour around it, without it,
// weighted by (3 - |rows away|)(3 - |columns away|). What d has of its own is fine detail that the tent lost (as in Malvar, He
// and Cutler 2004, for Bayer arrays). At sites of the guiding colour mean is light, and so is the guide. Sites outside the
// frame do not count; where that leaves none, difference is d.
// Of SHARE from 0.5 to 0.8 and reaches of 3 to 6 pixels these are best on the photographs of tests/isp/photographs.py, for
// X-Trans and RGBW alike.
// Units: light relative to saturation. In: light, means (rows, cols), of which the frame is the rectangle from first to before
// last; near (PY, PX, COUNT): of each site of the pattern those around of its colour, rows and columns away and weight; 0, 0, 0
// of those that are fewer, and of the guiding colour, which has no difference. Out: guide, differences (rows, cols); pixels
// outside the frame are not written.
// Dispatch: ceil(cols/16) x ceil(rows/16) workgroups of 16 x 16, one pixel each.

override PY: u32;                       // rows and columns of the filter pattern
override PX: u32;
override COUNT: u32;

const SHARE = 0.7;

struct Params {
    rows: u32,
    cols: u32,
    first: vec2i,        // row and column of the frame's first pixel
    last: vec2i,         // and behind its last one
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> light: array<f32>;
@group(0) @binding(2) var<storage, read> means: array<f32>;
@group(0) @binding(3) var<storage, read> near: array<vec4i>;
@group(0) @binding(4) var<storage, read_write> guide: array<f32>;
@group(0) @binding(5) var<storage, read_write> differences: array<f32>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let row = i32(id.y);
    let col = i32(id.x);
    if (row < params.first.x || row >= params.last.x || col < params.first.y || col >= params.last.y) {
        return;
    }
    let site = (id.y % PY * PX + id.x % PX) * COUNT;
    var sum = 0.0;
    var weights = 0.0;
    for (var n = 0u; n < COUNT; n++) {
        let away = near[site + n];
        let place = vec2i(row, col) + away.xy;
        if (all(place >= params.first) && all(place < params.last)) {
            let there = u32(place.x) * params.cols + u32(place.y);
            sum += f32(away.z) * (light[there] - means[there]);
            weights += f32(away.z);
        }
    }
    let at = id.y * params.cols + id.x;
    var difference = light[at] - means[at];
    if (weights > 0.0) {
        difference = (1.0 - SHARE) * difference + SHARE * sum / weights;
    }
    guide[at] = light[at] - difference;
    differences[at] = difference;
}

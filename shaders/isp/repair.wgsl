// Defect correction: a pixel that stands out from all eight of its colour around it gets the mean of the two opposite
// ones that differ least.
//   out of line: v > max + t or v < min - t,   t = sigmas sqrt(max(slope m + floor, 0)),   m the mean of the eight
// slope, floor: the variance of noise at light m, as DNG's NoiseProfile gives it.
// Units: light relative to saturation. In: light (rows, cols). Out: repaired (rows, cols); pixels less than STEP from
// the rim are not written.
// Dispatch: ceil((cols - 2 STEP)/16) x ceil((rows - 2 STEP)/16) workgroups of 16 x 16, one pixel each.

override STEP: u32;                     // pixels between sites of one colour: 2 of a Bayer array, 1 without filters

struct Params {
    rows: u32,
    cols: u32,
    sigmas: f32,
    slope: f32,
    floor: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> light: array<f32>;
@group(0) @binding(2) var<storage, read_write> repaired: array<f32>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x + 2u * STEP >= params.cols || id.y + 2u * STEP >= params.rows) {
        return;
    }
    let at = (id.y + STEP) * params.cols + id.x + STEP;
    let down = STEP * params.cols;
    let before = vec4f(light[at - STEP], light[at - down], light[at - down - STEP], light[at - down + STEP]);
    let behind = vec4f(light[at + STEP], light[at + down], light[at + down + STEP], light[at + down - STEP]);
    let most = max(before, behind);
    let least = min(before, behind);
    let high = max(max(most.x, most.y), max(most.z, most.w));
    let low = min(min(least.x, least.y), min(least.z, least.w));
    let mean = dot(before + behind, vec4f(0.125));
    let margin = params.sigmas * sqrt(max(params.slope * mean + params.floor, 0.0));
    let value = light[at];
    var found = value;
    if (value > high + margin || value < low - margin) {
        var step = most - least;
        var middle = 0.5 * (before + behind);
        let first = select(middle.x, middle.y, step.y < step.x);
        let second = select(middle.z, middle.w, step.w < step.z);
        found = select(first, second, min(step.z, step.w) < min(step.x, step.y));
    }
    repaired[at] = found;
}

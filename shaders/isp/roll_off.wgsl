// Exposure: light shown brighter or darker, with white kept.
//   brighter, slope s >= 1:  y = s x up to the knee k; above, y = k + d / (1 + d (1/(1 - k) - 1/(s - k))), d = s x - k,
//                            which goes on with the same slope and has white, x = 1, at 1; no more than 1
//   darker, s < 1:           y = s x up to 1/4; above, a parabola of the same slope there to white at 1
//                            (Adobe's DNG SDK 1.4, dng_function_exposure_tone)
// A knee of 1 clips. What is below 0 is scaled.
// Units: light, 1 is white. In and out: light (fours of samples).
// Dispatch: ceil(fours/64) workgroups of 64, up to 65535 along x and the rest along y, four samples each.

override DARKER: bool = false;

struct Params {
    fours: u32,
    wide: u32,           // invocations along x
    slope: f32,
    knee: f32,           // up to 1
    bend: f32,           // 1/(1 - k) - 1/(s - k); 0 where nothing is above the knee or it clips
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> light: array<vec4f>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let at = id.y * params.wide + id.x;
    if (at >= params.fours) {
        return;
    }
    let x = light[at];
    let straight = params.slope * x;
    if (DARKER) {
        let a = 16.0 / 9.0 * (1.0 - params.slope);
        let b = params.slope - 0.5 * a;
        light[at] = select((a * x + b) * x + (1.0 - a - b), straight, x <= vec4f(0.25));
        return;
    }
    let above = max(straight - params.knee, vec4f(0.0));
    light[at] = min(min(straight, vec4f(params.knee)) + above / (1.0 + params.bend * above), vec4f(1.0));
}

// Exposure: the mean number of electrons that each pixel has collected when it is read (EMVA 1288 R3.1, sections 2.1, 3 and 4.1):
//   mean = min(max(0, t (1 + PRNU z) rate) + dark, limit),   dark = t mu_I,   z ~ N(0, 1), the same in every frame
// Photo response non-uniformity thus comes before the shot noise. dark is the dark current at the sensor's temperature
// times the exposure time; the host works it out. z is keyed by the sensor's serial number and the pixel; without PRNU
// it is not drawn. limit is the full well where no noise stage follows, which clips after the shot noise.
// Units: rate electrons per second, exposure_s seconds, dark_e and mean electrons, prnu a fraction of the signal.
// In: rate (rows, cols). Out: mean (rows, cols): the rectangle of pixels from (row0, col0).
// Dispatch: ceil((col0 mod 4 + cols)/128) x ceil(rows/2) workgroups of 32 x 2, four neighbouring pixels each,
// which share a call of the generator. Lavapipe, 2 cores: 270 MP/s.
#include "philox"
#include "gaussian"

override PRNU: bool = true;   // the pixels respond unlike

struct Params {
    serial: vec2u,   // serial number, low and high word
    row0: u32,
    col0: u32,
    rows: u32,
    cols: u32,
    exposure_s: f32,
    prnu: f32,
    dark_e: f32,
    limit_e: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rate: array<f32>;
@group(0) @binding(2) var<storage, read_write> mean: array<f32>;

// Reads rate: the value of a pixel of the quad, or of the nearest inside the rectangle.
fn pixel(row: u32, col: i32) -> f32 {
    return rate[row * params.cols + u32(clamp(col, 0, i32(params.cols) - 1))];
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.y >= params.rows) {
        return;
    }
    let quad = params.col0 / 4u + id.x;
    let first = i32(4u * quad) - i32(params.col0);
    let light = vec4f(pixel(id.y, first), pixel(id.y, first + 1), pixel(id.y, first + 2), pixel(id.y, first + 3));
    var gain = vec4f(params.exposure_s);
    if (PRNU) {
        let words = philox(vec4u(quad, params.row0 + id.y, 0u, PURPOSE_PRNU), params.serial);
        gain *= 1.0 + params.prnu * gaussian(words);
    }
    let signal = min(max(gain * light, vec4f(0.0)) + params.dark_e, vec4f(params.limit_e));
    for (var i = 0; i < 4; i++) {
        let col = first + i;
        if (col >= 0 && col < i32(params.cols)) {
            mean[id.y * params.cols + u32(col)] = signal[i];
        }
    }
}

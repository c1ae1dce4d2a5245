// Noise: the charge that is read from each pixel (EMVA 1288 R3.1, section 2.2):
//   electrons = min(Poisson(mean), full_well) + DSNU z_1 + sigma_d z_2,   z_1, z_2 ~ N(0, 1)
// The Poisson number holds photon and dark shot noise together. The dark signal non-uniformity z_1 is an offset of
// the read-out, without shot noise, keyed by the sensor's serial number, the same in every frame; z_2 is the temporal
// dark noise. The rest is keyed by seed and frame. The charge may be negative after read-out. What is zero is not drawn.
// Where charge moves in between, the stage is dispatched twice: without read-out (DSNU, READ_NOISE off) the charge that
// each photosite collected, min(Poisson(mean), full_well); without SHOT the charge that arrives, in mean, is read.
// Units: electrons, in and out.
// In: mean (rows, cols). Out: electrons (rows, cols): the rectangle of pixels from (row0, col0).
// Dispatch: ceil((col0 mod 4 + cols)/128) x ceil(rows/2) workgroups of 32 x 2, four neighbouring pixels each,
// which share calls of the generator. Lavapipe, 2 cores, of the processors' time: 114 MP/s at means of 1000, 73 at 9.9,
// 87 where means from 0.01 to 10 000 lie side by side; the shot noise alone takes 0.6 of it.
#include "philox"
#include "gaussian"
#include "poisson"

override SHOT: bool = true;         // shot noise, full well
override DSNU: bool = true;         // the pixels' offsets differ
override READ_NOISE: bool = true;   // there is temporal dark noise

const MEAN_LIMIT = 1.6e7;   // e-; the count must fit i32; the largest full well, 1e7, lies 1500 sigmas below

struct Params {
    seed: vec2u,     // low and high word
    serial: vec2u,
    frame: u32,
    row0: u32,
    col0: u32,
    rows: u32,
    cols: u32,
    full_well_e: f32,
    temporal_dark_noise_e: f32,
    dsnu_e: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> mean: array<f32>;
@group(0) @binding(2) var<storage, read_write> electrons: array<f32>;

// Reads mean: the value of a pixel of the quad, or of the nearest inside the rectangle.
fn pixel(row: u32, col: i32) -> f32 {
    return mean[row * params.cols + u32(clamp(col, 0, i32(params.cols) - 1))];
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.y >= params.rows) {
        return;
    }
    let row = params.row0 + id.y;
    let quad = params.col0 / 4u + id.x;
    let first = i32(4u * quad) - i32(params.col0);
    var charge = vec4f(pixel(id.y, first), pixel(id.y, first + 1), pixel(id.y, first + 2), pixel(id.y, first + 3));
    if (SHOT) {
        let counter = vec4u(quad, row, params.frame, PURPOSE_SHOT);
        let count = poisson(min(charge, vec4f(MEAN_LIMIT)), counter, params.seed);
        charge = min(vec4f(count), vec4f(params.full_well_e));
    }
    if (DSNU) {
        charge += params.dsnu_e * gaussian(philox(vec4u(quad, row, 0u, PURPOSE_DSNU), params.serial));
    }
    if (READ_NOISE) {
        let words = philox(vec4u(quad, row, params.frame, PURPOSE_READ), params.seed);
        charge += params.temporal_dark_noise_e * gaussian(words);
    }
    for (var i = 0; i < 4; i++) {
        let col = first + i;
        if (col >= 0 && col < i32(params.cols)) {
            electrons[id.y * params.cols + u32(col)] = charge[i];
        }
    }
}

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
// which share calls of the generator. Lavapipe, 2 cores: 38 to 58 MP/s, least at means of 5 to 10; workgroups of 8 x 1 to
// 16 x 16 run alike (54 to 59 MP/s at a mean of 1000), so does the generator unrolled.
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

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.y >= params.rows) {
        return;
    }
    let row = params.row0 + id.y;
    let quad = params.col0 / 4u + id.x;
    var dark_words = vec4u(0u);
    if (READ_NOISE) {
        dark_words = philox(vec4u(quad, row, params.frame, PURPOSE_READ), params.seed);
    }
    var dsnu_words = vec4u(0u);
    if (DSNU) {
        dsnu_words = philox(vec4u(quad, row, 0u, PURPOSE_DSNU), params.serial);
    }
    for (var i = 0u; i < 4u; i++) {
        let col = 4u * quad + i;
        let out_col = col - params.col0;   // wraps to a huge number left of the rectangle
        if (out_col < params.cols) {
            let at = id.y * params.cols + out_col;
            var charge = mean[at];
            if (SHOT) {
                let counter = vec4u(col, row, params.frame, PURPOSE_SHOT);
                charge = min(f32(poisson(min(charge, MEAN_LIMIT), counter, params.seed)), params.full_well_e);
            }
            if (DSNU) {
                charge += params.dsnu_e * gaussian(dsnu_words[i]);
            }
            if (READ_NOISE) {
                charge += params.temporal_dark_noise_e * gaussian(dark_words[i]);
            }
            electrons[at] = charge;
        }
    }
}

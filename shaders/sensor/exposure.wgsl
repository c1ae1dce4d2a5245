// Exposure: the mean number of electrons that each pixel has collected when it is read (EMVA 1288 R3.1, sections 2.1, 3, 4.1;
// rows and columns apart as in R4.0, section 8):
//   mean = min(max(0, t mask (1 + PRNU z + PRNU_row z_row + PRNU_col z_col) rate) + t mu_I d, limit),   z ~ N(0, 1)
//   d = exp(s z_d - s^2 / 2), s^2 = log(1 + DCNU^2): a dark current of mean mu_I and standard deviation DCNU mu_I, never
//   negative, log-normal for the few warm pixels that every sensor has
// All z are the same in every frame, keyed by the sensor's serial number and the pixel, row or column; what is zero is
// not drawn. Response thus comes before the shot noise. mask is a camera's multiplicative mask (Short, Williams & Jones
// 1999, section 2.2). mu_I is the dark current at the sensor's temperature; the host works it out. limit is the full
// well where no noise stage follows, which clips after the shot noise.
// Units: rate electrons per second, exposure_s seconds, dark_e = t mu_I and mean electrons, PRNU fractions of the signal.
// In: rate (rows, cols), mask (rows, cols), which is not read without MASK. Out: mean (rows, cols): the rectangle of
// pixels from (row0, col0).
// Dispatch: ceil((col0 mod 4 + cols)/128) x ceil(rows/2) workgroups of 32 x 2, four neighbouring pixels each,
// which share a call of the generator. Lavapipe, 2 cores: 270 MP/s with PRNU alone.
#include "deviates"

override PRNU: bool = true;         // the pixels respond unlike
override PRNU_LINES: bool = true;   // so do rows and columns
override DCNU: bool = true;         // the pixels' dark currents differ
override MASK: bool = true;         // there is a multiplicative mask

struct Params {
    serial: vec2u,   // serial number, low and high word
    row0: u32,
    col0: u32,
    rows: u32,
    cols: u32,
    exposure_s: f32,
    prnu: f32,
    prnu_row: f32,
    prnu_column: f32,
    dark_e: f32,
    log_dcnu: f32,   // s
    limit_e: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> rate: array<f32>;
@group(0) @binding(2) var<storage, read> mask: array<f32>;
@group(0) @binding(3) var<storage, read_write> mean: array<f32>;

// The place of a pixel of the quad, or of the nearest inside the rectangle.
fn place(row: u32, col: i32) -> u32 {
    return row * params.cols + u32(clamp(col, 0, i32(params.cols) - 1));
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.y >= params.rows) {
        return;
    }
    let row = params.row0 + id.y;
    let quad = params.col0 / 4u + id.x;
    let first = i32(4u * quad) - i32(params.col0);
    let at = vec4u(place(id.y, first), place(id.y, first + 1), place(id.y, first + 2), place(id.y, first + 3));
    var light = vec4f(rate[at.x], rate[at.y], rate[at.z], rate[at.w]);
    if (MASK) {
        light *= vec4f(mask[at.x], mask[at.y], mask[at.z], mask[at.w]);
    }
    var response = vec4f(1.0);
    if (PRNU) {
        response += params.prnu * of_pixels(quad, row, 0u, PURPOSE_PRNU, params.serial);
    }
    if (PRNU_LINES) {
        response += params.prnu_row * of_row(row, 0u, PURPOSE_PRNU_ROW, params.serial);
        response += params.prnu_column * of_columns(quad, 0u, PURPOSE_PRNU_COLUMN, params.serial);
    }
    var dark = vec4f(params.dark_e);
    if (DCNU) {
        let z = of_pixels(quad, row, 0u, PURPOSE_DARK_CURRENT, params.serial);
        dark *= exp(params.log_dcnu * (z - 0.5 * params.log_dcnu));
    }
    let signal = min(max(params.exposure_s * response * light, vec4f(0.0)) + dark, vec4f(params.limit_e));
    for (var i = 0; i < 4; i++) {
        let col = first + i;
        if (col >= 0 && col < i32(params.cols)) {
            mean[id.y * params.cols + u32(col)] = signal[i];
        }
    }
}

// Noise: the charge that each pixel collects, and what is added when it is read (EMVA 1288 R3.1, section 2.2; rows and
// columns apart as in R4.0, section 8), in this order:
//   SHOT       n = Poisson(mean), photon and dark shot noise together; GAUSSIAN in its place: n = mean + z sqrt(a + b mean),
//              a camera's two-number temporal noise (Short, Williams & Jones 1999, section 2.2), with the read noise in it
//   SOFT_SATURATION  above the knee k: k + (w - k) (1 - exp(-(n - k) / (w - k))), w the full well: continuous in slope,
//              rising
//              n = min(n, w)
//   read-out   + DSNU z + DSNU_row z_row + DSNU_col z_col + mask                the same in every frame
//              + reset z + read q(z) + row_noise z_row + column_noise z_col    new in every frame
// Each z ~ N(0, 1) has a purpose of its own; what belongs to the sensor is keyed by its serial number, the rest by seed
// and frame. q(z) = z, or with READ_TABLE a measured law: z between the quantiles of the normal law that a table
// of QUANTILES values from -REACH to REACH lists. The charge may be negative after read-out. What is zero is not drawn.
// Where charge moves in between, the stage is dispatched twice: without any read-out the charge that each photosite
// collected; without SHOT the charge that arrives, in mean, is read.
// Units: electrons, in and out; a in e-^2, b in e-.
// In: mean and mask (rows, cols), quantiles; mask and quantiles are not read without MASK and READ_TABLE. Out: electrons
// (rows, cols): the rectangle of pixels from (row0, col0).
// Dispatch: ceil((col0 mod 4 + cols)/128) x ceil(rows/2) workgroups of 32 x 2, four neighbouring pixels each,
// which share calls of the generator. Lavapipe, 2 cores, of the processors' time, with shot noise, DSNU and read noise:
// 114 MP/s at means of 1000, 73 at 9.9, 87 where means from 0.01 to 10 000 lie side by side; the shot noise alone
// takes 0.6 of it.
#include "deviates"
#include "poisson"

override SHOT: bool = true;         // shot noise, full well
override GAUSSIAN: bool = false;    // temporal noise by two numbers in place of Poisson's law
override SOFT_SATURATION: bool = false; // the full well saturates softly
override DSNU: bool = true;         // the pixels' offsets differ
override DSNU_LINES: bool = true;   // so do those of rows and columns
override MASK: bool = true;         // there is an additive mask
override RESET: bool = true;        // there is reset noise
override READ_NOISE: bool = true;   // there is temporal dark noise
override READ_TABLE: bool = false;  // not of a normal law
override LINES: bool = true;        // there is temporal noise of rows and columns

const MEAN_LIMIT = 1.6e7;   // e-; the count must fit i32; the largest full well, 1e7, lies 1500 sigmas below
const QUANTILES = 1025;
const REACH = 6.5;          // sigmas: the smallest word lies at 6.34

struct Params {
    seed: vec2u,     // low and high word
    serial: vec2u,
    frame: u32,
    row0: u32,
    col0: u32,
    rows: u32,
    cols: u32,
    full_well_e: f32,
    knee_e: f32,
    temporal_dark_noise_e: f32,
    variance_per_e: f32,
    reset_noise_e: f32,
    row_noise_e: f32,
    column_noise_e: f32,
    dsnu_e: f32,
    dsnu_row_e: f32,
    dsnu_column_e: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> mean: array<f32>;
@group(0) @binding(2) var<storage, read> mask: array<f32>;
@group(0) @binding(3) var<storage, read> quantiles: array<f32>;
@group(0) @binding(4) var<storage, read_write> electrons: array<f32>;

// The place of a pixel of the quad, or of the nearest inside the rectangle.
fn place(row: u32, col: i32) -> u32 {
    return row * params.cols + u32(clamp(col, 0, i32(params.cols) - 1));
}

// Reads quantiles: the measured law's value at z sigmas of the normal law, of which a deviate has less than REACH.
fn measured(z: f32) -> f32 {
    let at = (z + REACH) * (f32(QUANTILES - 1) / (2.0 * REACH));
    let cell = i32(at);
    return mix(quantiles[cell], quantiles[cell + 1], at - f32(cell));
}

// Reads params: what photosites hold of the charge that they collect.
fn held(charge: vec4f) -> vec4f {
    var softened = charge;
    if (SOFT_SATURATION) {
        let room = params.full_well_e - params.knee_e;
        let above = max(charge - params.knee_e, vec4f(0.0));
        softened = min(charge, vec4f(params.knee_e)) + room * (1.0 - exp(-above / room));
    }
    return min(softened, vec4f(params.full_well_e));
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
    var charge = vec4f(mean[at.x], mean[at.y], mean[at.z], mean[at.w]);
    if (SHOT) {
        charge = min(charge, vec4f(MEAN_LIMIT));
        if (GAUSSIAN) {
            let dark = params.temporal_dark_noise_e * params.temporal_dark_noise_e;
            let z = of_pixels(quad, row, params.frame, PURPOSE_SHOT, params.seed);
            charge += sqrt(dark + params.variance_per_e * charge) * z;
        } else {
            charge = vec4f(poisson(charge, vec4u(quad, row, params.frame, PURPOSE_SHOT), params.seed));
        }
        charge = held(charge);
    }
    if (DSNU) {
        charge += params.dsnu_e * of_pixels(quad, row, 0u, PURPOSE_DSNU, params.serial);
    }
    if (DSNU_LINES) {
        charge += params.dsnu_row_e * of_row(row, 0u, PURPOSE_DSNU_ROW, params.serial);
        charge += params.dsnu_column_e * of_columns(quad, 0u, PURPOSE_DSNU_COLUMN, params.serial);
    }
    if (MASK) {
        charge += vec4f(mask[at.x], mask[at.y], mask[at.z], mask[at.w]);
    }
    if (RESET) {
        charge += params.reset_noise_e * of_pixels(quad, row, params.frame, PURPOSE_RESET, params.seed);
    }
    if (READ_NOISE) {
        var z = of_pixels(quad, row, params.frame, PURPOSE_READ, params.seed);
        if (READ_TABLE) {
            z = vec4f(measured(z.x), measured(z.y), measured(z.z), measured(z.w));
        }
        charge += params.temporal_dark_noise_e * z;
    }
    if (LINES) {
        charge += params.row_noise_e * of_row(row, params.frame, PURPOSE_ROW_NOISE, params.seed);
        charge += params.column_noise_e * of_columns(quad, params.frame, PURPOSE_COLUMN_NOISE, params.seed);
    }
    for (var i = 0; i < 4; i++) {
        let col = first + i;
        if (col >= 0 && col < i32(params.cols)) {
            electrons[id.y * params.cols + u32(col)] = charge[i];
        }
    }
}

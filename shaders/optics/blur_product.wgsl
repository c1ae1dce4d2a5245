// Second of three steps that blur an image with a space-variant PSF, for one column frequency kx of one column of blocks,
// block after block downwards: forward transform in y with the weights of the upper and lower PSF nodes, product with the PSFs
// of the four nodes, inverse in y; what the windows of two blocks share is added up.
//
//   X[ky] = sum_n H_n[kx, ky] sum_y A_nx[y] r_ny(y) exp(-2 pi i ky y / 160),   r_0 = 1 - s(y), r_1 = s(y)
//   H_n[kx, ky] = sum_y h_n[kx, y] exp(-2 pi i ky y / 160)
//   columns[kx, SIDE b + y] = sum over blocks b of sum_ky X[ky] exp(2 pi i ky y / 160)
// The PSFs come transformed along x alone: their few rows are fetched faster than 160 frequencies.
// A_nx = spectra (channels, blocks, 2, SIDE/2, 81, 2), unit of the image; h_n = psfs (channels, nodes down, nodes across,
// ROWS/2, 81, 2) divided by 160^2
// -> columns (channels, blocks across, (SIDE (down - 1) + 160) / 2, 81, 2), unit of the image: [channel, column, y/2, kx, y%2].
// A loop over the four nodes, or all straight through: what a loop leaves to its next turn lavapipe copies under a mask, and Mesa
// 22.3 is then a quarter slower; straight through it compiles in 10 s in place of 2.5. Mesa 25 is as fast with the loop, and
// compiles in 5 s in place of 13; SwiftShader in 4 in place of 40 to 54, and runs 10 % faster. Both give the same, bit for bit.
// Dispatch: ceil(lines / 8) workgroups of 8 invocations.
#include "line_160"
#include "texels"

override SIDE: u32 = 128u;  // of a block, samples; a multiple of 4, from 80 to 160
override ROWS: u32 = 32u;   // of a PSF, from the first to the last that is not dark; even
override STRAIGHT: bool = false; // no loop over the nodes
override KEEP: bool = false; // straight, and a cell is one block: its lower nodes are the next block's upper ones

struct Params {
    lines: u32,       // channels * blocks across * 81
    across: u32,      // blocks in a row of blocks
    down: u32,        // rows of blocks
    per_cell: u32,    // blocks along a cell
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var spectra: texture_2d<f32>;  // two rows at a time
@group(0) @binding(2) var psfs: texture_2d<f32>;     // two rows at a time
@group(0) @binding(3) var<storage, read_write> columns: array<vec4f>;

// Rows y and y + 1 of a line of so many rows; beyond them it is dark.
fn load(line: ptr<function, Line>, numbers: texture_2d<f32>, rows: u32, y: u32, at: u32) {
    var both = vec4f(0.0);
    if (y < rows) {
        both = texel(numbers, at + y / 2u * 81u);
    }
    (*line)[y] = both.xy;
    (*line)[y + 1u] = both.zw;
}

fn load_32(line: ptr<function, Line>, numbers: texture_2d<f32>, rows: u32, y: u32, at: u32) {
    load(line, numbers, rows, y, at); load(line, numbers, rows, y + 2u, at); load(line, numbers, rows, y + 4u, at); load(line, numbers, rows, y + 6u, at);
    load(line, numbers, rows, y + 8u, at); load(line, numbers, rows, y + 10u, at); load(line, numbers, rows, y + 12u, at); load(line, numbers, rows, y + 14u, at);
    load(line, numbers, rows, y + 16u, at); load(line, numbers, rows, y + 18u, at); load(line, numbers, rows, y + 20u, at); load(line, numbers, rows, y + 22u, at);
    load(line, numbers, rows, y + 24u, at); load(line, numbers, rows, y + 26u, at); load(line, numbers, rows, y + 28u, at); load(line, numbers, rows, y + 30u, at);
}

fn load_line(line: ptr<function, Line>, numbers: texture_2d<f32>, rows: u32, at: u32) {
    load_32(line, numbers, rows, 0u, at); load_32(line, numbers, rows, 32u, at); load_32(line, numbers, rows, 64u, at);
    load_32(line, numbers, rows, 96u, at); load_32(line, numbers, rows, 128u, at);
}

// A node's PSF, transformed.
fn transform(psf: ptr<function, Line>, node: u32, kx: u32) {
    load_line(psf, psfs, ROWS, node * (ROWS / 2u) * 81u + kx);
    line_160(psf);
}

// Rows y .. y + 3, weighted by w + y step.
fn weigh(v: ptr<function, Line>, column: ptr<function, Line>, y: u32, w: f32, step: f32) {
    (*v)[y] = (w + f32(y) * step) * (*column)[y];
    (*v)[y + 1u] = (w + f32(y + 1u) * step) * (*column)[y + 1u];
    (*v)[y + 2u] = (w + f32(y + 2u) * step) * (*column)[y + 2u];
    (*v)[y + 3u] = (w + f32(y + 3u) * step) * (*column)[y + 3u];
}

fn weigh_32(v: ptr<function, Line>, column: ptr<function, Line>, y: u32, w: f32, step: f32) {
    weigh(v, column, y, w, step); weigh(v, column, y + 4u, w, step); weigh(v, column, y + 8u, w, step);
    weigh(v, column, y + 12u, w, step); weigh(v, column, y + 16u, w, step); weigh(v, column, y + 20u, w, step);
    weigh(v, column, y + 24u, w, step); weigh(v, column, y + 28u, w, step);
}

// Two frequencies times the PSF's; real and imaginary parts exchanged for the inverse transform.
fn add(sum: ptr<function, Line>, v: ptr<function, Line>, psf: ptr<function, Line>, i: u32) {
    (*sum)[i] += cmul((*v)[i], (*psf)[i]).yx;
    (*sum)[i + 1u] += cmul((*v)[i + 1u], (*psf)[i + 1u]).yx;
}

fn add_32(sum: ptr<function, Line>, v: ptr<function, Line>, psf: ptr<function, Line>, i: u32) {
    add(sum, v, psf, i); add(sum, v, psf, i + 2u); add(sum, v, psf, i + 4u); add(sum, v, psf, i + 6u);
    add(sum, v, psf, i + 8u); add(sum, v, psf, i + 10u); add(sum, v, psf, i + 12u); add(sum, v, psf, i + 14u);
    add(sum, v, psf, i + 16u); add(sum, v, psf, i + 18u); add(sum, v, psf, i + 20u); add(sum, v, psf, i + 22u);
    add(sum, v, psf, i + 24u); add(sum, v, psf, i + 26u); add(sum, v, psf, i + 28u); add(sum, v, psf, i + 30u);
}

// What one node makes of a column.
fn convolve(sum: ptr<function, Line>, column: ptr<function, Line>, psf: ptr<function, Line>, w: f32, step: f32) {
    var v: Line;
    weigh_32(&v, column, 0u, w, step); weigh_32(&v, column, 32u, w, step); weigh_32(&v, column, 64u, w, step);
    weigh_32(&v, column, 96u, w, step); weigh_32(&v, column, 128u, w, step);
    line_160(&v);
    add_32(sum, &v, psf, 0u); add_32(sum, &v, psf, 32u); add_32(sum, &v, psf, 64u); add_32(sum, &v, psf, 96u);
    add_32(sum, &v, psf, 128u);
}

// What the nodes of one side make of it: the upper one, whose PSF is given if it is kept, and the lower one, which is kept.
fn convolve_side(sum: ptr<function, Line>, kept: ptr<function, Line>, at: u32, upper: u32, lower: u32, kx: u32, s: f32, step: f32) {
    var column: Line;
    load_line(&column, spectra, SIDE, at);
    if (!KEEP) {
        transform(kept, upper, kx);
    }
    convolve(sum, &column, kept, 1.0 - s, -step);
    transform(kept, lower, kx);
    convolve(sum, &column, kept, s, step);
}

// What one of the four nodes makes of its side's column: 0 and 1 are the left side's upper and lower one.
fn convolve_node(sum: ptr<function, Line>, at: u32, node: u32, nodes: u32, which: u32, kx: u32, s: f32, step: f32) {
    let side = which / 2u;
    let lower = which % 2u;
    var column: Line;
    load_line(&column, spectra, SIDE, at + side * (SIDE / 2u * 81u));
    var psf: Line;
    transform(&psf, node + side + lower * nodes, kx);
    convolve(sum, &column, &psf, select(1.0 - s, s, lower == 1u), select(-step, step, lower == 1u));
}

// Rows y and y + 1 of a window: those of the block, on top of what the window before left; and what is left to the next.
fn store(sum: ptr<function, Line>, rest: ptr<function, Line>, y: u32, at: u32) {
    if (y < SIDE) {
        columns[at + y / 2u * 81u] = vec4f((*sum)[y].yx + (*rest)[y], (*sum)[y + 1u].yx + (*rest)[y + 1u]);
    }
    if (y < 160u - SIDE) {
        (*rest)[y] = (*sum)[y + SIDE].yx;
        (*rest)[y + 1u] = (*sum)[y + SIDE + 1u].yx;
    }
}

fn finish(rest: ptr<function, Line>, y: u32, at: u32) {
    if (y < 160u - SIDE) {
        columns[at + y / 2u * 81u] = vec4f((*rest)[y], (*rest)[y + 1u]);
    }
}

@compute @workgroup_size(8, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.lines) {
        return;
    }
    let kx = id.x % 81u;
    let x = id.x / 81u % params.across;
    let channel = id.x / 81u / params.across;
    let nodes = params.across / params.per_cell + 1u;
    let step = 1.0 / f32(params.per_cell * SIDE);
    var node = channel * (params.down / params.per_cell + 1u) * nodes + x / params.per_cell;
    var at = (channel * params.down * params.across + x) * SIDE * 81u + kx;
    var to = id.x / 81u * ((params.down - 1u) * SIDE + 160u) / 2u * 81u + kx;
    var left = Line();   // PSF of a node, transformed
    var right = Line();
    if (KEEP) {
        for (var first = 0u; first < 2u; first++) {
            left = right;
            transform(&right, node + first, kx);
        }
    }
    var rest = Line();
    for (var row = 0u; row < params.down; row++) {
        let s = (f32(row % params.per_cell * SIDE) + 0.5) * step;
        var sum = Line();
        if (STRAIGHT) {
            convolve_side(&sum, &left, at, node, node + nodes, kx, s, step);
            convolve_side(&sum, &right, at + SIDE / 2u * 81u, node + 1u, node + nodes + 1u, kx, s, step);
        } else {
            for (var which = 0u; which < 4u; which++) {
                convolve_node(&sum, at, node, nodes, which, kx, s, step);
            }
        }
        line_160_back(&sum);
        store(&sum, &rest, 0u, to); store(&sum, &rest, 2u, to); store(&sum, &rest, 4u, to); store(&sum, &rest, 6u, to);
        store(&sum, &rest, 8u, to); store(&sum, &rest, 10u, to); store(&sum, &rest, 12u, to); store(&sum, &rest, 14u, to);
        store(&sum, &rest, 16u, to); store(&sum, &rest, 18u, to); store(&sum, &rest, 20u, to); store(&sum, &rest, 22u, to);
        store(&sum, &rest, 24u, to); store(&sum, &rest, 26u, to); store(&sum, &rest, 28u, to); store(&sum, &rest, 30u, to);
        store(&sum, &rest, 32u, to); store(&sum, &rest, 34u, to); store(&sum, &rest, 36u, to); store(&sum, &rest, 38u, to);
        store(&sum, &rest, 40u, to); store(&sum, &rest, 42u, to); store(&sum, &rest, 44u, to); store(&sum, &rest, 46u, to);
        store(&sum, &rest, 48u, to); store(&sum, &rest, 50u, to); store(&sum, &rest, 52u, to); store(&sum, &rest, 54u, to);
        store(&sum, &rest, 56u, to); store(&sum, &rest, 58u, to); store(&sum, &rest, 60u, to); store(&sum, &rest, 62u, to);
        store(&sum, &rest, 64u, to); store(&sum, &rest, 66u, to); store(&sum, &rest, 68u, to); store(&sum, &rest, 70u, to);
        store(&sum, &rest, 72u, to); store(&sum, &rest, 74u, to); store(&sum, &rest, 76u, to); store(&sum, &rest, 78u, to);
        store(&sum, &rest, 80u, to); store(&sum, &rest, 82u, to); store(&sum, &rest, 84u, to); store(&sum, &rest, 86u, to);
        store(&sum, &rest, 88u, to); store(&sum, &rest, 90u, to); store(&sum, &rest, 92u, to); store(&sum, &rest, 94u, to);
        store(&sum, &rest, 96u, to); store(&sum, &rest, 98u, to); store(&sum, &rest, 100u, to);
        store(&sum, &rest, 102u, to); store(&sum, &rest, 104u, to); store(&sum, &rest, 106u, to);
        store(&sum, &rest, 108u, to); store(&sum, &rest, 110u, to); store(&sum, &rest, 112u, to);
        store(&sum, &rest, 114u, to); store(&sum, &rest, 116u, to); store(&sum, &rest, 118u, to);
        store(&sum, &rest, 120u, to); store(&sum, &rest, 122u, to); store(&sum, &rest, 124u, to);
        store(&sum, &rest, 126u, to); store(&sum, &rest, 128u, to); store(&sum, &rest, 130u, to);
        store(&sum, &rest, 132u, to); store(&sum, &rest, 134u, to); store(&sum, &rest, 136u, to);
        store(&sum, &rest, 138u, to); store(&sum, &rest, 140u, to); store(&sum, &rest, 142u, to);
        store(&sum, &rest, 144u, to); store(&sum, &rest, 146u, to); store(&sum, &rest, 148u, to);
        store(&sum, &rest, 150u, to); store(&sum, &rest, 152u, to); store(&sum, &rest, 154u, to);
        store(&sum, &rest, 156u, to); store(&sum, &rest, 158u, to);
        node += select(0u, nodes, (row + 1u) % params.per_cell == 0u);
        at += params.across * SIDE * 81u;
        to += SIDE / 2u * 81u;
    }
    finish(&rest, 0u, to); finish(&rest, 2u, to); finish(&rest, 4u, to); finish(&rest, 6u, to); finish(&rest, 8u, to);
    finish(&rest, 10u, to); finish(&rest, 12u, to); finish(&rest, 14u, to); finish(&rest, 16u, to); finish(&rest, 18u, to);
    finish(&rest, 20u, to); finish(&rest, 22u, to); finish(&rest, 24u, to); finish(&rest, 26u, to); finish(&rest, 28u, to);
    finish(&rest, 30u, to); finish(&rest, 32u, to); finish(&rest, 34u, to); finish(&rest, 36u, to); finish(&rest, 38u, to);
    finish(&rest, 40u, to); finish(&rest, 42u, to); finish(&rest, 44u, to); finish(&rest, 46u, to); finish(&rest, 48u, to);
    finish(&rest, 50u, to); finish(&rest, 52u, to); finish(&rest, 54u, to); finish(&rest, 56u, to); finish(&rest, 58u, to);
    finish(&rest, 60u, to); finish(&rest, 62u, to); finish(&rest, 64u, to); finish(&rest, 66u, to); finish(&rest, 68u, to);
    finish(&rest, 70u, to); finish(&rest, 72u, to); finish(&rest, 74u, to); finish(&rest, 76u, to); finish(&rest, 78u, to);
}

// Second of three steps that blur an image with a space-variant PSF, for one column frequency kx of one column of blocks,
// block after block downwards: forward transform in y with the weights of the upper and lower PSF nodes, product with the PSFs
// of the four nodes, inverse in y; what the windows of two blocks share is added up.
//
//   X[ky] = sum_n H_n[kx, ky] sum_y A_nx[y] r_ny(y) exp(-2 pi i ky y / 160),   r_0 = 1 - s(y), r_1 = s(y)
//   H_n[kx, ky] = sum_y h_n[kx, y] exp(-2 pi i ky y / 160)
//   columns[kx, SIDE b + y] = sum over blocks b of sum_ky X[ky] exp(2 pi i ky y / 160)
// The PSFs come transformed along x alone: their few rows are fetched faster than 160 frequencies. Where a cell is one block,
// the lower node's transform is the next block's upper one.
// A_nx = spectra (blocks, 2, SIDE/2, 81, 2), unit of the image; h_n = psfs (nodes down, nodes across, ROWS/2, 81, 2) divided by
// 160^2 -> columns (blocks across, (SIDE (down - 1) + 160) / 2, 81, 2), unit of the image: [column, y/2, kx, y%2].
// Dispatch: ceil(lines / 8) workgroups of 8 invocations.
#include "line_160"
#include "texels"

override SIDE: u32 = 128u;  // of a block, samples; a multiple of 4, from 80 to 160
override ROWS: u32 = 32u;   // of a PSF, from the first to the last that is not dark; even

struct Params {
    lines: u32,       // blocks across * 81
    across: u32,      // blocks in a row of blocks
    down: u32,        // rows of blocks
    per_cell: u32,    // blocks along a cell
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var spectra: texture_2d<f32>;  // two rows at a time
@group(0) @binding(2) var psfs: texture_2d<f32>;     // two rows at a time
@group(0) @binding(3) var<storage, read_write> columns: array<vec4f>;

// Rows y and y + 1 of one side's column.
fn load(column: ptr<function, Line>, y: u32, at: u32) {
    if (y < SIDE) {
        let both = texel(spectra, at + y / 2u * 81u);
        (*column)[y] = both.xy;
        (*column)[y + 1u] = both.zw;
    }
}

// Rows y .. y + 3, weighted by w + y step.
fn weigh(v: ptr<function, Line>, column: ptr<function, Line>, y: u32, w: f32, step: f32) {
    (*v)[y] = (w + f32(y) * step) * (*column)[y];
    (*v)[y + 1u] = (w + f32(y + 1u) * step) * (*column)[y + 1u];
    (*v)[y + 2u] = (w + f32(y + 2u) * step) * (*column)[y + 2u];
    (*v)[y + 3u] = (w + f32(y + 3u) * step) * (*column)[y + 3u];
}

// Rows y and y + 1 of a node's PSF, transformed along x.
fn load_psf(psf: ptr<function, Line>, y: u32, at: u32) {
    var both = vec4f(0.0);
    if (y < ROWS) {
        both = texel(psfs, at + y / 2u * 81u);
    }
    (*psf)[y] = both.xy;
    (*psf)[y + 1u] = both.zw;
}

// Two frequencies times the PSF's; real and imaginary parts exchanged for the inverse transform.
fn add(sum: ptr<function, Line>, v: ptr<function, Line>, psf: ptr<function, Line>, i: u32) {
    (*sum)[i] += cmul((*v)[i], (*psf)[i]).yx;
    (*sum)[i + 1u] += cmul((*v)[i + 1u], (*psf)[i + 1u]).yx;
}

fn exchange(a: ptr<function, Line>, b: ptr<function, Line>, i: u32) {
    let kept = (*a)[i];
    let next = (*a)[i + 1u];
    (*a)[i] = (*b)[i];
    (*a)[i + 1u] = (*b)[i + 1u];
    (*b)[i] = kept;
    (*b)[i + 1u] = next;
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
    let x = id.x / 81u;
    let kx = id.x % 81u;
    let cell = x / params.per_cell;
    let nodes = params.across / params.per_cell + 1u;
    let step = 1.0 / f32(params.per_cell * SIDE);
    var to = (x * ((params.down - 1u) * SIDE + 160u) / 2u) * 81u + kx;
    var column: Line;  // rows from SIDE on stay zero
    var psf: Line;     // of the node at hand, transformed; and of the one on the other side
    var other: Line;
    var v: Line;
    var rest: Line;
    for (var row = 0u; row < params.down; row++) {
        let s = (f32(row % params.per_cell * SIDE) + 0.5) * step;
        let block = row * params.across + x;
        var sum = Line();
        for (var right = 0u; right < 2u; right++) {
            let at = (2u * block + right) * (SIDE / 2u) * 81u + kx;
            load(&column, 0u, at); load(&column, 2u, at); load(&column, 4u, at); load(&column, 6u, at);
            load(&column, 8u, at); load(&column, 10u, at); load(&column, 12u, at); load(&column, 14u, at);
            load(&column, 16u, at); load(&column, 18u, at); load(&column, 20u, at); load(&column, 22u, at);
            load(&column, 24u, at); load(&column, 26u, at); load(&column, 28u, at); load(&column, 30u, at);
            load(&column, 32u, at); load(&column, 34u, at); load(&column, 36u, at); load(&column, 38u, at);
            load(&column, 40u, at); load(&column, 42u, at); load(&column, 44u, at); load(&column, 46u, at);
            load(&column, 48u, at); load(&column, 50u, at); load(&column, 52u, at); load(&column, 54u, at);
            load(&column, 56u, at); load(&column, 58u, at); load(&column, 60u, at); load(&column, 62u, at);
            load(&column, 64u, at); load(&column, 66u, at); load(&column, 68u, at); load(&column, 70u, at);
            load(&column, 72u, at); load(&column, 74u, at); load(&column, 76u, at); load(&column, 78u, at);
            load(&column, 80u, at); load(&column, 82u, at); load(&column, 84u, at); load(&column, 86u, at);
            load(&column, 88u, at); load(&column, 90u, at); load(&column, 92u, at); load(&column, 94u, at);
            load(&column, 96u, at); load(&column, 98u, at); load(&column, 100u, at); load(&column, 102u, at);
            load(&column, 104u, at); load(&column, 106u, at); load(&column, 108u, at); load(&column, 110u, at);
            load(&column, 112u, at); load(&column, 114u, at); load(&column, 116u, at); load(&column, 118u, at);
            load(&column, 120u, at); load(&column, 122u, at); load(&column, 124u, at); load(&column, 126u, at);
            load(&column, 128u, at); load(&column, 130u, at); load(&column, 132u, at); load(&column, 134u, at);
            load(&column, 136u, at); load(&column, 138u, at); load(&column, 140u, at); load(&column, 142u, at);
            load(&column, 144u, at); load(&column, 146u, at); load(&column, 148u, at); load(&column, 150u, at);
            load(&column, 152u, at); load(&column, 154u, at); load(&column, 156u, at); load(&column, 158u, at);
            for (var lower = 0u; lower < 2u; lower++) {
                let node = (row / params.per_cell + lower) * nodes + cell + right;
                let h = node * (ROWS / 2u) * 81u + kx;
                // Loops of one turn or none: lavapipe runs through both sides of an `if`.
                for (var made = u32(lower == 0u && row > 0u && params.per_cell == 1u); made == 0u; made++) {
                    load_psf(&psf, 0u, h); load_psf(&psf, 2u, h); load_psf(&psf, 4u, h); load_psf(&psf, 6u, h);
                    load_psf(&psf, 8u, h); load_psf(&psf, 10u, h); load_psf(&psf, 12u, h); load_psf(&psf, 14u, h);
                    load_psf(&psf, 16u, h); load_psf(&psf, 18u, h); load_psf(&psf, 20u, h); load_psf(&psf, 22u, h);
                    load_psf(&psf, 24u, h); load_psf(&psf, 26u, h); load_psf(&psf, 28u, h); load_psf(&psf, 30u, h);
                    load_psf(&psf, 32u, h); load_psf(&psf, 34u, h); load_psf(&psf, 36u, h); load_psf(&psf, 38u, h);
                    load_psf(&psf, 40u, h); load_psf(&psf, 42u, h); load_psf(&psf, 44u, h); load_psf(&psf, 46u, h);
                    load_psf(&psf, 48u, h); load_psf(&psf, 50u, h); load_psf(&psf, 52u, h); load_psf(&psf, 54u, h);
                    load_psf(&psf, 56u, h); load_psf(&psf, 58u, h); load_psf(&psf, 60u, h); load_psf(&psf, 62u, h);
                    load_psf(&psf, 64u, h); load_psf(&psf, 66u, h); load_psf(&psf, 68u, h); load_psf(&psf, 70u, h);
                    load_psf(&psf, 72u, h); load_psf(&psf, 74u, h); load_psf(&psf, 76u, h); load_psf(&psf, 78u, h);
                    load_psf(&psf, 80u, h); load_psf(&psf, 82u, h); load_psf(&psf, 84u, h); load_psf(&psf, 86u, h);
                    load_psf(&psf, 88u, h); load_psf(&psf, 90u, h); load_psf(&psf, 92u, h); load_psf(&psf, 94u, h);
                    load_psf(&psf, 96u, h); load_psf(&psf, 98u, h); load_psf(&psf, 100u, h); load_psf(&psf, 102u, h);
                    load_psf(&psf, 104u, h); load_psf(&psf, 106u, h); load_psf(&psf, 108u, h); load_psf(&psf, 110u, h);
                    load_psf(&psf, 112u, h); load_psf(&psf, 114u, h); load_psf(&psf, 116u, h); load_psf(&psf, 118u, h);
                    load_psf(&psf, 120u, h); load_psf(&psf, 122u, h); load_psf(&psf, 124u, h); load_psf(&psf, 126u, h);
                    load_psf(&psf, 128u, h); load_psf(&psf, 130u, h); load_psf(&psf, 132u, h); load_psf(&psf, 134u, h);
                    load_psf(&psf, 136u, h); load_psf(&psf, 138u, h); load_psf(&psf, 140u, h); load_psf(&psf, 142u, h);
                    load_psf(&psf, 144u, h); load_psf(&psf, 146u, h); load_psf(&psf, 148u, h); load_psf(&psf, 150u, h);
                    load_psf(&psf, 152u, h); load_psf(&psf, 154u, h); load_psf(&psf, 156u, h); load_psf(&psf, 158u, h);
                    line_160(&psf);
                }
                let w = select(1.0 - s, s, lower == 1u);
                let by = select(-step, step, lower == 1u);
                weigh(&v, &column, 0u, w, by); weigh(&v, &column, 4u, w, by); weigh(&v, &column, 8u, w, by);
                weigh(&v, &column, 12u, w, by); weigh(&v, &column, 16u, w, by); weigh(&v, &column, 20u, w, by);
                weigh(&v, &column, 24u, w, by); weigh(&v, &column, 28u, w, by); weigh(&v, &column, 32u, w, by);
                weigh(&v, &column, 36u, w, by); weigh(&v, &column, 40u, w, by); weigh(&v, &column, 44u, w, by);
                weigh(&v, &column, 48u, w, by); weigh(&v, &column, 52u, w, by); weigh(&v, &column, 56u, w, by);
                weigh(&v, &column, 60u, w, by); weigh(&v, &column, 64u, w, by); weigh(&v, &column, 68u, w, by);
                weigh(&v, &column, 72u, w, by); weigh(&v, &column, 76u, w, by); weigh(&v, &column, 80u, w, by);
                weigh(&v, &column, 84u, w, by); weigh(&v, &column, 88u, w, by); weigh(&v, &column, 92u, w, by);
                weigh(&v, &column, 96u, w, by); weigh(&v, &column, 100u, w, by); weigh(&v, &column, 104u, w, by);
                weigh(&v, &column, 108u, w, by); weigh(&v, &column, 112u, w, by); weigh(&v, &column, 116u, w, by);
                weigh(&v, &column, 120u, w, by); weigh(&v, &column, 124u, w, by); weigh(&v, &column, 128u, w, by);
                weigh(&v, &column, 132u, w, by); weigh(&v, &column, 136u, w, by); weigh(&v, &column, 140u, w, by);
                weigh(&v, &column, 144u, w, by); weigh(&v, &column, 148u, w, by); weigh(&v, &column, 152u, w, by);
                weigh(&v, &column, 156u, w, by);
                line_160(&v);
                add(&sum, &v, &psf, 0u); add(&sum, &v, &psf, 2u); add(&sum, &v, &psf, 4u); add(&sum, &v, &psf, 6u);
                add(&sum, &v, &psf, 8u); add(&sum, &v, &psf, 10u); add(&sum, &v, &psf, 12u); add(&sum, &v, &psf, 14u);
                add(&sum, &v, &psf, 16u); add(&sum, &v, &psf, 18u); add(&sum, &v, &psf, 20u); add(&sum, &v, &psf, 22u);
                add(&sum, &v, &psf, 24u); add(&sum, &v, &psf, 26u); add(&sum, &v, &psf, 28u); add(&sum, &v, &psf, 30u);
                add(&sum, &v, &psf, 32u); add(&sum, &v, &psf, 34u); add(&sum, &v, &psf, 36u); add(&sum, &v, &psf, 38u);
                add(&sum, &v, &psf, 40u); add(&sum, &v, &psf, 42u); add(&sum, &v, &psf, 44u); add(&sum, &v, &psf, 46u);
                add(&sum, &v, &psf, 48u); add(&sum, &v, &psf, 50u); add(&sum, &v, &psf, 52u); add(&sum, &v, &psf, 54u);
                add(&sum, &v, &psf, 56u); add(&sum, &v, &psf, 58u); add(&sum, &v, &psf, 60u); add(&sum, &v, &psf, 62u);
                add(&sum, &v, &psf, 64u); add(&sum, &v, &psf, 66u); add(&sum, &v, &psf, 68u); add(&sum, &v, &psf, 70u);
                add(&sum, &v, &psf, 72u); add(&sum, &v, &psf, 74u); add(&sum, &v, &psf, 76u); add(&sum, &v, &psf, 78u);
                add(&sum, &v, &psf, 80u); add(&sum, &v, &psf, 82u); add(&sum, &v, &psf, 84u); add(&sum, &v, &psf, 86u);
                add(&sum, &v, &psf, 88u); add(&sum, &v, &psf, 90u); add(&sum, &v, &psf, 92u); add(&sum, &v, &psf, 94u);
                add(&sum, &v, &psf, 96u); add(&sum, &v, &psf, 98u); add(&sum, &v, &psf, 100u); add(&sum, &v, &psf, 102u);
                add(&sum, &v, &psf, 104u); add(&sum, &v, &psf, 106u); add(&sum, &v, &psf, 108u);
                add(&sum, &v, &psf, 110u); add(&sum, &v, &psf, 112u); add(&sum, &v, &psf, 114u);
                add(&sum, &v, &psf, 116u); add(&sum, &v, &psf, 118u); add(&sum, &v, &psf, 120u);
                add(&sum, &v, &psf, 122u); add(&sum, &v, &psf, 124u); add(&sum, &v, &psf, 126u);
                add(&sum, &v, &psf, 128u); add(&sum, &v, &psf, 130u); add(&sum, &v, &psf, 132u);
                add(&sum, &v, &psf, 134u); add(&sum, &v, &psf, 136u); add(&sum, &v, &psf, 138u);
                add(&sum, &v, &psf, 140u); add(&sum, &v, &psf, 142u); add(&sum, &v, &psf, 144u);
                add(&sum, &v, &psf, 146u); add(&sum, &v, &psf, 148u); add(&sum, &v, &psf, 150u);
                add(&sum, &v, &psf, 152u); add(&sum, &v, &psf, 154u); add(&sum, &v, &psf, 156u);
                add(&sum, &v, &psf, 158u);
            }
            exchange(&psf, &other, 0u); exchange(&psf, &other, 2u); exchange(&psf, &other, 4u);
            exchange(&psf, &other, 6u); exchange(&psf, &other, 8u); exchange(&psf, &other, 10u);
            exchange(&psf, &other, 12u); exchange(&psf, &other, 14u); exchange(&psf, &other, 16u);
            exchange(&psf, &other, 18u); exchange(&psf, &other, 20u); exchange(&psf, &other, 22u);
            exchange(&psf, &other, 24u); exchange(&psf, &other, 26u); exchange(&psf, &other, 28u);
            exchange(&psf, &other, 30u); exchange(&psf, &other, 32u); exchange(&psf, &other, 34u);
            exchange(&psf, &other, 36u); exchange(&psf, &other, 38u); exchange(&psf, &other, 40u);
            exchange(&psf, &other, 42u); exchange(&psf, &other, 44u); exchange(&psf, &other, 46u);
            exchange(&psf, &other, 48u); exchange(&psf, &other, 50u); exchange(&psf, &other, 52u);
            exchange(&psf, &other, 54u); exchange(&psf, &other, 56u); exchange(&psf, &other, 58u);
            exchange(&psf, &other, 60u); exchange(&psf, &other, 62u); exchange(&psf, &other, 64u);
            exchange(&psf, &other, 66u); exchange(&psf, &other, 68u); exchange(&psf, &other, 70u);
            exchange(&psf, &other, 72u); exchange(&psf, &other, 74u); exchange(&psf, &other, 76u);
            exchange(&psf, &other, 78u); exchange(&psf, &other, 80u); exchange(&psf, &other, 82u);
            exchange(&psf, &other, 84u); exchange(&psf, &other, 86u); exchange(&psf, &other, 88u);
            exchange(&psf, &other, 90u); exchange(&psf, &other, 92u); exchange(&psf, &other, 94u);
            exchange(&psf, &other, 96u); exchange(&psf, &other, 98u); exchange(&psf, &other, 100u);
            exchange(&psf, &other, 102u); exchange(&psf, &other, 104u); exchange(&psf, &other, 106u);
            exchange(&psf, &other, 108u); exchange(&psf, &other, 110u); exchange(&psf, &other, 112u);
            exchange(&psf, &other, 114u); exchange(&psf, &other, 116u); exchange(&psf, &other, 118u);
            exchange(&psf, &other, 120u); exchange(&psf, &other, 122u); exchange(&psf, &other, 124u);
            exchange(&psf, &other, 126u); exchange(&psf, &other, 128u); exchange(&psf, &other, 130u);
            exchange(&psf, &other, 132u); exchange(&psf, &other, 134u); exchange(&psf, &other, 136u);
            exchange(&psf, &other, 138u); exchange(&psf, &other, 140u); exchange(&psf, &other, 142u);
            exchange(&psf, &other, 144u); exchange(&psf, &other, 146u); exchange(&psf, &other, 148u);
            exchange(&psf, &other, 150u); exchange(&psf, &other, 152u); exchange(&psf, &other, 154u);
            exchange(&psf, &other, 156u); exchange(&psf, &other, 158u);
        }
        line_160_back(&sum);
        store(&sum, &rest, 0u, to); store(&sum, &rest, 2u, to); store(&sum, &rest, 4u, to); store(&sum, &rest, 6u, to);
        store(&sum, &rest, 8u, to); store(&sum, &rest, 10u, to); store(&sum, &rest, 12u, to); store(&sum, &rest, 14u, to);
        store(&sum, &rest, 16u, to); store(&sum, &rest, 18u, to); store(&sum, &rest, 20u, to);
        store(&sum, &rest, 22u, to); store(&sum, &rest, 24u, to); store(&sum, &rest, 26u, to);
        store(&sum, &rest, 28u, to); store(&sum, &rest, 30u, to); store(&sum, &rest, 32u, to);
        store(&sum, &rest, 34u, to); store(&sum, &rest, 36u, to); store(&sum, &rest, 38u, to);
        store(&sum, &rest, 40u, to); store(&sum, &rest, 42u, to); store(&sum, &rest, 44u, to);
        store(&sum, &rest, 46u, to); store(&sum, &rest, 48u, to); store(&sum, &rest, 50u, to);
        store(&sum, &rest, 52u, to); store(&sum, &rest, 54u, to); store(&sum, &rest, 56u, to);
        store(&sum, &rest, 58u, to); store(&sum, &rest, 60u, to); store(&sum, &rest, 62u, to);
        store(&sum, &rest, 64u, to); store(&sum, &rest, 66u, to); store(&sum, &rest, 68u, to);
        store(&sum, &rest, 70u, to); store(&sum, &rest, 72u, to); store(&sum, &rest, 74u, to);
        store(&sum, &rest, 76u, to); store(&sum, &rest, 78u, to); store(&sum, &rest, 80u, to);
        store(&sum, &rest, 82u, to); store(&sum, &rest, 84u, to); store(&sum, &rest, 86u, to);
        store(&sum, &rest, 88u, to); store(&sum, &rest, 90u, to); store(&sum, &rest, 92u, to);
        store(&sum, &rest, 94u, to); store(&sum, &rest, 96u, to); store(&sum, &rest, 98u, to);
        store(&sum, &rest, 100u, to); store(&sum, &rest, 102u, to); store(&sum, &rest, 104u, to);
        store(&sum, &rest, 106u, to); store(&sum, &rest, 108u, to); store(&sum, &rest, 110u, to);
        store(&sum, &rest, 112u, to); store(&sum, &rest, 114u, to); store(&sum, &rest, 116u, to);
        store(&sum, &rest, 118u, to); store(&sum, &rest, 120u, to); store(&sum, &rest, 122u, to);
        store(&sum, &rest, 124u, to); store(&sum, &rest, 126u, to); store(&sum, &rest, 128u, to);
        store(&sum, &rest, 130u, to); store(&sum, &rest, 132u, to); store(&sum, &rest, 134u, to);
        store(&sum, &rest, 136u, to); store(&sum, &rest, 138u, to); store(&sum, &rest, 140u, to);
        store(&sum, &rest, 142u, to); store(&sum, &rest, 144u, to); store(&sum, &rest, 146u, to);
        store(&sum, &rest, 148u, to); store(&sum, &rest, 150u, to); store(&sum, &rest, 152u, to);
        store(&sum, &rest, 154u, to); store(&sum, &rest, 156u, to); store(&sum, &rest, 158u, to);
        to += SIDE / 2u * 81u;
    }
    finish(&rest, 0u, to); finish(&rest, 2u, to); finish(&rest, 4u, to); finish(&rest, 6u, to); finish(&rest, 8u, to);
    finish(&rest, 10u, to); finish(&rest, 12u, to); finish(&rest, 14u, to); finish(&rest, 16u, to);
    finish(&rest, 18u, to); finish(&rest, 20u, to); finish(&rest, 22u, to); finish(&rest, 24u, to);
    finish(&rest, 26u, to); finish(&rest, 28u, to); finish(&rest, 30u, to); finish(&rest, 32u, to);
    finish(&rest, 34u, to); finish(&rest, 36u, to); finish(&rest, 38u, to); finish(&rest, 40u, to);
    finish(&rest, 42u, to); finish(&rest, 44u, to); finish(&rest, 46u, to); finish(&rest, 48u, to);
    finish(&rest, 50u, to); finish(&rest, 52u, to); finish(&rest, 54u, to); finish(&rest, 56u, to);
    finish(&rest, 58u, to); finish(&rest, 60u, to); finish(&rest, 62u, to); finish(&rest, 64u, to);
    finish(&rest, 66u, to); finish(&rest, 68u, to); finish(&rest, 70u, to); finish(&rest, 72u, to);
    finish(&rest, 74u, to); finish(&rest, 76u, to); finish(&rest, 78u, to);
}

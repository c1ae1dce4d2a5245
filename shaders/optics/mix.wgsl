// Second of three steps that blur an image with a space-variant PSF, for one column frequency kx of one block: forward
// transform in y with the weights of the upper and lower PSF nodes, product with the PSFs of the four nodes, inverse in y.
//
//   X[ky] = sum_n H_n[kx, ky] sum_y A_nx[y] r_ny(y) exp(-2 pi i ky y / 160),   r_0 = 1 - s(y), r_1 = s(y)
//   H_n[kx, ky] = sum_y h_n[kx, y] exp(-2 pi i ky y / 160)
//   columns[block, kx, y] = sum_ky X[ky] exp(2 pi i ky y / 160)
// The PSFs come transformed along x alone: their few rows are loaded faster than 160 frequencies, which lavapipe brings number
// by number, and the transforms hide behind what else is loaded.
// A_nx = spectra (blocks, SIDE, 81, 2), unit of the image; h_n = psfs (nodes down, nodes across, 81, ROWS), divided by 160^2
// -> columns (blocks, 81, 160), unit of the image.
// Dispatch: ceil(lines / 64) workgroups of 64 invocations.
#include "line_160"

override SIDE: u32 = 128u;  // of a block, samples; a multiple of 4, from 80 to 160
override ROWS: u32 = 32u;   // of a PSF, from the first to the last that is not dark; even

struct Params {
    lines: u32,       // blocks * 81
    cells: u32,       // between nodes in a row
    per_cell: u32,    // blocks along a cell
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> spectra: array<vec2f>;  // for the left and the right node in turns
@group(0) @binding(2) var<storage, read> psfs: array<vec4f>;     // two rows at a time
@group(0) @binding(3) var<storage, read_write> columns: array<vec4f>;  // two rows at a time

// Row y of the column at `a`: of one side.
fn load(column: ptr<function, Line>, y: u32, a: u32) {
    if (y < SIDE) {
        (*column)[y] = spectra[a + 162u * y];
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
        both = psfs[at + y / 2u];
    }
    (*psf)[y] = both.xy;
    (*psf)[y + 1u] = both.zw;
}

// Two frequencies times the PSF's; real and imaginary parts exchanged for the inverse transform.
fn add(sum: ptr<function, Line>, v: ptr<function, Line>, psf: ptr<function, Line>, i: u32) {
    (*sum)[i] += cmul((*v)[i], (*psf)[i]).yx;
    (*sum)[i + 1u] += cmul((*v)[i + 1u], (*psf)[i + 1u]).yx;
}

fn store(sum: ptr<function, Line>, y: u32, at: u32) {
    columns[at + y / 2u] = vec4f((*sum)[y].yx, (*sum)[y + 1u].yx);
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.lines) {
        return;
    }
    let block = id.x / 81u;
    let kx = id.x % 81u;
    let across = params.cells * params.per_cell;
    let row = block / across;
    let cell = block % across / params.per_cell;
    let step = 1.0 / f32(params.per_cell * SIDE);
    let s = (f32(row % params.per_cell * SIDE) + 0.5) * step;
    let a = 2u * (block * SIDE * 81u + kx);
    var column: Line;  // rows from SIDE on stay zero
    var psf: Line;
    var v: Line;
    var sum: Line;
    for (var right = 0u; right < 2u; right++) {
        load(&column, 0u, a + right); load(&column, 1u, a + right); load(&column, 2u, a + right);
        load(&column, 3u, a + right); load(&column, 4u, a + right); load(&column, 5u, a + right);
        load(&column, 6u, a + right); load(&column, 7u, a + right); load(&column, 8u, a + right);
        load(&column, 9u, a + right); load(&column, 10u, a + right); load(&column, 11u, a + right);
        load(&column, 12u, a + right); load(&column, 13u, a + right); load(&column, 14u, a + right);
        load(&column, 15u, a + right); load(&column, 16u, a + right); load(&column, 17u, a + right);
        load(&column, 18u, a + right); load(&column, 19u, a + right); load(&column, 20u, a + right);
        load(&column, 21u, a + right); load(&column, 22u, a + right); load(&column, 23u, a + right);
        load(&column, 24u, a + right); load(&column, 25u, a + right); load(&column, 26u, a + right);
        load(&column, 27u, a + right); load(&column, 28u, a + right); load(&column, 29u, a + right);
        load(&column, 30u, a + right); load(&column, 31u, a + right); load(&column, 32u, a + right);
        load(&column, 33u, a + right); load(&column, 34u, a + right); load(&column, 35u, a + right);
        load(&column, 36u, a + right); load(&column, 37u, a + right); load(&column, 38u, a + right);
        load(&column, 39u, a + right); load(&column, 40u, a + right); load(&column, 41u, a + right);
        load(&column, 42u, a + right); load(&column, 43u, a + right); load(&column, 44u, a + right);
        load(&column, 45u, a + right); load(&column, 46u, a + right); load(&column, 47u, a + right);
        load(&column, 48u, a + right); load(&column, 49u, a + right); load(&column, 50u, a + right);
        load(&column, 51u, a + right); load(&column, 52u, a + right); load(&column, 53u, a + right);
        load(&column, 54u, a + right); load(&column, 55u, a + right); load(&column, 56u, a + right);
        load(&column, 57u, a + right); load(&column, 58u, a + right); load(&column, 59u, a + right);
        load(&column, 60u, a + right); load(&column, 61u, a + right); load(&column, 62u, a + right);
        load(&column, 63u, a + right); load(&column, 64u, a + right); load(&column, 65u, a + right);
        load(&column, 66u, a + right); load(&column, 67u, a + right); load(&column, 68u, a + right);
        load(&column, 69u, a + right); load(&column, 70u, a + right); load(&column, 71u, a + right);
        load(&column, 72u, a + right); load(&column, 73u, a + right); load(&column, 74u, a + right);
        load(&column, 75u, a + right); load(&column, 76u, a + right); load(&column, 77u, a + right);
        load(&column, 78u, a + right); load(&column, 79u, a + right); load(&column, 80u, a + right);
        load(&column, 81u, a + right); load(&column, 82u, a + right); load(&column, 83u, a + right);
        load(&column, 84u, a + right); load(&column, 85u, a + right); load(&column, 86u, a + right);
        load(&column, 87u, a + right); load(&column, 88u, a + right); load(&column, 89u, a + right);
        load(&column, 90u, a + right); load(&column, 91u, a + right); load(&column, 92u, a + right);
        load(&column, 93u, a + right); load(&column, 94u, a + right); load(&column, 95u, a + right);
        load(&column, 96u, a + right); load(&column, 97u, a + right); load(&column, 98u, a + right);
        load(&column, 99u, a + right); load(&column, 100u, a + right); load(&column, 101u, a + right);
        load(&column, 102u, a + right); load(&column, 103u, a + right); load(&column, 104u, a + right);
        load(&column, 105u, a + right); load(&column, 106u, a + right); load(&column, 107u, a + right);
        load(&column, 108u, a + right); load(&column, 109u, a + right); load(&column, 110u, a + right);
        load(&column, 111u, a + right); load(&column, 112u, a + right); load(&column, 113u, a + right);
        load(&column, 114u, a + right); load(&column, 115u, a + right); load(&column, 116u, a + right);
        load(&column, 117u, a + right); load(&column, 118u, a + right); load(&column, 119u, a + right);
        load(&column, 120u, a + right); load(&column, 121u, a + right); load(&column, 122u, a + right);
        load(&column, 123u, a + right); load(&column, 124u, a + right); load(&column, 125u, a + right);
        load(&column, 126u, a + right); load(&column, 127u, a + right); load(&column, 128u, a + right);
        load(&column, 129u, a + right); load(&column, 130u, a + right); load(&column, 131u, a + right);
        load(&column, 132u, a + right); load(&column, 133u, a + right); load(&column, 134u, a + right);
        load(&column, 135u, a + right); load(&column, 136u, a + right); load(&column, 137u, a + right);
        load(&column, 138u, a + right); load(&column, 139u, a + right); load(&column, 140u, a + right);
        load(&column, 141u, a + right); load(&column, 142u, a + right); load(&column, 143u, a + right);
        load(&column, 144u, a + right); load(&column, 145u, a + right); load(&column, 146u, a + right);
        load(&column, 147u, a + right); load(&column, 148u, a + right); load(&column, 149u, a + right);
        load(&column, 150u, a + right); load(&column, 151u, a + right); load(&column, 152u, a + right);
        load(&column, 153u, a + right); load(&column, 154u, a + right); load(&column, 155u, a + right);
        load(&column, 156u, a + right); load(&column, 157u, a + right); load(&column, 158u, a + right);
        load(&column, 159u, a + right);
        for (var lower = 0u; lower < 2u; lower++) {
            let w = select(1.0 - s, s, lower == 1u);
            let by = select(-step, step, lower == 1u);
            let node = (row / params.per_cell + lower) * (params.cells + 1u) + cell + right;
            let h = (node * 81u + kx) * (ROWS / 2u);
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
    }
    line_160_back(&sum);
    let at = (block * 81u + kx) * 80u;
    store(&sum, 0u, at); store(&sum, 2u, at); store(&sum, 4u, at); store(&sum, 6u, at); store(&sum, 8u, at);
    store(&sum, 10u, at); store(&sum, 12u, at); store(&sum, 14u, at); store(&sum, 16u, at); store(&sum, 18u, at);
    store(&sum, 20u, at); store(&sum, 22u, at); store(&sum, 24u, at); store(&sum, 26u, at); store(&sum, 28u, at);
    store(&sum, 30u, at); store(&sum, 32u, at); store(&sum, 34u, at); store(&sum, 36u, at); store(&sum, 38u, at);
    store(&sum, 40u, at); store(&sum, 42u, at); store(&sum, 44u, at); store(&sum, 46u, at); store(&sum, 48u, at);
    store(&sum, 50u, at); store(&sum, 52u, at); store(&sum, 54u, at); store(&sum, 56u, at); store(&sum, 58u, at);
    store(&sum, 60u, at); store(&sum, 62u, at); store(&sum, 64u, at); store(&sum, 66u, at); store(&sum, 68u, at);
    store(&sum, 70u, at); store(&sum, 72u, at); store(&sum, 74u, at); store(&sum, 76u, at); store(&sum, 78u, at);
    store(&sum, 80u, at); store(&sum, 82u, at); store(&sum, 84u, at); store(&sum, 86u, at); store(&sum, 88u, at);
    store(&sum, 90u, at); store(&sum, 92u, at); store(&sum, 94u, at); store(&sum, 96u, at); store(&sum, 98u, at);
    store(&sum, 100u, at); store(&sum, 102u, at); store(&sum, 104u, at); store(&sum, 106u, at);
    store(&sum, 108u, at); store(&sum, 110u, at); store(&sum, 112u, at); store(&sum, 114u, at);
    store(&sum, 116u, at); store(&sum, 118u, at); store(&sum, 120u, at); store(&sum, 122u, at);
    store(&sum, 124u, at); store(&sum, 126u, at); store(&sum, 128u, at); store(&sum, 130u, at);
    store(&sum, 132u, at); store(&sum, 134u, at); store(&sum, 136u, at); store(&sum, 138u, at);
    store(&sum, 140u, at); store(&sum, 142u, at); store(&sum, 144u, at); store(&sum, 146u, at);
    store(&sum, 148u, at); store(&sum, 150u, at); store(&sum, 152u, at); store(&sum, 154u, at);
    store(&sum, 156u, at); store(&sum, 158u, at);
}

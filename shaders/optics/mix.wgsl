// Second of three steps that blur an image with a space-variant PSF, for one column frequency kx of one block: forward
// transform in y with the weights of the upper and lower PSF nodes, product with the PSFs of the four nodes, inverse in y.
//
//   X[ky] = sum_n H_n[kx, ky] sum_y A_nx[y] r_ny(y) exp(-2 pi i ky y / 160),   r_0 = 1 - s(y), r_1 = s(y)
//   columns[block, kx, y] = sum_ky X[ky] exp(2 pi i ky y / 160)
// A_nx = spectra (blocks, SIDE, 81, 2), unit of the image; kernels (nodes down, nodes across, 81, 160), ky = a + 10 m at place
// 16 a + m, divided by 160^2 -> columns (blocks, 81, 160), unit of the image.
// Dispatch: ceil(lines / 64) workgroups of 64 invocations.
#include "line_160"

override SIDE: u32 = 128u;  // of a block, samples; a multiple of 4, from 80 to 160

struct Params {
    lines: u32,       // blocks * 81
    cells: u32,       // between nodes in a row
    per_cell: u32,    // blocks along a cell
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> spectra: array<vec2f>;  // for the left and the right node in turns
@group(0) @binding(2) var<storage, read> kernels: array<vec4f>;
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

// Two frequencies times the PSF of one node; real and imaginary parts exchanged for the inverse transform.
fn add(sum: ptr<function, Line>, v: ptr<function, Line>, i: u32, h: u32) {
    let psf = kernels[h + i / 2u];
    (*sum)[i] += cmul((*v)[i], psf.xy).yx;
    (*sum)[i + 1u] += cmul((*v)[i + 1u], psf.zw).yx;
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
            let h = (((row / params.per_cell + lower) * (params.cells + 1u) + cell + right) * 81u + kx) * 80u;
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
            add(&sum, &v, 0u, h); add(&sum, &v, 2u, h); add(&sum, &v, 4u, h); add(&sum, &v, 6u, h);
            add(&sum, &v, 8u, h); add(&sum, &v, 10u, h); add(&sum, &v, 12u, h); add(&sum, &v, 14u, h);
            add(&sum, &v, 16u, h); add(&sum, &v, 18u, h); add(&sum, &v, 20u, h); add(&sum, &v, 22u, h);
            add(&sum, &v, 24u, h); add(&sum, &v, 26u, h); add(&sum, &v, 28u, h); add(&sum, &v, 30u, h);
            add(&sum, &v, 32u, h); add(&sum, &v, 34u, h); add(&sum, &v, 36u, h); add(&sum, &v, 38u, h);
            add(&sum, &v, 40u, h); add(&sum, &v, 42u, h); add(&sum, &v, 44u, h); add(&sum, &v, 46u, h);
            add(&sum, &v, 48u, h); add(&sum, &v, 50u, h); add(&sum, &v, 52u, h); add(&sum, &v, 54u, h);
            add(&sum, &v, 56u, h); add(&sum, &v, 58u, h); add(&sum, &v, 60u, h); add(&sum, &v, 62u, h);
            add(&sum, &v, 64u, h); add(&sum, &v, 66u, h); add(&sum, &v, 68u, h); add(&sum, &v, 70u, h);
            add(&sum, &v, 72u, h); add(&sum, &v, 74u, h); add(&sum, &v, 76u, h); add(&sum, &v, 78u, h);
            add(&sum, &v, 80u, h); add(&sum, &v, 82u, h); add(&sum, &v, 84u, h); add(&sum, &v, 86u, h);
            add(&sum, &v, 88u, h); add(&sum, &v, 90u, h); add(&sum, &v, 92u, h); add(&sum, &v, 94u, h);
            add(&sum, &v, 96u, h); add(&sum, &v, 98u, h); add(&sum, &v, 100u, h); add(&sum, &v, 102u, h);
            add(&sum, &v, 104u, h); add(&sum, &v, 106u, h); add(&sum, &v, 108u, h); add(&sum, &v, 110u, h);
            add(&sum, &v, 112u, h); add(&sum, &v, 114u, h); add(&sum, &v, 116u, h); add(&sum, &v, 118u, h);
            add(&sum, &v, 120u, h); add(&sum, &v, 122u, h); add(&sum, &v, 124u, h); add(&sum, &v, 126u, h);
            add(&sum, &v, 128u, h); add(&sum, &v, 130u, h); add(&sum, &v, 132u, h); add(&sum, &v, 134u, h);
            add(&sum, &v, 136u, h); add(&sum, &v, 138u, h); add(&sum, &v, 140u, h); add(&sum, &v, 142u, h);
            add(&sum, &v, 144u, h); add(&sum, &v, 146u, h); add(&sum, &v, 148u, h); add(&sum, &v, 150u, h);
            add(&sum, &v, 152u, h); add(&sum, &v, 154u, h); add(&sum, &v, 156u, h); add(&sum, &v, 158u, h);
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

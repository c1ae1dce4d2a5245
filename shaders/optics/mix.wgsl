// Second of three steps that blur an image with a space-variant PSF, for one column frequency kx of one block: forward
// transform in y with the weights of the upper and lower PSF nodes, product with the PSFs of the four nodes, inverse in y.
//
//   X[ky] = sum_n H_n[kx, ky] sum_y A_nx[y] r_ny(y) exp(-2 pi i ky y / 160),   r_0 = 1 - s(y), r_1 = s(y)
//   columns[block, kx, y] = sum_ky X[ky] exp(2 pi i ky y / 160)
// A_nx = spectra (blocks, SIDE, 81, 2), unit of the image; kernels (nodes down, 81, nodes across, 160), ky = a + 10 m at place
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
@group(0) @binding(1) var<storage, read> spectra: array<vec4f>;
@group(0) @binding(2) var<storage, read> kernels: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> columns: array<vec4f>;  // two rows at a time

// Row y of the column at `a` for the left (0) or the right (1) node, weighted by w + y step.
fn load(v: ptr<function, Line>, y: u32, a: u32, side: u32, w: f32, step: f32) {
    var both = vec4f(0.0);
    if (y < SIDE) {
        both = spectra[a + y * 81u];
    }
    (*v)[y] = (w + f32(y) * step) * select(both.xy, both.zw, side == 1u);
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
    let a = block * SIDE * 81u + kx;
    var v: Line;
    var sum: Line;
    for (var node = 0u; node < 4u; node++) {
        let lower = node / 2u;
        let w = select(1.0 - s, s, lower == 1u);
        let by = select(-step, step, lower == 1u);
        let h = (((row / params.per_cell + lower) * 81u + kx) * (params.cells + 1u) + cell + node % 2u) * 80u;
        load(&v, 0u, a, node % 2u, w, by); load(&v, 1u, a, node % 2u, w, by); load(&v, 2u, a, node % 2u, w, by);
        load(&v, 3u, a, node % 2u, w, by); load(&v, 4u, a, node % 2u, w, by); load(&v, 5u, a, node % 2u, w, by);
        load(&v, 6u, a, node % 2u, w, by); load(&v, 7u, a, node % 2u, w, by); load(&v, 8u, a, node % 2u, w, by);
        load(&v, 9u, a, node % 2u, w, by); load(&v, 10u, a, node % 2u, w, by); load(&v, 11u, a, node % 2u, w, by);
        load(&v, 12u, a, node % 2u, w, by); load(&v, 13u, a, node % 2u, w, by); load(&v, 14u, a, node % 2u, w, by);
        load(&v, 15u, a, node % 2u, w, by); load(&v, 16u, a, node % 2u, w, by); load(&v, 17u, a, node % 2u, w, by);
        load(&v, 18u, a, node % 2u, w, by); load(&v, 19u, a, node % 2u, w, by); load(&v, 20u, a, node % 2u, w, by);
        load(&v, 21u, a, node % 2u, w, by); load(&v, 22u, a, node % 2u, w, by); load(&v, 23u, a, node % 2u, w, by);
        load(&v, 24u, a, node % 2u, w, by); load(&v, 25u, a, node % 2u, w, by); load(&v, 26u, a, node % 2u, w, by);
        load(&v, 27u, a, node % 2u, w, by); load(&v, 28u, a, node % 2u, w, by); load(&v, 29u, a, node % 2u, w, by);
        load(&v, 30u, a, node % 2u, w, by); load(&v, 31u, a, node % 2u, w, by); load(&v, 32u, a, node % 2u, w, by);
        load(&v, 33u, a, node % 2u, w, by); load(&v, 34u, a, node % 2u, w, by); load(&v, 35u, a, node % 2u, w, by);
        load(&v, 36u, a, node % 2u, w, by); load(&v, 37u, a, node % 2u, w, by); load(&v, 38u, a, node % 2u, w, by);
        load(&v, 39u, a, node % 2u, w, by); load(&v, 40u, a, node % 2u, w, by); load(&v, 41u, a, node % 2u, w, by);
        load(&v, 42u, a, node % 2u, w, by); load(&v, 43u, a, node % 2u, w, by); load(&v, 44u, a, node % 2u, w, by);
        load(&v, 45u, a, node % 2u, w, by); load(&v, 46u, a, node % 2u, w, by); load(&v, 47u, a, node % 2u, w, by);
        load(&v, 48u, a, node % 2u, w, by); load(&v, 49u, a, node % 2u, w, by); load(&v, 50u, a, node % 2u, w, by);
        load(&v, 51u, a, node % 2u, w, by); load(&v, 52u, a, node % 2u, w, by); load(&v, 53u, a, node % 2u, w, by);
        load(&v, 54u, a, node % 2u, w, by); load(&v, 55u, a, node % 2u, w, by); load(&v, 56u, a, node % 2u, w, by);
        load(&v, 57u, a, node % 2u, w, by); load(&v, 58u, a, node % 2u, w, by); load(&v, 59u, a, node % 2u, w, by);
        load(&v, 60u, a, node % 2u, w, by); load(&v, 61u, a, node % 2u, w, by); load(&v, 62u, a, node % 2u, w, by);
        load(&v, 63u, a, node % 2u, w, by); load(&v, 64u, a, node % 2u, w, by); load(&v, 65u, a, node % 2u, w, by);
        load(&v, 66u, a, node % 2u, w, by); load(&v, 67u, a, node % 2u, w, by); load(&v, 68u, a, node % 2u, w, by);
        load(&v, 69u, a, node % 2u, w, by); load(&v, 70u, a, node % 2u, w, by); load(&v, 71u, a, node % 2u, w, by);
        load(&v, 72u, a, node % 2u, w, by); load(&v, 73u, a, node % 2u, w, by); load(&v, 74u, a, node % 2u, w, by);
        load(&v, 75u, a, node % 2u, w, by); load(&v, 76u, a, node % 2u, w, by); load(&v, 77u, a, node % 2u, w, by);
        load(&v, 78u, a, node % 2u, w, by); load(&v, 79u, a, node % 2u, w, by); load(&v, 80u, a, node % 2u, w, by);
        load(&v, 81u, a, node % 2u, w, by); load(&v, 82u, a, node % 2u, w, by); load(&v, 83u, a, node % 2u, w, by);
        load(&v, 84u, a, node % 2u, w, by); load(&v, 85u, a, node % 2u, w, by); load(&v, 86u, a, node % 2u, w, by);
        load(&v, 87u, a, node % 2u, w, by); load(&v, 88u, a, node % 2u, w, by); load(&v, 89u, a, node % 2u, w, by);
        load(&v, 90u, a, node % 2u, w, by); load(&v, 91u, a, node % 2u, w, by); load(&v, 92u, a, node % 2u, w, by);
        load(&v, 93u, a, node % 2u, w, by); load(&v, 94u, a, node % 2u, w, by); load(&v, 95u, a, node % 2u, w, by);
        load(&v, 96u, a, node % 2u, w, by); load(&v, 97u, a, node % 2u, w, by); load(&v, 98u, a, node % 2u, w, by);
        load(&v, 99u, a, node % 2u, w, by); load(&v, 100u, a, node % 2u, w, by); load(&v, 101u, a, node % 2u, w, by);
        load(&v, 102u, a, node % 2u, w, by); load(&v, 103u, a, node % 2u, w, by);
        load(&v, 104u, a, node % 2u, w, by); load(&v, 105u, a, node % 2u, w, by);
        load(&v, 106u, a, node % 2u, w, by); load(&v, 107u, a, node % 2u, w, by);
        load(&v, 108u, a, node % 2u, w, by); load(&v, 109u, a, node % 2u, w, by);
        load(&v, 110u, a, node % 2u, w, by); load(&v, 111u, a, node % 2u, w, by);
        load(&v, 112u, a, node % 2u, w, by); load(&v, 113u, a, node % 2u, w, by);
        load(&v, 114u, a, node % 2u, w, by); load(&v, 115u, a, node % 2u, w, by);
        load(&v, 116u, a, node % 2u, w, by); load(&v, 117u, a, node % 2u, w, by);
        load(&v, 118u, a, node % 2u, w, by); load(&v, 119u, a, node % 2u, w, by);
        load(&v, 120u, a, node % 2u, w, by); load(&v, 121u, a, node % 2u, w, by);
        load(&v, 122u, a, node % 2u, w, by); load(&v, 123u, a, node % 2u, w, by);
        load(&v, 124u, a, node % 2u, w, by); load(&v, 125u, a, node % 2u, w, by);
        load(&v, 126u, a, node % 2u, w, by); load(&v, 127u, a, node % 2u, w, by);
        load(&v, 128u, a, node % 2u, w, by); load(&v, 129u, a, node % 2u, w, by);
        load(&v, 130u, a, node % 2u, w, by); load(&v, 131u, a, node % 2u, w, by);
        load(&v, 132u, a, node % 2u, w, by); load(&v, 133u, a, node % 2u, w, by);
        load(&v, 134u, a, node % 2u, w, by); load(&v, 135u, a, node % 2u, w, by);
        load(&v, 136u, a, node % 2u, w, by); load(&v, 137u, a, node % 2u, w, by);
        load(&v, 138u, a, node % 2u, w, by); load(&v, 139u, a, node % 2u, w, by);
        load(&v, 140u, a, node % 2u, w, by); load(&v, 141u, a, node % 2u, w, by);
        load(&v, 142u, a, node % 2u, w, by); load(&v, 143u, a, node % 2u, w, by);
        load(&v, 144u, a, node % 2u, w, by); load(&v, 145u, a, node % 2u, w, by);
        load(&v, 146u, a, node % 2u, w, by); load(&v, 147u, a, node % 2u, w, by);
        load(&v, 148u, a, node % 2u, w, by); load(&v, 149u, a, node % 2u, w, by);
        load(&v, 150u, a, node % 2u, w, by); load(&v, 151u, a, node % 2u, w, by);
        load(&v, 152u, a, node % 2u, w, by); load(&v, 153u, a, node % 2u, w, by);
        load(&v, 154u, a, node % 2u, w, by); load(&v, 155u, a, node % 2u, w, by);
        load(&v, 156u, a, node % 2u, w, by); load(&v, 157u, a, node % 2u, w, by);
        load(&v, 158u, a, node % 2u, w, by); load(&v, 159u, a, node % 2u, w, by);
        line_160(&v);
        add(&sum, &v, 0u, h); add(&sum, &v, 2u, h); add(&sum, &v, 4u, h); add(&sum, &v, 6u, h); add(&sum, &v, 8u, h);
        add(&sum, &v, 10u, h); add(&sum, &v, 12u, h); add(&sum, &v, 14u, h); add(&sum, &v, 16u, h);
        add(&sum, &v, 18u, h); add(&sum, &v, 20u, h); add(&sum, &v, 22u, h); add(&sum, &v, 24u, h);
        add(&sum, &v, 26u, h); add(&sum, &v, 28u, h); add(&sum, &v, 30u, h); add(&sum, &v, 32u, h);
        add(&sum, &v, 34u, h); add(&sum, &v, 36u, h); add(&sum, &v, 38u, h); add(&sum, &v, 40u, h);
        add(&sum, &v, 42u, h); add(&sum, &v, 44u, h); add(&sum, &v, 46u, h); add(&sum, &v, 48u, h);
        add(&sum, &v, 50u, h); add(&sum, &v, 52u, h); add(&sum, &v, 54u, h); add(&sum, &v, 56u, h);
        add(&sum, &v, 58u, h); add(&sum, &v, 60u, h); add(&sum, &v, 62u, h); add(&sum, &v, 64u, h);
        add(&sum, &v, 66u, h); add(&sum, &v, 68u, h); add(&sum, &v, 70u, h); add(&sum, &v, 72u, h);
        add(&sum, &v, 74u, h); add(&sum, &v, 76u, h); add(&sum, &v, 78u, h); add(&sum, &v, 80u, h);
        add(&sum, &v, 82u, h); add(&sum, &v, 84u, h); add(&sum, &v, 86u, h); add(&sum, &v, 88u, h);
        add(&sum, &v, 90u, h); add(&sum, &v, 92u, h); add(&sum, &v, 94u, h); add(&sum, &v, 96u, h);
        add(&sum, &v, 98u, h); add(&sum, &v, 100u, h); add(&sum, &v, 102u, h); add(&sum, &v, 104u, h);
        add(&sum, &v, 106u, h); add(&sum, &v, 108u, h); add(&sum, &v, 110u, h); add(&sum, &v, 112u, h);
        add(&sum, &v, 114u, h); add(&sum, &v, 116u, h); add(&sum, &v, 118u, h); add(&sum, &v, 120u, h);
        add(&sum, &v, 122u, h); add(&sum, &v, 124u, h); add(&sum, &v, 126u, h); add(&sum, &v, 128u, h);
        add(&sum, &v, 130u, h); add(&sum, &v, 132u, h); add(&sum, &v, 134u, h); add(&sum, &v, 136u, h);
        add(&sum, &v, 138u, h); add(&sum, &v, 140u, h); add(&sum, &v, 142u, h); add(&sum, &v, 144u, h);
        add(&sum, &v, 146u, h); add(&sum, &v, 148u, h); add(&sum, &v, 150u, h); add(&sum, &v, 152u, h);
        add(&sum, &v, 154u, h); add(&sum, &v, 156u, h); add(&sum, &v, 158u, h);
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

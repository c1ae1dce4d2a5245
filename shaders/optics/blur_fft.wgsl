// First of three steps that blur an image with a space-variant PSF: forward transform of every row of every block.
// The image is cut into square blocks of SIDE samples, `per_cell` along a cell between PSF nodes. With s the position between
// the left and the right node (0..1), the real rows a (1 - s) and a s share one complex transform of 160 samples:
//   Z[k] = sum_x a[y, x] ((1 - s(x)) + i s(x)) exp(-2 pi i k x / 160)
//   A_0 = (Z[k] + conj Z[160-k]) / 2,  A_1 = (Z[k] - conj Z[160-k]) / 2i
// image (rows, 4 stride) in its own unit, SIDE rows and columns for each block -> spectra (blocks, 2, SIDE/2, 81, 2), same
// unit: [block, side, y/2, kx, y%2]. Channels are rows below those of the channel before.
// Dispatch: ceil(lines / 64) workgroups of 64 invocations, one row of one block each; block = across * row + column.
#include "line_160"
#include "texels"

override SIDE: u32 = 128u;  // of a block, samples; a multiple of 4, from 80 to 160

struct Params {
    lines: u32,       // blocks * SIDE
    across: u32,      // blocks in a row of blocks
    per_cell: u32,    // blocks along a cell
    stride: u32,      // of the image, in fours of samples
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var image: texture_2d<f32>;
@group(0) @binding(2) var<storage, read_write> spectra: array<vec2f>;

// Samples x .. x + 3, weighted for the left and the right node; `step` from sample to sample.
fn load(v: ptr<function, Line>, x: u32, at: u32, s: f32, step: f32) {
    var a = vec4f(0.0);
    if (x < SIDE) {
        a = texel(image, at + x / 4u);
    }
    let right = s + (vec4f(0.5, 1.5, 2.5, 3.5) + f32(x)) * step;
    (*v)[x] = a.x * vec2f(1.0 - right.x, right.x);
    (*v)[x + 1u] = a.y * vec2f(1.0 - right.y, right.y);
    (*v)[x + 2u] = a.z * vec2f(1.0 - right.z, right.z);
    (*v)[x + 3u] = a.w * vec2f(1.0 - right.w, right.w);
}

// Frequency k, in slot `i`, and its mirror in slot `j`, told apart.
fn store(v: ptr<function, Line>, i: u32, j: u32, at: u32) {
    let z = 0.5 * (*v)[i];
    let mirror = 0.5 * conj((*v)[j]);
    spectra[at] = z + mirror;
    spectra[at + SIDE * 81u] = -times_i(z - mirror);
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.lines) {
        return;
    }
    let block = id.x / SIDE;
    let y = id.x % SIDE;
    let column = block % params.across;
    let at = (block / params.across * SIDE + y) * params.stride + column * (SIDE / 4u);
    let step = 1.0 / f32(params.per_cell * SIDE);
    let s = f32(column % params.per_cell * SIDE) * step;
    var v: Line;
    load(&v, 0u, at, s, step); load(&v, 4u, at, s, step); load(&v, 8u, at, s, step); load(&v, 12u, at, s, step);
    load(&v, 16u, at, s, step); load(&v, 20u, at, s, step); load(&v, 24u, at, s, step); load(&v, 28u, at, s, step);
    load(&v, 32u, at, s, step); load(&v, 36u, at, s, step); load(&v, 40u, at, s, step); load(&v, 44u, at, s, step);
    load(&v, 48u, at, s, step); load(&v, 52u, at, s, step); load(&v, 56u, at, s, step); load(&v, 60u, at, s, step);
    load(&v, 64u, at, s, step); load(&v, 68u, at, s, step); load(&v, 72u, at, s, step); load(&v, 76u, at, s, step);
    load(&v, 80u, at, s, step); load(&v, 84u, at, s, step); load(&v, 88u, at, s, step); load(&v, 92u, at, s, step);
    load(&v, 96u, at, s, step); load(&v, 100u, at, s, step); load(&v, 104u, at, s, step); load(&v, 108u, at, s, step);
    load(&v, 112u, at, s, step); load(&v, 116u, at, s, step); load(&v, 120u, at, s, step); load(&v, 124u, at, s, step);
    load(&v, 128u, at, s, step); load(&v, 132u, at, s, step); load(&v, 136u, at, s, step); load(&v, 140u, at, s, step);
    load(&v, 144u, at, s, step); load(&v, 148u, at, s, step); load(&v, 152u, at, s, step); load(&v, 156u, at, s, step);
    line_160(&v);
    let line = (block * SIDE + y / 2u) * 162u + y % 2u;
    store(&v, 0u, 0u, line); store(&v, 107u, 92u, line + 2u); store(&v, 54u, 145u, line + 4u);
    store(&v, 153u, 46u, line + 6u); store(&v, 69u, 99u, line + 8u); store(&v, 8u, 31u, line + 10u);
    store(&v, 115u, 84u, line + 12u); store(&v, 62u, 137u, line + 14u); store(&v, 130u, 38u, line + 16u);
    store(&v, 77u, 122u, line + 18u); store(&v, 16u, 23u, line + 20u); store(&v, 123u, 76u, line + 22u);
    store(&v, 39u, 129u, line + 24u); store(&v, 138u, 61u, line + 26u); store(&v, 85u, 114u, line + 28u);
    store(&v, 24u, 15u, line + 30u); store(&v, 100u, 68u, line + 32u); store(&v, 47u, 152u, line + 34u);
    store(&v, 146u, 53u, line + 36u); store(&v, 93u, 106u, line + 38u); store(&v, 1u, 7u, line + 40u);
    store(&v, 108u, 91u, line + 42u); store(&v, 55u, 144u, line + 44u); store(&v, 154u, 45u, line + 46u);
    store(&v, 70u, 98u, line + 48u); store(&v, 9u, 30u, line + 50u); store(&v, 116u, 83u, line + 52u);
    store(&v, 63u, 136u, line + 54u); store(&v, 131u, 37u, line + 56u); store(&v, 78u, 121u, line + 58u);
    store(&v, 17u, 22u, line + 60u); store(&v, 124u, 75u, line + 62u); store(&v, 32u, 128u, line + 64u);
    store(&v, 139u, 60u, line + 66u); store(&v, 86u, 113u, line + 68u); store(&v, 25u, 14u, line + 70u);
    store(&v, 101u, 67u, line + 72u); store(&v, 40u, 159u, line + 74u); store(&v, 147u, 52u, line + 76u);
    store(&v, 94u, 105u, line + 78u); store(&v, 2u, 6u, line + 80u); store(&v, 109u, 90u, line + 82u);
    store(&v, 48u, 151u, line + 84u); store(&v, 155u, 44u, line + 86u); store(&v, 71u, 97u, line + 88u);
    store(&v, 10u, 29u, line + 90u); store(&v, 117u, 82u, line + 92u); store(&v, 56u, 143u, line + 94u);
    store(&v, 132u, 36u, line + 96u); store(&v, 79u, 120u, line + 98u); store(&v, 18u, 21u, line + 100u);
    store(&v, 125u, 74u, line + 102u); store(&v, 33u, 135u, line + 104u); store(&v, 140u, 59u, line + 106u);
    store(&v, 87u, 112u, line + 108u); store(&v, 26u, 13u, line + 110u); store(&v, 102u, 66u, line + 112u);
    store(&v, 41u, 158u, line + 114u); store(&v, 148u, 51u, line + 116u); store(&v, 95u, 104u, line + 118u);
    store(&v, 3u, 5u, line + 120u); store(&v, 110u, 89u, line + 122u); store(&v, 49u, 150u, line + 124u);
    store(&v, 156u, 43u, line + 126u); store(&v, 64u, 96u, line + 128u); store(&v, 11u, 28u, line + 130u);
    store(&v, 118u, 81u, line + 132u); store(&v, 57u, 142u, line + 134u); store(&v, 133u, 35u, line + 136u);
    store(&v, 72u, 127u, line + 138u); store(&v, 19u, 20u, line + 140u); store(&v, 126u, 73u, line + 142u);
    store(&v, 34u, 134u, line + 144u); store(&v, 141u, 58u, line + 146u); store(&v, 80u, 119u, line + 148u);
    store(&v, 27u, 12u, line + 150u); store(&v, 103u, 65u, line + 152u); store(&v, 42u, 157u, line + 154u);
    store(&v, 149u, 50u, line + 156u); store(&v, 88u, 111u, line + 158u); store(&v, 4u, 4u, line + 160u);
}

// Last of three steps that blur an image with a space-variant PSF: inverse transform of two rows of all windows in a row,
// overlapped, added and stored.
//
//   image[y, x] = sum over windows of sum_kx columns[kx, y] exp(2 pi i kx x / 160),  columns[160-kx] = conj columns[kx]
// columns (channels, blocks across, rows/2, 81, 2), unit of the image: [channel, column, y/2, kx, y%2]
// -> image (channels, rows, SIDE (across - 1) + 160), same unit.
// Dispatch: ceil(lines / 8) workgroups of 8 invocations.
#include "line_160"
#include "texels"

override SIDE: u32 = 128u;  // of a block, samples; a multiple of 4, from 80 to 160

struct Params {
    lines: u32,       // channels * rows / 2
    rows: u32,        // of the image
    across: u32,      // blocks in a row of blocks
    first: u32,       // of the image's first channel here, in fours of samples
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var columns: texture_2d<f32>;  // two rows at a time
@group(0) @binding(2) var<storage, read_write> image: array<vec4f>;

// Frequency kx of both rows, f + i g, with real and imaginary parts exchanged; `slot` as common/line_160 has it.
fn load(v: ptr<function, Line>, slot: u32, at: u32) {
    let f = texel(columns, at);
    (*v)[slot] = vec2f(f.y + f.z, f.x - f.w);
}

// The same, and its mirror image: conj f + i conj g.
fn load_both(v: ptr<function, Line>, slot: u32, mirror: u32, at: u32) {
    let f = texel(columns, at);
    (*v)[slot] = vec2f(f.y + f.z, f.x - f.w);
    (*v)[mirror] = vec2f(f.z - f.y, f.x + f.w);
}

// Four samples of both rows.
fn put(at: u32, stride: u32, a: vec2f, b: vec2f, c: vec2f, d: vec2f) {
    image[at] = vec4f(a.y, b.y, c.y, d.y);
    image[at + stride] = vec4f(a.x, b.x, c.x, d.x);
}

// Stores samples x .. x + 3 of the block with the rest of the window before, and keeps what goes to the next.
fn add(v: ptr<function, Line>, rest: ptr<function, Line>, x: u32, at: u32, stride: u32) {
    if (x < SIDE) {
        put(at + x / 4u, stride, (*v)[x] + (*rest)[x], (*v)[x + 1u] + (*rest)[x + 1u],
            (*v)[x + 2u] + (*rest)[x + 2u], (*v)[x + 3u] + (*rest)[x + 3u]);
    }
    if (x < 160u - SIDE) {
        (*rest)[x] = (*v)[x + SIDE];
        (*rest)[x + 1u] = (*v)[x + SIDE + 1u];
        (*rest)[x + 2u] = (*v)[x + SIDE + 2u];
        (*rest)[x + 3u] = (*v)[x + SIDE + 3u];
    }
}

fn finish(rest: ptr<function, Line>, x: u32, at: u32, stride: u32) {
    if (x < 160u - SIDE) {
        put(at + x / 4u, stride, (*rest)[x], (*rest)[x + 1u], (*rest)[x + 2u], (*rest)[x + 3u]);
    }
}

@compute @workgroup_size(8, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.lines) {
        return;
    }
    let stride = ((params.across - 1u) * SIDE + 160u) / 4u;  // of the image, in fours of samples
    let pairs = params.rows / 2u;
    var from_ = (id.x / pairs * params.across * pairs + id.x % pairs) * 81u;
    var at = params.first + 2u * id.x * stride;
    var v: Line;
    var rest: Line;
    for (var column = 0u; column < params.across; column++) {
        load(&v, 0u, from_); load_both(&v, 107u, 92u, from_ + 1u); load_both(&v, 54u, 145u, from_ + 2u);
        load_both(&v, 153u, 46u, from_ + 3u); load_both(&v, 69u, 99u, from_ + 4u); load_both(&v, 8u, 31u, from_ + 5u);
        load_both(&v, 115u, 84u, from_ + 6u); load_both(&v, 62u, 137u, from_ + 7u); load_both(&v, 130u, 38u, from_ + 8u);
        load_both(&v, 77u, 122u, from_ + 9u); load_both(&v, 16u, 23u, from_ + 10u); load_both(&v, 123u, 76u, from_ + 11u);
        load_both(&v, 39u, 129u, from_ + 12u); load_both(&v, 138u, 61u, from_ + 13u);
        load_both(&v, 85u, 114u, from_ + 14u); load_both(&v, 24u, 15u, from_ + 15u); load_both(&v, 100u, 68u, from_ + 16u);
        load_both(&v, 47u, 152u, from_ + 17u); load_both(&v, 146u, 53u, from_ + 18u);
        load_both(&v, 93u, 106u, from_ + 19u); load_both(&v, 1u, 7u, from_ + 20u); load_both(&v, 108u, 91u, from_ + 21u);
        load_both(&v, 55u, 144u, from_ + 22u); load_both(&v, 154u, 45u, from_ + 23u); load_both(&v, 70u, 98u, from_ + 24u);
        load_both(&v, 9u, 30u, from_ + 25u); load_both(&v, 116u, 83u, from_ + 26u); load_both(&v, 63u, 136u, from_ + 27u);
        load_both(&v, 131u, 37u, from_ + 28u); load_both(&v, 78u, 121u, from_ + 29u); load_both(&v, 17u, 22u, from_ + 30u);
        load_both(&v, 124u, 75u, from_ + 31u); load_both(&v, 32u, 128u, from_ + 32u);
        load_both(&v, 139u, 60u, from_ + 33u); load_both(&v, 86u, 113u, from_ + 34u); load_both(&v, 25u, 14u, from_ + 35u);
        load_both(&v, 101u, 67u, from_ + 36u); load_both(&v, 40u, 159u, from_ + 37u);
        load_both(&v, 147u, 52u, from_ + 38u); load_both(&v, 94u, 105u, from_ + 39u); load_both(&v, 2u, 6u, from_ + 40u);
        load_both(&v, 109u, 90u, from_ + 41u); load_both(&v, 48u, 151u, from_ + 42u);
        load_both(&v, 155u, 44u, from_ + 43u); load_both(&v, 71u, 97u, from_ + 44u); load_both(&v, 10u, 29u, from_ + 45u);
        load_both(&v, 117u, 82u, from_ + 46u); load_both(&v, 56u, 143u, from_ + 47u);
        load_both(&v, 132u, 36u, from_ + 48u); load_both(&v, 79u, 120u, from_ + 49u); load_both(&v, 18u, 21u, from_ + 50u);
        load_both(&v, 125u, 74u, from_ + 51u); load_both(&v, 33u, 135u, from_ + 52u);
        load_both(&v, 140u, 59u, from_ + 53u); load_both(&v, 87u, 112u, from_ + 54u); load_both(&v, 26u, 13u, from_ + 55u);
        load_both(&v, 102u, 66u, from_ + 56u); load_both(&v, 41u, 158u, from_ + 57u);
        load_both(&v, 148u, 51u, from_ + 58u); load_both(&v, 95u, 104u, from_ + 59u); load_both(&v, 3u, 5u, from_ + 60u);
        load_both(&v, 110u, 89u, from_ + 61u); load_both(&v, 49u, 150u, from_ + 62u);
        load_both(&v, 156u, 43u, from_ + 63u); load_both(&v, 64u, 96u, from_ + 64u); load_both(&v, 11u, 28u, from_ + 65u);
        load_both(&v, 118u, 81u, from_ + 66u); load_both(&v, 57u, 142u, from_ + 67u);
        load_both(&v, 133u, 35u, from_ + 68u); load_both(&v, 72u, 127u, from_ + 69u); load_both(&v, 19u, 20u, from_ + 70u);
        load_both(&v, 126u, 73u, from_ + 71u); load_both(&v, 34u, 134u, from_ + 72u);
        load_both(&v, 141u, 58u, from_ + 73u); load_both(&v, 80u, 119u, from_ + 74u); load_both(&v, 27u, 12u, from_ + 75u);
        load_both(&v, 103u, 65u, from_ + 76u); load_both(&v, 42u, 157u, from_ + 77u);
        load_both(&v, 149u, 50u, from_ + 78u); load_both(&v, 88u, 111u, from_ + 79u); load(&v, 4u, from_ + 80u);
        line_160_back(&v);
        add(&v, &rest, 0u, at, stride); add(&v, &rest, 4u, at, stride); add(&v, &rest, 8u, at, stride);
        add(&v, &rest, 12u, at, stride); add(&v, &rest, 16u, at, stride); add(&v, &rest, 20u, at, stride);
        add(&v, &rest, 24u, at, stride); add(&v, &rest, 28u, at, stride); add(&v, &rest, 32u, at, stride);
        add(&v, &rest, 36u, at, stride); add(&v, &rest, 40u, at, stride); add(&v, &rest, 44u, at, stride);
        add(&v, &rest, 48u, at, stride); add(&v, &rest, 52u, at, stride); add(&v, &rest, 56u, at, stride);
        add(&v, &rest, 60u, at, stride); add(&v, &rest, 64u, at, stride); add(&v, &rest, 68u, at, stride);
        add(&v, &rest, 72u, at, stride); add(&v, &rest, 76u, at, stride); add(&v, &rest, 80u, at, stride);
        add(&v, &rest, 84u, at, stride); add(&v, &rest, 88u, at, stride); add(&v, &rest, 92u, at, stride);
        add(&v, &rest, 96u, at, stride); add(&v, &rest, 100u, at, stride); add(&v, &rest, 104u, at, stride);
        add(&v, &rest, 108u, at, stride); add(&v, &rest, 112u, at, stride); add(&v, &rest, 116u, at, stride);
        add(&v, &rest, 120u, at, stride); add(&v, &rest, 124u, at, stride); add(&v, &rest, 128u, at, stride);
        add(&v, &rest, 132u, at, stride); add(&v, &rest, 136u, at, stride); add(&v, &rest, 140u, at, stride);
        add(&v, &rest, 144u, at, stride); add(&v, &rest, 148u, at, stride); add(&v, &rest, 152u, at, stride);
        add(&v, &rest, 156u, at, stride);
        from_ += pairs * 81u;
        at += SIDE / 4u;
    }
    finish(&rest, 0u, at, stride); finish(&rest, 4u, at, stride); finish(&rest, 8u, at, stride);
    finish(&rest, 12u, at, stride); finish(&rest, 16u, at, stride); finish(&rest, 20u, at, stride);
    finish(&rest, 24u, at, stride); finish(&rest, 28u, at, stride); finish(&rest, 32u, at, stride);
    finish(&rest, 36u, at, stride); finish(&rest, 40u, at, stride); finish(&rest, 44u, at, stride);
    finish(&rest, 48u, at, stride); finish(&rest, 52u, at, stride); finish(&rest, 56u, at, stride);
    finish(&rest, 60u, at, stride); finish(&rest, 64u, at, stride); finish(&rest, 68u, at, stride);
    finish(&rest, 72u, at, stride); finish(&rest, 76u, at, stride);
}

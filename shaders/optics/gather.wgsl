// Last of three steps that blur an image with a space-variant PSF: inverse transform of two rows of the windows of a row of
// blocks, overlapped, added and stored.
//
//   image[y, x] = sum over windows of sum_kx columns[kx, y] exp(2 pi i kx x / 160),  columns[160-kx] = conj columns[kx]
// What a window shares with the next in its row stays at hand. Windows of neighbouring rows share image rows: the even rows of
// blocks go first and store, then the odd ones add.
// columns (blocks, 81, 160), unit of the image -> image (SIDE * rows of blocks + 160, 4 stride) of a channel, same unit.
// Dispatch: ceil(lines / 8) workgroups of 8 invocations.
#include "line_160"

override SIDE: u32 = 128u;  // of a block, samples; a multiple of 4, from 80 to 160

struct Params {
    lines: u32,       // rows of blocks of this parity * 80
    across: u32,      // blocks in a row of blocks
    down: u32,        // rows of blocks
    stride: u32,      // of the image, in fours of samples
    parity: u32,      // of the rows of blocks
    first: u32,       // of the image's channel, in fours of samples
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> columns: array<vec4f>;  // two rows at a time
@group(0) @binding(2) var<storage, read_write> image: array<vec4f>;

// Frequency kx of both rows, f + i g, with real and imaginary parts exchanged; `slot` as common/line_160 has it.
fn load(v: ptr<function, Line>, slot: u32, kx: u32, at: u32) {
    let f = columns[at + 80u * kx];
    (*v)[slot] = vec2f(f.y + f.z, f.x - f.w);
}

// The same, and its mirror image: conj f + i conj g.
fn load_both(v: ptr<function, Line>, slot: u32, mirror: u32, kx: u32, at: u32) {
    let f = columns[at + 80u * kx];
    (*v)[slot] = vec2f(f.y + f.z, f.x - f.w);
    (*v)[mirror] = vec2f(f.z - f.y, f.x + f.w);
}

// Four samples of both rows, on top of what the odd rows find there.
fn put(x: u32, at: u32, shared_: bool, a: vec2f, b: vec2f, c: vec2f, d: vec2f) {
    var upper = vec4f(a.y, b.y, c.y, d.y);
    var lower = vec4f(a.x, b.x, c.x, d.x);
    let i = at + x / 4u;
    if (shared_) {
        upper += image[i];
        lower += image[i + params.stride];
    }
    image[i] = upper;
    image[i + params.stride] = lower;
}

// Stores samples x .. x + 3 of the block with the rest of the window before, and keeps what goes to the next.
fn add(v: ptr<function, Line>, rest: ptr<function, Line>, x: u32, at: u32, shared_: bool) {
    if (x < SIDE) {
        put(x, at, shared_, (*v)[x] + (*rest)[x], (*v)[x + 1u] + (*rest)[x + 1u],
            (*v)[x + 2u] + (*rest)[x + 2u], (*v)[x + 3u] + (*rest)[x + 3u]);
    }
    if (x < 160u - SIDE) {
        (*rest)[x] = (*v)[x + SIDE];
        (*rest)[x + 1u] = (*v)[x + SIDE + 1u];
        (*rest)[x + 2u] = (*v)[x + SIDE + 2u];
        (*rest)[x + 3u] = (*v)[x + SIDE + 3u];
    }
}

fn finish(rest: ptr<function, Line>, x: u32, at: u32, shared_: bool) {
    if (x < 160u - SIDE) {
        put(x, at, shared_, (*rest)[x], (*rest)[x + 1u], (*rest)[x + 2u], (*rest)[x + 3u]);
    }
}

@compute @workgroup_size(8, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.lines) {
        return;
    }
    let pair = id.x % 80u;
    let row = id.x / 80u * 2u + params.parity;
    let shared_ = params.parity == 1u
        && (2u * pair < 160u - SIDE || (2u * pair >= SIDE && row + 1u < params.down));
    var from_ = row * params.across * 81u * 80u + pair;
    var at = params.first + (row * SIDE + 2u * pair) * params.stride;
    var v: Line;
    var rest: Line;
    for (var column = 0u; column < params.across; column++) {
        load(&v, 0u, 0u, from_);
        load_both(&v, 16u, 159u, 1u, from_); load_both(&v, 32u, 143u, 2u, from_);
        load_both(&v, 48u, 127u, 3u, from_); load_both(&v, 64u, 111u, 4u, from_); load_both(&v, 80u, 95u, 5u, from_);
        load_both(&v, 96u, 79u, 6u, from_); load_both(&v, 112u, 63u, 7u, from_); load_both(&v, 128u, 47u, 8u, from_);
        load_both(&v, 144u, 31u, 9u, from_); load_both(&v, 1u, 15u, 10u, from_);
        load_both(&v, 17u, 158u, 11u, from_); load_both(&v, 33u, 142u, 12u, from_);
        load_both(&v, 49u, 126u, 13u, from_); load_both(&v, 65u, 110u, 14u, from_);
        load_both(&v, 81u, 94u, 15u, from_); load_both(&v, 97u, 78u, 16u, from_);
        load_both(&v, 113u, 62u, 17u, from_); load_both(&v, 129u, 46u, 18u, from_);
        load_both(&v, 145u, 30u, 19u, from_); load_both(&v, 2u, 14u, 20u, from_);
        load_both(&v, 18u, 157u, 21u, from_); load_both(&v, 34u, 141u, 22u, from_);
        load_both(&v, 50u, 125u, 23u, from_); load_both(&v, 66u, 109u, 24u, from_);
        load_both(&v, 82u, 93u, 25u, from_); load_both(&v, 98u, 77u, 26u, from_);
        load_both(&v, 114u, 61u, 27u, from_); load_both(&v, 130u, 45u, 28u, from_);
        load_both(&v, 146u, 29u, 29u, from_); load_both(&v, 3u, 13u, 30u, from_);
        load_both(&v, 19u, 156u, 31u, from_); load_both(&v, 35u, 140u, 32u, from_);
        load_both(&v, 51u, 124u, 33u, from_); load_both(&v, 67u, 108u, 34u, from_);
        load_both(&v, 83u, 92u, 35u, from_); load_both(&v, 99u, 76u, 36u, from_);
        load_both(&v, 115u, 60u, 37u, from_); load_both(&v, 131u, 44u, 38u, from_);
        load_both(&v, 147u, 28u, 39u, from_); load_both(&v, 4u, 12u, 40u, from_);
        load_both(&v, 20u, 155u, 41u, from_); load_both(&v, 36u, 139u, 42u, from_);
        load_both(&v, 52u, 123u, 43u, from_); load_both(&v, 68u, 107u, 44u, from_);
        load_both(&v, 84u, 91u, 45u, from_); load_both(&v, 100u, 75u, 46u, from_);
        load_both(&v, 116u, 59u, 47u, from_); load_both(&v, 132u, 43u, 48u, from_);
        load_both(&v, 148u, 27u, 49u, from_); load_both(&v, 5u, 11u, 50u, from_);
        load_both(&v, 21u, 154u, 51u, from_); load_both(&v, 37u, 138u, 52u, from_);
        load_both(&v, 53u, 122u, 53u, from_); load_both(&v, 69u, 106u, 54u, from_);
        load_both(&v, 85u, 90u, 55u, from_); load_both(&v, 101u, 74u, 56u, from_);
        load_both(&v, 117u, 58u, 57u, from_); load_both(&v, 133u, 42u, 58u, from_);
        load_both(&v, 149u, 26u, 59u, from_); load_both(&v, 6u, 10u, 60u, from_);
        load_both(&v, 22u, 153u, 61u, from_); load_both(&v, 38u, 137u, 62u, from_);
        load_both(&v, 54u, 121u, 63u, from_); load_both(&v, 70u, 105u, 64u, from_);
        load_both(&v, 86u, 89u, 65u, from_); load_both(&v, 102u, 73u, 66u, from_);
        load_both(&v, 118u, 57u, 67u, from_); load_both(&v, 134u, 41u, 68u, from_);
        load_both(&v, 150u, 25u, 69u, from_); load_both(&v, 7u, 9u, 70u, from_);
        load_both(&v, 23u, 152u, 71u, from_); load_both(&v, 39u, 136u, 72u, from_);
        load_both(&v, 55u, 120u, 73u, from_); load_both(&v, 71u, 104u, 74u, from_);
        load_both(&v, 87u, 88u, 75u, from_); load_both(&v, 103u, 72u, 76u, from_);
        load_both(&v, 119u, 56u, 77u, from_); load_both(&v, 135u, 40u, 78u, from_);
        load_both(&v, 151u, 24u, 79u, from_);
        load(&v, 8u, 80u, from_);
        line_160_back(&v);
        add(&v, &rest, 0u, at, shared_); add(&v, &rest, 4u, at, shared_); add(&v, &rest, 8u, at, shared_);
        add(&v, &rest, 12u, at, shared_); add(&v, &rest, 16u, at, shared_); add(&v, &rest, 20u, at, shared_);
        add(&v, &rest, 24u, at, shared_); add(&v, &rest, 28u, at, shared_); add(&v, &rest, 32u, at, shared_);
        add(&v, &rest, 36u, at, shared_); add(&v, &rest, 40u, at, shared_); add(&v, &rest, 44u, at, shared_);
        add(&v, &rest, 48u, at, shared_); add(&v, &rest, 52u, at, shared_); add(&v, &rest, 56u, at, shared_);
        add(&v, &rest, 60u, at, shared_); add(&v, &rest, 64u, at, shared_); add(&v, &rest, 68u, at, shared_);
        add(&v, &rest, 72u, at, shared_); add(&v, &rest, 76u, at, shared_); add(&v, &rest, 80u, at, shared_);
        add(&v, &rest, 84u, at, shared_); add(&v, &rest, 88u, at, shared_); add(&v, &rest, 92u, at, shared_);
        add(&v, &rest, 96u, at, shared_); add(&v, &rest, 100u, at, shared_); add(&v, &rest, 104u, at, shared_);
        add(&v, &rest, 108u, at, shared_); add(&v, &rest, 112u, at, shared_); add(&v, &rest, 116u, at, shared_);
        add(&v, &rest, 120u, at, shared_); add(&v, &rest, 124u, at, shared_); add(&v, &rest, 128u, at, shared_);
        add(&v, &rest, 132u, at, shared_); add(&v, &rest, 136u, at, shared_); add(&v, &rest, 140u, at, shared_);
        add(&v, &rest, 144u, at, shared_); add(&v, &rest, 148u, at, shared_); add(&v, &rest, 152u, at, shared_);
        add(&v, &rest, 156u, at, shared_);
        from_ += 81u * 80u;
        at += SIDE / 4u;
    }
    finish(&rest, 0u, at, shared_); finish(&rest, 4u, at, shared_); finish(&rest, 8u, at, shared_);
    finish(&rest, 12u, at, shared_); finish(&rest, 16u, at, shared_); finish(&rest, 20u, at, shared_);
    finish(&rest, 24u, at, shared_); finish(&rest, 28u, at, shared_); finish(&rest, 32u, at, shared_);
    finish(&rest, 36u, at, shared_); finish(&rest, 40u, at, shared_); finish(&rest, 44u, at, shared_);
    finish(&rest, 48u, at, shared_); finish(&rest, 52u, at, shared_); finish(&rest, 56u, at, shared_);
    finish(&rest, 60u, at, shared_); finish(&rest, 64u, at, shared_); finish(&rest, 68u, at, shared_);
    finish(&rest, 72u, at, shared_); finish(&rest, 76u, at, shared_);
}

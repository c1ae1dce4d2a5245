// Packing: from values to whole numbers of 8 or 16 bits, halves rounded up.
//   code = floor(most clamp(value, 0, 1) + 1/2),   most 255 or 65535
// Units: 1 is white. In: values (3, pixels), the fours of pixels of one plane after another. Out: codes (pixels), red,
// green, blue and nothing: 8 bits each in one word, red lowest; with WIDE 16 bits each in two.
// Dispatch: ceil(fours/64) workgroups of 64, up to 65535 along x and the rest along y, four pixels each.

override WIDE: bool = false;

struct Params {
    fours: u32,
    wide: u32,           // invocations along x
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> codes: array<vec4u>;

// Depends on the global values: four codes of one colour.
fn four(at: u32, most: f32) -> vec4u {
    return vec4u(most * clamp(values[at], vec4f(0.0), vec4f(1.0)) + 0.5);
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let at = id.y * params.wide + id.x;
    if (at >= params.fours) {
        return;
    }
    let most = select(255.0, 65535.0, WIDE);
    let red = four(at, most);
    let green = four(params.fours + at, most);
    let blue = four(2u * params.fours + at, most);
    if (WIDE) {
        let low = red | (green << vec4u(16u));
        codes[2u * at] = vec4u(low.x, blue.x, low.y, blue.y);
        codes[2u * at + 1u] = vec4u(low.z, blue.z, low.w, blue.w);
    } else {
        codes[at] = red | (green << vec4u(8u)) | (blue << vec4u(16u));
    }
}

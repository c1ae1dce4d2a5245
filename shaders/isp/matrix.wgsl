// Colour matrix: from the camera's balanced colours to those of the picture.
//   colours = M planes
// Units: light, 1 is white in each. In: planes (COLOURS, rows, cols), the fours of pixels of one after another. Out:
// colours (3, rows, cols); rows times cols is a multiple of 4.
// Dispatch: ceil(fours/64) workgroups of 64, up to 65535 along x and the rest along y, four pixels each.

override COLOURS: u32;                  // of the camera, up to 8

struct Params {
    fours: u32,          // rows times cols over 4
    wide: u32,           // invocations along x
    red: array<vec4f, 2>,    // rows of M, zeros behind the last colour
    green: array<vec4f, 2>,
    blue: array<vec4f, 2>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> planes: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> colours: array<vec4f>;

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let at = id.y * params.wide + id.x;
    if (at >= params.fours) {
        return;
    }
    var red = vec4f(0.0);
    var green = vec4f(0.0);
    var blue = vec4f(0.0);
    for (var colour = 0u; colour < COLOURS; colour++) {
        let value = planes[colour * params.fours + at];
        red += params.red[colour / 4u][colour % 4u] * value;
        green += params.green[colour / 4u][colour % 4u] * value;
        blue += params.blue[colour / 4u][colour % 4u] * value;
    }
    colours[at] = red;
    colours[params.fours + at] = green;
    colours[2u * params.fours + at] = blue;
}

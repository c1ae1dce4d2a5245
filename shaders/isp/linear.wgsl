// Black level and linearisation: from the codes of a raw file to light.
//   light = (table[code] - black[site]) scale      0 is black, 1 saturation; noise below black stays negative
// table: what DNG's LinearizationTable makes of a code; compiled away where there is none. black: of each site of the
// pattern of black levels, with what shielded pixels collected. scale: 1 / (saturation - black).
// Units: codes in; table and black in its units; light relative to saturation.
// In: codes (rows, cols/2), two of 16 bits to a word, the left one low; table (codes); black (PY, PX).
// Out: light (rows, cols); cols is a multiple of 4.
// Dispatch: ceil(cols/64) x ceil(rows/16) workgroups of 16 x 16, four pixels of a row each.

override TABLE: bool = false;
override PY: u32 = 1u;                  // rows and columns of the pattern of black levels
override PX: u32 = 1u;

struct Params {
    rows: u32,
    fours: u32,     // cols/4
    scale: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> codes: array<vec2u>;
@group(0) @binding(2) var<storage, read> table: array<f32>;
@group(0) @binding(3) var<storage, read> black: array<f32>;
@group(0) @binding(4) var<storage, read_write> light: array<vec4f>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= params.fours || id.y >= params.rows) {
        return;
    }
    let at = id.y * params.fours + id.x;
    let pairs = codes[at];
    let each = vec4u(pairs.x & 0xffffu, pairs.x >> 16u, pairs.y & 0xffffu, pairs.y >> 16u);
    var level = vec4f(each);
    if (TABLE) {
        level = vec4f(table[each.x], table[each.y], table[each.z], table[each.w]);
    }
    let row = id.y % PY * PX;
    let col = 4u * id.x;
    let zero = vec4f(black[row + col % PX], black[row + (col + 1u) % PX], black[row + (col + 2u) % PX], black[row + (col + 3u) % PX]);
    light[at] = (level - zero) * params.scale;
}

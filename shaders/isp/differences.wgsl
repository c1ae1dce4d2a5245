// Directional demosaicing, first of four stages: green at red and blue sites, along the row and along the column, by a
// filter of five taps; of it the colour differences (Menon, Andriani and Calvagno 2007, section II-A; the filter of
// Hamilton and Adams 1997).
//   green = (g[-1] + g[1])/2 + (2 c[0] - c[-2] - c[2])/4,   difference = c[0] - green
// Units: light relative to saturation. In: light (rows, cols), red at even rows and columns, both numbers even. Out:
// differences (rows/2, cols/2, 4), of each cell of 2 x 2: red along the row, red along the column, blue along the row,
// blue along the column; the cells at the rim are not written.
// Dispatch: ceil((cols/2 - 2)/16) x ceil((rows/2 - 2)/16) workgroups of 16 x 16, one cell each.

struct Params {
    rows: u32,
    pairs: u32,     // cols/2
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> light: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> differences: array<vec4f>;

// What is left of c without the green between: the sum of the next greens, that of the next of its own colour.
fn difference(c: f32, greens: f32, own: f32) -> f32 {
    return 0.5 * (c - greens) + 0.25 * own;
}

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x + 2u >= params.pairs || 2u * id.y + 4u >= params.rows) {
        return;
    }
    let row = params.pairs;
    let at = (2u * id.y + 2u) * row + id.x + 1u;
    let above = light[at - row];
    let c0 = light[at - 1u];
    let c1 = light[at];
    let c2 = light[at + 1u];
    let d0 = light[at + row - 1u];
    let d1 = light[at + row];
    let d2 = light[at + row + 1u];
    let below = light[at + 2u * row];
    differences[(id.y + 1u) * row + id.x + 1u] = vec4f(
        difference(c1.x, c0.y + c1.y, c0.x + c2.x),
        difference(c1.x, above.x + d1.x, light[at - 2u * row].x + below.x),
        difference(d1.y, d1.x + d2.x, d0.y + d2.y),
        difference(d1.y, c1.y + below.y, above.y + light[at + 3u * row].y),
    );
}

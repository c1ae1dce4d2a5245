// Directional demosaicing, second of four stages: each red and blue site takes the difference along the row or along the
// column, whichever changes less around it (Menon, Andriani and Calvagno 2007, section II-B).
//   change along the row = sum of weight |difference - the next one along the row|, of the sites within 5 x 5: on the
//   site's own row weight 3, two rows away 1; of the other colour, one row away, 1. Along the column alike.
// Equal changes take the row.
// Units: light relative to saturation. In: differences (rows, cols, 4), of cells, as stage differences writes them. Out:
// chosen (rows, cols, 4): difference of red, of blue; then 1 where red's is along the row, 0 along the column; the same
// of blue. The cells at the rim are not written.
// Dispatch: ceil((cols - 2)/16) x ceil((rows - 2)/16) workgroups of 16 x 16, one cell each.

struct Params {
    rows: u32,      // of cells
    cols: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> differences: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> chosen: array<vec4f>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x + 2u >= params.cols || id.y + 2u >= params.rows) {
        return;
    }
    var at = id.y * params.cols + id.x;
    let a0 = differences[at];
    let a1 = differences[at + 1u];
    let a2 = differences[at + 2u];
    at += params.cols;
    let b0 = differences[at];
    let b1 = differences[at + 1u];
    let b2 = differences[at + 2u];
    at += params.cols;
    let c0 = differences[at];
    let c1 = differences[at + 1u];
    let c2 = differences[at + 2u];
    // Own colour: steps along the row (x, z) and along the column (y, w), of red and of blue at once.
    let rows = abs(a0 - a1) + abs(a1 - a2) + 3.0 * (abs(b0 - b1) + abs(b1 - b2)) + abs(c0 - c1) + abs(c1 - c2);
    let cols = abs(a0 - b0) + abs(b0 - c0) + 3.0 * (abs(a1 - b1) + abs(b1 - c1)) + abs(a2 - b2) + abs(b2 - c2);
    // The other colour: blue's cells lie above and left of red's site, red's below and right of blue's.
    let red_row = rows.x + abs(a0.z - a1.z) + abs(b0.z - b1.z);
    let red_col = cols.y + abs(a0.w - b0.w) + abs(a1.w - b1.w);
    let blue_row = rows.z + abs(b1.x - b2.x) + abs(c1.x - c2.x);
    let blue_col = cols.w + abs(b1.y - c1.y) + abs(b2.y - c2.y);
    let red = red_row <= red_col;
    let blue = blue_row <= blue_col;
    chosen[at - params.cols + 1u] = vec4f(
        select(b1.y, b1.x, red),
        select(b1.w, b1.z, blue),
        select(0.0, 1.0, red),
        select(0.0, 1.0, blue),
    );
}

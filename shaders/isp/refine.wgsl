// Directional demosaicing, third of four stages: the differences of red and blue to green, smoothed along the direction
// that was chosen (Menon, Andriani and Calvagno 2007, section II-D: the mean of the site's and of those at the greens
// beside it, each of which is the mean of two sites').
//   refined = (previous + 4 own + next)/6
// Units: light relative to saturation. In: chosen (rows, cols, 4), of cells, as stage direction writes it. Out: refined
// (rows, cols, 2): of red, of blue; the cells at the rim are not written.
// Dispatch: ceil((cols - 2)/16) x ceil((rows - 2)/16) workgroups of 16 x 16, one cell each.

struct Params {
    rows: u32,      // of cells
    cols: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> chosen: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> refined: array<vec2f>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x + 2u >= params.cols || id.y + 2u >= params.rows) {
        return;
    }
    let at = (id.y + 1u) * params.cols + id.x + 1u;
    let own = chosen[at];
    let along_row = chosen[at - 1u].xy + chosen[at + 1u].xy;
    let along_col = chosen[at - params.cols].xy + chosen[at + params.cols].xy;
    refined[at] = (4.0 * own.xy + select(along_col, along_row, own.zw > vec2f(0.5))) / 6.0;
}

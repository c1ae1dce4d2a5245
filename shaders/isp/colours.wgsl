// Directional demosaicing, last of four stages: all colours at every pixel, from the differences to green (Menon,
// Andriani and Calvagno 2007, sections II-C and II-D).
//   green at red and blue: light - refined difference
//   red at green: green + the mean of the refined differences of the two red sites beside it, on its row or its column;
//   blue alike
//   red at blue: light + (first guess + the red less blue at the two greens beside it, along the direction)/3, where the
//   first guess is the mean of the same two before refinement; blue at red alike
// Units: light relative to saturation. In: light (2 rows, 2 cols), red at even rows and columns; chosen, refined, of cells
// (rows, cols), as the stages of these names write them. Out: planes (3, 2 rows, 2 cols): red, green, blue; the cells at
// the rim are not written.
// Dispatch: ceil((cols - 2)/16) x ceil((rows - 2)/16) workgroups of 16 x 16, one cell each.

struct Params {
    rows: u32,      // of cells
    cols: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> light: array<vec2f>;
@group(0) @binding(2) var<storage, read> chosen: array<vec4f>;
@group(0) @binding(3) var<storage, read> refined: array<vec2f>;
@group(0) @binding(4) var<storage, read_write> planes: array<vec2f>;

struct Contrast {
    at_red: f32,    // blue less red, the mean of the two greens beside the site
    at_blue: f32,   // red less blue
}

// Differences of red (x) and blue (y): rows a, b, c of cells, 1 in the middle; the direction at red and at blue.
fn contrast(a0: vec2f, a1: vec2f, b0: vec2f, b1: vec2f, b2: vec2f, c1: vec2f, c2: vec2f, row: vec2<bool>) -> Contrast {
    // Twice red less blue at the four greens around red: right, left, below, above.
    let right = b1.x + b2.x - a1.y - b1.y;
    let left = b0.x + b1.x - a0.y - b0.y;
    let below = b1.x + c1.x - b0.y - b1.y;
    let above = a1.x + b1.x - a0.y - a1.y;
    // And around blue: left is `below`, above is `right`.
    let far_right = b2.x + c2.x - b1.y - b2.y;
    let far_below = c1.x + c2.x - b1.y - c1.y;
    let at_red = select(above + below, left + right, row.x);
    let at_blue = select(right + far_below, below + far_right, row.y);
    return Contrast(-0.25 * at_red, 0.25 * at_blue);
}

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x + 2u >= params.cols || id.y + 2u >= params.rows) {
        return;
    }
    let b = (id.y + 1u) * params.cols + id.x + 1u;
    let a = b - params.cols;
    let c = b + params.cols;
    let own = chosen[b];
    let row = own.zw > vec2f(0.5);
    let first = contrast(
        chosen[a - 1u].xy, chosen[a].xy, chosen[b - 1u].xy, own.xy, chosen[b + 1u].xy,
        chosen[c].xy, chosen[c + 1u].xy, row,
    );
    let a1 = refined[a];
    let b0 = refined[b - 1u];
    let b1 = refined[b];
    let b2 = refined[b + 1u];
    let c1 = refined[c];
    let second = contrast(
        refined[a - 1u], a1, b0, b1, b2, c1, refined[c + 1u], row,
    );
    let here = 2u * (id.y + 1u) * params.cols + id.x + 1u;
    let there = here + params.cols;
    let top = light[here];
    let bottom = light[there];
    let plane = 2u * params.rows * params.cols;
    planes[here] = vec2f(top.x, top.y + 0.5 * (b1.x + b2.x));
    planes[there] = vec2f(
        bottom.x + 0.5 * (b1.x + c1.x),
        bottom.y + (first.at_blue + 2.0 * second.at_blue) / 3.0,
    );
    planes[plane + here] = vec2f(top.x - b1.x, top.y);
    planes[plane + there] = vec2f(bottom.x, bottom.y - b1.y);
    planes[2u * plane + here] = vec2f(
        top.x + (first.at_red + 2.0 * second.at_red) / 3.0,
        top.y + 0.5 * (a1.y + b1.y),
    );
    planes[2u * plane + there] = vec2f(bottom.x + 0.5 * (b0.y + b1.y), bottom.y);
}

// Demosaicing of a Bayer array by linear filters of 5 x 5: the mean of the neighbours of the wanted colour, corrected by
// the Laplacian of the site's own (Malvar, He and Cutler 2004, eq. 2 to 4 and figure 2: alpha 1/2, beta 5/8, gamma 3/4).
// Units: light relative to saturation. In: light (rows, cols), red at even rows and columns, both numbers even. Out:
// planes (3, rows, cols): red, green, blue; the two rows and columns at each rim are not written.
// Dispatch: ceil((cols/2 - 2)/16) x ceil((rows/2 - 2)/16) workgroups of 16 x 16, one cell of 2 x 2 pixels each.

struct Params {
    rows: u32,
    pairs: u32,     // cols/2
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> light: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> planes: array<vec2f>;

@compute @workgroup_size(16, 16, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x + 2u >= params.pairs || 2u * id.y + 4u >= params.rows) {
        return;
    }
    // Six rows of six pixels around the cell: rows a to f, each as left, middle, right pairs.
    var at = 2u * id.y * params.pairs + id.x;
    let a = light[at + 1u];
    at += params.pairs;
    let b0 = light[at];
    let b1 = light[at + 1u];
    let b2 = light[at + 2u];
    at += params.pairs;
    let c0 = light[at];
    let c1 = light[at + 1u];
    let c2 = light[at + 2u];
    let here = at + 1u;
    at += params.pairs;
    let d0 = light[at];
    let d1 = light[at + 1u];
    let d2 = light[at + 2u];
    at += params.pairs;
    let e0 = light[at];
    let e1 = light[at + 1u];
    let e2 = light[at + 2u];
    let f = light[at + params.pairs + 1u];
    // At red (c1.x): green, and blue from the corners.
    let red_far = a.x + e1.x + c0.x + c2.x;
    let green_at_red = 0.125 * (4.0 * c1.x + 2.0 * (b1.x + d1.x + c0.y + c1.y) - red_far);
    let blue_at_red = 0.125 * (6.0 * c1.x + 2.0 * (b0.y + b1.y + d0.y + d1.y) - 1.5 * red_far);
    // At blue (d1.y).
    let blue_far = b1.y + f.y + d0.y + d2.y;
    let green_at_blue = 0.125 * (4.0 * d1.y + 2.0 * (c1.y + e1.y + d1.x + d2.x) - blue_far);
    let red_at_blue = 0.125 * (6.0 * d1.y + 2.0 * (c1.x + c2.x + e1.x + e2.x) - 1.5 * blue_far);
    // At green of the red row (c1.y): red beside it, blue above and below.
    let first_near = 5.0 * c1.y - (b1.x + b2.x + d1.x + d2.x);
    let first_rows = a.y + e1.y;
    let first_cols = c0.y + c2.y;
    let red_first = 0.125 * (first_near + 4.0 * (c1.x + c2.x) - first_cols + 0.5 * first_rows);
    let blue_first = 0.125 * (first_near + 4.0 * (b1.y + d1.y) - first_rows + 0.5 * first_cols);
    // At green of the blue row (d1.x).
    let second_near = 5.0 * d1.x - (c0.y + c1.y + e0.y + e1.y);
    let second_rows = b1.x + f.x;
    let second_cols = d0.x + d2.x;
    let red_second = 0.125 * (second_near + 4.0 * (c1.x + e1.x) - second_rows + 0.5 * second_cols);
    let blue_second = 0.125 * (second_near + 4.0 * (d0.y + d1.y) - second_cols + 0.5 * second_rows);
    let plane = params.rows * params.pairs;
    let below = here + params.pairs;
    planes[here] = vec2f(c1.x, red_first);
    planes[below] = vec2f(red_second, red_at_blue);
    planes[plane + here] = vec2f(green_at_red, c1.y);
    planes[plane + below] = vec2f(d1.x, green_at_blue);
    planes[2u * plane + here] = vec2f(blue_at_red, blue_first);
    planes[2u * plane + below] = vec2f(blue_second, d1.y);
}

// The chief-ray map at the reference wavelength of a lens that is symmetric about its axis, from the real image plane to the
// ideal one.
//
// u = x + x d(s), s = n |x|^2 / R^2 with the image circle's radius R: d is a cubic spline in |x|^2 of n even pieces, one after
// the other in `terms`: d0 + t (d1 + t (d2 + t d3)), t = s - k in piece k. Beyond the circle d stays.
// Only what the lens distorts is multiplied and rounded, and x is added as it is. x and u in sim samples from the optical axis.
// Depends on the globals: `terms`: array<vec4f>.

struct IdealPoint {
    u: vec2f,
    jacobian: mat2x2f,   // du/dx, column by column: du/dx_x, du/dx_y
}

fn ideal_point(x: vec2f, inverse_radius2: f32, pieces: f32) -> IdealPoint {
    let s = min(dot(x, x) * inverse_radius2, 1.0) * pieces;
    let piece = min(u32(s), u32(pieces) - 1u);
    let t = s - f32(piece);
    let own = terms[piece];
    let d = own.x + t * (own.y + t * (own.z + t * own.w));
    let slope = own.y + t * (2.0 * own.z + t * 3.0 * own.w);
    let dd = 2.0 * slope * pieces * inverse_radius2;   // du/dx = (1 + d) I + dd x x^T
    let g = 1.0 + d;
    return IdealPoint(x + d * x, mat2x2f(g + dd * x.x * x.x, dd * x.x * x.y, dd * x.x * x.y, g + dd * x.y * x.y));
}

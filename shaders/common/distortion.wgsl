// The chief-ray map at the reference wavelength of a lens that is symmetric about its axis, from the real image plane to the
// ideal one.
//
// u = x g(rho2), rho2 = |x|^2 / R^2 with the image circle's radius R, g a polynomial of degree 7 fitted on the host in float64
// (coefficients low to high, g_low first). x and u in sim samples from the optical axis.

struct IdealPoint {
    u: vec2f,
    jacobian: mat2x2f,   // du/dx, column by column: du/dx_x, du/dx_y
}

fn ideal_point(x: vec2f, inverse_radius2: f32, g_low: vec4f, g_high: vec4f) -> IdealPoint {
    let r2 = dot(x, x) * inverse_radius2;
    let g = g_low.x + r2 * (g_low.y + r2 * (g_low.z + r2 * (g_low.w
        + r2 * (g_high.x + r2 * (g_high.y + r2 * (g_high.z + r2 * g_high.w))))));
    let slope = g_low.y + r2 * (2.0 * g_low.z + r2 * (3.0 * g_low.w
        + r2 * (4.0 * g_high.x + r2 * (5.0 * g_high.y + r2 * (6.0 * g_high.z + r2 * 7.0 * g_high.w)))));
    let dg = 2.0 * slope * inverse_radius2;   // du/dx = g I + dg x x^T
    return IdealPoint(g * x, mat2x2f(g + dg * x.x * x.x, dg * x.x * x.y, dg * x.x * x.y, g + dg * x.y * x.y));
}

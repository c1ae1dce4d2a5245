// The chief-ray map of any lens, from the real image plane to the ideal one; x and u in sim samples from the optical axis.
//
// Without distortion u = x. With an axis: see common/distortion. Without one:
//   u = x + sum of terms[(i + a) (n + 3) + j + b] w_a(s - i) w_b(r - j),  a, b = 0 to 3,
// a bicubic spline over the square around the image circle, n x n cells: s, r = n (1 + z) / 2, z = (x - c) / R with the circle's
// centre c and radius R; i, j their whole parts; w the B-spline's weights of common/b_spline. Beyond the square it goes on as
// at its sides.
// Made on the host in float64.
// Depends on the globals: `DISTORTION`, `AXIS`: bool; `terms`: array<vec4f>; `params.circle` (c), `.inverse_radius2`, `.pieces` (n).
#include "b_spline"
#include "distortion"

fn chief_ray(x: vec2f) -> IdealPoint {
    if (!DISTORTION) {
        return IdealPoint(x, mat2x2f(1.0, 0.0, 0.0, 1.0));
    }
    if (AXIS) {
        return ideal_point(x, params.inverse_radius2, params.pieces);
    }
    let scale = 0.5 * params.pieces * sqrt(params.inverse_radius2);
    let s = clamp(0.5 * params.pieces + (x - params.circle) * scale, vec2f(0.0), vec2f(params.pieces));
    let cell = min(floor(s), vec2f(params.pieces - 1.0));
    let across = cubic_weights(s.x - cell.x);
    let down = cubic_weights(s.y - cell.y);
    let across_slopes = cubic_slopes(s.x - cell.x);
    let down_slopes = cubic_slopes(s.y - cell.y);
    let side = u32(params.pieces) + 3u;
    var shift = vec2f(0.0);
    var along_x = vec2f(0.0);
    var along_y = vec2f(0.0);
    for (var a = 0u; a < 4u; a++) {
        let k = (u32(cell.x) + a) * side + u32(cell.y);
        let c0 = terms[k].xy;
        let c1 = terms[k + 1u].xy;
        let c2 = terms[k + 2u].xy;
        let c3 = terms[k + 3u].xy;
        let column = down.x * c0 + down.y * c1 + down.z * c2 + down.w * c3;
        shift += across[a] * column;
        along_x += across_slopes[a] * column;
        along_y += across[a] * (down_slopes.x * c0 + down_slopes.y * c1 + down_slopes.z * c2 + down_slopes.w * c3);
    }
    return IdealPoint(x + shift, mat2x2f(vec2f(1.0, 0.0) + scale * along_x, vec2f(0.0, 1.0) + scale * along_y));
}

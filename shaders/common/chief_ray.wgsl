// The chief-ray map of any lens, from the real image plane to the ideal one; x and u in sim samples from the optical axis.
//
// Without distortion u = x. With an axis (DEGREE 0): see common/distortion. Without one:
//   u = sum of terms[k] z_x^i z_y^j,  i + j <= DEGREE,  z = (x - c) / R with the image circle's centre c and radius R,
// by Horner's scheme in z_x within each power of z_y and in z_y over them; terms: z_y^DEGREE first, and of each power of z_y
// the highest of z_x first. Fitted on the host in float64.
// Depends on the globals: `DISTORTION`: bool; `DEGREE`: u32; `terms`: array<vec2f>; `params.g_low`, `.g_high`, `.circle` (c), `.inverse_radius2`.
#include "distortion"

fn chief_ray(x: vec2f) -> IdealPoint {
    if (!DISTORTION) {
        return IdealPoint(x, mat2x2f(1.0, 0.0, 0.0, 1.0));
    }
    if (DEGREE == 0u) {
        return ideal_point(x, params.inverse_radius2, params.g_low, params.g_high);
    }
    let scale = sqrt(params.inverse_radius2);
    let z = (x - params.circle) * scale;
    var u = vec2f(0.0);
    var along_x = vec2f(0.0);
    var along_y = vec2f(0.0);
    var k = 0u;
    for (var row = 0u; row <= DEGREE; row++) {
        var sum = vec2f(0.0);
        var slope = vec2f(0.0);
        for (var i = 0u; i <= row; i++) {
            slope = slope * z.x + sum;
            sum = sum * z.x + terms[k];
            k++;
        }
        along_y = along_y * z.y + u;
        along_x = along_x * z.y + slope;
        u = u * z.y + sum;
    }
    return IdealPoint(u, scale * mat2x2f(along_x, along_y));
}

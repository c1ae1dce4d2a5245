// A ray in f32 through one surface of revolution: sphere, conic or even asphere, then Snell's law.
//
// Depends on the globals: params.terms, u32, coefficients per surface; surfaces: array<Surface>;
// aspheres: array<vec2f>, params.terms per surface: a2 U^2, a4 U^4 ... each as high and low part, mm;
// params.per_unit2, f32: 1 / U^2. In a unit U of about the lens's radius a30 does not leave the range of f32.

struct Surface {
    curvature: vec2f,         // 1/mm, high and low part
    bulge: vec2f,             // conic constant + 1
    gap: vec2f,               // from the vertex before to this one, mm
    inverse_semi2: f32,       // of the clear aperture, 1/mm^2; 0 for none
    terms: u32,               // of the polynomial that are used
}

struct Ray {
    at: vec3f,                // mm, from the vertex of the last surface met
    along: vec3f,             // direction cosines
    ok: bool,
}

// Sag of the polynomial and its derivative with respect to r^2.
fn polynomial(s: u32, r2: f32) -> vec2f {
    let t = r2 * params.per_unit2;
    var sum = 0.0;
    var slope = 0.0;
    for (var k = surfaces[s].terms; k > 0u; k--) {
        slope = slope * t + sum;
        sum = sum * t + aspheres[s * params.terms + k - 1u].x;
    }
    return vec2f(sum * t, (slope * t + sum) * params.per_unit2);
}

// Sag of conic and polynomial, and its derivative with respect to r^2.
fn sag(s: u32, r2: f32) -> vec2f {
    let c = surfaces[s].curvature.x;
    let root = sqrt(max(1.0 - surfaces[s].bulge.x * c * c * r2, 1e-6));
    return vec2f(c * r2 / (1.0 + root), 0.5 * c / root) + polynomial(s, r2);
}

// How far a point lies from surface s along the axis.
fn gap_at(s: u32, q: vec3f) -> f32 {
    return abs(q.z - sag(s, dot(q.xy, q.xy)).x);
}

// Meet surface s and bend there; ratio of the indices before and behind it.
// A ray that misses it, meets its far side or is totally reflected stays as it was, not ok.
fn bend(ray: Ray, s: u32, ratio: f32) -> Ray {
    let c = surfaces[s].curvature.x;
    let k = c * surfaces[s].bulge.x;
    let p = vec3f(ray.at.xy, ray.at.z - surfaces[s].gap.x);
    let d = ray.along;
    // The root nearest the vertex of A t^2 - 2 B t + C = 0 (Welford 1986, ch. 4).
    let square_a = c * dot(d.xy, d.xy) + k * d.z * d.z;
    let b = d.z - c * dot(p.xy, d.xy) - k * p.z * d.z;
    let square_c = c * dot(p.xy, p.xy) + k * p.z * p.z - 2.0 * p.z;
    let root = b * b - square_a * square_c;
    var t = square_c / (b + sqrt(max(root, 0.0)));
    var met = root >= 0.0;
    var q = p + t * d;
    var normal = vec3f(-c * q.xy, 1.0 - k * q.z);
    if (surfaces[s].terms > 0u) {
        // Newton starts from the conic or from the vertex's plane, whichever is nearer to the surface there: a ray may
        // miss the conic, or meet it far from the asphere.
        let plane = -p.z / d.z;
        t = select(plane, t, met && gap_at(s, p + t * d) < gap_at(s, p + plane * d));
        for (var n = 0u; n < 8u; n++) {  // quadratic convergence: 4 to 6 do
            q = p + t * d;
            let f = sag(s, dot(q.xy, q.xy));
            t -= (q.z - f.x) / (d.z - 2.0 * f.y * dot(q.xy, d.xy));
        }
        let r2 = dot(q.xy, q.xy);
        let f = sag(s, r2);
        // 1e-5 of the way is a hundred roundings.
        met = abs(q.z - f.x) <= 1e-5 * (abs(t) + abs(q.z) + 1e-3) && k * c * r2 < 1.0;
        normal = vec3f(-2.0 * f.y * q.xy, 1.0);
    }
    met = met && normal.z > 0.0;  // the sheet that carries the vertex
    normal = normalize(normal);
    let cos_in = dot(d, normal);
    let square = 1.0 - ratio * ratio * (1.0 - cos_in * cos_in);
    // Snell's law in vector form (Welford 1986, ch. 4); total reflection: square < 0.
    let bent = ratio * d + (sqrt(max(square, 0.0)) - ratio * cos_in) * normal;
    if (!(ray.ok && met && cos_in > 0.0 && square >= 0.0)) {
        return Ray(p, d, false);
    }
    return Ray(q, bent, true);
}

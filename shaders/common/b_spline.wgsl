// The cubic B-spline beta3: four weights that are never negative and add up to 1 (Unser 1999, eq. 6).

// beta3 at f + 1, f, f - 1, f - 2 for 0 <= f < 1
fn cubic_weights(f: f32) -> vec4f {
    let e = 1.0 - f;
    return vec4f(
        e * e * e,
        4.0 + 3.0 * f * f * (f - 2.0),
        4.0 + 3.0 * e * e * (e - 2.0),
        f * f * f,
    ) / 6.0;
}

// Their derivatives
fn cubic_slopes(f: f32) -> vec4f {
    let e = 1.0 - f;
    return 0.5 * vec4f(-e * e, f * (3.0 * f - 4.0), -e * (3.0 * e - 4.0), f * f);
}

// cos and sin of 2 pi x, to 2e-7 for |x| < 2^20: adapters' own may be as bad as 2^-11 (WGSL, "Accuracy").
// Taylor series of the half angle, which lies within a quarter turn: the first term left out is below 6e-8.

fn turn(x: f32) -> vec2f {
    let h = 3.14159265 * (fract(x + 0.5) - 0.5);
    let h2 = h * h;
    let s = h * (1.0 + h2 * (-1.6666667e-1 + h2 * (8.3333333e-3 + h2 * (-1.9841270e-4
        + h2 * (2.7557319e-6 + h2 * -2.5052108e-8)))));
    let c = 1.0 + h2 * (-0.5 + h2 * (4.1666667e-2 + h2 * (-1.3888889e-3
        + h2 * (2.4801587e-5 + h2 * (-2.7557319e-7 + h2 * 2.0876757e-9)))));
    return vec2f(1.0 - 2.0 * s * s, 2.0 * s * c);
}

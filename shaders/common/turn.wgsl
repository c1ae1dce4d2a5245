// cos and sin of 2 pi x, to 1.5e-7 for |x| < 2^20: adapters' own may be as bad as 2^-11 (WGSL, "Accuracy").
// Taylor series of the angle to the nearest quarter turn, at most pi/4: the first terms left out are 2.4e-8 and 2e-9.

fn turn(x: f32) -> vec2f {
    let n = floor(4.0 * x + 0.5);
    let h = 6.2831853 * (x - 0.25 * n);
    let h2 = h * h;
    let s = h * (1.0 + h2 * (-1.6666667e-1 + h2 * (8.3333333e-3 + h2 * (-1.9841270e-4 + h2 * 2.7557319e-6))));
    let c = 1.0 + h2 * (-0.5 + h2 * (4.1666667e-2 + h2 * (-1.3888889e-3 + h2 * 2.4801587e-5)));
    let quarters = i32(n);
    let z = select(vec2f(c, s), vec2f(-s, c), (quarters & 1) != 0);
    return select(z, -z, (quarters & 2) != 0);
}

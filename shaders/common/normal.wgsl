// The normal distribution function.

// Phi(z), absolute error below 1e-6: erfc by Abramowitz & Stegun (1964), eq. 7.1.26 (1.5e-7), rounded in f32.
fn normal_cdf(z: f32) -> f32 {
    let x = abs(z) * 0.70710678118654752;  // 1/sqrt(2)
    let t = 1.0 / (1.0 + 0.3275911 * x);
    let p = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
    let tail = 0.5 * p * exp(-x * x);
    return select(tail, 1.0 - tail, z > 0.0);
}

// Standard normal numbers by inversion of the distribution function.
#include "uniform"

const GAUSSIAN_SPLIT = 5.0;   // of t, below; the polynomials err by 9e-8 and 4e-7 of themselves, minimax

fn gaussian_is_central(t: vec4f) -> vec4<bool> {
    return t <= vec4f(GAUSSIAN_SPLIT);
}

// The normal deviates of four words: z = Phi^-1(u), u = (word + 1/2) / 2^32. With q = u - 1/2, z / q is a smooth
// function of t = -log(4 u (1 - u)), and beyond t = 5 (one word in 300) of its root (the variables of Giles 2011,
// "Approximating the erfinv function"). Where log is taken near 1 its absolute error, 2^-21, is what counts, and a
// quarter of it remains.
fn gaussian(words: vec4u) -> vec4f {
    let e = edge(words);
    let t = -log(4.0 * e * (1.0 - e));
    let x = t - 2.5;
    var ratio = (((((((8.0709270e-8 * x + 9.7220787e-7) * x - 9.9811304e-6) * x - 1.2435985e-5) * x + 6.1830041e-4) * x
        - 3.5460203e-3) * x - 1.1816342e-2) * x + 0.69760532) * x + 4.2466271;
    let central = gaussian_is_central(t);
    if (!all(central)) {
        let y = sqrt(t) - 3.4;
        let tail = ((((((-4.7754767e-4 * y + 1.9343741e-3) * y - 3.2540608e-3) * y + 4.1733242e-3) * y
            - 7.0817970e-3) * y + 1.1243494e-2) * y + 2.8472015) * y + 9.1493493;
        ratio = select(tail, ratio, central);
    }
    return centred(words) * ratio;
}

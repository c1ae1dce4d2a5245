// Standard normal numbers by inversion of the distribution function.
#include "uniform"

// Inside this distance from the median the central fit holds (Wichura 1988, SPLIT1).
const GAUSSIAN_SPLIT = 0.425;

fn gaussian_is_central(q: f32) -> bool {
    return abs(q) <= GAUSSIAN_SPLIT;
}

// The normal deviate of one word: Phi^-1((word + 1/2) / 2^32), Wichura 1988, algorithm AS 241, routine PPND7
// (relative error 1e-7 in exact arithmetic). Its far tail, p < 1.4e-11, is below the smallest p here, 2^-33.
// log is taken of p < 0.075 only, where WGSL holds it to 3 ULP.
fn gaussian(word: u32) -> f32 {
    let q = centred(word);
    if (gaussian_is_central(q)) {
        let r = GAUSSIAN_SPLIT * GAUSSIAN_SPLIT - q * q;
        return q * (((59.109374720 * r + 159.29113202) * r + 50.434271938) * r + 3.3871327179)
            / (((67.187563600 * r + 78.757757664) * r + 17.895169469) * r + 1.0);
    }
    let r = sqrt(-log(edge(word))) - 1.6;
    return sign(q) * (((0.17023821103 * r + 1.3067284816) * r + 2.7568153900) * r + 1.4234372777)
        / ((0.12021132975 * r + 0.73700164250) * r + 1.0);
}

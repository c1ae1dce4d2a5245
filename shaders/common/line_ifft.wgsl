// Inverse transform, not normalised, of one short line of M complex samples by one workgroup:
// x[n] = sum_k X[k] exp(+2 pi i n k / M), Stockham auto-sort of radix 2 (short lines are 1/16 of the work).
//
// Depends on the globals: overrides T, LANES, M (a power of two, M <= T);
// sh_line: array<vec2f, SCRATCH> with SCRATCH >= 2 M in workgroup memory; twiddle: array<vec2f>, exp(-2 pi i n / T) for n < T.
// In: sh_line[0..M). Returns the offset in sh_line (0 or M) at which the result lies.
// Every lane must call it, after a barrier that follows the writes; it ends with a barrier.
#include "complex"

fn line_ifft(t: u32) -> u32 {
    var here = 0u;
    var there = M;
    for (var ns = 1u; ns < M; ns *= 2u) {
        for (var b = t; b < M / 2u; b += LANES) {
            let k = b % ns;
            let p = sh_line[here + b];
            let q = cmul(sh_line[here + b + M / 2u], conj(twiddle[k * (T / (2u * ns))]));
            let d = there + 2u * (b - k) + k;
            sh_line[d] = p + q;
            sh_line[d + ns] = p - q;
        }
        workgroupBarrier();
        let swap = here;
        here = there;
        there = swap;
    }
    return here;
}

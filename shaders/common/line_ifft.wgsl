// Inverse transforms, not normalised, of LINES short lines of M complex samples by one workgroup:
// x[n] = sum_k X[k] exp(+2 pi i n k / M), Stockham auto-sort of radix 2 (short lines are 1/16 of the work).
// All lines go through each pass together: on lavapipe a barrier costs more than a pass of one line.
//
// Depends on the globals: overrides T, LANES, M (a power of two, M <= T), LINES;
// sh_line: array<vec2f, >= 2 LINES M> in workgroup memory; twiddle: array<vec2f>, exp(-2 pi i n / T) for n < T.
// In: line l at sh_line[l M]. Returns the offset in sh_line (0 or LINES M) from which the results lie likewise.
// Every lane must call it, after a barrier that follows the writes; it ends with a barrier.
#include "complex"

fn line_ifft(t: u32) -> u32 {
    var here = 0u;
    var there = LINES * M;
    for (var ns = 1u; ns < M; ns *= 2u) {
        for (var b = t; b < LINES * (M / 2u); b += LANES) {
            let start = b / (M / 2u) * M;
            let i = b % (M / 2u);
            let k = i % ns;
            let p = sh_line[here + start + i];
            let q = cmul(sh_line[here + start + i + M / 2u], conj(twiddle[k * (T / (2u * ns))]));
            let d = there + start + 2u * (i - k) + k;
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

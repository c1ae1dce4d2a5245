// Forward transform of one line of T complex samples by one workgroup of LANES = T/8 invocations:
// Stockham auto-sort (Govindaraju et al. 2008, fig. 2), a first pass of radix FIRST_RADIX, then radix 8.
// Lane t holds the samples t + r T/8, r = 0..7, before and after.
//
// Depends on the globals: overrides T, LANES, FIRST_RADIX (8^k FIRST_RADIX = T);
// sh_line: array<vec2f, >= T> in workgroup memory; twiddle: array<vec2f>, exp(-2 pi i n / T) for n < T,
// computed on the host in float64.
// Every lane of the workgroup must call it. It begins and ends with sh_line free for use.
#include "octet"

fn line_fft(x: Octet, t: u32) -> Octet {
    if (FIRST_RADIX == 8u) {
        let y = fft8(x);
        let d = 8u * t;
        sh_line[d] = y.v0;
        sh_line[d + 1u] = y.v1;
        sh_line[d + 2u] = y.v2;
        sh_line[d + 3u] = y.v3;
        sh_line[d + 4u] = y.v4;
        sh_line[d + 5u] = y.v5;
        sh_line[d + 6u] = y.v6;
        sh_line[d + 7u] = y.v7;
    } else if (FIRST_RADIX == 4u) {
        let y = fft4(x.v0, x.v2, x.v4, x.v6);
        let z = fft4(x.v1, x.v3, x.v5, x.v7);
        let d = 4u * t;
        let e = 4u * (t + LANES);
        sh_line[d] = y.v0;
        sh_line[d + 1u] = y.v1;
        sh_line[d + 2u] = y.v2;
        sh_line[d + 3u] = y.v3;
        sh_line[e] = z.v0;
        sh_line[e + 1u] = z.v1;
        sh_line[e + 2u] = z.v2;
        sh_line[e + 3u] = z.v3;
    } else {
        let d = 2u * t;
        sh_line[d] = x.v0 + x.v4;
        sh_line[d + 1u] = x.v0 - x.v4;
        sh_line[d + 2u * LANES] = x.v1 + x.v5;
        sh_line[d + 2u * LANES + 1u] = x.v1 - x.v5;
        sh_line[d + 4u * LANES] = x.v2 + x.v6;
        sh_line[d + 4u * LANES + 1u] = x.v2 - x.v6;
        sh_line[d + 6u * LANES] = x.v3 + x.v7;
        sh_line[d + 6u * LANES + 1u] = x.v3 - x.v7;
    }
    var v: Octet;
    for (var ns = FIRST_RADIX; ns < T; ns *= 8u) {
        workgroupBarrier();
        let k = t % ns;
        // One load and six products: loads are what costs here, and the powers stay within 8 roundings.
        let w1 = twiddle[k * (LANES / ns)];
        let w2 = cmul(w1, w1);
        let w3 = cmul(w2, w1);
        let w4 = cmul(w2, w2);
        let w5 = cmul(w3, w2);
        let w6 = cmul(w3, w3);
        let w7 = cmul(w4, w3);
        v = fft8(Octet(
            sh_line[t],
            cmul(sh_line[t + LANES], w1),
            cmul(sh_line[t + 2u * LANES], w2),
            cmul(sh_line[t + 3u * LANES], w3),
            cmul(sh_line[t + 4u * LANES], w4),
            cmul(sh_line[t + 5u * LANES], w5),
            cmul(sh_line[t + 6u * LANES], w6),
            cmul(sh_line[t + 7u * LANES], w7),
        ));
        workgroupBarrier();
        if (ns < LANES) {
            let d = (t - k) * 8u + k;
            sh_line[d] = v.v0;
            sh_line[d + ns] = v.v1;
            sh_line[d + 2u * ns] = v.v2;
            sh_line[d + 3u * ns] = v.v3;
            sh_line[d + 4u * ns] = v.v4;
            sh_line[d + 5u * ns] = v.v5;
            sh_line[d + 6u * ns] = v.v6;
            sh_line[d + 7u * ns] = v.v7;
        }
    }
    return v;
}

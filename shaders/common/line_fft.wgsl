// Forward transform of two lines of N complex samples, side by side, by N/8 invocations:
// Stockham auto-sort (Govindaraju et al. 2008, fig. 2), a first pass of radix `first`, then radix 8.
// Lane t holds the samples t + r N/8, r = 0..7, of both lines, before and after.
// A workgroup may transform several pairs of lines at once, each by lanes t = 0..N/8 - 1 in sh_line from its own `base` on.
//
// Depends on the globals: overrides T, LANES = T/8 (N divides T, first 8^k = N);
// sh_line: array<vec4f> in workgroup memory, N for each pair; twiddle: array<vec2f>, exp(-2 pi i n / T) for n < T,
// computed on the host in float64.
// Every lane of the workgroup must call it. It begins and ends with sh_line free for use.
#include "octet"

fn line_fft(x: Octet, t: u32, base: u32, n: u32, first: u32) -> Octet {
    let lanes = n / 8u;
    if (first == 8u) {
        let y = fft8(x);
        let d = base + 8u * t;
        #repeat k 8
        sh_line[d + ${k}u] = y.v${k};
        #end
    } else if (first == 4u) {
        let y = fft4(x.v0, x.v2, x.v4, x.v6);
        let z = fft4(x.v1, x.v3, x.v5, x.v7);
        let d = base + 4u * t;
        let e = d + 4u * lanes;
        sh_line[d] = y.v0;
        sh_line[d + 1u] = y.v1;
        sh_line[d + 2u] = y.v2;
        sh_line[d + 3u] = y.v3;
        sh_line[e] = z.v0;
        sh_line[e + 1u] = z.v1;
        sh_line[e + 2u] = z.v2;
        sh_line[e + 3u] = z.v3;
    } else {
        let d = base + 2u * t;
        sh_line[d] = x.v0 + x.v4;
        sh_line[d + 1u] = x.v0 - x.v4;
        sh_line[d + 2u * lanes] = x.v1 + x.v5;
        sh_line[d + 2u * lanes + 1u] = x.v1 - x.v5;
        sh_line[d + 4u * lanes] = x.v2 + x.v6;
        sh_line[d + 4u * lanes + 1u] = x.v2 - x.v6;
        sh_line[d + 6u * lanes] = x.v3 + x.v7;
        sh_line[d + 6u * lanes + 1u] = x.v3 - x.v7;
    }
    var v: Octet;
    for (var ns = first; ns < n; ns *= 8u) {
        workgroupBarrier();
        let k = t % ns;
        // One load and six products: loads are what costs here, and the powers stay within 8 roundings.
        let w1 = twiddle[k * LANES / ns];
        let w2 = cmul(w1, w1);
        let w3 = cmul(w2, w1);
        let w4 = cmul(w2, w2);
        let w5 = cmul(w3, w2);
        let w6 = cmul(w3, w3);
        let w7 = cmul(w4, w3);
        let s = base + t;
        v = fft8(Octet(
            sh_line[s],
            pair_mul(sh_line[s + lanes], w1),
            pair_mul(sh_line[s + 2u * lanes], w2),
            pair_mul(sh_line[s + 3u * lanes], w3),
            pair_mul(sh_line[s + 4u * lanes], w4),
            pair_mul(sh_line[s + 5u * lanes], w5),
            pair_mul(sh_line[s + 6u * lanes], w6),
            pair_mul(sh_line[s + 7u * lanes], w7),
        ));
        workgroupBarrier();
        if (ns < lanes) {
            let d = base + (t - k) * 8u + k;
            #repeat k 8
            sh_line[d + ${k}u * ns] = v.v${k};
            #end
        }
    }
    return v;
}

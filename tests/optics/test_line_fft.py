"""The forward transform of a line, against the sum that defines it.

Tolerance. Every result is a sum of the T samples with factors of amount 1, so each rounding on its
way is one of a sum of at most S = sum of all |parts|. Roundings: a pass of radix 8 takes 6 (see
test_octet), the product with a twiddle 3, and the twiddle itself is off by at most 24 (w7 = w4 w3
from one that is rounded: 1, 5, 9, 13 for w1..w4, 13 + 9 + 3 for w7; 25 in all). With the first pass
that is 6 + 34 a further pass: 108 at most, in units of 2^-24 S.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage
from optics.made import ULP, complex_noise, twiddles

from gpusim.gpu import Kernel
from gpusim.optics.convolve import FIRST_RADIX

# Lines of N in pairs, T/N pairs together, one batch after the other: the second must find sh_line
# free.
TEXT = """
#include "line_fft"
override T: u32 = 512u;
override LANES: u32 = 64u;
override N: u32 = 512u;
override FIRST: u32 = 8u;
struct Params { unused: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> x: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> y: array<vec4f>;
var<workgroup> sh_line: array<vec4f, T>;

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let step = N / 8u;
    let lane = t % step;
    let base = t / step * N;
    var parts: array<Octet, 2>;
    for (var i = 0u; i < 2u; i++) {
        let d = (2u * group.x + i) * T + base + lane;
        parts[i] = line_fft(Octet(
            x[d], x[d + step], x[d + 2u * step], x[d + 3u * step],
            x[d + 4u * step], x[d + 5u * step], x[d + 6u * step], x[d + 7u * step],
        ), lane, base, N, FIRST);
    }
    for (var i = 0u; i < 2u; i++) {
        let d = (2u * group.x + i) * T + base + lane;
        y[d] = parts[i].v0;
        y[d + step] = parts[i].v1;
        y[d + 2u * step] = parts[i].v2;
        y[d + 3u * step] = parts[i].v3;
        y[d + 4u * step] = parts[i].v4;
        y[d + 5u * step] = parts[i].v5;
        y[d + 6u * step] = parts[i].v6;
        y[d + 7u * step] = parts[i].v7;
    }
}
"""


def transform(length: int, n: int, lines: np.ndarray) -> np.ndarray:
    """Return the transforms of lines (groups, 2 T/N, N, 2): of both that lie side by side."""
    kernel = Kernel.from_text(
        "tests/line_fft", TEXT, T=length, LANES=length // 8, N=n, FIRST=FIRST_RADIX[n]
    )
    inputs = {"twiddle": twiddles(length), "x": lines}
    outputs = {"y": (lines.shape, np.complex64)}
    return run_stage(kernel, (len(lines), 1, 1), {"unused": 0}, inputs, outputs)["y"]


@pytest.mark.parametrize(
    ("length", "n"),
    [(256, 256), (512, 512), (1024, 1024), (256, 64), (256, 32), (512, 128), (1024, 512)],
)
def test_it_is_the_fourier_transform(length: int, n: int):
    lines = complex_noise(np.random.default_rng(length + n), 3, 2 * length // n, n, 2)
    turns = np.outer(np.arange(n), np.arange(n)) % n
    basis = np.exp(-2j * np.pi * turns / n)
    exact = np.einsum("glnp,nk->glkp", lines.astype(np.complex128), basis)
    parts = np.abs(lines.real.astype(float)) + np.abs(lines.imag.astype(float))
    bound = np.broadcast_to(108 * ULP * parts.sum(axis=2, keepdims=True), exact.shape)
    assert_close(transform(length, n, lines), exact, atol=bound)

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

# Two lines a workgroup, one after the other: the second must find sh_line free.
TEXT = """
#include "line_fft"
override T: u32 = 512u;
override LANES: u32 = 64u;
override FIRST_RADIX: u32 = 8u;
struct Params { unused: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> x: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> y: array<vec2f>;
var<workgroup> sh_line: array<vec2f, T>;

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    var parts: array<Octet, 2>;
    for (var i = 0u; i < 2u; i++) {
        let d = (2u * group.x + i) * T + t;
        parts[i] = line_fft(Octet(
            x[d], x[d + LANES], x[d + 2u * LANES], x[d + 3u * LANES],
            x[d + 4u * LANES], x[d + 5u * LANES], x[d + 6u * LANES], x[d + 7u * LANES],
        ), t);
    }
    for (var i = 0u; i < 2u; i++) {
        let d = (2u * group.x + i) * T + t;
        y[d] = parts[i].v0;
        y[d + LANES] = parts[i].v1;
        y[d + 2u * LANES] = parts[i].v2;
        y[d + 3u * LANES] = parts[i].v3;
        y[d + 4u * LANES] = parts[i].v4;
        y[d + 5u * LANES] = parts[i].v5;
        y[d + 6u * LANES] = parts[i].v6;
        y[d + 7u * LANES] = parts[i].v7;
    }
}
"""


def transform(length: int, lines: np.ndarray) -> np.ndarray:
    radix = FIRST_RADIX[length]
    kernel = Kernel.from_text(
        "tests/line_fft", TEXT, T=length, LANES=length // 8, FIRST_RADIX=radix
    )
    inputs = {"twiddle": twiddles(length), "x": lines}
    outputs = {"y": (lines.shape, np.complex64)}
    return run_stage(kernel, (len(lines) // 2, 1, 1), {"unused": 0}, inputs, outputs)["y"]


@pytest.mark.parametrize("length", sorted(FIRST_RADIX))
def test_it_is_the_fourier_transform(length: int):
    lines = complex_noise(np.random.default_rng(length), 6, length)
    turns = np.outer(np.arange(length), np.arange(length)) % length
    exact = lines.astype(np.complex128) @ np.exp(-2j * np.pi * turns / length)
    total = np.abs(lines.view(np.float32)).sum(axis=1, dtype=np.float64)
    bound = np.broadcast_to(108 * ULP * total[:, None], exact.shape)
    assert_close(transform(length, lines), exact, atol=bound)

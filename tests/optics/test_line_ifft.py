"""The inverse transform of short lines together, against the sum that defines it.

Tolerance: each of the log2 M passes adds twice at most, after a product (3 roundings) with a
rounded twiddle (1): 6 log2 M * 2^-24 S, S the sum of all |parts| of the line (see test_line_fft).
"""

import numpy as np
import pytest
from harness import assert_close, run_stage
from optics.made import ULP, complex_noise, twiddles

from gpusim.gpu import Kernel

TEXT = """
#include "line_ifft"
override T: u32 = 256u;
override LANES: u32 = 32u;
override M: u32 = 64u;
override LINES: u32 = 4u;
override SCRATCH: u32 = 512u;
struct Params { unused: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> twiddle: array<vec2f>;
@group(0) @binding(2) var<storage, read> x: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> y: array<vec2f>;
var<workgroup> sh_line: array<vec2f, SCRATCH>;

@compute @workgroup_size(LANES, 1, 1)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    for (var i = t; i < LINES * M; i += LANES) {
        sh_line[i] = x[group.x * LINES * M + i];
    }
    workgroupBarrier();
    let here = line_ifft(t);
    for (var i = LANES - 1u - t; i < LINES * M; i += LANES) {
        y[group.x * LINES * M + i] = sh_line[here + i];
    }
}
"""


@pytest.mark.parametrize(
    ("length", "m", "lines"),
    [(256, 64, 4), (256, 256, 1), (256, 32, 3), (512, 64, 1), (1024, 512, 2)],
)
def test_it_is_the_inverse_fourier_transform(length: int, m: int, lines: int):
    kernel = Kernel.from_text(
        "tests/line_ifft",
        TEXT,
        T=length,
        LANES=length // 8,
        M=m,
        LINES=lines,
        SCRATCH=2 * lines * m,
    )
    x = complex_noise(np.random.default_rng(m), 3, lines, m)
    inputs = {"twiddle": twiddles(length), "x": x}
    found = run_stage(kernel, (3, 1, 1), {"unused": 0}, inputs, {"y": (x.shape, np.complex64)})["y"]
    turns = np.outer(np.arange(m), np.arange(m)) % m
    exact = x.astype(np.complex128) @ np.exp(2j * np.pi * turns / m)
    total = np.abs(x.view(np.float32)).sum(axis=2, dtype=np.float64)[..., None]
    bound = np.broadcast_to(6 * np.log2(m) * ULP * total, exact.shape)
    assert_close(found, exact, atol=bound)

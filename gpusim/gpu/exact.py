"""Whether an adapter keeps sums and products of f32 exact, as common/double_float.wgsl needs.

Compilers may take (a + b) - a for b; an exclusive or with a number that they cannot know hides the
sum from them (`pin`). Drivers have been seen that find out even so (gpuweb #2076, luma.gl #2795):
such an adapter would give optical paths and shifted charge of 24 bits for 48, without a word.
"""

from __future__ import annotations

import numpy as np

from gpusim.errors import UserError

from .device import Device
from .kernel import Kernel
from .recording import Recording

COUNT = 1024  # pairs of numbers, over 2^24 of magnitude
PROBE = """
#include "double_float"
struct Params { zero: u32, count: u32, }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> numbers: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> found: array<vec4f>;
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x < params.count) {
        let both = numbers[id.x];
        found[id.x] = vec4f(two_sum(both.x, both.y), two_product(both.x, both.y));
    }
}
"""


def keeps_double_float(device: Device, probe: Kernel | None = None) -> bool:
    """Return whether sums and products of random pairs come back to the last bit."""
    rng = np.random.default_rng(1)
    # 24 bits each: sums over at most 2^12 and all products are exact in float64.
    numbers = np.ldexp(
        rng.integers(1 << 23, 1 << 24, (COUNT, 2)) * rng.choice([-1.0, 1.0], (COUNT, 2)),
        rng.integers(-36, -12, (COUNT, 2)),
    )
    rec = Recording(device)
    given = rec.buffer("numbers", numbers.shape, np.float32)
    found = rec.buffer("found", (COUNT, 4), np.float32)
    rec.upload(given, numbers.astype(np.float32))
    (probe or Kernel.from_text("gpu/exact", PROBE)).record(
        rec, (COUNT // 64, 1, 1), {"zero": 0, "count": COUNT}, numbers=given, found=found
    )
    rec.download(found)
    sums = rec.run()["found"].astype(float).reshape(COUNT, 2, 2).sum(axis=-1)
    expected = np.stack([numbers.sum(axis=1), numbers.prod(axis=1)], axis=1)
    return np.array_equal(sums, expected)


def need_double_float(device: Device) -> None:
    """Test a device at the first use of double float.

    Raises
    ------
    UserError
        Its arithmetic is not exact. There is no other way yet: integers in place of f32 would take
        some forty operations for each sum.
    """
    if device.double_float is None:
        device.double_float = keeps_double_float(device)
    if not device.double_float:
        raise UserError(
            "This adapter's driver takes rounding errors for zero: rays, smear and bloom, which "
            "need 48 bits, would be wrong on it",
            field="adapter",
            value=device.report()["adapter"],
            allowed="another adapter (--adapter NAME; gpusim devices lists them)",
        )

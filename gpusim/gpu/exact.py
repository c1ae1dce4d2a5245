"""How an adapter keeps sums and products of f32 exact, as common/double_float.wgsl needs.

Compilers may take (a + b) - a for b; an exclusive or with a number that they cannot know hides the
sum from them (`pin`). Drivers have been seen that find out even so (gpuweb #2076, luma.gl #2795):
such an adapter would give optical paths and shifted charge of 24 bits for 48, without a word. It
gets sums and products by integers, common/integer_float.wgsl: the same numbers, in some forty
operations each.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from gpusim.errors import UserError

from .device import Device
from .kernel import Kernel
from .recording import Recording

WAYS = ({"INTEGERS": False}, {"INTEGERS": True})
COUNT = 1024  # pairs of numbers, over 2^24 of magnitude
PROBE = """
#include "double_float"
struct Params { zero: u32, count: u32, }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> numbers: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> found: array<vec2f>;
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x < params.count) {
        let both = numbers[id.x];
        found[3u * id.x] = two_sum(both.y, both.x);
        found[3u * id.x + 1u] = quick_two_sum(both.x, both.y);
        found[3u * id.x + 2u] = two_product(both.x, both.y);
    }
}
"""


def keeps_double_float(device: Device, probe: Kernel) -> bool:
    """Return whether sums and products of random pairs come back to the last bit."""
    rng = np.random.default_rng(1)
    # 24 bits each: sums over at most 2^12 and all products are exact in float64.
    numbers = np.ldexp(
        rng.integers(1 << 23, 1 << 24, (COUNT, 2)) * rng.choice([-1.0, 1.0], (COUNT, 2)),
        rng.integers(-36, -12, (COUNT, 2)),
    )
    numbers = np.take_along_axis(numbers, np.argsort(-np.abs(numbers)), axis=1)
    rec = Recording(device)
    given = rec.buffer("numbers", numbers.shape, np.float32)
    found = rec.buffer("found", (COUNT, 3, 2), np.float32)
    rec.upload(given, numbers.astype(np.float32))
    probe.record(rec, (COUNT // 64, 1, 1), {"zero": 0, "count": COUNT}, numbers=given, found=found)
    rec.download(found)
    sums = rec.run()["found"].astype(float).sum(axis=-1)
    total = numbers.sum(axis=1)
    return np.array_equal(sums, np.stack([total, total, numbers.prod(axis=1)], axis=1))


def double_float(device: Device) -> dict[str, bool]:
    """Return the override by which kernels of double float are exact on a device.

    It is found at the first use: f32 where that is exact, else integers.

    Raises
    ------
    UserError
        Neither is exact.
    """
    if device.double_float is None:
        device.double_float = next(filter(partial(_exact, device), WAYS), {})
    if not device.double_float:
        raise UserError(
            "This adapter's driver takes rounding errors for zero, and its integers are wrong: "
            "rays, smear and bloom, which need 48 bits, would be wrong on it",
            field="adapter",
            value=device.report()["adapter"],
            allowed="another adapter (--adapter NAME; gpusim devices lists them)",
        )
    return device.double_float


def _exact(device: Device, way: dict[str, bool]) -> bool:
    return keeps_double_float(device, Kernel.from_text("gpu/exact", PROBE, **way))

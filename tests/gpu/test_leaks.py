"""Memory: after a hundred runs there are as many GPU objects as before."""

import gc

import numpy as np
import wgpu

from gpusim.gpu import Device, Kernel, Recording

TEXT = """
struct Params { n: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> a: array<f32>;
@group(0) @binding(2) var<storage, read_write> b: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x < params.n) { b[id.x] = a[id.x]; }
}
"""
RAMP = np.arange(100, dtype=np.float32)


def run(device: Device) -> np.ndarray:
    rec = Recording(device)
    a, b = rec.buffer("a", 100, np.float32), rec.buffer("b", 100, np.float32)
    rec.upload(a, RAMP)
    kernel = Kernel.from_text("tests/leak", TEXT)
    kernel.record(rec, kernel.cover(100), {"n": 100}, a=a, b=b)
    rec.download(b)
    return rec.run()["b"]


def counts() -> dict[str, int]:
    gc.collect()
    found = wgpu.diagnostics.object_counts.get_dict()
    return {name: values["count"] for name, values in found.items() if values["count"]}


def test_objects_and_memory_return_to_the_baseline(device: Device):
    run(device)
    before, in_use, held = counts(), device.pool.in_use, device.pool.idle
    for _ in range(100):
        run(device)
    assert counts() == before
    assert (device.pool.in_use, device.pool.idle) == (in_use, held)


def test_the_count_sees_an_object_that_is_kept(device: Device):
    before = counts()
    kept = device.gpu.create_buffer(label="kept", size=256, usage=wgpu.BufferUsage.COPY_DST)
    assert counts() != before
    kept.destroy()


def test_residents_return_to_the_pool(device: Device):
    before = device.pool.in_use
    for _ in range(100):
        device.resident("one", RAMP).destroy()
    assert device.pool.in_use == before

"""Recordings as plain data: all that is needed to run them again, and nothing twice."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.gpu import Device, Kernel, Recording, ShaderError, Use
from gpusim.gpu.exported import exported

TEXT = """
override TWICE: bool = false;
struct Params { frame: u32, count: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> given: array<f32>;
@group(0) @binding(2) var<storage, read_write> sum: array<f32>;
@compute @workgroup_size(4, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let times = select(1.0, 2.0, TWICE);
    if (id.x < params.count) { sum[id.x] += times * given[id.x] + f32(params.frame); }
}
"""


def test_a_recording_is_told_in_full(device: Device):
    kernel = Kernel.from_text("made/sum", TEXT, TWICE=True)
    held = device.resident("held", np.arange(6, dtype=np.float32))
    rec = Recording(device)
    total = rec.buffer("total", 6, "f4")
    rec.clear(total)
    for frame in (3, 5):
        kernel.record(rec, (2, 1, 1), {"frame": frame, "count": 6}, given=held, sum=total)
    rec.upload(total, np.ones(6, np.float32))
    rec.download(total)
    found = exported(rec)
    assert [step["do"] for step in found.steps] == ["clear", "write", "run", "run", "write", "read"]
    assert found.buffers == [24, 24] and found.shaders == {"made/sum": kernel.source.text}
    run = found.steps[2]
    assert run["constants"] == {"TWICE": 1.0} and run["groups"] == [2, 1, 1]
    assert run["bound"] == [[1, 1, "read-only-storage"], [2, 0, "storage"]]
    values = [int.from_bytes(found.params[at : at + 4], "little") for at in found.members["frame"]]
    assert values == [3, 5] and run["size"] == kernel.params.size
    assert [found.data[k].tolist() for k in (0, 1)] == [[0, 1, 2, 3, 4, 5], [1] * 6]
    held.destroy()


def test_texels_are_refused(device: Device):
    rec = Recording(device)
    texels = rec.buffer("texels", (16, 4), "f4", Use.TEXELS)
    rec.upload(texels, np.zeros((16, 4), np.float32))
    with pytest.raises(ShaderError, match="not exported"):
        exported(rec)

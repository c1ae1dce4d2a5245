"""What a kernel refuses, each beside a control case that passes.

Covered: overrides (unknown, wrong type, out of range, NumPy scalars taken); limits that wgpu does
not check (workgroup bytes and size from an override, storage buffers); compile errors; record():
missing, unknown, wrong dtype, wrong size, aliased buffers, groups.
"""

import numpy as np
import pytest

from gpusim.gpu import Device, Kernel, Recording, ShaderError, held

TEXT = """
override WIDTH: u32 = 64u;
override CELLS: u32 = 16u;
override GAIN: f32 = 1.0;
override FLIP: bool = false;
override SHIFT: i32 = 0;
struct Params { n: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> pairs: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> out: array<f32>;
@group(0) @binding(4) var<storage, read_write> count: array<atomic<u32>>;
var<workgroup> sh_tile: array<f32, CELLS>;
@compute @workgroup_size(WIDTH)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(local_invocation_index) lane: u32) {
    if (lane < CELLS) { sh_tile[lane] = 0.0; }
    workgroupBarrier();
    if (id.x < params.n) {
        let sign = select(1.0, -1.0, FLIP);
        out[id.x] = sign * GAIN * image[id.x] + pairs[0].y + sh_tile[0] + f32(SHIFT);
        atomicAdd(&count[0], 1u);
    }
}
"""


def kernel(**overrides) -> Kernel:
    return Kernel.from_text("tests/kernel", TEXT, **overrides)


def buffers(rec: Recording) -> dict:
    made = {
        "image": rec.buffer("image", 8, np.float32),
        "pairs": rec.buffer("pairs", (2, 2), np.float32),
        "out": rec.buffer("out", 8, np.float32),
        "count": rec.buffer("count", 1, np.uint32),
    }
    for one in made.values():
        rec.clear(one)
    return made


def test_overrides_reach_the_shader(device: Device):
    rec = Recording(device)
    made = buffers(rec)
    rec.upload(made["image"], np.arange(8, dtype=np.float32))
    values = {"GAIN": np.float32(0.5), "FLIP": np.bool_(True), "SHIFT": np.int64(-3), "WIDTH": 8}
    kernel(**values).record(rec, (1, 1, 1), {"n": 8}, **made)
    rec.download(made["out"])
    rec.download(made["count"])
    result = rec.run()
    assert result["out"].tolist() == [-0.5 * n - 3.0 for n in range(8)]
    assert result["count"].tolist() == [8]


def test_the_resolved_overrides_are_shown():
    made = kernel(WIDTH=32)
    assert made.overrides["WIDTH"] == 32
    assert made.overrides["CELLS"] == 16
    assert made.workgroup_size == (32, 1, 1)
    assert made.cover(65) == (3, 1, 1)


@pytest.mark.parametrize(
    ("overrides", "problem"),
    [
        ({"WIDE": 3}, r"unknown override \['WIDE'\]"),
        ({"WIDTH": 8.0}, "override WIDTH: u32"),
        ({"WIDTH": -8}, "override WIDTH: u32"),
        ({"WIDTH": True}, "override WIDTH: u32"),
        ({"WIDTH": "8"}, "override WIDTH: u32"),
        ({"SHIFT": 1 << 31}, "override SHIFT: i32"),
        ({"GAIN": float("inf")}, "override GAIN: f32"),
        ({"FLIP": 1}, "override FLIP: bool"),
        ({"WIDTH": 0}, r"workgroup size \(0, 1, 1\)"),
        ({"WIDTH": 257}, "257 invocations per workgroup, every adapter has only 256"),
        ({"CELLS": 4097}, "16400 bytes of workgroup storage, every adapter has only 16384"),
    ],
)
def test_an_override_that_does_not_fit_is_refused(overrides: dict, problem: str):
    assert kernel(WIDTH=256, CELLS=4096, GAIN=2, FLIP=True, SHIFT=-1).workgroup_bytes == 16384
    with pytest.raises(ShaderError, match=problem):
        kernel(**overrides)


def storage_buffers(count: int) -> Kernel:
    text = "struct Params { n: u32 }\n@group(0) @binding(0) var<uniform> params: Params;\n"
    for index in range(1, count + 1):
        text += f"@group(0) @binding({index}) var<storage, read> b{index}: array<f32>;\n"
    return Kernel.from_text("tests/many", text + "@compute @workgroup_size(1) fn main() {}")


def test_a_ninth_storage_buffer_is_refused():
    assert len(storage_buffers(8).buffers) == 8
    with pytest.raises(ShaderError, match="9 storage buffers, every adapter has only 8"):
        storage_buffers(9)


def test_a_workgroup_may_be_no_deeper_than_64():
    text = storage_buffers(1).source.text
    assert Kernel.from_text("t", text.replace("size(1)", "size(1, 1, 64)")).workgroup_size[2] == 64
    with pytest.raises(ShaderError, match="65 workgroup depth"):
        Kernel.from_text("t", text.replace("size(1)", "size(1, 1, 65)"))


def test_a_compile_error_shows_the_line_and_its_origin(device: Device):
    kernel().compile(device)
    broken = Kernel.from_text("tests/broken", TEXT.replace("= sign *", "= sing *"))
    with pytest.raises(ShaderError, match="tests/broken does not compile") as caught:
        broken.compile(device)
    line = 1 + TEXT[: TEXT.index("sign *")].count("\n")
    marked = [row for row in str(caught.value).split("\n") if row.startswith(">")]
    assert len(marked) == 1
    assert f"tests/broken.wgsl:{line}" in marked[0]
    assert "sing *" in marked[0]


def test_the_composed_text_is_printed_on_request(
    device: Device, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("GPUSIM_PRINT_WGSL", "1")
    Kernel.from_text("tests/printed", TEXT + "// printed").compile(device)
    assert "tests/printed.wgsl:2" in capsys.readouterr().err


def test_a_pipeline_is_kept_by_text_and_overrides(device: Device):
    first = kernel(GAIN=3.0).compile(device)
    assert kernel(GAIN=np.float64(3.0)).compile(device) is first
    assert kernel(GAIN=4.0).compile(device) is not first


def bound(change: dict, groups: tuple = (1, 1, 1)):
    """Return a function that records the kernel with some buffers replaced, None removing one."""

    def record(device: Device) -> None:
        rec = Recording(device)
        made = buffers(rec)
        for name, spec in change.items():
            made[name] = (
                spec if spec is None else made.get(spec) or rec.buffer(f"new {name}", *spec)
            )
        given = {name: one for name, one in made.items() if one is not None}
        for one in given.values():
            rec.clear(one)
        kernel().record(rec, groups, {"n": 8}, **given)

    return record


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"image": None}, r"missing \['image'\]"),
        ({"mask": (8, np.float32)}, r"unknown \['mask'\]"),
        ({"image": (8, np.uint32)}, "image: .*new image.*uint32"),
        ({"count": (1, np.float32)}, "count: "),
        ({"pairs": (3, np.float32)}, "pairs: .*12 bytes, elements have 8"),
        ({"image": "out"}, "same buffer 'out', and one is written"),
        ({"image": (0, np.float32)}, r"\['new image'\] have no elements"),
    ],
)
def test_a_buffer_that_does_not_fit_is_refused(device: Device, change: dict, problem: str):
    bound({"pairs": (1, np.complex64)})(device)  # the control: complex64 is vec2f
    with pytest.raises(ShaderError, match=problem):
        bound(change)(device)


@pytest.mark.parametrize("groups", [(65536, 1, 1), (1, -1, 1), (1, 1)])
def test_groups_that_no_adapter_takes_are_refused(device: Device, groups: tuple):
    bound({}, (65535, 1, 1))(device)
    with pytest.raises(ShaderError, match=r"tests/kernel: groups .* from 0 to 65535"):
        bound({}, groups)(device)


def test_one_buffer_may_be_read_twice(device: Device):
    rec = Recording(device)
    made = buffers(rec)
    kernel().record(rec, (1, 1, 1), {"n": 0}, **(made | {"pairs": made["image"]}))
    rec.run()


def test_kernels_are_read_once_while_they_are_held(tmp_path, monkeypatch):
    (tmp_path / "optics").mkdir()
    file = tmp_path / "optics/x.wgsl"
    text = (
        "struct Params { n: u32 }\n@group(0) @binding(0) var<uniform> params: Params;\n"
        "override SIDE: u32 = 1;\n@compute @workgroup_size(64)\n"
        "fn main() { _ = params.n + SIDE; }\n"
    )
    file.write_text(text)
    monkeypatch.setenv("GPUSIM_SHADERS_DIR", str(tmp_path))
    with held():
        first = Kernel("optics/x")
        file.write_text("// edited\n" + text)
        with held():  # another thread, or a part of the same work, ends before
            assert Kernel("optics/x").key == first.key
        assert Kernel("optics/x").key == first.key
        assert Kernel("optics/x", SIDE=2).key != first.key
    assert Kernel("optics/x").key != first.key

"""Composition and reflection of WGSL: pure text, no GPU.

Covered: include once, nested, unknown, cyclic, repeated lines, unknown directive, line origins;
comments; bindings, overrides, constants, workgroup size and bytes; every refusal beside a control
case that passes; memory layout against offsets worked out by hand from the WGSL specification;
packing of values.
"""

from pathlib import Path

import numpy as np
import pytest

from gpusim.gpu import Kernel, ShaderError
from gpusim.gpu.packing import Layouts, split_top
from gpusim.gpu.wgsl import Names, compose, load, reflect, shaders_root, strip_comments

MINIMAL = """
struct Params { n: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> out: array<f32>;
@compute @workgroup_size(64) fn main() { out[0] = 1.0; }
"""


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make an empty shaders root and switch to it."""
    (tmp_path / "common").mkdir()
    (tmp_path / "optics").mkdir()
    monkeypatch.setenv("GPUSIM_SHADERS_DIR", str(tmp_path))
    return tmp_path


def test_the_root_is_beside_the_package_or_in_it():
    assert (shaders_root() / "common").is_dir()


def test_an_include_is_pasted_once_and_lines_keep_their_origin(root: Path):
    (root / "common/a.wgsl").write_text("// a\n")
    (root / "common/b.wgsl").write_text('#include "a"\n// b1\n// b2\n')
    (root / "optics/x.wgsl").write_text('// x\n#include "a"\n#include "b"\n#include "b"\n// end\n')
    source = load("optics/x")
    assert source.text.split("\n") == ["// x", "// a", "// b1", "// b2", "// end"]
    assert source.origins == (
        ("optics/x.wgsl", 1),
        ("common/a.wgsl", 1),
        ("common/b.wgsl", 2),
        ("common/b.wgsl", 3),
        ("optics/x.wgsl", 5),
    )
    assert "common/b.wgsl:3" in source.numbered().split("\n")[3]
    assert source.numbered(around=4, margin=1).split("\n")[1].startswith(">    4")


def test_what_is_unrolled_is_written_once(root: Path):
    (root / "optics/x.wgsl").write_text(
        "// x\n#repeat k 3\nv[${k}] = ${8 * k + 1}u;\n// {k}\n#end\n"
    )
    source = load("optics/x")
    numbered = [line for k in range(3) for line in (f"v[{k}] = {8 * k + 1}u;", "// {k}")]
    assert source.text.split("\n") == ["// x", *numbered]
    assert [line for _, line in source.origins] == [1, 3, 4, 3, 4, 3, 4]


def test_the_digest_changes_with_an_included_file(root: Path):
    (root / "common/a.wgsl").write_text("// one\n")
    (root / "optics/x.wgsl").write_text('#include "a"\n')
    first = load("optics/x").digest
    assert load("optics/x").digest == first
    (root / "common/a.wgsl").write_text("// two\n")
    assert load("optics/x").digest != first


@pytest.mark.parametrize(
    ("files", "problem"),
    [
        ({"optics/x": '#include "none"'}, "unknown include 'none'"),
        ({"optics/x": '#include "a"', "common/a": '#include "a"'}, "include cycle a -> a"),
        (
            {"optics/x": '#include "a"', "common/a": '#include "b"', "common/b": '#include "a"'},
            "include cycle a -> b -> a",
        ),
        ({"optics/x": "#define N 3"}, "optics/x.wgsl:1: unknown directive '#define N 3'"),
        ({"optics/x": "#include <a>", "common/a": ""}, "unknown directive"),
        ({"optics/x": "// x\n#repeat k 2\na${k}"}, "optics/x.wgsl:2: #repeat without #end"),
        ({"optics/x": "#repeat k two\n#end"}, "optics/x.wgsl:1: unknown directive '#repeat k two'"),
        ({"optics/x": "#end"}, "unknown directive '#end'"),
        ({"optics/x": "#repeat k 2\n#repeat n 2\n#end\n#end"}, "unknown directive '#repeat n 2'"),
        ({"optics/x": "#repeat k 2\na${n}\n#end"}, "optics/x.wgsl:2: cannot evaluate 'n'"),
        ({}, "no shader 'optics/x'"),
    ],
)
def test_a_broken_directive_is_refused(root: Path, files: dict[str, str], problem: str):
    for name, text in files.items():
        (root / f"{name}.wgsl").write_text(text + "\n")
    with pytest.raises(ShaderError, match=problem):
        load("optics/x")


def test_comments_are_blanked_and_lines_keep_their_numbers():
    text = "a // b /* c\n/* d\n/* e */ f\n*/ g / h\n// @binding\n"
    assert strip_comments(text) == "a \n\n\n g / h\n\n"


def test_reflection_reads_the_declarations():
    module = reflect(
        """
        // @group(0) @binding(7) var<uniform> ghost: u32;
        const N = 4u;
        override TILE: u32 = 8u;
        override SCALE: f32 = 0.5;
        override FLIP: bool = false;
        override HALO: u32 = TILE + 2u * N;
        struct Params { n: u32, v: vec3f }
        @group(0) @binding(0) var<uniform> params: Params;
        @group(0) @binding(2) var<storage, read_write> out: array<vec2<f32>>;
        @group(0) @binding(1) var<storage, read> image: array<f32>;
        @group(0) @binding(3) var<uniform> weights: array<vec4f, N>;
        var<workgroup> sh_a: array<vec2f, HALO>;
        var<workgroup> sh_b: array<array<f32, 3>, N>;
        var<workgroup> sh_n: atomic<u32>;
        fn helper() -> f32 { const INNER = 3u; { let x = 1; } return 1.0; }
        @compute @workgroup_size(TILE, TILE / 2)
        fn main(@builtin(global_invocation_id) id: vec3u) { const N = 9u; }
        """
    )
    assert [(one.index, one.name, one.kind, one.type) for one in module.bindings] == [
        (0, "params", "uniform", "Params"),
        (1, "image", "read-only-storage", "array<f32>"),
        (2, "out", "storage", "array<vec2<f32>>"),
        (3, "weights", "uniform", "array<vec4f, N>"),
    ]
    assert list(module.overrides) == ["TILE", "SCALE", "FLIP", "HALO"]
    assert module.consts == {"N": "4u"}
    names = module.constants({})
    assert module.workgroup_size(names) == (8, 4, 1)
    assert names.evaluate("SCALE") == 0.5
    assert names.evaluate("FLIP") is False
    # 16 vec2f of 8 bytes; 4 x 3 floats = 48 bytes; 4 bytes rounded up to 16
    assert module.workgroup_bytes(names) == 128 + 48 + 16
    wider = module.constants({"TILE": 16})
    assert module.workgroup_size(wider) == (16, 8, 1)
    assert module.workgroup_bytes(wider) == 192 + 48 + 16


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("@group(0) @binding(1)", "@group(1) @binding(1)", "group 1"),
        ("var<storage, read_write> out: array<f32>", "var out: texture_2d<u32>", "binding 'out'"),
        ("@group(0) @binding(1)", "@binding(1) @group(0)", "could not be read"),
        ("@binding(1)", "@binding(0)", "used twice"),
        ("params: Params", "settings: Params", "binding 0 must be"),
        ("@binding(0)", "@binding(2)", "binding 0 must be"),
        ("struct Params { n: u32 }", "", "no `struct Params`"),
        ("struct Params { n: u32 }", "struct Params { }", "empty"),
        ("n: u32 }", "n: f16 }", "type 'f16'"),
        ("n: u32 }", "n: array<f32, 4> }", "16 bytes"),
        ("n: u32 }", "@size(32) n: u32 }", "attributes"),
        ("n: u32 }", "n: array<vec4f, M> }", "cannot evaluate 'M'"),
        ("fn main", "fn start", "no `@compute"),
        ("@workgroup_size(64)", "", "no `@compute"),
        ("@compute", "@id(3) override A: u32 = 1u; @compute", "@id"),
        ("@compute", "override A = 1u; @compute", "an override could not be read"),
        ("@compute", "override A: f16 = 1.0h; @compute", "type 'f16'"),
    ],
)
def test_a_declaration_outside_the_rules_is_refused(old: str, new: str, problem: str):
    assert reflect(MINIMAL).bindings[1].name == "out"  # the control
    assert old in MINIMAL
    with pytest.raises(ShaderError, match=problem):
        reflect(MINIMAL.replace(old, new, 1))


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("3u", 3),
        ("0x1Fu + 1", 32),
        ("2 * (N + 1u)", 10),
        ("7u / 2u", 3),
        ("-7 / 2", -3),
        ("-7 % 3", -1),
        ("7.0 / 2.0", 3.5),
        ("1e2f", 100.0),
        ("1u << 4u | 1u", 17),
        ("max(N, 6u) - min(1u, 2u)", 5),
        ("f32(N) * 0.5", 2.0),
        ("TWICE", 8),
        ("true", True),
    ],
)
def test_constant_expressions(expression: str, value: float):
    assert Names({"N": 4, "TWICE": "2u * N"}).evaluate(expression) == value


@pytest.mark.parametrize("expression", ["M", "N +", "open('x')", "N.real", "1 if N else 2", "1/0"])
def test_other_expressions_are_refused(expression: str):
    with pytest.raises(ShaderError, match="cannot evaluate"):
        Names({"N": 4}).evaluate(expression)


def test_an_override_without_default_needs_a_value():
    text = MINIMAL + "override SIZE: u32;"
    assert reflect(text).constants({"SIZE": 3}).evaluate("SIZE") == 3
    with pytest.raises(ShaderError, match="override 'SIZE' has no default"):
        reflect(text).constants({})


def test_splitting_respects_brackets():
    assert split_top("a: array<vec2f, 3>, b: f32(1, 2), ") == ["a: array<vec2f, 3>", "b: f32(1, 2)"]


# Offsets by hand from the specification, section "Alignment and Size": vec3 is 12 bytes at 16,
# mat3x3f is three columns 16 bytes apart, mat2x2f two columns 8 bytes apart.
LAID_OUT = """
    a: f32, b: vec3f, c: f32, d: vec2u, e: mat3x3f, f: i32, g: mat2x2<f32>, h: array<vec3f, 2>,
    i: mat4x2f, j: array<mat2x3f, 2>
"""
OFFSETS = {"a": 0, "b": 16, "c": 28, "d": 32, "e": 48, "f": 96, "g": 104, "h": 128, "i": 160}


def test_members_lie_where_the_specification_puts_them():
    struct = Layouts({}, {"P": LAID_OUT}, lambda text: int(text)).uniform("P")
    assert {name: offset for name, (offset, _) in struct.members.items()} == OFFSETS | {"j": 192}
    assert struct.size == 256
    assert struct.dtype.itemsize == 256
    assert struct.dtype.fields["e"][1] == 48


def test_values_are_packed_where_the_shader_reads_them():
    struct = Layouts({}, {"P": LAID_OUT}, lambda text: int(text)).uniform("P")
    e = np.arange(9.0).reshape(3, 3)
    j = np.arange(12.0).reshape(2, 3, 2)
    packed = struct.pack(
        {
            "a": np.float64(1.5),
            "b": [1, 2, 3],
            "c": -2.0,
            "d": np.array([4, 5], np.int64),
            "e": e,
            "f": -6,
            "g": [[1, 2], [3, 4]],
            "h": np.ones((2, 3)),
            "i": np.zeros((2, 4)),
            "j": j,
        }
    )
    words = np.frombuffer(packed, np.float32)
    integers = np.frombuffer(packed, np.int32)
    assert words[:8].tolist() == [1.5, 0, 0, 0, 1, 2, 3, -2]
    assert integers[8:10].tolist() == [4, 5]
    assert words[12:24].tolist() == [0, 3, 6, 0, 1, 4, 7, 0, 2, 5, 8, 0]  # columns of e, padded
    assert integers[24] == -6
    assert words[26:30].tolist() == [1, 3, 2, 4]
    assert words[32:40].tolist() == [1, 1, 1, 0, 1, 1, 1, 0]
    assert words[48:56].tolist() == [0, 2, 4, 0, 1, 3, 5, 0]
    assert words[56:64].tolist() == [6, 8, 10, 0, 7, 9, 11, 0]


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"n": 1}, r"missing \['g', 'v'\]"),
        ({"n": 1, "g": 1.0, "v": [1, 2], "w": 3}, r"unknown \['w'\]"),
        ({"n": -1, "g": 1.0, "v": [1, 2]}, "out of its range"),
        ({"n": 1 << 32, "g": 1.0, "v": [1, 2]}, "out of its range"),
        ({"n": 1.0, "g": 1.0, "v": [1, 2]}, "n is u32"),
        ({"n": 1, "g": "1", "v": [1, 2]}, "g is f32"),
        ({"n": 1, "g": float("nan"), "v": [1, 2]}, "not a finite f32"),
        ({"n": 1, "g": 1e39, "v": [1, 2]}, "not a finite f32"),
        ({"n": 1, "g": [1.0], "v": [1, 2]}, r"shape \(\), got \(1,\)"),
        ({"n": 1, "g": 1.0, "v": [1, 2, 3]}, r"shape \(2,\), got \(3,\)"),
    ],
)
def test_values_that_do_not_fit_are_refused(values: dict, problem: str):
    struct = Layouts({}, {"P": "n: u32, g: f32, v: vec2i"}, int).uniform("P")
    assert (
        len(struct.pack({"n": np.uint32(1), "g": 1, "v": np.int64([1, -2])})) == 16
    )  # the control
    with pytest.raises(ShaderError, match=problem):
        struct.pack(values)


def test_a_kernel_of_a_text_may_include(root: Path):
    (root / "common/one.wgsl").write_text("fn one() -> f32 { return 1.0; }\n")
    kernel = Kernel.from_text("tests/x", '#include "one"' + MINIMAL.replace("= 1.0", "= one()"))
    assert kernel.path == "tests/x"
    assert compose("tests/x", MINIMAL).text in kernel.source.text.replace("one()", "1.0")

"""The tests' own tools can fail: a defect is planted for each, and must be found.

Covered: assert_close (one bad element, tolerance missed by little, NaN, infinity, shape, imaginary
part, outliers; comparisons that prove nothing); unwritten outputs; wgsl_eval (wrong expression,
order of components, more than one row of workgroups); echo_params (a member elsewhere, swapped,
transposed); a wrong and a missing adapter.
"""

import dataclasses
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from harness import assert_close, echo_params, example_params, filled, run_stage, unwritten
from harness import wgsl_eval as evaluate
from harness.compare import _picture

from gpusim.gpu import Kernel, ShaderError, packing
from gpusim.gpu.packing import Struct

REFERENCE = np.linspace(1.0, 2.0, 12).reshape(3, 4)


def changed(index: tuple[int, int], value: float) -> np.ndarray:
    actual = REFERENCE.copy()
    actual[index] = value
    return actual


def test_equal_arrays_pass():
    assert_close(REFERENCE.copy(), REFERENCE, atol=0)
    assert_close(REFERENCE.astype(np.float32), REFERENCE, rtol=2.0**-24)
    assert_close(REFERENCE + 0.5, REFERENCE, atol=np.full((3, 4), 0.5000001))


def test_one_element_just_out_of_tolerance_fails():
    assert_close(changed((1, 2), REFERENCE[1, 2] + 0.99e-3), REFERENCE, atol=1e-3)
    with pytest.raises(
        AssertionError, match=r"1 of 12 elements are bad, in the box 1\.\.1 x 2\.\.2"
    ):
        assert_close(changed((1, 2), REFERENCE[1, 2] + 1.01e-3), REFERENCE, atol=1e-3)
    with pytest.raises(AssertionError, match="1 of 12"):
        assert_close(changed((1, 2), REFERENCE[1, 2] * 0.9989), REFERENCE, rtol=1e-3)
    with pytest.raises(AssertionError, match="1 of 12"):
        bounds = np.ones((3, 4))
        bounds[1, 2] = 1e-3
        assert_close(REFERENCE + 2e-3, REFERENCE, atol=bounds)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_fails_under_any_tolerance(value: float):
    with pytest.raises(AssertionError, match=r"worst at \(2, 0\)"):
        assert_close(changed((2, 0), value), REFERENCE, atol=1e30, rtol=1e30)


def test_the_message_shows_the_box_and_the_worst_value():
    actual = REFERENCE.copy()
    actual[0, 1] += 0.25
    actual[2, 3] -= 0.5
    with pytest.raises(AssertionError) as caught:
        assert_close(actual, REFERENCE, atol=0.1)
    assert "2 of 12 elements are bad, in the box 0..2 x 1..3" in str(caught.value)
    assert "worst at (2, 3)" in str(caught.value)


@pytest.mark.parametrize("actual", [REFERENCE[0], REFERENCE.T, REFERENCE[:1], np.float64(1.0)])
def test_another_shape_fails_and_is_not_broadcast(actual: np.ndarray):
    with pytest.raises(AssertionError, match="shape"):
        assert_close(actual.copy(), REFERENCE, atol=1e9)


def test_integers_are_compared_exactly():
    words = np.array([0, 1, 0xFFFFFFFF], np.uint32)
    assert_close(words.copy(), words, atol=0)
    for wrong in ([0, 1, 0xFFFFFFFE], [1, 1, 0xFFFFFFFF]):
        with pytest.raises(AssertionError, match="1 of 3"):
            assert_close(np.array(wrong, np.uint32), words, atol=0)


def test_an_imaginary_error_fails():
    with pytest.raises(AssertionError, match="12 of 12"):
        assert_close(REFERENCE + 1e-3j, REFERENCE, atol=1e-4)


def test_outliers_are_few_and_bounded():
    off = changed((0, 0), REFERENCE[0, 0] + 1.0)
    assert_close(off, REFERENCE, atol=0, outliers=0.1, outlier_atol=1.0)
    with pytest.raises(AssertionError):
        assert_close(off, REFERENCE, atol=0, outliers=0.05, outlier_atol=1.0)
    with pytest.raises(AssertionError):
        assert_close(off, REFERENCE, atol=0, outliers=0.1, outlier_atol=0.5)
    with pytest.raises(AssertionError):
        nan = changed((0, 0), np.nan)
        assert_close(nan, REFERENCE, atol=0, outliers=0.1, outlier_atol=1.0)


@pytest.mark.parametrize(
    ("actual", "reference", "tolerance", "problem"),
    [
        (REFERENCE, REFERENCE, {"atol": 1}, "same object"),
        (REFERENCE[:], REFERENCE, {"atol": 1}, "share memory"),
        (REFERENCE.T.T[::1], REFERENCE, {"atol": 1}, "share memory"),
        (REFERENCE.copy(), REFERENCE, {}, "give a tolerance"),
        (REFERENCE.copy(), REFERENCE, {"atol": -1.0}, "not negative"),
        (REFERENCE.copy(), REFERENCE, {"atol": np.nan}, "must be finite"),
        (REFERENCE.copy(), REFERENCE, {"rtol": np.inf}, "must be finite"),
        (REFERENCE.copy(), changed((0, 0), np.nan), {"atol": 1}, "not finite"),
        (REFERENCE.copy(), changed((0, 0), np.inf), {"atol": 1}, "not finite"),
        (np.zeros(0), np.ones(0), {"atol": 1}, "nothing to compare"),
        (REFERENCE.copy(), REFERENCE, {"atol": 1, "outliers": 0.1}, "outlier_atol"),
        (REFERENCE.copy(), REFERENCE, {"atol": 1, "outlier_atol": 0.1}, "outlier_atol"),
        (REFERENCE.copy(), REFERENCE, {"atol": 1, "outliers": 1.0, "outlier_atol": 1}, "share"),
    ],
)
def test_a_comparison_that_proves_nothing_is_refused(actual, reference, tolerance, problem):
    with pytest.raises(ValueError, match=problem):
        assert_close(actual, reference, **tolerance)


def test_a_failing_image_leaves_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GPUSIM_SHADERS_DIR", raising=False)
    with pytest.raises(AssertionError, match="difference x 4 of the range") as caught:
        assert_close(changed((1, 2), REFERENCE[1, 2] + 0.5), REFERENCE, atol=0.1)
    file = Path(re.search(r"(\S+\.png)", str(caught.value))[1])
    assert (tmp_path / file).stat().st_size > 0
    assert _picture(REFERENCE[0], REFERENCE[0]) == ""


HALF = """
override PART: u32 = 8u;
struct Params { n: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> image: array<f32>;
@group(0) @binding(2) var<storage, read_write> index: array<u32>;
@group(0) @binding(3) var<storage, read_write> pair: array<vec2f>;
@compute @workgroup_size(8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x < min(params.n, PART)) {
        image[id.x] = f32(id.x);
        index[id.x] = id.x;
        pair[id.x].x = 1.0;
        if (id.x < 7u) { pair[id.x].y = 0.0; }
    }
}
"""
OUTPUTS = {"image": (8, np.float32), "index": ((4, 2), np.uint32), "pair": (8, np.complex64)}


def test_what_a_shader_does_not_write_is_seen():
    part = Kernel.from_text("tests/half", HALF, PART=5)
    result = run_stage(part, (1, 1, 1), {"n": 8}, {}, OUTPUTS)
    assert unwritten(result["image"]).tolist() == [False] * 5 + [True] * 3
    assert unwritten(result["index"]).ravel().tolist() == [False] * 5 + [True] * 3
    assert unwritten(result["pair"]).tolist() == [False] * 5 + [True] * 3
    with pytest.raises(AssertionError, match="3 of 8"):
        assert_close(result["image"], np.arange(8.0), atol=1e9)
    with pytest.raises(AssertionError, match="3 of 8"):
        assert_close(result["index"].ravel(), np.arange(8), atol=8)
    whole = run_stage(Kernel.from_text("tests/half", HALF), (1, 1, 1), {"n": 8}, {}, OUTPUTS)
    assert not unwritten(whole["image"]).any()
    assert unwritten(whole["pair"]).tolist() == [False] * 7 + [True]  # one word of a complex


def test_a_grid_that_is_too_small_is_seen():
    result = run_stage(Kernel.from_text("tests/half", HALF), (0, 1, 1), {"n": 8}, {}, OUTPUTS)
    assert all(unwritten(array).all() for array in result.values())


def test_a_write_past_the_end_is_seen():
    wide = Kernel.from_text("tests/half", HALF)
    short = OUTPUTS | {"image": (7, np.float32)}
    run_stage(Kernel.from_text("tests/half", HALF, PART=7), (1, 1, 1), {"n": 8}, {}, short)
    with pytest.raises(AssertionError, match="tests/half writes past the end of image"):
        run_stage(wide, (1, 1, 1), {"n": 8}, {}, short)


def test_a_read_past_the_end_is_seen():
    kernel = Kernel.from_text("tests/copy", COPY, SHIFT=1)
    given = np.arange(8, dtype=np.float32)
    result = run_stage(kernel, (1, 1, 1), {"n": 8}, {"given": given}, {"image": (8, np.float32)})
    assert result["image"][:7].tolist() == [1, 2, 3, 4, 5, 6, 7]
    assert np.isnan(result["image"][7])


COPY = """
override SHIFT: u32;
struct Params { n: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> given: array<f32>;
@group(0) @binding(2) var<storage, read_write> image: array<f32>;
@compute @workgroup_size(8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x < params.n) { image[id.x] = given[id.x + SHIFT] * 1.0; }
}
"""


def test_a_computed_nan_is_not_taken_for_unwritten():
    assert unwritten(filled((2, 3), np.float32)).all()
    assert not unwritten(np.array([np.nan, -np.nan], np.float32)).any()
    assert not unwritten(np.array([0, 0x7FC0BEEF], np.uint32)).any()


def test_a_buffer_that_is_read_and_written_starts_with_its_input():
    start = np.arange(8, dtype=np.float32) + 100
    part = Kernel.from_text("tests/half", HALF, PART=2)
    result = run_stage(part, (1, 1, 1), {"n": 8}, {"image": start}, OUTPUTS)
    assert result["image"].tolist() == [0, 1, *range(102, 108)]


def test_a_kernel_takes_no_further_overrides():
    with pytest.raises(ValueError, match="has its overrides"):
        run_stage(Kernel.from_text("tests/half", HALF), (1, 1, 1), {"n": 8}, {}, OUTPUTS, PART=5)


X = np.linspace(0.5, 4.0, 130)
V = np.stack([X, 10 * X, 100 * X], axis=-1)


def test_an_expression_gives_its_values_and_a_wrong_one_fails():
    inputs = {"x": ("f32", X), "v": ("vec3f", V)}
    expected = X.astype(np.float32).astype(float) ** 2 + V[:, 2].astype(np.float32)
    # Two roundings, of the square and of the sum: 2 * 2^-24 relative.
    assert_close(evaluate([], "x * x + v.z", inputs), expected, rtol=2**-23)
    for wrong in ("x * x - v.z", "x * x + v.y", "x * x * 1.01 + v.z"):
        with pytest.raises(AssertionError):
            assert_close(evaluate([], wrong, inputs), expected, rtol=2**-23)


def test_vectors_keep_the_order_of_their_components():
    result = evaluate([], "v.zxy", {"v": ("vec3<f32>", V)}, returns="vec3f")
    assert_close(result, V[:, [2, 0, 1]], rtol=2**-24)  # one rounding to f32
    with pytest.raises(AssertionError):
        assert_close(result, V, rtol=2**-24)


def test_integers_declarations_and_statements():
    words = np.array([0, 1, 0x7FFFFFFF, 0xFFFFFFFF], np.uint32)
    result = evaluate(
        [],
        "y + twice(n)",
        {"n": ("u32", words), "i": ("i32", np.array([0, -1, 5, -5]))},
        returns="u32",
        declarations="fn twice(n: u32) -> u32 { return 2u * n; }",
        statements="var y = 0u; for (var k = 0; k < 3; k++) { y += u32(i + k); }",
    )
    i = np.array([0, -1, 5, -5])
    assert_close(result, (2 * words.astype(np.int64) + 3 * i + 3) % 2**32, atol=0)


def test_more_values_than_one_row_of_workgroups_holds():
    n = 64 * 65535 + 70
    result = evaluate([], "n + 1u", {"n": ("u32", np.arange(n, dtype=np.uint32))}, returns="u32")
    assert_close(result, np.arange(1, n + 1), atol=0)


@pytest.mark.parametrize(
    ("inputs", "problem"),
    [
        ({"x": ("f32", X), "v": ("vec3f", V[:5])}, "different lengths"),
        ({"x": ("vec3f", X)}, "needs the shape"),
        ({"x": ("f32", V)}, "needs the shape"),
        ({"x": ("u32", np.array([-1]))}, "do not fit u32"),
        ({"x": ("f64", X)}, "type 'f64'"),
    ],
)
def test_inputs_that_do_not_fit_are_refused(inputs: dict, problem: str):
    with pytest.raises(ValueError, match=problem):
        evaluate([], "x", inputs)


def test_an_expression_that_does_not_compile_is_an_error():
    with pytest.raises(ShaderError, match="does not compile"):
        evaluate([], "y", {"x": ("f32", X)})


MEMBERS = """
struct Params { a: f32, b: vec3f, c: f32, m: mat3x3f }
@group(0) @binding(0) var<uniform> params: Params;
@compute @workgroup_size(1) fn main() {}
"""


def echo_fails(kernel: Kernel) -> bool:
    values = example_params(kernel, seed=3)
    seen = echo_params(kernel, values)
    return any(not np.array_equal(seen[name], values[name]) for name in values)


def moved(struct: Struct, **offsets: int) -> Struct:
    members = {
        name: (offsets.get(name, offset), kind) for name, (offset, kind) in struct.members.items()
    }
    return dataclasses.replace(struct, members=members)


def test_the_echo_sees_a_member_that_lies_elsewhere():
    kernel = Kernel.from_text("tests/members", MEMBERS)
    assert not echo_fails(kernel)
    right = kernel.params
    assert right.members["c"][0] == 28
    for wrong in ({"b": 4, "c": 16}, {"a": 28, "c": 0}, {"c": 12}):
        kernel.params = moved(right, **wrong)
        assert echo_fails(kernel), wrong


def test_the_echo_sees_a_transposed_matrix(monkeypatch: pytest.MonkeyPatch):
    kernel = Kernel.from_text("tests/members", MEMBERS)
    assert not echo_fails(kernel)
    monkeypatch.setattr(packing.np, "swapaxes", lambda value, *axes: value)
    assert echo_fails(kernel)


@pytest.mark.parametrize(
    ("variable", "problem"),
    [("GPUSIM_EXPECT_ADAPTER", "was expected"), ("GPUSIM_ADAPTER", "No adapter of that name")],
)
def test_a_wrong_or_missing_adapter_fails_and_does_not_skip(variable: str, problem: str):
    test = Path(__file__).parent / "gpu" / "test_device.py"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", f"{test}::{ONE_TEST}"],
        env=os.environ | {variable: "no such adapter"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert problem in done.stdout
    assert "skipped" not in done.stdout


ONE_TEST = "test_the_report_names_the_adapter_and_the_driver"

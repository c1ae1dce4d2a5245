"""Every shader: it composes, compiles, and sees its params where the host puts them."""

import numpy as np
import pytest
from harness import assert_close, echo_params, example_kernel, example_params, shader_names

from gpusim.gpu import Device, Kernel
from gpusim.gpu.wgsl import compose, shaders_root


def test_there_are_shaders():
    assert len(shader_names()) >= 5
    assert len(shader_names(includes=True)) >= 1


@pytest.mark.parametrize("name", shader_names())
def test_a_shader_composes_and_compiles(device: Device, name: str):
    kernel = example_kernel(name)
    kernel.compile(device)
    # Shown by `pytest -rP`: a change that keeps the digest changed nothing.
    print(f"{name} {kernel.source.digest}")


@pytest.mark.parametrize("name", shader_names())
def test_a_shader_sees_its_params_where_the_host_puts_them(name: str):
    kernel = example_kernel(name)
    values = example_params(kernel, seed=1)
    seen = echo_params(kernel, values)
    assert list(seen) == list(values)
    for member, value in values.items():
        assert_close(seen[member], value, atol=0)


def test_every_kind_of_member_is_echoed():
    members = """
        a: f32, b: vec3f, c: i32, d: vec2u, e: mat3x3f, f: mat2x4f, g: array<vec3f, N>, h: vec4i,
        i: array<mat2x3f, 2>, j: u32, k: Pair
    """
    kernel = Kernel.from_text(
        "tests/members",
        f"""
        const N = 3u;
        alias Pair = vec2f;
        struct Params {{ {members} }}
        @group(0) @binding(0) var<uniform> params: Params;
        @compute @workgroup_size(1) fn main() {{}}
        """,
    )
    values = example_params(kernel, seed=2)
    seen = echo_params(kernel, values)
    assert (
        sum(np.size(value) for value in values.values()) == 1 + 3 + 1 + 2 + 9 + 8 + 9 + 4 + 12 + 3
    )
    for member, value in values.items():
        assert_close(seen[member], value, atol=0)


@pytest.mark.parametrize("name", shader_names(includes=True))
def test_an_include_stands_alone(device: Device, name: str):
    """Compile an include with nothing but itself, unless its header says on what it depends."""
    include = name.removeprefix("common/")
    text = (shaders_root() / f"{name}.wgsl").read_text()
    assert compose("tests/include", f'#include "{include}"').text
    if "Depends on the globals" in text:
        return  # compiled with the stages that give it these globals
    Kernel.from_text(
        f"tests/{include}",
        f'#include "{include}"\nstruct Params {{ n: u32 }}\n'
        "@group(0) @binding(0) var<uniform> params: Params;\n"
        "@compute @workgroup_size(1) fn main() {}",
    ).compile(device)

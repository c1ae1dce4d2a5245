"""Tint, the compiler of Chrome, accepts every shader: it is stricter than the one we run on.

wgpudawn is Tint and Dawn as a package. Dawn makes modules on an adapter only, and takes fewer than
we do: Mesa's lavapipe from version 25 on, SwiftShader, and GPUs. `tools/drivers.py` runs this test
on each driver that is there.
"""

import pytest

from gpusim.gpu.wgsl import load, shaders_root

SHADERS = sorted(
    path.relative_to(shaders_root()).with_suffix("").as_posix()
    for path in shaders_root().rglob("*.wgsl")
    if path.parent.name != "common"
)


@pytest.fixture(scope="module")
def dawn():
    """Return a device of Dawn."""
    wgpudawn = pytest.importorskip("wgpudawn")
    found = [
        adapter
        for adapter in wgpudawn.gpu.enumerate_adapters_sync()
        if adapter.info["backend_type"] != "Null"
    ]
    if not found:
        pytest.skip("Dawn takes none of the adapters here")
    return found[0].request_device_sync()


@pytest.mark.parametrize("path", SHADERS)
def test_tint_accepts_a_shader(dawn, path: str):
    dawn.create_shader_module(label=path, code=load(path).text)


def test_tint_refuses_what_is_no_wgsl(dawn):
    """Else the test above would prove nothing."""
    with pytest.raises(Exception, match="error"):
        dawn.create_shader_module(label="wrong", code="fn main() -> f32 { return 1u; }")

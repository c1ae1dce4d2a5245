"""Choice of the adapter, its limits, and arrays that stay on the device."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from gpusim.errors import UserError
from gpusim.gpu import (
    Device,
    DeviceLostError,
    Kernel,
    Recording,
    ShaderError,
    adapters,
    default_device,
    devices,
)
from gpusim.gpu import device as device_module
from gpusim.gpu.device import PORTABLE_LIMITS


def test_there_is_one_device_per_process(device: Device):
    assert default_device() is device


def test_the_listed_adapters_are_no_opengl_ones():
    found = devices()
    assert found
    assert {one["backend"] for one in found} <= {"Vulkan", "Metal", "D3D12"}


def test_a_machine_without_a_screen_hears_no_complaint():
    """Mesa's libwayland complains on stderr where nobody names a folder for sockets."""
    bare = {key: value for key, value in os.environ.items() if key != "XDG_RUNTIME_DIR"}
    look = "import os, gpusim.gpu as g; g.devices(); print(os.environ.get('XDG_RUNTIME_DIR'))"
    ended = subprocess.run(
        [sys.executable, "-c", look], env=bare, capture_output=True, text=True, check=True
    )
    assert (ended.stdout, ended.stderr) == ("None\n", "")


def test_the_report_names_the_adapter_and_the_driver(device: Device):
    report = device.report()
    assert report["adapter"] in {one["adapter"] for one in devices()}
    assert report["driver"]
    assert report["wgpu"].count(".") == 2
    assert report["budget_bytes"] == device.pool.budget


def test_the_device_has_the_portable_limits_and_no_larger_ones(device: Device):
    assert device.report()["limits"] == PORTABLE_LIMITS


def test_an_unknown_adapter_is_refused_with_the_known_ones(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(device_module, "Device", None)  # nothing may be opened
    with pytest.raises(UserError, match="No adapter of that name") as caught:
        Device.open("no such adapter")
    assert caught.value.value == "no such adapter"
    assert devices()[0]["adapter"] in caught.value.allowed


def test_without_an_adapter_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(adapters, "usable", list)
    with pytest.raises(UserError, match="No GPU adapter") as caught:
        Device.open()
    assert "mesa-vulkan-drivers" in caught.value.allowed


class Listed:
    """An adapter as far as the choice looks at it."""

    def __init__(self, name: str, kind: str, driver: str = "Mesa 22") -> None:
        self.info = {"device": name, "description": driver, "adapter_type": kind}


def test_the_choice_is_by_name_then_by_kind(monkeypatch: pytest.MonkeyPatch):
    listed = [
        Listed("llvmpipe", "CPU"),
        Listed("small", "IntegratedGPU"),
        Listed("large", "DiscreteGPU", "other"),
        Listed("odd", "Unknown"),
    ]
    monkeypatch.setattr(adapters, "usable", lambda: listed)
    monkeypatch.setattr(
        Device, "__init__", lambda self, adapter, budget: vars(self).update(a=adapter)
    )
    assert Device.open().a.info["device"] == "large"
    assert Device.open("LLVMpipe").a.info["device"] == "llvmpipe"
    assert Device.open("mesa").a.info["device"] == "small"


@pytest.mark.parametrize("dtype", [np.float32, np.complex64, np.uint32, np.int32])
def test_a_resident_comes_back_as_it_went(device: Device, dtype: type):
    array = np.arange(35).reshape(5, 7).astype(dtype)
    one = device.resident("one", array)
    back = device.read(one)
    assert back.dtype == array.dtype
    assert np.array_equal(back, array)
    device.write(one, array[::-1])
    assert np.array_equal(device.read(one), array[::-1])
    one.destroy()


def test_an_empty_resident_has_no_elements(device: Device):
    one = device.resident("none", np.zeros((0, 3), np.float32))
    assert device.read(one).shape == (0, 3)
    one.destroy()


@pytest.mark.parametrize(
    "array", [np.zeros(4, np.float64), np.zeros(4, np.uint8), np.zeros(4, np.float16)]
)
def test_a_dtype_that_shaders_lack_is_refused(device: Device, array: np.ndarray):
    with pytest.raises(ShaderError, match=f"dtype {array.dtype}, allowed are float32"):
        device.resident("one", array)


def test_writing_another_shape_or_dtype_is_refused(device: Device):
    one = device.empty("one", (2, 3), np.float32)
    device.write(one, np.ones((2, 3), np.float32))
    for wrong in (np.ones((3, 2), np.float32), np.ones((2, 3))):
        with pytest.raises(ShaderError, match="buffer 'one' is float32"):
            device.write(one, wrong)
    one.destroy()


def test_a_lost_device_says_so_and_the_next_one_is_opened(monkeypatch: pytest.MonkeyPatch):
    """Destroyed behind our back, as a reset of the driver does it."""
    one = Device.open(os.environ.get("GPUSIM_ADAPTER"))
    monkeypatch.setattr(device_module, "_default", one)
    array = one.resident("a", np.zeros(8, np.float32))
    rec = Recording(one)
    rec.clear(rec.buffer("b", 8, np.float32))
    rec.run()
    assert default_device() is one and not one.lost
    one.gpu.destroy()
    fresh = Recording(one)
    numbers = dict.fromkeys(("rows", "cols", "row0", "col0", "inner_rows", "inner_cols"), 1)
    framed = fresh.buffer("framed", 8, np.float32)
    Kernel("sensor/border").record(fresh, (1, 1, 1), numbers, inner=array, framed=framed)
    for work in (
        rec.run,
        fresh.run,
        lambda: one.read(array),
        lambda: one.resident("c", np.zeros(8, np.float32)),
        lambda: one.empty("d", 8, np.float32),
    ):
        with pytest.raises(DeviceLostError, match="was lost") as caught:
            work()
        assert "--memory" in caught.value.allowed and "--adapter" in caught.value.allowed
    assert one.lost
    assert default_device() is not one


def test_other_errors_are_not_taken_for_a_loss(device: Device):
    with pytest.raises(RuntimeError, match="something else"), device.telling_of_loss():
        raise RuntimeError("something else")
    assert not device.lost


def test_after_waiting_there_is_nothing_left_to_wait_for(device: Device):
    """Seen red on SwiftShader; lavapipe works while it takes a submission, and passes always."""
    source = """
        struct Params { turns: u32, }
        @group(0) @binding(0) var<uniform> params: Params;
        @group(0) @binding(1) var<storage, read_write> to: array<f32>;
        @compute @workgroup_size(64, 1, 1)
        fn main(@builtin(global_invocation_id) id: vec3u) {
            var x = f32(id.x);
            for (var turn = 0u; turn < params.turns; turn++) { x = fract(x * 1.7 + 0.3); }
            to[id.x] = x;
        }
    """
    kernel = Kernel.from_text("work", source)
    to = device.empty("work", 64 * 64, np.float32)
    rec = Recording(device)
    kernel.record(rec, (64, 1, 1), {"turns": 100_000}, to=to)
    rec.run()  # compiled
    started = time.perf_counter()
    rec.run()
    worked_s = time.perf_counter() - started
    started = time.perf_counter()
    device.read(to)
    assert time.perf_counter() - started < worked_s / 2

"""Double float on this adapter: the probe sees what a driver that folds (a + b) - a does."""

import re
from unittest import mock

import pytest

from gpusim.errors import UserError
from gpusim.gpu import Device, Kernel, Recording
from gpusim.gpu.exact import PROBE, keeps_double_float, need_double_float
from gpusim.gpu.wgsl import shaders_root
from gpusim.sensor.bloom import record_bloom
from gpusim.sensor.smear import record_smear
from gpusim.sensor.smear_model import Smear

TEXT = (shaders_root() / "common" / "double_float.wgsl").read_text()


def probe(change: str) -> Kernel:
    """Return the probe with another body of `pin`."""
    text = re.sub(r"(fn pin\(x: f32\) -> f32 \{\s*return )[^;]+", rf"\g<1>{change}", TEXT)
    assert text != TEXT
    return Kernel.from_text("gpu/exact", PROBE.replace('#include "double_float"', text))


def test_this_adapter_keeps_it(device: Device):
    assert keeps_double_float(device)


def test_a_rounding_error_that_is_lost_is_seen(device: Device):
    """What a compiler makes of it that sees through `pin`, here by an operation that loses it."""
    assert not keeps_double_float(device, probe("bitcast<f32>(bitcast<u32>(x) & 0xFFFFFFFEu)"))


def test_stages_of_double_float_are_refused_where_it_is_lost(device: Device):
    rec = Recording(device)
    rate = rec.buffer("rate", (8, 8), "f4")
    rec.clear(rate)
    with mock.patch.object(device, "double_float", False):
        with pytest.raises(UserError, match="rounding errors"):
            need_double_float(device)
        with pytest.raises(UserError, match="rounding errors"):
            record_bloom(rec, rate, 1e5)
        with pytest.raises(UserError, match="rounding errors"):
            record_smear(rec, rate, rate, Smear(kind="frame_transfer", row_s=1e-6))


def test_a_device_is_tested_once(device: Device):
    with (
        mock.patch.object(device, "double_float", None),
        mock.patch("gpusim.gpu.exact.keeps_double_float", return_value=True) as probed,
    ):
        need_double_float(device)
        need_double_float(device)
    assert probed.call_count == 1

"""Double float on this adapter: the probe sees what a driver that folds (a + b) - a does."""

import re
import shutil
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from lens.rays import LENSES, LINES

from gpusim.errors import UserError
from gpusim.gpu import Device, Kernel, Recording
from gpusim.gpu.exact import PROBE, WAYS, double_float, keeps_double_float
from gpusim.gpu.wgsl import shaders_root
from gpusim.lens.tracer import Beams
from gpusim.sensor.bloom import record_bloom
from gpusim.sensor.smear import record_smear
from gpusim.sensor.smear_model import Smear

PIN = re.compile(r"(fn pin\(x: f32\) -> f32 \{\s*return )[^;]+")
# In place of `pin`: nothing, which lavapipe's compiler sees through, and what loses a bit anywhere.
FOLDED = ("x", "bitcast<f32>(bitcast<u32>(x) & 0xFFFFFFFEu)")
F32, INTEGERS = WAYS


@pytest.fixture
def folding(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, device: Device, body: str) -> Device:
    """Return the device, not tested yet, under shaders with another `pin`."""
    root = shutil.copytree(shaders_root(), tmp_path / "shaders")
    file = root / "common" / "double_float.wgsl"
    text, count = PIN.subn(rf"\g<1>{body}", file.read_text())
    assert count == 1
    file.write_text(text)
    monkeypatch.setenv("GPUSIM_SHADERS_DIR", str(root))
    monkeypatch.setattr(device, "double_float", None)
    return device


@pytest.fixture(scope="module")
def expected(device: Device) -> list[np.ndarray]:
    """Return what the stages of double float make on the device as it is."""
    return results(device)


def probe(way: dict[str, bool]) -> Kernel:
    return Kernel.from_text("gpu/exact", PROBE, **way)


def results(device: Device) -> list[np.ndarray]:
    """Return what the stages of double float make: smear, bloom, and optical paths of a lens."""
    rng = np.random.default_rng(5)
    rec = Recording(device)
    found = []
    for name, top in (("rate", 1e9), ("mean", 1e4)):
        found.append(rec.buffer(name, (200, 70), "f4"))
        rec.upload(found[-1], rng.integers(0, int(top), (200, 70)).astype(np.float32))
    rate, mean = found
    smear = record_smear(rec, rate, mean, Smear(kind="frame_transfer", row_s=1e-6))
    labels = [rec.download(one) for one in (smear, *record_bloom(rec, rate, 777.0))]
    result = rec.run()
    made = [result[one] for one in labels]
    if "SwiftShader" in device.report()["adapter"]:
        return made  # it takes minutes over the tracer with integers, which it has no need of
    make, fields = LENSES["near phone"]  # aspheres, and a point of the object
    beams = Beams(device, make(), LINES, np.radians(fields))
    pair = np.arange(1000) % beams.count
    traced = beams.trace(rng.uniform(-0.5, 0.5, (len(pair), 2)), pair)  # mm, around the stop
    beams.release()
    return [*made, traced.opd_waves, traced.cosines]


@pytest.mark.parametrize("way", WAYS, ids=["f32", "integers"])
def test_this_adapter_keeps_it_in_both_ways(device: Device, way: dict[str, bool]):
    assert keeps_double_float(device, probe(way))
    assert double_float(device) == F32


def test_integers_give_the_same_numbers_bit_for_bit(device: Device, expected: list[np.ndarray]):
    with mock.patch.object(device, "double_float", INTEGERS):
        assert all(map(np.array_equal, results(device), expected))


@pytest.mark.parametrize("body", FOLDED)
def test_a_driver_that_folds_gets_integers_and_the_same_numbers(expected, folding: Device):
    if keeps_double_float(folding, probe(F32)):
        pytest.skip("this driver takes (a + b) - a as it is written")
    assert double_float(folding) == INTEGERS
    assert all(map(np.array_equal, results(folding), expected))
    folding.double_float = F32  # else they would be others
    assert not all(map(np.array_equal, results(folding), expected))


def test_stages_of_double_float_are_refused_where_it_is_lost(device: Device):
    rec = Recording(device)
    rate = rec.buffer("rate", (8, 8), "f4")
    rec.clear(rate)
    with (
        mock.patch.object(device, "double_float", None),
        mock.patch("gpusim.gpu.exact.keeps_double_float", return_value=False),
    ):
        with pytest.raises(UserError, match="rounding errors"):
            double_float(device)
        with pytest.raises(UserError, match="rounding errors"):
            record_bloom(rec, rate, 1e5)
        with pytest.raises(UserError, match="rounding errors"):
            record_smear(rec, rate, rate, Smear(kind="frame_transfer", row_s=1e-6))


def test_a_device_is_tested_once(device: Device):
    with (
        mock.patch.object(device, "double_float", None),
        mock.patch("gpusim.gpu.exact.keeps_double_float", return_value=True) as probed,
    ):
        double_float(device)
        double_float(device)
    assert probed.call_count == 1

"""Drawn offsets of the columns' converters: against float64 from the same words, and their law."""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from scipy.stats import chi2, kstest

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.column_offset import column_offset
from gpusim.sensor.adc_model import ColumnOffset
from gpusim.sensor.column_offset import record_column_offset
from gpusim.sensor.load import load_sensor

F32 = np.float32
SERIAL = (5 << 32) + 88


def on_device(cols: int, col0: int = 0, sigma_dn: float = 1.0, serial: int = SERIAL) -> np.ndarray:
    params = {
        "serial": (serial & 0xFFFFFFFF, serial >> 32),
        "col0": col0,
        "cols": cols,
        "sigma_dn": sigma_dn,
    }
    groups = (-(-(col0 % 4 + cols) // 256), 1, 1)
    found = run_stage("sensor/column_offset", groups, params, {}, {"offset": (cols + 9, F32)})
    assert unwritten(found["offset"][cols:]).all()
    return found["offset"][:cols]


@pytest.mark.parametrize("cols", [1, 3, 4, 5, 255, 256, 257])
@pytest.mark.parametrize("col0", [0, 1, 2, 3, 4000])
def test_offsets_are_those_of_the_reference(cols: int, col0: int):
    expected = column_offset(np.arange(col0, col0 + cols), SERIAL, 2.5)
    # The deviates are good to 1e-6 (test_gaussian); one product more.
    assert_close(on_device(cols, col0, 2.5), expected, atol=4e-6)


def test_offsets_are_normal_and_unrelated():
    found = on_device(8192).astype(float)
    assert kstest(found, "norm").pvalue > 1e-3
    others = [np.roll(found, shift) for shift in (1, 2, 3, 4, 16)]
    others += [
        on_device(8192, serial=key).astype(float) for key in (SERIAL + 1, SERIAL + (1 << 32))
    ]
    for other in others:
        # By chance once in 1e4
        assert abs(np.corrcoef(found, other)[0, 1]) < np.sqrt(chi2.isf(1e-4, 1) / found.size)


def test_the_host_draws_those_of_the_sensor(device: Device):
    sensor = load_sensor("imx477").model_copy(
        update={"serial_number": SERIAL, "column_offset": ColumnOffset(sigma_dn=2.5)}
    )
    rec = Recording(device)
    label = rec.download(record_column_offset(rec, sensor, 13, 70))
    assert_close(rec.run()[label], on_device(70, 13, 2.5), atol=0)


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/column_offset").workgroup_size == (64, 1, 1)

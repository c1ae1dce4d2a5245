"""Packing against the reference."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import F32

from gpusim.gpu import Device, Recording
from gpusim.isp.pack import record_pack, unpacked
from gpusim.reference.pack import pack


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("shape", [(1, 4), (3, 20), (41, 100)])
def test_codes_are_those_of_the_reference(device: Device, bits: int, shape):
    values = np.random.default_rng(bits).uniform(-0.2, 1.2, (3, *shape)).astype(F32)
    values[0, 0, :4] = [0, 1, -1, 2]
    rec = Recording(device)
    given = rec.buffer("values", values.shape, "f4")
    rec.upload(given, values)
    label = record_pack(rec, given, bits)
    found = unpacked(rec.run()[label])
    assert found.dtype == (np.uint8 if bits == 8 else np.uint16)
    expected = pack(values.reshape(3, -1), bits).reshape(*shape, 3)
    # The product is rounded to 2^-24 of the largest code, which carries so many over a half.
    assert_close(found.astype(int), expected, atol=0, outliers=2.0 ** (bits - 20), outlier_atol=1)

"""Black level and linearisation against the reference."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import ULP

from gpusim.gpu import Device, Recording
from gpusim.isp.linear import record_linear
from gpusim.reference.linear import linear

RNG = np.random.default_rng(1)
TABLE = np.minimum(np.arange(4096) ** 1.1, 65535).astype(np.uint16)


def found(device: Device, codes, black, span, table=None) -> np.ndarray:
    rec = Recording(device)
    label = rec.download(record_linear(rec, codes, black, span, table=table))
    return rec.run()[label]


@pytest.mark.parametrize("table", [None, TABLE], ids=["linear", "table"])
@pytest.mark.parametrize("period", [(1, 1), (2, 2), (3, 5)])
@pytest.mark.parametrize("shape", [(1, 4), (17, 68), (40, 128)])
def test_light_is_that_of_the_reference(device: Device, table, period, shape):
    codes = RNG.integers(0, 4096, shape).astype(np.uint16)
    black = RNG.uniform(200, 300, period)
    # Black, difference, scale and product are rounded: levels of up to `top`.
    top = 4096 if table is None else int(TABLE.max())
    expected = linear(codes, black, 3700.5, table)
    assert_close(found(device, codes, black, 3700.5, table), expected, atol=4 * ULP * top / 3700.5)


def test_codes_of_sixteen_bits_keep_their_places(device: Device):
    codes = np.array([[0, 1, 65535, 32768], [40000, 2, 3, 65534]], np.uint16)
    assert_close(found(device, codes, np.zeros((1, 1)), 1.0), codes.astype(float), atol=0)

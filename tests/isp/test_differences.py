"""The first stage of directional demosaicing against the reference."""

import pytest
from harness import assert_close
from isp.stages import ULP, scene

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.differences import differences


def found(device: Device, light):
    rows, cols = light.shape
    rec = Recording(device)
    given = rec.buffer("light", light.shape, "f4")
    rec.upload(given, light)
    out = rec.buffer("out", (rows // 2, cols // 2, 4), "f4")
    kernel = Kernel("isp/differences")
    groups = kernel.cover(cols // 2 - 2, rows // 2 - 2)
    kernel.record(rec, groups, {"rows": rows, "pairs": cols // 2}, light=given, differences=out)
    label = rec.download(out)
    return rec.run()[label][1:-1, 1:-1]


@pytest.mark.parametrize("shape", [(6, 6), (38, 74), (80, 36)])
def test_differences_are_those_of_the_reference(device: Device, shape):
    light = scene(*shape, 3)
    expected = differences(light)
    cells = found(device, light)
    # Four sums of magnitudes up to 2.4 and two products by powers of two.
    for first, place in ((0, 2), (2, 3)):  # red at even places, blue at odd ones
        end = place - 4
        own = expected[place : end or None : 2, place : end or None : 2][
            : cells.shape[0], : cells.shape[1]
        ]
        assert_close(cells[..., first : first + 2], own, atol=10 * ULP)

"""The guide is added to all colours."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import ULP, scene

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.regain import regain


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (18, 35)])
def test_colours_are_differences_and_guide(device: Device, shape):
    differences = np.stack([scene(*shape, seed) for seed in range(4)])
    guide = scene(*shape, 9)
    rec = Recording(device)
    planes, given = rec.buffer("planes", differences.shape, "f4"), rec.buffer("guide", shape, "f4")
    rec.upload(planes, differences)
    rec.upload(given, guide)
    kernel = Kernel("isp/regain")
    params = {"rows": shape[0], "cols": shape[1], "colours": 4}
    kernel.record(rec, kernel.cover(shape[1], shape[0]), params, guide=given, planes=planes)
    label = rec.download(planes)
    # One sum of magnitude up to 2.4.
    assert_close(rec.run()[label], regain(differences, guide), atol=3 * ULP)

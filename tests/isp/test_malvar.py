"""Demosaicing by linear filters against the reference and another program."""

import numpy as np
import pytest
from harness import assert_close
from isp.photographs import cpsnr_db, mosaicked, photographs
from isp.stages import F32, ULP, scene, through

from gpusim.gpu import Device
from gpusim.isp.malvar import record_malvar
from gpusim.reference.malvar import malvar


@pytest.mark.parametrize("shape", [(6, 6), (38, 70), (64, 32)])
def test_colours_are_those_of_the_reference(device: Device, shape):
    light = scene(*shape, 3)
    inner = (slice(None), slice(2, -2), slice(2, -2))
    # Sums of a dozen terms of up to 6 in magnitude, an eighth of them: 12 x 24/8 roundings.
    expected = malvar(light)[inner]
    assert_close(through(device, light, record_malvar)[inner], expected, atol=36 * ULP)


def test_colours_without_detail_come_out_whole(device: Device):
    """Grey ramps are reproduced, since the filters' weights sum to 1 and are even."""
    rows, cols = np.indices((24, 28))
    ramp = (0.2 + 0.01 * rows + 0.02 * cols).astype(F32)
    found = through(device, ramp, record_malvar)[:, 2:-2, 2:-2]
    assert_close(found, np.repeat(ramp[None], 3, axis=0)[:, 2:-2, 2:-2], atol=16 * ULP)


@pytest.mark.parametrize("name", ["whole", "half"])
def test_it_is_as_good_as_another_programs(device: Device, name: str):
    demosaicing = pytest.importorskip("colour_demosaicing")
    picture = photographs()[name]
    light = mosaicked(picture)
    ours = through(device, light.astype(F32), record_malvar).transpose(1, 2, 0)
    theirs = demosaicing.demosaicing_CFA_Bayer_Malvar2004(light, "RGGB")
    quality = [cpsnr_db(one, picture) for one in (ours, theirs)]
    print(f"{name}: CPSNR {quality[0]:.3f} dB, colour-demosaicing {quality[1]:.3f} dB")
    assert abs(quality[0] - quality[1]) < 0.05
    inner = slice(2, -2), slice(2, -2)
    assert_close(ours[inner], theirs[inner], atol=40 * ULP)

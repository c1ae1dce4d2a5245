"""Transfer curves against the reference and against colour-science."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import F32, ULP, through

from gpusim.gpu import Device
from gpusim.isp.transfer import SPACES, record_transfer
from gpusim.reference.transfer import transfer

CUTS = [0.0031308, 0.018053968510807]
LIGHT = np.concatenate([[-1, 0, 1, 7], np.geomspace(1e-6, 1, 1018), CUTS]).astype(F32)
CURVED = [name for name, space in SPACES.items() if space.transfer is not None]


@pytest.mark.parametrize("name", CURVED)
def test_values_are_those_of_the_reference(device: Device, name: str):
    curve = SPACES[name].transfer
    found = through(device, LIGHT, lambda rec, light: record_transfer(rec, light, curve))
    # WGSL lets pow be exp2(y log2 x), with log2 off by 2^-21 near 1 and 3 ULP elsewhere, exp2 by
    # 3 + 2 |x| ULP: 16 ULP of values up to 1. At the cut both pieces are within 1e-7 in value.
    assert_close(found, transfer(LIGHT, **vars(curve)), atol=16 * ULP)


@pytest.mark.parametrize(
    ("name", "theirs"), [("srgb", "sRGB"), ("p3", "Display P3"), ("rec2020", "ITU-R BT.2020")]
)
def test_spaces_are_those_of_colour_science(name: str, theirs: str):
    colour = pytest.importorskip("colour")
    space, known = SPACES[name], colour.RGB_COLOURSPACES[theirs]
    given = np.array([*known.primaries.ravel(), *known.whitepoint])
    assert_close(np.array(space.chromaticities), given, atol=1e-9)
    light = np.linspace(0, 1, 101)
    curve = transfer(light, **vars(space.transfer))
    # They round BT.2020's constants as the recommendation does for 12 bits: 1.0993 and 0.0181,
    # which moves dark values most, by 2.5e-4.
    assert_close(curve, known.cctf_encoding(light), atol=3e-4)

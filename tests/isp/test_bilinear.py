"""Demosaicing by weighted means against the reference and another program's."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import ULP, scene, through

from gpusim.gpu import Device
from gpusim.isp.bilinear import far_of, reach_of, record_bilinear
from gpusim.reference.bilinear import bilinear
from gpusim.sensor.cfa import CFA_LETTERS, PATTERNS


def of(pattern: tuple[str, ...]) -> str:
    return "".join(sorted(set("".join(pattern)), key=CFA_LETTERS.index))


def found(device: Device, light: np.ndarray, pattern, frame=None) -> np.ndarray:
    frame = frame or (0, 0, *light.shape)
    return through(
        device,
        light,
        lambda rec, given: record_bilinear(rec, given, pattern, of(pattern), frame),
    )


ARRAYS = {
    "Bayer": ("RG", "GB"),
    "X-Trans": tuple("".join(row) for row in PATTERNS["X-Trans"]),
    "quad": ("RRGG", "RRGG", "GGBB", "GGBB"),
    "four": ("RG", "BW"),
    "two": ("RW", "WR"),
    "seven": ("RGBC", "MYWR"),
    "row": ("RGB",),
}


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (18, 23)])
def test_planes_are_those_of_the_reference(device: Device, name: str, shape):
    light = scene(*shape, 9)
    pattern = ARRAYS[name]
    expected = bilinear(light, pattern, of(pattern), reach_of(pattern), far_of(pattern))
    # Sums of up to 9 products of whole weights, and a quotient: less than 1.2 times that many.
    assert_close(found(device, light, pattern), expected, atol=12 * ULP)


def test_what_is_outside_the_frame_does_not_count(device: Device):
    light = scene(20, 28, 4)
    pattern = ARRAYS["Bayer"]
    inner = light[3:18, 5:26]
    moved = ("BG", "GR")  # that of the inner part's first pixel
    whole = found(device, light, pattern, (3, 5, 15, 21))[:, 3:18, 5:26]
    assert_close(whole, bilinear(inner, moved, "RGB", 2, 2), atol=12 * ULP)


def test_the_tent_reaches_as_far_as_it_must():
    assert reach_of(("RG", "GB")) == 2
    assert reach_of(("W",)) == 1
    assert far_of(("RG", "GB")) == 2
    assert far_of(ARRAYS["quad"]) == 3
    # Each 3 x 3 of these has every colour.
    assert reach_of(ARRAYS["quad"]) == 2
    assert reach_of(ARRAYS["X-Trans"]) == 2
    assert reach_of(("RGRG", "GRGR", "RGBG", "GRGR")) == 3  # 5 x 5 has it


@pytest.mark.parametrize("name", ARRAYS)
def test_an_even_frame_is_even_to_its_corners(device: Device, name: str):
    pattern = ARRAYS[name]
    shape = max(len(pattern), 4), max(len(pattern[0]), 5)
    assert_close(
        found(device, np.full(shape, 0.25, np.float32), pattern),
        np.full((len(of(pattern)), *shape), 0.25),
        atol=4 * ULP,
    )


def test_bilinear_is_as_good_as_another_programs(device: Device):
    demosaicing = pytest.importorskip("colour_demosaicing")
    light = scene(60, 64, 8)
    theirs = demosaicing.demosaicing_CFA_Bayer_bilinear(light.astype(float), "RGGB")
    inner = slice(2, -2), slice(2, -2)  # they fill up with black beyond the rim
    ours = found(device, light, ARRAYS["Bayer"])
    for number in range(3):
        assert_close(ours[number][inner], theirs[..., number][inner], atol=12 * ULP)

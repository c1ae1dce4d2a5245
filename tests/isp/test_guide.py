"""Demosaicing by the most frequent colour: against the reference, and how good it is."""

from __future__ import annotations

import numpy as np
import pytest
from harness import assert_close
from isp.photographs import cpsnr_db, photographs
from isp.stages import ULP, scene, through

from gpusim.gpu import Device, Kernel, Recording
from gpusim.isp.bilinear import far_of, reach_of, record_bilinear
from gpusim.isp.guided import guide_of, near_of, record_guided
from gpusim.reference.bilinear import bilinear
from gpusim.reference.guide import guide
from gpusim.sensor.cfa import PATTERNS

ARRAYS = {
    "X-Trans": tuple("".join(row) for row in PATTERNS["X-Trans"]),
    "RGBW": tuple("".join(row) for row in PATTERNS["RGBW"]),
    "quad": tuple("".join(row) for row in PATTERNS["quad Bayer"]),
    "seven": ("RGBC", "MYWR"),
}
COLOURS = {"X-Trans": "RGB", "RGBW": "RGBW", "quad": "RGB", "seven": "RGBCMYW"}


def stage(device: Device, light, means, pattern, frame) -> dict[str, np.ndarray]:
    """Return what the stage makes of light and means."""
    rec = Recording(device)
    arrays = {name: rec.buffer(name, light.shape, "f4") for name in ("light", "means")}
    for name, values in (("light", light), ("means", means)):
        rec.upload(arrays[name], values)
    around = near_of(pattern)
    near = rec.buffer("near", around.shape, "i4")
    rec.upload(near, around)
    out = {name: rec.buffer(name, light.shape, "f4") for name in ("guide", "differences")}
    kernel = Kernel("isp/guide", PY=around.shape[0], PX=around.shape[1], COUNT=around.shape[2])
    rows, cols = light.shape
    params = {"rows": rows, "cols": cols, "first": frame[:2]}
    params["last"] = (frame[0] + frame[2], frame[1] + frame[3])
    kernel.record(rec, kernel.cover(cols, rows), params, near=near, **arrays, **out)
    labels = {name: rec.download(array) for name, array in out.items()}
    result = rec.run()
    return {name: result[label] for name, label in labels.items()}


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (18, 23)])
def test_the_guide_is_that_of_the_reference(device: Device, name: str, shape):
    light, means, pattern = scene(*shape, 9), scene(*shape, 5), ARRAYS[name]
    found = stage(device, light, means, pattern, (0, 0, *shape))
    expected = guide(light, means, pattern, guide_of(pattern))
    # Differences up to 1.3; sums of up to 24 products, a quotient, two products and two sums.
    for one, true in zip((found["guide"], found["differences"]), expected, strict=True):
        assert_close(one, true, atol=40 * ULP)


def test_what_is_outside_the_frame_does_not_count(device: Device):
    light, means, pattern = scene(24, 30, 4), scene(24, 30, 6), ARRAYS["X-Trans"]
    found = stage(device, light, means, pattern, (6, 12, 15, 16))
    inner = np.s_[6:21, 12:28]  # whole patterns from the corner: theirs is the same
    expected = guide(light[inner], means[inner], pattern, "G")
    assert_close(found["guide"][inner], expected[0], atol=40 * ULP)
    assert not found["guide"][:6].any()


def planes(device: Device, light: np.ndarray, name: str, record) -> np.ndarray:
    """Return all colours by a way of demosaicing."""
    frame = (0, 0, *light.shape)
    return through(
        device, light, lambda rec, given: record(rec, given, ARRAYS[name], COLOURS[name], frame)
    )


@pytest.mark.parametrize("name", ARRAYS)
def test_all_colours_are_those_of_the_equations(device: Device, name: str):
    pattern, light = ARRAYS[name], scene(18, 23, 2)
    reach = reach_of(pattern), far_of(pattern)
    tents = bilinear(light, pattern, COLOURS[name], *reach)
    means = tents[COLOURS[name].index(guide_of(pattern))]
    guiding, differences = guide(light, means, pattern, guide_of(pattern))
    expected = bilinear(differences, pattern, COLOURS[name], *reach) + guiding
    # The stages' bounds one after the other: 12 of each tent, 40 of the guide.
    assert_close(planes(device, light, name, record_guided), expected, atol=80 * ULP)


@pytest.mark.parametrize("name", ARRAYS)
def test_an_even_frame_is_even_to_its_corners(device: Device, name: str):
    light = np.full((16, 16), 0.25, np.float32)
    found = planes(device, light, name, record_guided)
    assert_close(found, np.full(found.shape, 0.25), atol=8 * ULP)


def test_the_guide_is_the_most_frequent_colour():
    assert [guide_of(pattern) for pattern in ARRAYS.values()] == ["G", "W", "G", "R"]


@pytest.mark.parametrize("name", ["X-Trans", "RGBW"])
def test_photographs_come_out_better_than_by_tents(device: Device, name: str):
    """Measured 5.8 to 7.6 dB; colour differences alone, without the guide's fine detail, have 3."""
    pattern = ARRAYS[name]
    sites = np.array([list(line) for line in pattern])
    for title, picture in photographs().items():
        # White is what a filter that passes the three colours in these shares sees.
        seen = dict(zip("RGB", np.moveaxis(picture, -1, 0), strict=True))
        seen["W"] = picture @ [0.3, 0.5, 0.2]
        y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
        letters = sites[y % sites.shape[0], x % sites.shape[1]]
        light = sum((letters == one) * seen[one] for one in set("".join(pattern)))
        light = light.astype(np.float32)
        quality = [
            cpsnr_db(np.moveaxis(planes(device, light, name, record)[:3], 0, -1), picture)
            for record in (record_guided, record_bilinear)
        ]
        print(f"{name}, {title}: {quality[0]:.2f} dB, by tents {quality[1]:.2f} dB")
        assert quality[0] > quality[1] + 5

"""The report's PSFs: one strip of pictures, and where each of them lies."""

from __future__ import annotations

import base64
import io
import json
import re
from html import unescape

import numpy as np
import pytest
from PIL import Image

from gpusim.psf.local import LocalPsfs
from gpusim.report.psfs import psfs_html

FACTS = {
    "camera": {"sensor": {"pixel_pitch_um": 2.0, "rows": 40, "cols": 60}},
    "capture": {"first_row": 4, "first_col": 6},
}


@pytest.mark.parametrize("colours", [(), (3,)])
def test_the_strip_has_the_fourth_root_of_each(colours):
    light = np.zeros((3, 8, 8, *colours))
    for number in range(3):
        light[number, 4, 4 + number] = 0.5 / (1 + number)
        light[number, 4, 3] = 0.5 / (1 + number) / 16
    found = LocalPsfs(np.array([[0.0, 0], [50, 0], [100, 0]]), True, light, 12.0)
    page = psfs_html(found, FACTS)
    source = re.search(r'base64,([^"]+)"', page)[1]
    strip = np.array(Image.open(io.BytesIO(base64.b64decode(source))))
    assert strip.shape == (8, 24, *colours)
    for number in range(3):
        assert np.all(strip[4, 8 * number + 4 + number] == 255)
        assert np.all(strip[4, 8 * number + 3] == round(255 / 2))
    data = json.loads(unescape(re.search(r'data-psf="([^"]+)"', page)[1]))
    assert data["axis"] == [24, 16]
    assert data["places"] == [[0, 0], [50, 0], [100, 0]]
    assert (data["turned"], data["side"], data["pitch"]) == (True, 12.0, 2.0)

"""The gallery: every lens of the library has its entry, and the page tells what was not met."""

from __future__ import annotations

import sys

import pytest
from command_line import ROOT

sys.path.insert(0, str(ROOT / "tools"))
import gallery

from gpusim.formats.lens_file import presets

RECORD = {
    "lens": "A lens",
    "scene": "checkerboard",
    "f_number": 2.8,
    "field_deg": 60.0,
    "efl_mm": 4.5,
    "object_m": None,
    "engine_rms": 1e-3,
    "bank_rms": 2e-4,
    "window": 0.0,
    "total_rms": 1.1e-3,
    "total_worst": 3e-3,
    "met": True,
    "anew": [],
    "seconds": 12.3,
    "adapter": "an adapter",
}


def test_every_lens_of_the_library_is_shown():
    assert set(presets()) <= {entry.lens for entry in gallery.ENTRIES}
    assert len({entry.name for entry in gallery.ENTRIES}) == len(gallery.ENTRIES)


def test_the_page_says_what_is_not_met_and_what_was_planned_anew():
    missed = RECORD | {
        "name": "other",
        "met": False,
        "total_rms": 4e-3,
        "anew": ["planned for 0.001: by a looser plan the certificate missed 0.003"],
    }
    text = gallery.page([RECORD | {"name": "one"}, missed])
    assert "1 of 2 are met" in text
    assert "| 4.0e-03 **not met** |" in text
    assert text.count("not met") == 1
    assert "Planned for 0.001" in text
    assert "![other: checkerboard](gallery/other.jpg)" in text


@pytest.mark.parametrize("name", ["phone", "double-gauss-near"])
def test_a_lens_fills_the_sensor(name):
    entry = next(one for one in gallery.ENTRIES if one.name == name)
    camera = gallery.camera_of(entry)
    corner_mm = 0.5e-3 * gallery.PITCH_UM * (gallery.ROWS**2 + gallery.COLS**2) ** 0.5
    circle_mm = gallery.circle_mm(camera.lens)
    if name == "phone":
        assert corner_mm == pytest.approx(gallery.FILL * circle_mm, rel=1e-3)
    else:  # focused nearer, the image lies farther behind the lens
        assert gallery.FILL * circle_mm == pytest.approx(corner_mm, rel=0.05)

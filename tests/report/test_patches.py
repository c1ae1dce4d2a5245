"""Patches of the report: found where the lens puts them, and their differences told."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gpusim.isp.lens_tags import Optics
from gpusim.report.patches import INNER, patch_facts, patches_html
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, adaptation, encode_srgb, rgb_to_xyz
from gpusim.scene.make import make_scene
from gpusim.scene.spectra import patch_names, xyz
from gpusim.sensor.frame import areas_of
from gpusim.sensor.load import load_sensor

ROWS, COLS = 380, 507
HEIGHT = np.linspace(0, 2500, 60)
REAL = HEIGHT * (1 - 0.05 * (HEIGHT / 2500) ** 2)  # barrel distortion of 5 %


def capture(name: str, rect=(0, 0, ROWS, COLS)) -> SimpleNamespace:
    sensor = load_sensor("imx477").roi(ROWS, COLS)
    sensor = sensor.model_copy(update={"pixel_pitch_um": 6.2})
    optics = Optics("a lens", 8.0, 2.8, REAL, HEIGHT, np.ones(60))
    scene = make_scene(name, illuminant="A")
    return SimpleNamespace(
        scene=scene,
        optics=optics,
        camera=SimpleNamespace(sensor=sensor),
        areas=areas_of(rect, sensor.frame),
    )


def codes(taken: SimpleNamespace, exposure: float, off: str = "") -> np.ndarray:
    """Return the sRGB (M, 3) of the chart's materials."""
    scene = taken.scene
    white = xyz(scene.white)
    to_xyz = rgb_to_xyz(REC709_CHROMATICITIES)
    to_rgb = adaptation(white / white[1], to_xyz.sum(axis=1)).T @ np.linalg.inv(to_xyz).T
    colours = exposure * (xyz(scene.spectra) / white[1]) @ to_rgb
    if off:
        colours[scene.source.materials.index(off)] *= 1.3, 1.0, 0.8
    return np.round(255 * encode_srgb(colours)).astype(np.uint8)


def picture(taken: SimpleNamespace, exposure: float, *, off: str = "") -> np.ndarray:
    """Return what an exact camera shows: each pixel the colour at the point that it sees."""
    scene, sensor = taken.scene, taken.camera.sensor
    row, col, rows, cols = taken.areas.lit
    pitch = sensor.pixel_pitch_um
    y, x = np.mgrid[row : row + rows, col : col + cols] + 0.5
    x, y = (x - COLS / 2) * pitch, (y - ROWS / 2) * pitch
    real = np.hypot(x, y)
    scale = np.interp(real, REAL, HEIGHT) / np.maximum(real, 1e-9) / (ROWS / 2 * pitch)
    material = scene.source.material_at(x * scale, y * scale)
    return codes(taken, exposure, off)[material]


@pytest.mark.parametrize(("name", "count"), [("colorchecker", 24), ("colorchecker-sg", 140)])
def test_an_exact_camera_has_no_differences(name, count):
    taken = capture(name)
    found = patch_facts(taken, picture(taken, 0.8))
    assert [one["name"] for one in found["patches"]] == [
        one for one in patch_names() if one.startswith("SG") == (count == 140)
    ]
    # Codes of 8 bits: half a step of a patch of 2 % is a third of a Delta E.
    assert found["mean_delta_e_2000"] < 0.3
    assert found["largest_delta_e_2000"] < 1.0
    # Colours at an end of sRGB are named, not counted: cyan, the most saturated ones of the SG.
    names = taken.scene.source.materials
    beyond = {name for name, code in zip(names, codes(taken, 0.8), strict=True) if 0 in code}
    clipped = {one["name"] for one in found["patches"] if one["clipped"]}
    assert clipped == beyond & set(patch_names())
    assert 0 < len(clipped) < count / 4


def test_a_patch_that_is_off_is_seen_where_it_lies():
    taken = capture("colorchecker")
    found = patch_facts(taken, picture(taken, 0.4, off="neutral 5 (.70 D)"))
    worst = max(found["patches"], key=lambda one: one["delta_e_2000"] * (not one["clipped"]))
    assert worst["name"] == "neutral 5 (.70 D)"
    assert worst["delta_e_2000"] > 5
    # Ten times the exposure: bright patches clip and do not count.
    bright = patch_facts(taken, picture(taken, 4.0))
    assert any(one["clipped"] for one in bright["patches"][18:])


def test_a_part_of_a_frame_shows_the_patches_that_are_whole_in_it():
    part = capture("colorchecker", (0, 0, ROWS // 2, COLS))
    found = patch_facts(part, picture(part, 0.4))
    assert [one["name"] for one in found["patches"]] == list(patch_names())[:12]
    high = found["patches"][0]["box_px"]
    assert 0.7 * INNER < (high[3] - high[1]) / (0.365 * ROWS / 2) < 1.01 * INNER


def test_where_there_are_none_nothing_is_said():
    taken = capture("slanted-edge")
    developed = picture(taken, 0.4)
    assert patch_facts(taken, developed) is None
    assert patches_html(None) == ""
    mono = capture("colorchecker")
    mono.camera.sensor = load_sensor("imx249-mono").roi(ROWS, COLS)
    assert patch_facts(mono, developed) is None
    none = capture("colorchecker")
    none.optics = replace(none.optics, ideal_um=np.zeros(0))
    assert patch_facts(none, developed) is None


def test_the_page_shows_rows_as_the_chart_has_them():
    taken = capture("colorchecker-sg")
    page = patches_html(patch_facts(taken, picture(taken, 0.4)))
    assert page.count('class="patch-row"') == 10
    assert page.count('class="patch"') == 140
    assert 'title="SG A1: Delta E2000 0.' in page

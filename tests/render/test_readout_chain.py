"""The read-out in the whole chain: optical black, gain, what converters add; tiles and files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import rawpy
from changes import sensor_file
from fake_capture import fake_capture
from harness import assert_close
from optics.made import StubCamera, bank, monochrome, scene, sensor, shapes
from PIL import Image

from gpusim.cli.render import write
from gpusim.errors import UserError
from gpusim.isp.dng import write_dng
from gpusim.plan import Accuracy
from gpusim.render import Capture, Renderer, capture
from gpusim.sensor.adc_model import ColumnOffset, DualGain, GainStep, Linearity
from gpusim.sensor.frame import MAX_BORDER, Border
from gpusim.sensor.load import load_sensor

LENS = bank(coma_um=0.0, falloff=0.1)
BLACK = Border(top=8, bottom=3, left=12, right=5)
LIT = np.s_[8:-3, 12:-5]
KEEP = ("rate", "electrons")


def renderer(camera_sensor, probes: int = 0) -> Renderer:
    camera = StubCamera(LENS, camera_sensor)
    return Renderer(camera, scene(shapes()), Accuracy(1e-2, probes), method="fft")


@pytest.fixture(scope="module")
def framed():
    one = renderer(sensor(64, 80, optical_black=BLACK))
    yield one
    one.release()


@pytest.fixture(scope="module")
def whole(framed: Renderer) -> Capture:
    return framed.capture(0.01, seed=5, keep=KEEP)


@pytest.mark.parametrize("kind", [sensor, monochrome])
def test_the_light_is_that_of_the_sensor_without_a_border(kind):
    shots = []
    for black in (None, BLACK):
        one = renderer(kind(64, 80, optical_black=black), probes=6)
        shots.append(one.capture(0.01, keep=("rate",)))
        one.release()
    bare, framed = shots
    assert framed.raw.shape == (75, 97) and bare.raw.shape == (64, 80)
    assert framed.areas.active == (8, 12, 64, 80) and framed.rect == (-8, -12, 75, 97)
    assert_close(framed.rate[LIT], bare.rate, atol=0)
    outside = framed.rate.copy()
    outside[LIT] = 0
    assert_close(outside, np.zeros((75, 97)), atol=0)
    assert framed.certificate.met
    # The engine's part is the same; of the sensor's, the border moves the fixed pattern's keys.
    engines = [
        [getattr(one.certificate, name) for name in ("engine_rms", "engine_worst", "points")]
        for one in shots
    ]
    assert engines[0] == engines[1]


def test_the_border_is_dark(whole: Capture):
    masked = np.ones(whole.raw.shape, bool)
    masked[LIT] = False
    level = whole.raw[masked].astype(float)
    # Black level 256, dark current 0.01 e-, 3.2 e- of noise: 1.5 DN. 4.9 sigma of the mean: 1e-6.
    assert abs(level.mean() - 256) < 4.9 * 1.6 / np.sqrt(level.size) + 0.01
    assert np.abs(level - 256).max() < 5 * 1.6
    assert whole.raw[LIT].mean() > 300


@pytest.mark.parametrize("tile_px", [34, 50])
def test_tiles_change_not_one_bit(framed: Renderer, whole: Capture, tile_px: int):
    found = framed.capture(0.01, seed=5, tile_px=tile_px, keep=KEEP)
    for name in ("raw", *KEEP):
        assert_close(getattr(found, name), getattr(whole, name), atol=0)


def test_tiles_of_the_border_alone_change_not_one_bit():
    one = renderer(sensor(12, 10, optical_black=Border(top=8, left=12)))
    whole = one.capture(0.01, seed=5, keep=KEEP)
    found = one.capture(0.01, seed=5, tile_px=8, keep=KEEP)
    one.release()
    assert found.work["tiles"] == 9
    for name in ("raw", *KEEP):
        assert_close(getattr(found, name), getattr(whole, name), atol=0)


@pytest.mark.parametrize("tile", [(0, 0, 80, 64), (5, 3, 40, 33), (79, 63, 1, 1)])
def test_a_tile_is_of_lit_pixels_and_that_part_of_the_whole(
    framed: Renderer, whole: Capture, tile: tuple
):
    x, y, width, height = tile
    part = np.s_[8 + y : 8 + y + height, 12 + x : 12 + x + width]
    found = framed.capture(0.01, seed=5, tile=tile, keep=KEEP)
    for name in ("raw", *KEEP):
        assert_close(getattr(found, name), getattr(whole, name)[part].copy(), atol=0)
    assert found.areas.active == (0, 0, height, width) and found.areas.masked == ()


def test_files_have_the_border_and_the_picture_has_not(whole: Capture, tmp_path: Path):
    made = fake_capture()
    camera = replace(made.camera, sensor=sensor(64, 80, optical_black=BLACK))
    planes = {name: getattr(whole, name) for name in ("raw", *KEEP)}
    facts = write(replace(made, camera=camera, rect=whole.rect, **planes), tmp_path)
    with rawpy.imread(str(tmp_path / "raw.dng")) as raw:
        assert_close(raw.raw_image.copy(), whole.raw, atol=0)
        assert_close(raw.raw_image_visible.copy(), whole.raw[LIT].copy(), atol=0)
        names = raw.color_desc.decode()
        assert "".join(names[site] for site in raw.raw_pattern.flat) == "BGGR"
    assert np.asarray(Image.open(tmp_path / "developed.png")).shape == (64, 80, 3)
    plane = OpenEXR.File(str(tmp_path / "electrons.exr")).channels()["Y"].pixels
    assert_close(plane, whole.electrons, atol=0)
    found = facts["capture"]
    assert [found[key] for key in ("first_row", "first_col", "rows", "cols")] == [0, 0, 64, 80]
    assert [found[key] for key in ("raw_rows", "raw_cols")] == [75, 97]


# Gain, non-linearity, black levels and column offsets


def test_a_gain_reaches_the_raw_and_what_is_told_of_it():
    steps = [GainStep(gain=1), GainStep(gain=4, iso=400, temporal_dark_noise_e=2.0)]
    camera = StubCamera(LENS, sensor(32, 40, analogue_gains=tuple(steps)))
    arguments = {"exposure_s": 0.01, "accuracy": Accuracy(1e-2, 0), "noise": False}
    shots = [capture(camera, scene(shapes()), gain=gain, **arguments) for gain in (None, 1, 4)]
    plain, at_1, at_4 = (shot.raw.astype(float) - 256 for shot in shots)
    assert_close(at_1, plain.copy(), atol=0)
    # Each code is rounded: half a DN, four times at gain 1.
    assert_close(at_4, 4 * at_1, atol=2.5)
    assert at_1.mean() > 30
    assert shots[2].camera.sensor.iso == 400 and shots[2].camera.sensor.analogue_gain == 4
    assert "analogue gain 4" in shots[2].plan.text()
    with pytest.raises(UserError, match="no such step"):
        capture(camera, scene(shapes()), gain=2, **arguments)


EVERYTHING = {
    "optical_black": Border(top=4, left=6),
    "linearity": Linearity(electrons=[0, 100, 9000], read_e=[0, 110, 8800]),
    "channel_black_level_dn": {"G": 240.0},
    "column_offset": ColumnOffset(sigma_dn=8.0),
}


def test_tiles_of_a_sensor_with_everything_change_not_one_bit():
    one = renderer(sensor(40, 50, **EVERYTHING))
    assert all(one.plan.runs(name) for name in ("border", "linearity", "column fpn"))
    whole = one.capture(0.01, seed=5)
    tiled = one.capture(0.01, seed=5, tile_px=22)
    part = one.capture(0.01, seed=5, tile=(7, 5, 31, 20))
    one.release()
    assert_close(tiled.raw, whole.raw, atol=0)
    assert_close(part.raw, whole.raw[9:29, 13:44].copy(), atol=0)


def test_black_levels_and_offsets_are_there_in_the_dark():
    """In the border above: channels 240 and 256 DN, 8 DN of offsets alike in each column."""
    black = {"optical_black": Border(top=1000)}
    one = renderer(sensor(6, 40, **EVERYTHING | black))
    dark = one.capture(0.01, seed=5).raw[:1000].astype(float)
    one.release()
    # Means of 500 pixels with 1.5 DN of noise: 0.07; 4.9 sigma of 40 columns' 20 pairs at most.
    green, blue = dark[0::2, 1::2].mean(0), dark[0::2, 0::2].mean(0)
    red, green_below = dark[1::2, 1::2].mean(0), dark[1::2, 0::2].mean(0)
    assert_close(red - green, np.full(20, 16.0), atol=0.5)
    assert_close(blue - green_below, np.full(20, 16.0), atol=0.5)
    offsets = np.concatenate([red, blue]) - 256
    # chi-square of 40 normal numbers of 8 DN: 4 to 13 DN but once in 1e4
    assert 4 < offsets.std() < 13


def test_without_noise_there_is_the_mean_signal_and_no_fixed_pattern():
    camera = StubCamera(LENS, sensor(32, 40, **EVERYTHING))
    one = Renderer(camera, scene(shapes()), Accuracy(1e-2, 0), noise=False)
    assert one.plan.runs("linearity") and not one.plan.runs("column fpn")
    raw = one.capture(0.01).raw
    one.release()
    assert set(np.unique(raw[:4])) == {240, 256}


# Two gains

DUAL = DualGain(
    system_gain_dn_per_e=0.04, temporal_dark_noise_e=12.0, black_level_dn=200.0, switch_dn=3800
)


def test_a_sensor_of_two_gains_sees_more_and_tiles_change_not_one_bit(tmp_path: Path):
    camera = sensor(40, 50, dual_gain=DUAL, full_well_e=85_000.0)
    one = renderer(camera)
    exposure_s = 2.5
    whole = one.capture(exposure_s, seed=5, keep=("rate",))
    tiled = one.capture(exposure_s, seed=5, tile_px=22)
    one.release()
    assert one.plan.runs("merge") and "switched at 3800 DN" in one.plan.text()
    assert_close(tiled.raw, whole.raw, atol=0)
    signal = exposure_s * whole.rate.astype(float)
    beyond = signal > 1.2 * 3800 / 0.47
    assert 0.2 < beyond.mean() < 1  # the control: most of it is lost on one gain
    # Shot noise, PRNU of 0.7 %, and steps of 25 e-: 5 sigma of the largest of 2000 pixels.
    sigma = np.sqrt(signal + (0.007 * signal) ** 2 + 12**2 + 52)
    assert (np.abs((whole.raw - 256.0) / 0.47 - signal) < 5 * sigma).all()
    # The raw of the DNG is white where the merged codes end.
    path = tmp_path / "a.dng"
    write_dng(path, whole.raw, camera, white_e=whole.white_e, exposure_s=exposure_s)
    with rawpy.imread(str(path)) as raw:
        # Less 3 sigma of the read noise at low gain and of the fixed offsets.
        assert raw.white_level == int(256 + 0.47 * (85_000 - 3 * np.hypot(12.0, camera.dsnu_e)))
        assert_close(raw.raw_image.copy(), whole.raw, atol=0)


# Bad input


@pytest.mark.parametrize(
    ("black", "field", "allowed"),
    [
        ({"top": -1}, "optical_black.top", "greater than or equal to 0"),
        ({"left": MAX_BORDER + 1}, "optical_black.left", f"less than or equal to {MAX_BORDER}"),
        ({"left": float("nan")}, "optical_black.left", "finite"),
        ({"right": 2.5}, "optical_black.right", "whole number"),
        ({"middle": 2}, "optical_black.middle", "top, bottom, left, right"),
        ({}, "optical_black", "above 0"),
        ({"top": 3}, "optical_black", "multiples of 2 and 2"),
        ({"left": 5}, "optical_black", "multiples of 2 and 2"),
    ],
)
def test_a_border_that_is_none_is_refused(tmp_path: Path, black: dict, field, allowed: str):
    right = sensor_file(tmp_path, optical_black={"top": 8, "left": 12})
    assert load_sensor(right).frame.read == (-8, -12, 3048, 4068)  # the control
    file = sensor_file(tmp_path, optical_black=black)
    with pytest.raises(UserError) as caught:
        load_sensor(file)
    assert (caught.value.file, caught.value.field) == (file, field)
    assert allowed in caught.value.allowed

"""A CCD in the whole chain: order of what happens to its charge, overscan, tiles bit for bit.

Tolerance against the references: the rate is the render's own, so that what is left is f32: of
exposure 6 roundings, of smear 4, of the transfers some tens (their own tests): 100 * 2^-24.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rawpy
from changes import sensor_file
from fake_capture import fake_capture
from harness import assert_close
from optics.made import StubCamera, bank, monochrome, scene, sensor, shapes
from PIL import Image

from gpusim.cli.render import write
from gpusim.errors import UserError
from gpusim.plan import Accuracy
from gpusim.reference.bloom import bloom
from gpusim.reference.crosstalk import crosstalk
from gpusim.reference.cti import cti
from gpusim.reference.smear import smear
from gpusim.reference.traps import traps
from gpusim.render import Capture, Renderer
from gpusim.sensor.crosstalk_model import Crosstalk, Kernels
from gpusim.sensor.cti_model import Cti, Species
from gpusim.sensor.frame import Border, Overscan
from gpusim.sensor.load import load_sensor
from gpusim.sensor.smear_model import Smear

LENS = bank(coma_um=0.0, falloff=0.1)
ROWS, COLS, MORE = 40, 56, 12
AFTER = Overscan(rows=MORE, cols=MORE)
LIT = np.s_[:ROWS, :COLS]
SMEAR = Smear(kind="frame_transfer", row_s=1e-5)
TRAPS = Cti(traps=(Species(density=4.0, release_transfers=3.0),), groups=3)
LINEAR = Cti(inefficiency=1e-3)
WHOLE = {
    "overscan": AFTER,
    "smear": SMEAR,
    "bloom": True,
    "parallel_cti": TRAPS,
    "serial_cti": LINEAR,
}
NEAR = [[0.0, 0.02, 0.0], [0.03, 0.9, 0.03], [0.0, 0.02, 0.0]]
SPREAD = Crosstalk(optical=Kernels({"*": NEAR}), electrical=Kernels({"*": NEAR}))
KEEP = ("rate", "electrons")
EXPOSURE_S = 0.01
TOLERANCE = 100 * 2.0**-24


def renderer(camera_sensor, **more) -> Renderer:
    camera = StubCamera(LENS, camera_sensor)
    return Renderer(camera, scene(shapes()), Accuracy(1e-2, 0), method="fft", **more)


def captured(camera_sensor, noise: bool = False, **more) -> Capture:
    one = renderer(camera_sensor, noise=noise)
    try:
        return one.capture(EXPOSURE_S, seed=5, keep=KEEP, **more)
    finally:
        one.release()


def ccd(**fields):
    return sensor(ROWS, COLS, first_row=0, first_col=0, **fields)


@pytest.fixture(scope="module")
def bare() -> Capture:
    return captured(sensor(ROWS, COLS), noise=True)


@pytest.fixture(scope="module")
def shifting():
    # A full well that the brightest photosites exceed; cross-talk needs the pixels around a tile.
    one = renderer(ccd(**WHOLE, crosstalk=SPREAD, full_well_e=150.0))
    yield one
    one.release()


@pytest.fixture(scope="module")
def whole(shifting: Renderer) -> Capture:
    return shifting.capture(EXPOSURE_S, seed=5, keep=KEEP)


def framed(plane: np.ndarray) -> np.ndarray:
    return np.pad(plane.astype(float), ((0, MORE), (0, MORE)))


@pytest.mark.parametrize("kind", [sensor, monochrome])
def test_overscan_alone_changes_no_pixel_and_holds_no_charge(kind):
    plain = captured(kind(ROWS, COLS), noise=True)
    found = captured(kind(ROWS, COLS, overscan=AFTER), noise=True)
    assert found.raw.shape == (ROWS + MORE, COLS + MORE)
    for name in ("raw", *KEEP):
        assert_close(getattr(found, name)[LIT].copy(), getattr(plain, name), atol=0)
    beyond = np.ones(found.raw.shape, bool)
    beyond[LIT] = False
    assert not found.rate[beyond].any()
    read = found.electrons[beyond]
    sigma = found.camera.sensor.temporal_dark_noise_e
    spread = np.hypot(sigma, found.camera.sensor.dsnu_e)
    assert abs(read.mean()) < 4.9 * spread / np.sqrt(read.size)  # no dark current either
    assert read.std() == pytest.approx(spread, rel=4.9 / np.sqrt(2 * read.size))


def test_cross_talk_comes_before_the_shift_and_after_it():
    fields = {"overscan": AFTER, "smear": SMEAR, "serial_cti": LINEAR}
    found = captured(ccd(**fields, crosstalk=SPREAD))
    one = found.camera.sensor
    plain = captured(ccd(**fields))
    assert_close(found.rate, plain.rate, atol=0)  # the light is what the optics made
    near, channels = np.array(NEAR), np.full((ROWS, COLS), "W")
    light = crosstalk(found.rate[LIT], channels, lambda giver, taker: near, (2, 2))
    mean = light * EXPOSURE_S + one.dark_current_e_per_s * EXPOSURE_S
    smeared = smear(framed(light), framed(mean), "cleared", SMEAR.row_s)
    channels = np.full((ROWS + MORE, COLS + MORE), "W")
    expected = crosstalk(
        cti(smeared.T, LINEAR.inefficiency).T, channels, lambda giver, taker: near, (2, 2)
    )
    assert_close(found.electrons, expected, rtol=TOLERANCE, atol=1e-5)


@pytest.mark.parametrize("more", [{}, {"overscan": AFTER}])
def test_optical_black_takes_from_the_lit_pixels_beside_it_alone(more: dict):
    black = Border(top=4, bottom=4, left=4, right=4)
    found = captured(ccd(optical_black=black, crosstalk=SPREAD, **more))
    dark = found.camera.sensor.dark_current_e_per_s * EXPOSURE_S
    inner = found.electrons[4 : ROWS + 4, 4 : COLS + 4]
    # Kernels of 3 x 3, twice: two rows and columns take something, the others nothing.
    for edge in (found.electrons[:2, 4 : COLS + 4], found.electrons[4 : ROWS + 4, :2].T):
        assert_close(edge.copy(), np.full(edge.shape, dark), rtol=TOLERANCE)
    beside = found.electrons[3, 4 : COLS + 4].mean()
    assert 0.02 < beside / inner[0].mean() < 0.06


def test_optical_black_is_shifted_with_the_rest():
    black = Border(top=4, bottom=2, left=6, right=3)
    plain = captured(ccd(optical_black=black), noise=True)
    found = captured(ccd(optical_black=black, overscan=AFTER), noise=True)
    rows, cols = plain.raw.shape
    assert found.raw.shape == (rows + MORE, cols + MORE)
    assert found.areas.masked == plain.areas.masked
    assert_close(found.raw[:rows, :cols].copy(), plain.raw, atol=0)


def test_a_frame_is_what_the_references_make_in_order():
    fields = {"overscan": AFTER, "smear": SMEAR, "parallel_cti": TRAPS, "serial_cti": LINEAR}
    found = captured(ccd(**fields))
    one = found.camera.sensor
    dark = one.dark_current_e_per_s * EXPOSURE_S
    mean = framed(found.rate[LIT] * EXPOSURE_S + dark)
    smeared = smear(framed(found.rate[LIT]), mean, "cleared", SMEAR.row_s, one.full_well_e)
    law = {"well_fill_power": 0.58, "well_e": one.full_well_e, "groups": 3, "overscan": MORE}
    parallel, _ = traps(smeared, [(4.0, 3.0)], **law)
    expected = cti(parallel.T, LINEAR.inefficiency).T
    assert_close(found.electrons, expected, rtol=TOLERANCE, atol=1e-5 * 4 * ROWS)
    # The other order, and smear after the transfer, are other numbers.
    late = smear(
        framed(found.rate[LIT]),
        cti(traps(mean, [(4.0, 3.0)], **law)[0].T, LINEAR.inefficiency).T,
        "cleared",
        SMEAR.row_s,
    )
    assert np.abs(late - found.electrons).max() > 0.1


@pytest.mark.parametrize(
    "model", [SMEAR, Smear(kind="interline", row_s=1e-3, leak=0.01)], ids=lambda m: m.kind
)
def test_smear_of_a_dark_row_is_the_closed_form(model: Smear):
    found = captured(ccd(overscan=AFTER, smear=model))
    total = found.rate[LIT].astype(float).sum(axis=0)
    # Rows of the overscan hold nothing but what the whole column adds.
    expected = np.tile(model.weight_s * total, (MORE, 1))
    assert_close(found.electrons[ROWS:, :COLS].copy(), expected, rtol=TOLERANCE)
    assert not found.electrons[:, COLS:].any()


def test_smear_has_shot_noise_but_no_response(bare: Capture):
    model = Smear(kind="frame_transfer", row_s=1e-3)
    found = captured(ccd(smear=model, overscan=Overscan(rows=400), prnu_percent=20.0), noise=True)
    total = model.row_s * found.rate[:ROWS].astype(float).sum(axis=0)
    over = found.electrons[ROWS:].astype(float)
    # Means of 400 draws: within 4.9 sigma of what all rows add, whatever the pixels' response.
    assert np.all(np.abs(over.mean(axis=0) - total) < 4.9 * np.sqrt((total + 12) / 400))
    read = found.camera.sensor
    variance = total + read.temporal_dark_noise_e**2 + read.dsnu_e**2
    ratio = np.mean(over.var(axis=0) / variance)
    assert ratio == pytest.approx(1, abs=4.9 * np.sqrt(2 / over.size))


@pytest.mark.parametrize("model", [TRAPS, LINEAR], ids=["traps", "linear"])
def test_trails_lie_in_the_overscan_and_fall_away(model: Cti):
    found = captured(ccd(overscan=AFTER, parallel_cti=model, serial_cti=model))
    below, right = found.electrons[ROWS:, :COLS].mean(axis=1), found.electrons[:ROWS, COLS:].mean(0)
    for trail in (below, right):
        assert trail[0] > 0 and np.all(np.diff(trail) <= 0)
    kept = found.electrons[LIT].sum() < captured(ccd(overscan=AFTER)).electrons[LIT].sum()
    assert kept


def test_charge_blooms_before_it_is_shifted():
    found = captured(ccd(overscan=AFTER, bloom=True, full_well_e=120.0))
    mean = (found.rate[LIT] * EXPOSURE_S).astype(np.float32)
    mean += np.float32(found.camera.sensor.dark_current_e_per_s * EXPOSURE_S)
    assert mean.max() > 120  # there is something to flow
    expected, _ = bloom(mean, 120.0)
    assert_close(found.electrons[LIT].copy(), expected, rtol=TOLERANCE, atol=2.0)  # halves floored
    assert not found.electrons[ROWS:].any()


def test_without_blooming_the_full_well_clips():
    found = captured(ccd(smear=SMEAR, full_well_e=120.0))
    assert found.electrons.max() == 120.0


@pytest.mark.parametrize("tile_px", [16, 34])
def test_tiles_change_not_one_bit(shifting: Renderer, whole: Capture, tile_px: int):
    found = shifting.capture(EXPOSURE_S, seed=5, tile_px=tile_px, keep=KEEP)
    for name in ("raw", *KEEP):
        assert_close(getattr(found, name), getattr(whole, name), atol=0)


@pytest.mark.parametrize("tile", [(0, 0, COLS, ROWS), (5, 3, 20, 33), (COLS - 1, ROWS - 1, 1, 1)])
def test_a_tile_is_that_part_of_the_whole(shifting: Renderer, whole: Capture, tile: tuple):
    x, y, width, height = tile
    found = shifting.capture(EXPOSURE_S, seed=5, tile=tile, keep=KEEP)
    for name in ("raw", *KEEP):
        part = getattr(whole, name)[y : y + height, x : x + width]
        assert_close(getattr(found, name), part.copy(), atol=0)


def test_traps_of_the_serial_register_are_as_many_for_a_tile():
    one = renderer(ccd(serial_cti=TRAPS), noise=False)
    whole = one.capture(EXPOSURE_S, keep=KEEP)
    part = one.capture(EXPOSURE_S, tile=(5, 3, 20, 33), keep=KEEP)
    one.release()
    assert_close(part.electrons, whole.electrons[3:36, 5:25].copy(), atol=0)


def test_planes_in_files_are_those_in_memory(shifting: Renderer, whole: Capture, tmp_path: Path):
    """With overscan and cross-talk: the rate that is kept is not the one that is read out."""
    found = shifting.capture(EXPOSURE_S, seed=5, keep=KEEP, folder=tmp_path)
    for name in ("raw", *KEEP):
        assert_close(np.array(getattr(found, name)), getattr(whole, name), atol=0)


def test_strips_change_not_one_bit(shifting: Renderer, whole: Capture, monkeypatch):
    monkeypatch.setattr("gpusim.sensor.ccd.PLANES", shifting.memory_bytes // 16 // (4 * 60 * 7))
    found = shifting.capture(EXPOSURE_S, seed=5, keep=KEEP)
    for name in ("raw", *KEEP):
        assert_close(getattr(found, name), getattr(whole, name), atol=0)


def test_charge_of_a_region_goes_through_the_rows_before_it():
    near, far = (
        captured(sensor(ROWS, COLS, first_row=row, first_col=0, parallel_cti=LINEAR))
        for row in (0, 400)
    )
    kept = [one.electrons[0].sum() / one.rate[0].sum() for one in (near, far)]
    # The first row has 1 and 401 transfers to make, and nothing before it to gain from.
    assert kept[1] / kept[0] == pytest.approx((1 - 1e-3) ** 400, rel=1e-5)


def test_the_file_holds_the_overscan_and_the_picture_does_not(whole: Capture, tmp_path: Path):
    made = fake_capture()
    camera = replace(made.camera, sensor=whole.camera.sensor)
    planes = {name: getattr(whole, name) for name in ("raw", *KEEP)}
    write(replace(made, camera=camera, rect=whole.rect, **planes), tmp_path)
    with rawpy.imread(str(tmp_path / "raw.dng")) as raw:
        assert_close(raw.raw_image.copy(), whole.raw, atol=0)
        assert_close(raw.raw_image_visible.copy(), whole.raw[LIT].copy(), atol=0)
    assert np.asarray(Image.open(tmp_path / "developed.png")).shape == (ROWS, COLS, 3)
    assert whole.areas.masked == ()  # what trails into it is no black level


@pytest.mark.parametrize(
    ("changes", "field", "allowed"),
    [
        ({"smear": {"kind": "interline", "row_s": 1e-6}}, "smear", "leak with interline"),
        ({"smear": {"kind": "interline", "row_s": -1, "leak": 0.1}}, "smear.row_s", "than 0"),
        ({"serial_cti": {"inefficiency": -1e-5}}, "serial_cti.inefficiency", "greater than 0"),
        ({"parallel_cti": {"inefficiency": 1}}, "parallel_cti.inefficiency", "less than 1"),
        ({"parallel_cti": {}}, "parallel_cti", "inefficiency, or traps"),
        (
            {"serial_cti": {"traps": [{"density": -2, "release_transfers": 1}]}},
            "serial_cti.traps.1.density",
            "greater than or equal to 0",
        ),
        (
            {"serial_cti": {"traps": [{"density": 2, "release_transfers": 0}]}},
            "serial_cti.traps.1.release_transfers",
            "greater than 0",
        ),
        ({"serial_cti": {"trap": []}}, "serial_cti.trap", "inefficiency, traps"),
        ({"overscan": {"rows": -1}}, "overscan.rows", "greater than or equal to 0"),
        ({"bloom": "perhaps"}, "bloom", "boolean"),
        ({"bloom": True, "full_well_knee": 0.8}, "full_well_knee", "1, or no bloom"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, changes: dict, field: str, allowed: str):
    right = sensor_file(tmp_path, preset="kodak-vga", serial_cti={"inefficiency": 1e-5})
    assert load_sensor(right).serial_cti.inefficiency == 1e-5  # the control
    file = sensor_file(tmp_path, preset="kodak-vga", **changes)
    with pytest.raises(UserError) as caught:
        load_sensor(file)
    assert (caught.value.file, caught.value.field) == (file, field)
    assert allowed in caught.value.allowed


def test_a_sensor_that_does_not_shift_is_left_alone(bare: Capture):
    assert not bare.camera.sensor.is_ccd
    for name in ("smear", "bloom", "parallel cti", "serial cti"):
        assert not bare.plan.runs(name)
        assert name not in bare.times_s
    assert ccd(**WHOLE).is_ccd

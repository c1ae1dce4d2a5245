"""Drafts and refined pictures: what is done again, and that they show the same light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import gpusim as gs
from gpusim.camera import PRESETS
from gpusim.config.text import read_yaml
from gpusim.preview.draft import binned, step_for
from gpusim.preview.engine import Engine, Stale
from gpusim.preview.state import Knobs, View
from gpusim.sensor.load import load_sensor

CAMERA = """
title: a small double Gauss
lens: {prescription: double-gauss, focal_length_mm: 8.3, f_number: 2.8, max_field_deg: 3}
sensor: {preset: imx477, rows: 240, cols: 320}
"""


MTF = read_yaml(PRESETS / "mtf-only.yaml", "it")["lens"]["mtf"]


@pytest.fixture(scope="module")
def knobs(tmp_path_factory) -> Knobs:
    path = tmp_path_factory.mktemp("preview") / "small.yaml"
    path.write_text(CAMERA)
    return Knobs(str(path), "colorchecker", exposure_s=0.02)


@pytest.fixture(scope="module")
def engine():
    made = Engine()
    yield made
    made.release()


@pytest.fixture(scope="module")
def ready(tmp_path_factory) -> Knobs:
    """Return a camera whose lens is not traced: its pictures are refined within seconds."""
    path = tmp_path_factory.mktemp("preview") / "ready.yaml"
    path.write_text(
        "title: ready\nlens: {mtf: %s}\nsensor: {preset: imx477, rows: 240, cols: 320}\n" % MTF
    )
    return Knobs(str(path), "colorchecker", exposure_s=0.02)


WHOLE = View.whole(240, 320, 640, 480)


def test_a_draft_does_again_what_a_knob_touches_and_no_more(engine, knobs):
    first = engine.draft(knobs, WHOLE)
    assert {"lens", "plan", "light", "read-out"} <= set(first.redone)
    again = [
        (dict(exposure_s=0.01), {"read-out", "development"}),
        (dict(ev=1.0), {"read-out", "development"}),
        (dict(noise=False), {"read-out", "development"}),
        (dict(off={"PRNU"}), {"read-out", "development"}),
        (dict(focus_shift_um=15.0), {"PSFs", "light", "read-out", "development"}),
        (dict(f_number=5.6), {"lens", "PSFs", "light", "read-out", "development"}),
        (dict(scene="flat-field"), {"lens", "plan", "light", "read-out", "development"}),
    ]
    for turned, redone in again:
        assert set(engine.draft(knobs.turned(**turned), WHOLE).redone) == redone, turned


def test_a_refined_picture_is_the_one_that_is_rendered(engine, ready):
    view = View(100.0, 90.0, 6.0, 320, 240)
    shown = engine.refine(ready, view, lambda: False)
    camera = gs.Camera.load(ready.camera)
    light = gs.expose(camera, gs.Scene.load("colorchecker"), 1e-2, probes=0, tile=shown.rect)
    assert np.array_equal(shown.frame.raw, light.capture(0.02).raw)
    assert engine.refine(ready.turned(exposure_s=0.01), view, lambda: False).redone == ("read-out",)


def test_a_draft_shows_the_light_of_the_picture(engine, ready):
    still = ready.turned(noise=False)
    seen = View(160.0, 120.0, 2.0, 640, 480)
    draft = engine.draft(still, seen)
    refined = engine.refine(still, seen, lambda: False)
    bright = [one.frame.electrons.mean() / one.step**2 for one in (draft, refined)]
    # 4 fields, 4 wavelengths and no light beyond the window: it is 2 % off at most.
    assert bright[0] == pytest.approx(bright[1], rel=0.03)


def test_focus_and_stop_of_a_draft_are_those_of_the_lens(engine, knobs):
    """The stop dims by its area, and a defocused edge is softer."""
    still = knobs.turned(noise=False, scene="slanted-edge")
    mean, steep = {}, {}
    for name, turned in (
        ("open", {}),
        ("f/5.6", {"f_number": 5.6}),
        ("off", {"focus_shift_um": 40.0}),
    ):
        frame = engine.draft(still.turned(**turned), WHOLE).frame
        mean[name] = frame.electrons.mean()
        steep[name] = np.abs(np.diff(frame.electrons[:, ::2], axis=1)).max() / mean[name]
    assert mean["f/5.6"] / mean["open"] == pytest.approx(0.25, rel=0.05)
    assert steep["off"] < 0.5 * steep["open"]


def test_what_is_stale_is_given_up(engine, ready):
    with pytest.raises(Stale):
        engine.refine(ready.turned(scene="grey"), WHOLE, lambda: True)
    assert engine.refine(ready, View(100.0, 90.0, 6.0, 320, 240), lambda: False).redone


def test_binned_photosites_count_and_make_noise_as_those_together():
    sensor = load_sensor("imx477")
    four = binned(sensor, 4)
    assert four.full_well_e == 16 * sensor.full_well_e
    assert four.temporal_dark_noise_e == 4 * sensor.temporal_dark_noise_e
    assert four.saturation_e * four.system_gain_dn_per_e == pytest.approx(
        sensor.saturation_e * sensor.system_gain_dn_per_e
    )
    assert four.pixel_pitch_um * four.rows == pytest.approx(
        sensor.pixel_pitch_um * sensor.rows, rel=0.01
    )
    assert binned(sensor, 1) is sensor
    assert step_for(200_000) == 1
    assert 4056 * 3040 / step_for(4056 * 3040) ** 2 < 260_000


def test_a_loupe_shows_the_psf_of_the_place(engine, knobs):
    engine.draft(knobs, WHOLE)
    (axis, pitch_um), (corner, _) = (engine.psf(knobs, *at) for at in ((160, 120), (0, 0)))
    assert axis.sum() == pytest.approx(1, abs=1e-4)
    assert pitch_um == 0.5
    assert not np.array_equal(axis, corner)


def test_what_is_saved_makes_the_same_raw(engine, ready, tmp_path: Path):
    from gpusim.camera import load_camera
    from gpusim.isp.rawfile import read_raw
    from gpusim.preview.saving import save

    shown = engine.refine(
        ready.turned(off={"PRNU"}), View(100.0, 90.0, 6.0, 320, 240), lambda: False
    )
    save(shown, tmp_path)
    assert "--tile " + ",".join(map(str, shown.rect)) in (tmp_path / "command.txt").read_text()
    camera = load_camera(tmp_path / "camera.yaml")
    assert camera.sensor.prnu_percent == 0
    light = gs.expose(
        gs.Camera(camera.lens, camera.sensor, "saved"),
        gs.Scene.load("colorchecker"), 1e-2, probes=0, tile=shown.rect,
    )  # fmt: skip
    assert np.array_equal(light.capture(0.02).raw, shown.frame.raw)
    assert read_raw(tmp_path / "raw.dng") is not None

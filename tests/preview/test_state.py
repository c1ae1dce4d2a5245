"""Knobs and views: what they refuse, where points lie, what switching an effect off leaves."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusim import camera as cameras
from gpusim.camera import load_camera
from gpusim.errors import UserError
from gpusim.formats import lens_file as lenses
from gpusim.lens.system import first_order
from gpusim.preview.controls import bare_camera
from gpusim.preview.saving import camera_file
from gpusim.preview.state import EFFECTS, Knobs, View, having, without
from gpusim.sensor.load import load_sensor, presets
from gpusim.sensor.sensor import Sensor

KNOBS = Knobs("mtf-only", "colorchecker")
POINT = st.floats(0, 900)


@given(factor=st.floats(0.2, 5), x=POINT, y=POINT)
def test_a_zoom_leaves_the_photosite_under_the_pointer_where_it_is(factor, x, y):
    view = View(400.0, 300.0, 1.0, 960, 720)
    assert view.zoomed(factor, x, y).at(x, y) == pytest.approx(view.at(x, y), abs=1e-9)


def test_a_pan_moves_the_picture_with_the_pointer():
    view = View(400.0, 300.0, 2.0, 960, 720)
    assert view.panned(30, -10).at(130, 90) == pytest.approx(view.at(100, 100))


@given(
    x=st.floats(-3000, 6000), y=st.floats(-3000, 6000), scale=st.floats(0.02, 64),
    period=st.sampled_from((1, 2, 4, 6)),
)  # fmt: skip
@settings(max_examples=300)
def test_what_is_seen_is_whole_patterns_within_the_sensor(x, y, scale, period):
    cols, rows = 24 * 26, 24 * 20
    left, top, width, height = View(x, y, scale, 960, 720).seen(rows, cols, period)
    assert 0 <= left < left + width <= cols
    assert 0 <= top < top + height <= rows
    assert not any(one % period for one in (left, top, width, height))


def test_what_is_seen_covers_the_screen():
    view = View(300.0, 200.0, 3.0, 300, 150)
    left, top, width, height = view.seen(480, 640, 2)
    low, high = view.at(0, 0), view.at(300, 150)
    assert left <= low[0]
    assert top <= low[1]
    assert left + width >= high[0]
    assert top + height >= high[1]


def test_unknown_knobs_and_effects_are_refused_with_what_there_is():
    with pytest.raises(UserError, match="exposure_s"):
        KNOBS.turned(exposre=1)
    with pytest.raises(UserError, match="dark current"):
        KNOBS.turned(off={"dark curent"})
    with pytest.raises(UserError, match="there is no camera"):
        KNOBS.turned(camera="demoo").made_camera()


@pytest.mark.parametrize("name", presets())
def test_every_effect_of_a_sensor_can_be_switched_off_alone(name):
    sensor = load_sensor(name)
    owned = having(sensor)
    assert "read noise" in owned
    for effect in owned:
        assert having(without(sensor, frozenset((effect,)))) == [
            one for one in owned if one != effect
        ]
    assert without(sensor, frozenset(EFFECTS)).veiling_glare == 0


def test_effects_name_fields_that_sensors_have():
    assert {name for names in EFFECTS.values() for name in names} <= Sensor.model_fields.keys()


def test_the_command_line_names_what_was_turned():
    line = KNOBS.turned(iso=200, noise=False, seed=3).command((4, 6, 20, 30), 0.0125)
    assert line.startswith("gpusim render camera.yaml colorchecker --exposure 0.0125 ")
    for part in ("--iso 200", "--no-noise", "--seed 3", "--tile 4,6,20,30"):
        assert part in line


@pytest.mark.parametrize("name", cameras.presets())
def test_every_camera_takes_every_lens_and_sensor(name):
    sides = itertools.product([None, *lenses.presets()], [None, *presets()])
    for lens, sensor in sides:
        camera, widest, _ = bare_camera(Knobs(name, "grey", lens=lens, sensor=sensor))
        if lens is None:
            continue
        # Another lens is wide open over its whole field, at the camera's own focal length.
        alone = lenses.load_prescription(lens)
        assert widest == pytest.approx(first_order(alone).f_number, rel=1e-3)
        assert camera.lens.max_field_deg == alone.max_field_deg


def test_a_saved_camera_with_another_lens_is_the_one_that_was_shown(tmp_path):
    knobs = Knobs("phone", "grey", lens="tessar", f_number=8.0)
    path = tmp_path / "camera.yaml"
    path.write_text(camera_file(knobs))
    saved, shown = load_camera(path).lens, knobs.made_camera().lens
    assert saved.surfaces == shown.surfaces
    assert first_order(saved).f_number == pytest.approx(8.0)

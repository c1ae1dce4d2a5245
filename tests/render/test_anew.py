"""Plans that are made anew where a certificate misses."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np
import pytest

import gpusim as gs
from gpusim.errors import UserError
from gpusim.library import session as session_module
from gpusim.library.again import made_raw
from gpusim.library.recipe import recipe_of_frame
from gpusim.plan import Accuracy
from gpusim.render import capture, planning, renderer
from gpusim.render.anew import SAFETY, TIMES, planned_anew, tighter


@dataclass(frozen=True)
class Made:
    """A result that errs by as much of what it was planned for."""

    certificate: SimpleNamespace | None
    notes: tuple[str, ...] = ()


def judged(
    rms: float, tolerance: float, worst: float = 0.0, sensor: float = 0.0
) -> SimpleNamespace:
    met = rms <= tolerance and worst <= 10 * tolerance
    return SimpleNamespace(total_rms=rms, total_worst=worst, sensor_rms=sensor, met=met)


def attempts(factor: float, *, refused_below: float = 0.0) -> tuple[list[float], object]:
    asked: list[float] = []

    def attempt(accuracy: Accuracy) -> Made:
        aim = accuracy.planned.tolerance
        asked.append(aim)
        if aim < refused_below:
            raise UserError("no plan meets the tolerance")
        return Made(judged(factor * aim, accuracy.tolerance))

    return asked, attempt


def test_a_plan_that_meets_is_made_once():
    asked, attempt = attempts(0.9)
    assert planned_anew(Accuracy(1e-3), attempt).certificate.met
    assert asked == [1e-3]


def test_no_plan_is_made_anew_for_what_the_sensor_errs_by():
    assert tighter(Accuracy(1e-3), judged(2e-3, 1e-3)) is not None
    assert tighter(Accuracy(1e-3), judged(2e-3, 1e-3, sensor=1.9e-3)) is None


def test_a_plan_that_misses_is_made_anew_in_the_ratio_by_which_it_missed():
    asked, attempt = attempts(3.0)
    made = planned_anew(Accuracy(1e-3), attempt)
    assert made.certificate.met
    assert made.certificate.total_rms == pytest.approx(SAFETY * 1e-3)
    assert asked == pytest.approx([1e-3, SAFETY * 1e-3 / 3])


def test_an_error_that_does_not_fall_ends_it():
    asked = []

    def attempt(accuracy: Accuracy) -> Made:
        asked.append(accuracy.planned.tolerance)
        return Made(judged(5e-3, accuracy.tolerance))

    assert not planned_anew(Accuracy(1e-3), attempt).certificate.met
    assert len(asked) == 1 + TIMES
    assert asked == sorted(asked, reverse=True)


def test_a_refused_plan_leaves_the_last_result_and_says_so():
    asked, attempt = attempts(3.0, refused_below=9e-4)
    made = planned_anew(Accuracy(1e-3), attempt)
    assert made.certificate.total_rms == pytest.approx(3e-3)
    assert "no plan meets the tolerance" in made.notes[-1]
    assert len(asked) == 2


@pytest.mark.parametrize(
    "accuracy", [Accuracy(1e-3, best_effort=True), Accuracy(1e-3, within_s=1.0)]
)
def test_one_render_was_asked_for(accuracy):
    assert tighter(accuracy, judged(3e-3, 1e-3)) is None
    assert tighter(replace(accuracy, best_effort=False, within_s=None), None) is None


def test_the_worst_probe_counts_a_tenth():
    assert tighter(Accuracy(1e-3), judged(1e-4, 1e-3, worst=2e-2)) == pytest.approx(
        SAFETY * 1e-3 / 2
    )


@pytest.fixture
def by_a_wrong_model(monkeypatch):
    """Plans are made for 30 times what they should be; return a small camera."""
    true = planning.plans_optics

    def wrong(bank, sensor, scene, accuracy, *rest, **more):
        asked = replace(accuracy, tolerance=min(30 * accuracy.tolerance, 0.1))
        return true(bank, sensor, scene, asked, *rest, **more)

    monkeypatch.setattr(planning, "plans_optics", wrong)
    given = gs.Camera.load("mtf-only")
    return gs.Camera(given.lens, given.sensor.roi(48, 64), "small")


@pytest.mark.slow
def test_light_by_a_prediction_that_errs_is_made_anew_and_again(tmp_path, by_a_wrong_model):
    light = gs.expose(by_a_wrong_model, gs.Scene.load("slanted-edge"), 1e-3, probes=32)
    assert light.certificate.met
    assert any("planned for" in note for note in light.notes)
    assert light.recipe["aim"] < 1e-3
    frame, raw = light.capture(1e-3, seed=3), tmp_path / "raw.dng"
    frame.save(raw)
    recipe = recipe_of_frame(frame, raw, datetime.now(UTC))
    (tmp_path / "raw.json").write_text(json.dumps({"recipe": recipe}, allow_nan=False))
    np.testing.assert_array_equal(made_raw(tmp_path / "raw.json").frame.raw, frame.raw)


def test_a_session_goes_on_with_the_tighter_plan(by_a_wrong_model):
    scene = gs.Scene.load("slanted-edge")
    session = gs.Session(by_a_wrong_model, scene, 1e-3, probes=32).change(tile=(16, 8, 32, 32))
    first = session.light()
    assert first.certificate.met
    plan = session.plan
    session.change(tile=(0, 0, 32, 32))
    session.light()
    assert session.redone == ("light",)
    assert session.plan is plan
    session.release()


def test_a_session_keeps_its_plan_where_a_tighter_one_is_refused(by_a_wrong_model, monkeypatch):
    session = gs.Session(by_a_wrong_model, gs.Scene.load("slanted-edge"), 1e-3, probes=32)
    made, true = [], session_module.Renderer

    def once(*given, **more):
        if made:
            raise UserError("no plan meets the tolerance")
        made.append(true(*given, **more))
        return made[0]

    monkeypatch.setattr(session_module, "Renderer", once)
    light = session.light()
    assert not light.certificate.met
    assert "no plan meets" in light.notes[-1]
    assert session.plan is made[0].plan
    session.release()


def test_a_frame_that_is_not_bettered_keeps_its_files(by_a_wrong_model, monkeypatch, tmp_path):
    true, kept = renderer.Lighting.render, []

    def once(self, *given):
        if kept:
            raise UserError("the memory does not suffice")
        true(self, *given)
        kept.append(self)

    monkeypatch.setattr(renderer.Lighting, "render", once)
    given = {"exposure_s": 1e-3, "accuracy": Accuracy(1e-3, 32), "noise": False}
    scene = gs.Scene.load("slanted-edge")
    found = capture(by_a_wrong_model, scene, folder=tmp_path, **given)
    assert not found.certificate.met
    assert "memory does not suffice" in found.notes[-1]
    kept.clear()
    alone = capture(
        by_a_wrong_model, scene, **given | {"accuracy": Accuracy(1e-3, 0, best_effort=True)}
    )
    np.testing.assert_array_equal(found.raw, alone.raw)

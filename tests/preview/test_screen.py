"""The screen without a window: events, panels, scripts, the command; and a real window on Xvfb."""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import subprocess
import sys
import threading
import time

import numpy as np
import psutil
import pytest
from command_line import ROOT, assert_refused, gpusim
from PIL import Image

from gpusim.preview.state import Knobs

pytest.importorskip("imgui_bundle")
pytest.importorskip("glfw")

from imgui_bundle import imgui

from gpusim.preview.window import SIZE, Offscreen, attached

MIDDLE = (760, 360)  # points: within the picture
EXPOSURE_BOX, NOISE_BOX = (17, 60), (17, 129)


@pytest.fixture(scope="module")
def screen(tmp_path_factory):
    made = Offscreen(
        Knobs("mtf-only", "colorchecker"), tmp_path_factory.mktemp("saved"), refine=False
    )
    made.settle("draft", 60)
    yield made
    made.close()


def press(screen, x, y, *, button=1, modifiers=()):
    where = dict(x=x, y=y, modifiers=modifiers, ntouches=0, touches={})
    screen.event("pointer_move", button=0, buttons=(), **where)
    screen.event("pointer_down", button=button, buttons=(button,), **where)
    screen.event("pointer_up", button=button, buttons=(), **where)


def test_a_click_turns_the_knob_under_it(screen):
    before = screen.app.knobs
    press(screen, *NOISE_BOX)
    assert screen.app.knobs == before.turned(noise=not before.noise)
    press(screen, *NOISE_BOX)
    press(screen, *EXPOSURE_BOX)
    assert screen.app.knobs.exposure_s == 0.01
    press(screen, *EXPOSURE_BOX)
    assert screen.app.knobs == before


def test_wheel_and_drag_move_the_view_and_the_picture_follows(screen):
    where = dict(x=MIDDLE[0], y=MIDDLE[1], modifiers=())
    screen.event("pointer_move", button=0, buttons=(), ntouches=0, touches={}, **where)
    before = screen.app.view
    shown = screen.settle("draft", 60)
    screen.event("wheel", dx=0, dy=-300, buttons=(), **where)
    screen.frame()
    assert screen.app.view.scale > 1.5 * before.scale
    closer = screen.settle("draft", 60)
    assert np.abs(closer.astype(int) - shown)[:700, 300:1200].mean() > 3
    screen.event("pointer_down", button=1, buttons=(1,), ntouches=0, touches={}, **where)
    moved = where | {"x": MIDDLE[0] + 40}
    zoomed = screen.app.view
    screen.event("pointer_move", button=0, buttons=(1,), ntouches=0, touches={}, **moved)
    screen.frame()
    screen.event("pointer_up", button=1, buttons=(), ntouches=0, touches={}, **moved)
    assert screen.app.view.x == pytest.approx(zoomed.x - 40 / zoomed.scale)
    screen.app.refit()
    screen.app.ask()
    again = screen.settle("draft", 60)
    assert np.abs(again.astype(int) - shown)[:700, 300:1200].mean() < 1


def test_more_exposure_is_a_brighter_picture(screen):
    means = []
    for seconds in (0.004, 0.016):
        screen.app.turn(exposure_s=seconds)
        means.append(screen.settle("draft", 60)[:700, 300:1200, :3].mean())
    screen.app.turn(exposure_s=None)
    assert means[1] > 1.4 * means[0]


def test_a_region_is_measured_and_a_mistake_is_said(screen):
    screen.app.roi, screen.app.loupe, screen.app.before = (
        (20, 20, 9, 9),
        (300.0, 200.0),
        screen.app.best,
    )
    screen.frame()
    screen.app.turn(scene="slanted-edge")
    screen.settle("draft", 60)
    screen.app.turn(illuminant="D66x")
    screen.settle("draft", 60)
    assert "illuminant" in screen.app.worker.mistake.screen()
    screen.app.turn(illuminant=None, scene="colorchecker")
    screen.settle("draft", 60)
    assert screen.app.worker.mistake is None
    screen.app.roi = screen.app.before = screen.app.loupe = None


def test_the_command_plays_a_script_and_saves_the_screen(tmp_path):
    steps = [
        {"wait": "draft"},
        {"turn": {"exposure_s": 0.01}},
        {"wait": "refined"},
        {"save": True},
        {"screenshot": str(tmp_path / "one.png")},
    ]
    (tmp_path / "steps.json").write_text(json.dumps(steps))
    ran = gpusim(
        "preview", "mtf-only", "colorchecker", "--script", tmp_path / "steps.json",
        "--screenshot", tmp_path / "two.png", "--out", tmp_path / "saved",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    assert Image.open(tmp_path / "one.png").size == (1528, 774)
    assert (tmp_path / "two.png").is_file()
    assert {one.name for one in (tmp_path / "saved").iterdir()} == {
        "raw.dng", "picture.png", "camera.yaml", "command.txt",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("steps", "word"),
    [
        ('[{"trun": {}}]', "trun"),
        ('{"wait": "draft"}', "list"),
        ('[{"wait": "soon"}]', "draft"),
        ('[{"turn": {"isoo": 3}}]', "isoo"),
        ('[{"pan": 3}]', "pan"),
        ("nonsense", "JSON"),
    ],
)
def test_a_wrong_script_is_refused(tmp_path, steps, word):
    (tmp_path / "steps.json").write_text(steps)
    ran = gpusim("preview", "mtf-only", "colorchecker", "--script", tmp_path / "steps.json")
    assert_refused(ran, word)


def test_unknown_parts_and_no_display_are_refused(tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert_refused(gpusim("preview", "mtf-only", "colorchecker"), "display", "--screenshot")
    assert_refused(gpusim("preview", "mtf-onlyy", "colorchecker"), "mtf-onlyy")
    assert_refused(gpusim("preview", "mtf-only", "colorcheker"), "colorchecker")
    monkeypatch.setitem(sys.modules, "imgui_bundle", None)
    assert_refused(gpusim("preview", "mtf-only", "colorchecker"), "gpusim[preview]")


def threads():
    return set(threading.enumerate())


def test_a_notebook_gets_a_widget():
    pytest.importorskip("anywidget")
    import gpusim as gs

    before = threads()
    canvas = gs.widget("mtf-only", "colorchecker", exposure_s=0.02)
    shown, _ = canvas._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in shown
    # Its own close calls itself without end (rendercanvas 2.7.2): the event is what counts.
    canvas.submit_event({"event_type": "close"})
    canvas._events.flush()
    assert not any(one.name == "preview" and one.is_alive() for one in threads() - before)
    with pytest.raises(gs.UserError, match="no such knob"):
        gs.widget("mtf-only", "colorchecker", exposure=0.02)


@pytest.mark.slow
def test_ten_thousand_random_events_leave_no_error_no_stale_picture_and_no_memory(screen):
    rng, app = random.Random(7), screen.app
    process = psutil.Process()
    seen = []
    for number in range(10_000):
        x, y = rng.uniform(0, 1528), rng.uniform(0, 774)
        kind = rng.random()
        where = dict(x=x, y=y, modifiers=rng.choice(((), ("Shift",))), ntouches=0, touches={})
        if kind < 0.6:
            screen.canvas.submit_event(
                {"event_type": "pointer_move", "button": 0, "buttons": (), **where}
            )
        elif kind < 0.85:
            # Not on the parts: other cameras and scenes take seconds each.
            where["x"] = max(x, 270.0)
            down = rng.random() < 0.5
            screen.canvas.submit_event(
                {
                    "event_type": "pointer_down" if down else "pointer_up",
                    "button": rng.choice((1, 2)), "buttons": (), **where,
                }
            )  # fmt: skip
        elif kind < 0.95:
            screen.canvas.submit_event(
                {
                    "event_type": "wheel",
                    "dx": 0,
                    "dy": rng.uniform(-200, 200),
                    "buttons": (),
                    **where,
                }
            )
        else:
            app.turn(exposure_s=10 ** rng.uniform(-4, 0), noise=rng.random() < 0.5)
        if number % 10 == 9:
            screen.frame()
        if number % 1000 == 999:
            seen.append(process.memory_info().rss)
    app.refit()
    app.turn(exposure_s=0.01, noise=True)
    screen.settle("draft", 120)
    assert app.best.knobs == app.knobs
    # Half of the run has filled what is kept; the other half adds less than a tenth.
    assert seen[-1] < 1.1 * seen[4]


def test_what_a_panel_keeps_for_itself_is_answered_all_the_same(screen, tmp_path):
    """ImGui stops events that it uses; the window must draw for them, and Ctrl-Q must end it."""
    canvas = type(screen.canvas)(size=SIZE, pixel_ratio=1)
    made = attached(canvas, Knobs("mtf-only", "colorchecker"), tmp_path, lambda call: call())
    asked = []
    try:
        canvas.draw()
        over = dict(x=NOISE_BOX[0], y=NOISE_BOX[1], modifiers=(), ntouches=0, touches={})
        held = {"event_type": "pointer_down", "button": 1, "buttons": (1,)} | over
        for event in ({"event_type": "pointer_move", "button": 0, "buttons": ()} | over, held):
            canvas.submit_event(event)
            canvas._events.flush()
            canvas.draw()
            canvas.draw()
        io = imgui.get_io()
        assert io.want_capture_mouse
        assert io.want_capture_keyboard
        plain, canvas.request_draw = canvas.request_draw, lambda *given: asked.append(given)
        canvas.submit_event({"event_type": "pointer_up", "button": 1, "buttons": ()} | over)
        canvas._events.flush()
        assert asked
        canvas.request_draw = plain
        leave = {"event_type": "key_down", "key": "q", "modifiers": ("Control",)}
        canvas.submit_event(leave)
        canvas._events.flush()
        assert canvas.get_closed()
    finally:
        made.app.close()
        canvas.close()


@pytest.mark.slow
@pytest.mark.skipif(
    not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="needs Xvfb and xdotool"
)
def test_a_real_window_answers_mouse_and_keys_and_closes(tmp_path):
    display = ":97"
    server = subprocess.Popen(
        ["Xvfb", display, "-screen", "0", "1600x900x24"], stderr=subprocess.DEVNULL
    )
    environment = {**os.environ, "DISPLAY": display, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "gpusim", "preview", "mtf-only", "colorchecker"]
    window = None

    def do(*words: object) -> str:
        done = subprocess.run(
            ["xdotool", *map(str, words)],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return done.stdout.strip()

    try:
        time.sleep(1)
        window = subprocess.Popen(
            [*command, "--out", str(tmp_path)], env=environment, stderr=subprocess.PIPE, text=True
        )
        found = ""
        for _ in range(120):
            found = do("search", "--name", "mtf-only, colorchecker")
            if found or window.poll() is not None:
                break
            time.sleep(0.5)
        assert found, window.stderr.read() if window.poll() is not None else "no window"
        do("mousemove", "--window", found, 700, 300)
        do("click", 4)
        do("mousemove", "--window", found, *NOISE_BOX, "click", 1)
        # "save" stands in the status line below the picture.
        do("mousemove", "--window", found, 563, 748)
        saved = tmp_path / "command.txt"
        for _ in range(60):  # what is shown is saved, and nothing before the first picture
            do("click", 1)
            time.sleep(1)
            if saved.is_file() and "--no-noise" in saved.read_text():
                break
        assert "--no-noise" in saved.read_text()
        assert "--tile" in saved.read_text()  # the wheel zoomed in
        # Without a window manager a window may not have the keys at once.
        for _ in range(10):
            do("windowfocus", found, "key", "ctrl+q")
            with contextlib.suppress(subprocess.TimeoutExpired):
                window.wait(5)
                break
        assert window.poll() == 0
        assert "Traceback" not in window.stderr.read()
    finally:
        for one in (window, server):
            if one is not None and one.poll() is None:
                one.kill()
                one.wait()


def test_a_lens_that_cannot_be_so_is_said_and_the_knobs_stay(screen):
    before = screen.app.knobs
    screen.app.turn(lens="no-such-lens")
    screen.frame()
    assert screen.app.knobs == before
    assert "no-such-lens" in screen.app.said or "tessar" in screen.app.said
    screen.app.turn(ev=0.5)
    assert screen.app.said == ""
    screen.app.turn(ev=0.0)
    screen.settle("draft", 60)

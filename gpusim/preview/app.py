"""The preview's screen: picture in the middle, knobs on the left, answers on the right.

It is drawn with Dear ImGui on whatever canvas there is: a window, a notebook, or none.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from imgui_bundle import imgui

from gpusim.errors import UserError
from gpusim.gpu.screen import Textures
from gpusim.preview import answers
from gpusim.preview.answer_panel import SOFT, WARN, AnswerPanel
from gpusim.preview.controls import Controls
from gpusim.preview.engine import REFINED, Engine, Shown
from gpusim.preview.memory import Memory
from gpusim.preview.saving import save
from gpusim.preview.state import Knobs, View
from gpusim.preview.worker import Worker

LEFT, RIGHT = 268.0, 300.0  # widths of the panels, points
FIXED = imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_collapse
BARE = FIXED | imgui.WindowFlags_.no_title_bar
WHEEL = 1.2  # times larger a click of the wheel
PROBES = 32  # of a certificate asked for
NEAREST = 4.0  # points a photosite: from here on photosites are seen as squares
MODES = ("developed", "photosites")


class App:
    """State of the screen, and what is drawn.

    Parameters
    ----------
    knobs : Knobs
    textures : Textures
    out : Path
        Folder that "save" writes to.
    refine : bool
        Whether pictures are refined at rest.

    Raises
    ------
    UserError
        The camera or the scene cannot be had.
    """

    def __init__(self, knobs: Knobs, textures: Textures, out: Path, *, refine: bool = True) -> None:
        self.controls = Controls()
        sensor = self.controls.sensor(knobs)
        knobs.made_scene()  # a mistake is told before there is a window
        self.knobs, self.textures, self.out = knobs, textures, out
        self.view = View.whole(sensor.rows, sensor.cols, 640, 480)
        self.shown: dict[str, tuple[Shown, int]] = {}
        self.before: Shown | None = None
        self.split = 0.5
        self.mode = MODES[0]
        self.roi: tuple[int, int, int, int] | None = None
        self.loupe: tuple[float, float] | None = None
        self.said = ""
        self.number = -1
        self.latency_s: list[float] = []  # from an event to the first picture of it
        self.changed: Callable[[], None] = lambda: None  # asks the canvas to draw
        self._asked_at: dict[int, float] = {}
        self._fitted = False
        self._corner: tuple[float, float] | None = None  # of a region that is being dragged
        self._lock = threading.Lock()
        self._memory = Memory()
        self.worker = Worker(Engine(), self._present, refine=refine, told=lambda: self.changed())
        self.answers = AnswerPanel(textures, self._memory, self.worker.engine, self.controls)

    # What is asked for, and what comes.

    def turn(self, **changes: Any) -> None:
        """Turn knobs and ask for their picture."""
        try:
            turned = self.knobs.turned(**changes)
            self.controls.sensor(turned)  # its panel cannot be drawn without one
        except UserError as mistake:
            self.said = _in_words(mistake)
            return
        self.knobs, self.said = turned, ""
        self.ask()

    def ask(self, probes: int = 0) -> None:
        """Ask for the picture of knobs and view as they are."""
        self.number = self.worker.ask(self.knobs, self.view, probes)
        self._asked_at[self.number] = time.perf_counter()

    def _present(self, shown: Shown, number: int) -> None:
        with self._lock:
            self.shown[shown.kind] = (shown, number)
            if shown.kind != REFINED:
                self.shown.pop(REFINED, None)
        asked = self._asked_at.pop(number, None)
        if asked is not None:
            self.latency_s.append(time.perf_counter() - asked)
            self._asked_at = {n: t for n, t in self._asked_at.items() if n > number}
        self.changed()

    @property
    def best(self) -> Shown | None:
        """The best picture of the knobs as they are, or the last draft."""
        with self._lock:
            found = self.shown.get(REFINED) or self.shown.get("draft")
        return None if found is None else found[0]

    def refit(self) -> None:
        """Show the whole sensor."""
        sensor = self.controls.sensor(self.knobs)
        self.view = View.whole(sensor.rows, sensor.cols, self.view.width, self.view.height)

    def close(self) -> None:
        """End the work."""
        self.worker.close()

    # What is drawn.

    def gui(self) -> None:
        """Draw one frame of the screen."""
        if self.worker.failure is not None:
            raise self.worker.failure
        width, height = imgui.get_io().display_size
        middle = max(width - LEFT - RIGHT, 64.0)
        self._panel("camera", 0.0, LEFT, height, self._left)
        self._middle(LEFT, middle, height)
        self._panel("answers", LEFT + middle, RIGHT, height, self._right)

    def _panel(
        self, name: str, left: float, width: float, height: float, draw: Callable[[], None]
    ) -> None:
        imgui.set_next_window_pos((left, 0))
        imgui.set_next_window_size((width, height))
        imgui.begin(name, None, FIXED)
        draw()
        imgui.end()

    def _left(self) -> None:
        changes = self.controls.draw(self.knobs)
        if changes:
            other = {"camera", "sensor"} & changes.keys()
            self.turn(**changes)
            if other:
                self._memory.clear()
                self.refit()
                self.ask()

    def _middle(self, left: float, width: float, height: float) -> None:
        imgui.set_next_window_pos((left, 0))
        imgui.set_next_window_size((width, height))
        imgui.push_style_var(imgui.StyleVar_.window_padding, (0, 0))
        imgui.begin("picture", None, BARE)
        imgui.pop_style_var()
        bar = 54.0
        self._picture(left, width, height - bar)
        imgui.set_cursor_pos((8, height - bar + 4))
        self._status()
        imgui.end()

    def _picture(self, left: float, width: float, height: float) -> None:
        size = (int(width), int(height))
        if size != (self.view.width, self.view.height):
            self.view = View(self.view.x, self.view.y, self.view.scale, *size)
            if not self._fitted:
                self.refit()
                self._fitted = True
            self.ask()
        imgui.set_cursor_pos((0, 0))
        imgui.invisible_button("view", (width, height))
        self._pointer(left)
        draw = imgui.get_window_draw_list()
        draw.push_clip_rect((left, 0), (left + width, height), True)
        with self._lock:
            layers = [found[0] for kind in ("draft", REFINED) if (found := self.shown.get(kind))]
        if self.before is not None and layers:
            line = left + self.split * width
            draw.push_clip_rect((left, 0), (line, height), True)
            self._layer(draw, self.before, left, "before")
            draw.pop_clip_rect()
            draw.push_clip_rect((line, 0), (left + width, height), True)
            self._layers(draw, layers, left)
            draw.pop_clip_rect()
            draw.add_line((line, 0), (line, height), imgui.IM_COL32(255, 255, 255, 200), 1.5)
            draw.add_text((left + 8, 6), imgui.IM_COL32(255, 255, 255, 220), "before")
            draw.add_text((line + 8, 6), imgui.IM_COL32(255, 255, 255, 220), "now")
        else:
            self._layers(draw, layers, left)
        if self.roi is not None:
            x, y, wide, high = self.roi
            draw.add_rect(
                self._screen(x, y, left), self._screen(x + wide, y + high, left),
                imgui.IM_COL32(255, 150, 40, 255), 0.0, 1.5,
            )  # fmt: skip
        if self.loupe is not None:
            at = self._screen(*self.loupe, left)
            draw.add_circle(at, 7.0, imgui.IM_COL32(120, 200, 255, 255), 16, 1.5)
        draw.pop_clip_rect()

    def _layers(self, draw: Any, layers: list[Shown], left: float) -> None:
        for shown in layers:
            self._layer(draw, shown, left, shown.kind)

    def _layer(self, draw: Any, shown: Shown, left: float, name: str) -> None:
        """Draw a picture where its photosites lie; close up each photosite is a square."""
        x, y, wide, high = shown.rect
        rgb = self._memory.of(
            f"{name} {self.mode}", shown,
            lambda: shown.photosites() if self.mode == "photosites" else shown.rgb,
        )  # fmt: skip
        if self.view.scale * shown.step >= NEAREST:
            first, last = self.view.at(0, 0), self.view.at(self.view.width, self.view.height)
            rows, cols = rgb.shape[:2]
            low = [
                int(np.clip((one - at) // shown.step, 0, most - 1))
                for one, at, most in zip(first, (x, y), (cols, rows), strict=True)
            ]
            end = [
                int(np.clip(-(-(one - at) // shown.step), least + 1, most))
                for one, at, most, least in zip(last, (x, y), (cols, rows), low, strict=True)
            ]
            times = max(1, min(int(self.view.scale * shown.step), 16))
            part = rgb[low[1] : end[1], low[0] : end[0]]
            key = (shown, *low, *end, times)
            rgb = self._memory.of(
                f"{name} near", key, lambda: part.repeat(times, 0).repeat(times, 1)
            )
            x, y = x + low[0] * shown.step, y + low[1] * shown.step
            wide, high = (end[0] - low[0]) * shown.step, (end[1] - low[1]) * shown.step
        picture = self.textures.of(name, rgb)
        draw.add_image(picture, self._screen(x, y, left), self._screen(x + wide, y + high, left))

    def _screen(self, x: float, y: float, left: float) -> tuple[float, float]:
        view = self.view
        return (
            left + view.width / 2 + (x - view.x) * view.scale,
            view.height / 2 + (y - view.y) * view.scale,
        )

    def _pointer(self, left: float) -> None:
        """Pan by dragging, zoom by the wheel, a region with Shift, the loupe by a right click."""
        io = imgui.get_io()
        px, py = io.mouse_pos.x - left, io.mouse_pos.y
        before = self.view
        if imgui.is_item_hovered() and io.mouse_wheel:
            self.view = self.view.zoomed(WHEEL**io.mouse_wheel, px, py)
        if imgui.is_item_hovered() and imgui.is_mouse_clicked(1):
            self.loupe = self.view.at(px, py)
        if imgui.is_item_activated() and io.key_shift:
            self._corner = self.view.at(px, py)
        if imgui.is_item_active():
            if self._corner is not None:
                self._drag_region(*self.view.at(px, py))
            elif self.before is not None and abs(px - self.split * self.view.width) < 12:
                self.split = min(max(px / self.view.width, 0.02), 0.98)
            elif io.mouse_delta.x or io.mouse_delta.y:
                self.view = self.view.panned(io.mouse_delta.x, io.mouse_delta.y)
        else:
            self._corner = None
        if self.view != before:
            self.ask()

    def _drag_region(self, x: float, y: float) -> None:
        sensor = self.controls.sensor(self.knobs)
        sides = []
        for start, end, most in zip(self._corner, (x, y), (sensor.cols, sensor.rows), strict=True):
            low, high = sorted((int(np.clip(start, 0, most)), int(np.clip(end, 0, most))))
            sides.append((low, high - low))
        (left, width), (top, height) = sides
        self.roi = (left, top, width, height) if min(width, height) > 0 else None

    def _status(self) -> None:
        shown = self.best
        what, done, total = self.worker.phase
        if self.worker.mistake is not None:
            imgui.push_style_color(imgui.Col_.text, WARN)
            imgui.text_wrapped(_in_words(self.worker.mistake))
            imgui.pop_style_color()
        elif shown is None:
            imgui.text("tracing the lens ...")
        else:
            imgui.text(answers.error_bar(shown))
            if what:
                imgui.same_line()
                imgui.text_colored(SOFT, f"   {what} {done} of {total}")
        imgui.set_cursor_pos_x(8)
        if imgui.small_button("fit"):
            self.refit()
            self.ask()
        imgui.same_line()
        if imgui.small_button("1:1"):
            self.view = self.view.zoomed(
                1 / self.view.scale, self.view.width / 2, self.view.height / 2
            )
            self.ask()
        imgui.same_line()
        if imgui.small_button(self.mode):
            self.mode = MODES[1 - MODES.index(self.mode)]
        imgui.same_line()
        if imgui.small_button("split off" if self.before else "split"):
            self.before = None if self.before else shown
        imgui.same_line()
        if imgui.small_button("certify"):
            self.ask(PROBES)
        imgui.same_line()
        if imgui.small_button("save"):
            self.save()
        imgui.same_line()
        imgui.text_colored(SOFT, self.said or f"{self.view.scale:.3g} points a photosite")

    def save(self) -> None:
        """Write what is shown into the folder."""
        if (shown := self.best) is None:
            return
        try:
            self.said = f"saved in {save(shown, self.out)[0].parent}"
        except UserError as mistake:
            self.said = mistake.problem

    def _right(self) -> None:
        self.answers.draw(self.best, self.knobs, self.roi, self.loupe)


def _in_words(mistake: UserError) -> str:
    allowed = f"; allowed: {mistake.allowed}" if mistake.allowed else ""
    return f"{mistake.problem}{allowed}"

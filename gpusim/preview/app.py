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
from gpusim.preview.controls import Controls
from gpusim.preview.engine import REFINED, Engine, Shown
from gpusim.preview.saving import save
from gpusim.preview.state import Knobs, View
from gpusim.preview.worker import Worker

LEFT, RIGHT = 268.0, 300.0  # widths of the panels, points
FIXED = imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_collapse
BARE = FIXED | imgui.WindowFlags_.no_title_bar
SOFT = imgui.ImVec4(0.62, 0.66, 0.72, 1.0)
WARN = imgui.ImVec4(1.0, 0.62, 0.30, 1.0)
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
        self._memory: dict[str, tuple[Any, Any]] = {}
        self.worker = Worker(Engine(), self._present, refine=refine, told=lambda: self.changed())

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
        rgb = self._remember(
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
            rgb = self._remember(
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

    def _remember(self, name: str, key: Any, make: Callable[[], Any]) -> Any:
        """Return what was made for a key, made anew when the key is another."""
        held = self._memory.get(name)
        if held is None or not _same(held[0], key):
            held = self._memory[name] = (key, make())
        return held[1]

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
        if (shown := self.best) is None:
            imgui.text_colored(SOFT, "no picture yet")
            return
        self._histogram(shown)
        self._edge(shown)
        self._psf()
        self._account(shown)

    def _histogram(self, shown: Shown) -> None:
        imgui.separator_text("raw histogram")
        found = self._remember("histogram", shown, lambda: answers.histogram(shown.frame))
        curves = {
            name: (curve, answers.COLOURS.get(name, answers.GREY))
            for name, curve in found.curves.items()
        }
        _plot(curves, 84.0)
        clipped = "  ".join(f"{name} {one:.2%}" for name, one in found.saturated.items())
        imgui.text_colored(SOFT, f"saturated: {clipped}")
        seconds, iso = shown.frame.exposure_s, shown.frame.iso
        imgui.text_colored(SOFT, f"{seconds:.4g} s, ISO {iso}")

    def _edge(self, shown: Shown) -> None:
        imgui.separator_text("edge (Shift-drag a region)")
        if self.roi is None:
            return
        found = self._remember("edge", (shown, self.roi), lambda: answers.edge(shown, self.roi))
        if isinstance(found, str):
            imgui.push_style_color(imgui.Col_.text, WARN)
            imgui.text_wrapped(found)
            imgui.pop_style_color()
            return
        keep = found.frequency_cy_px <= 1
        _plot({"SFR": (np.clip(found.sfr[keep], 0, 1.2) / 1.2, answers.GREY)}, 84.0)
        fall = found.falls_to(0.5)
        half = "none" if fall is None else f"{fall.value:.3f} c/px"
        imgui.text(f"MTF50 {half}, Nyquist {found.at(0.5).value:.3f}")
        imgui.text_colored(SOFT, f"0 to 1 c/px, edge {abs(found.line.angle_deg):.2f} deg")

    def _psf(self) -> None:
        imgui.separator_text("PSF (right click)")
        if self.loupe is None:
            return
        engine, knobs = self.worker.engine, self.knobs
        psf, pitch_um = engine.psf(knobs, *self.loupe)
        n = len(psf)
        near = self._remember(
            "psf", (psf,), lambda: _toned(psf[n // 4 : -n // 4, n // 4 : -n // 4])
        )
        imgui.image(self.textures.of("psf", near), (112, 112))
        imgui.same_line()
        imgui.begin_group()
        pixel_um = self.controls.sensor(knobs).pixel_pitch_um
        _, curves = self._remember(
            "mtf", (psf, pixel_um), lambda: answers.mtf(psf, pitch_um, pixel_um)
        )
        _plot(
            {
                "radial": (curves[0], (0.47, 0.78, 1.0)),
                "tangential": (curves[1], (1.0, 0.72, 0.35)),
            },
            84.0,
        )
        imgui.text_colored(SOFT, "MTF to 1 c/px")
        imgui.end_group()

    def _account(self, shown: Shown) -> None:
        imgui.separator_text("time and work")
        for name, seconds in shown.times_s.items():
            imgui.text(f"{name:12} {1e3 * seconds:8.0f} ms")
        if imgui.collapsing_header("left out"):
            for name, reason in answers.left_out(shown.plan):
                imgui.text(name)
                imgui.push_style_color(imgui.Col_.text, SOFT)
                imgui.text_wrapped(reason)
                imgui.pop_style_color()


def _in_words(mistake: UserError) -> str:
    allowed = f"; allowed: {mistake.allowed}" if mistake.allowed else ""
    return f"{mistake.problem}{allowed}"


def _same(one: Any, other: Any) -> bool:
    """Return whether two keys are the same: arrays and pictures by identity."""
    if isinstance(one, tuple) and isinstance(other, tuple) and len(one) == len(other):
        return all(_same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, np.ndarray | Shown) or isinstance(other, np.ndarray | Shown):
        return one is other
    return one == other


def _toned(psf: np.ndarray) -> np.ndarray:
    """Return a PSF as a picture: fourth root, so that faint light is seen."""
    light = (psf / (psf.max() or 1.0)).clip(0, 1) ** 0.25
    return np.repeat(np.round(255 * light).astype(np.uint8)[..., None], 3, axis=2)


def _plot(curves: dict[str, tuple[np.ndarray, tuple[float, float, float]]], height: float) -> None:
    """Draw curves from 0 to 1 over the panel's width."""
    width = imgui.get_content_region_avail().x
    left, top = imgui.get_cursor_screen_pos()
    draw = imgui.get_window_draw_list()
    draw.add_rect_filled((left, top), (left + width, top + height), imgui.IM_COL32(24, 27, 32, 255))
    for part in (0.25, 0.5, 0.75):
        draw.add_line(
            (left + part * width, top), (left + part * width, top + height),
            imgui.IM_COL32(60, 66, 74, 255),
        )  # fmt: skip
    for values, colour in curves.values():
        x = left + np.linspace(0, width, len(values))
        y = top + height - 2 - (height - 4) * np.clip(values, 0, 1)
        paint = imgui.IM_COL32(*(int(255 * one) for one in colour), 255)
        points = [imgui.ImVec2(float(a), float(b)) for a, b in zip(x, y, strict=True)]
        draw.add_polyline(points, paint, 1.4, 0)
    imgui.dummy((width, height))
    if len(curves) > 1:
        for name, (_, colour) in curves.items():
            imgui.text_colored(imgui.ImVec4(*colour, 1.0), name)
            imgui.same_line()
        imgui.new_line()

"""The preview's canvases: a window, or none, where events come from a script."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu.screen import drawing_on
from gpusim.preview.state import Knobs

if TYPE_CHECKING:
    from gpusim.preview.app import App
SIZE = (1528, 774)  # points: a view of 960 x 720 between the panels, over the status lines
ANSWERED = 4  # frames: ImGui takes in a move, a press and a release in frames of their own
# Before ImGui's handlers, of order -99: what they use they keep from later ones. Over a panel no
# frame answered, and once a box had the keys Ctrl-Q did nothing.
FIRST = -100
MISSING = "pip install 'gpusim[preview]'"


def check_packages(*more: str) -> None:
    """Say what is missing of what a window needs, and of `more`.

    Raises
    ------
    UserError
        A package of the extra is not installed.
    """
    for name in ("imgui_bundle", "rendercanvas", "glfw", *more):
        try:
            __import__(name)
        except ImportError as error:
            raise UserError(
                f"the preview needs the package {name.replace('_', '-')}, which cannot be "
                f"imported: {error}",
                allowed=MISSING,
            ) from error


def app_on(canvas: Any, knobs: Knobs, out: Path, *, refine: bool) -> tuple[App, Any]:
    """Return the screen's state on a canvas, and what draws it."""
    from gpusim.preview.app import App

    drawing, textures = drawing_on(canvas)
    app = App(knobs, textures, out, refine=refine)
    drawing.set_gui(app.gui)
    return app, drawing


def attached(canvas: Any, knobs: Knobs, out: Path, tell: Callable[[Callable], None]) -> Attached:
    """Put the screen on a canvas with a loop; `tell` runs a function in the loop's thread."""
    app, drawing = app_on(canvas, knobs, out, refine=True)
    made = Attached(app)
    due = 0  # frames still to draw for the last event

    def draw() -> None:
        nonlocal due
        try:
            drawing.render()
        except Exception as error:  # raised again by who opened it: the loop would log it and go on
            made.failure = error
            canvas.close()
            return
        due = max(due - 1, 0)
        if due:
            canvas.request_draw()

    def answer(event: dict[str, Any]) -> None:
        nonlocal due
        due = ANSWERED
        canvas.request_draw()
        if event["event_type"] == "key_down" and _leaves(event["key"], event["modifiers"]):
            canvas.close()

    app.changed = lambda: tell(canvas.request_draw)
    canvas.add_event_handler(
        answer,
        *("pointer_move", "pointer_down", "pointer_up", "wheel", "key_down", "char", "resize"),
        order=FIRST,
    )
    canvas.request_draw(draw)
    return made


@dataclass
class Attached:
    """A screen on a canvas, and what ended it, if it was no person."""

    app: App
    failure: BaseException | None = None


def show(knobs: Knobs, out: Path) -> None:
    """Open a window and stay until it is closed.

    Raises
    ------
    UserError
        There is no display, or no window can be opened on it.
    """
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    allowed = "a desktop, or --screenshot FILE.png, which needs none"
    if sys.platform.startswith("linux") and not display:
        raise UserError("there is no display to open a window on", field="DISPLAY", allowed=allowed)
    import glfw

    if not glfw.init():
        raise UserError(
            "no window can be opened on this display",
            field="DISPLAY",
            value=display,
            allowed=allowed,
        )
    from rendercanvas.glfw import GlfwRenderCanvas, loop

    canvas = GlfwRenderCanvas(
        size=SIZE, title=f"{knobs.camera}, {knobs.scene}", update_mode="ondemand", max_fps=60
    )

    def tell(call: Callable[[], None]) -> None:
        # Once the window is closed rendercanvas has no loop (AttributeError) or an ended one.
        with suppress(AttributeError, RuntimeError):
            loop.call_soon_threadsafe(call)

    made = attached(canvas, knobs, out, tell)
    try:
        loop.run()
    finally:
        made.app.close()
    if made.failure is not None:
        raise made.failure


def widget(camera: str, scene: str, out: str | Path = "out/preview", **knobs: Any) -> Any:
    """Return the preview as a widget for notebooks: Jupyter, marimo, VS Code.

    Parameters
    ----------
    camera, scene : str
        As for ``gpusim render``.
    out : path
        Folder that "save" writes to.
    **knobs
        Turned at first: ``exposure_s``, ``f_number`` ...: see `gpusim.preview.state.Knobs`.

    Raises
    ------
    UserError
        The camera, the scene or a knob cannot be had, or a package of the extra is missing.

    Examples
    --------
    >>> import gpusim as gs
    >>> gs.widget("demo", "colorchecker", exposure_s=1/50)  # in a notebook  # doctest: +SKIP
    """
    check_packages("anywidget")
    from rendercanvas.anywidget import AnywidgetRenderCanvas, loop

    chosen = turned(camera, scene, knobs)
    canvas = AnywidgetRenderCanvas(size=SIZE, update_mode="ondemand")
    made = attached(canvas, chosen, Path(out), loop.call_soon_threadsafe)
    canvas.add_event_handler(lambda _: made.app.close(), "close")
    return canvas


def turned(camera: str, scene: str, knobs: Mapping[str, Any]) -> Knobs:
    """Return the knobs of a preview, once it is clear that they can be had.

    Raises
    ------
    UserError
        Something of them cannot.
    """
    chosen = Knobs(camera, scene).turned(**knobs)
    chosen.made_camera()
    chosen.made_scene()
    return chosen


def _leaves(key: str, modifiers: tuple[str, ...]) -> bool:
    return key.lower() == "q" and "Control" in modifiers


class Offscreen:
    """The same screen without a window: events are given, pictures are taken.

    Parameters
    ----------
    knobs : Knobs
    out : Path
    size : (int, int)
        Points.
    refine : bool
    """

    def __init__(
        self, knobs: Knobs, out: Path, size: tuple[int, int] = SIZE, *, refine: bool = True
    ) -> None:
        from rendercanvas.offscreen import OffscreenRenderCanvas

        self.canvas = OffscreenRenderCanvas(size=size, pixel_ratio=1)
        self.app, self._drawing = app_on(self.canvas, knobs, out, refine=refine)
        self._failure: BaseException | None = None
        self.canvas.request_draw(self._draw)
        self.frame()

    def _draw(self) -> None:
        try:
            self._drawing.render()
        except Exception as error:  # raised again below: the canvas would log it and go on
            self._failure = error

    def frame(self) -> np.ndarray:
        """Draw the screen once; return it, (rows, cols, 4), uint8."""
        # A canvas without a loop takes its events in when it is told to.
        self.canvas._events.flush()
        pixels = np.asarray(self.canvas.draw())
        if self._failure is not None:
            raise self._failure
        return pixels

    def event(self, kind: str, **fields: Any) -> None:
        """Give an event as rendercanvas names it, and draw the frame that answers it."""
        self.canvas.submit_event({"event_type": kind, **fields})
        self.frame()

    def settle(self, kind: str, timeout_s: float) -> np.ndarray:
        """Wait for the picture of what is asked for now; return the screen.

        Raises
        ------
        UserError
            It did not come in time.
        """
        if not self.app.worker.wait(self.app.number, kind, timeout_s):
            raise UserError(f"no {kind} picture came within {timeout_s:g} s", field="wait")
        self.frame()
        return self.frame()

    def close(self) -> None:
        """End the work."""
        self.app.close()
        self.canvas.close()

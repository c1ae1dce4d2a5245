"""Events from a file, for a preview that nobody sits at.

A list of steps, each a mapping with one key:

| step | what it does |
|---|---|
| ``{"turn": {"exposure_s": 0.01}}`` | turns knobs, by the names of `gpusim.preview.state.Knobs` |
| ``{"zoom": [8, 480, 360]}`` | makes the view so many times larger about a point of it |
| ``{"pan": [40, 0]}`` | moves the picture, points |
| ``{"region": [x, y, width, height]}`` | measures an edge there, photosites |
| ``{"loupe": [x, y]}`` | shows the PSF at a photosite |
| ``{"split": true}`` | keeps the picture of now to compare with; false: no more |
| ``{"photosites": true}`` | shows the raw in the colours of its filters |
| ``{"certify": 32}`` | asks for a certificate with so many probes |
| ``{"event": {"event_type": "wheel", ...}}`` | an event of rendercanvas, as a person's |
| ``{"wait": "draft"}``, ``{"wait": "refined"}`` | waits for the picture of all that was asked |
| ``{"screenshot": "name.png"}`` | saves the screen |
| ``{"save": true}`` | saves raw, picture, camera file and command line |
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

from gpusim.config.text import read_json
from gpusim.errors import UserError
from gpusim.preview.window import Offscreen

LONGEST_S = 600.0  # of a wait
KINDS = ("draft", "refined")


def read_script(path: Path) -> list[dict[str, Any]]:
    """Return the steps of a file.

    Raises
    ------
    UserError
        The file cannot be read, or a step is none of those above.
    """
    steps = read_json(path, "the script")
    if not isinstance(steps, list):
        raise UserError("the script is no list of steps", file=path, allowed="[{...}, ...]")
    for number, step in enumerate(steps, start=1):
        if not (isinstance(step, dict) and len(step) == 1 and set(step) <= STEPS.keys()):
            raise UserError(
                "a step is none that is known",
                file=path,
                field=f"step {number}",
                value=step,
                allowed=f"a mapping with one of {', '.join(STEPS)}",
            )
    return steps


def play(screen: Offscreen, steps: list[dict[str, Any]]) -> None:
    """Do steps one after another.

    Raises
    ------
    UserError
        A value is one that its step cannot have, or a picture did not come.
    """
    for number, step in enumerate(steps, start=1):
        ((name, value),) = step.items()
        try:
            STEPS[name](screen, value)
        except (TypeError, ValueError, KeyError) as error:
            raise UserError(
                f"the step {name} cannot be done: {error}", field=f"step {number}", value=value
            ) from error
        mistake = screen.app.worker.mistake
        if mistake is not None and name == "wait":
            raise mistake


def _turn(screen: Offscreen, value: dict[str, Any]) -> None:
    screen.app.knobs.turned(**value)  # says what is wrong, where the screen only shows it
    screen.app.turn(**value)


def _zoom(screen: Offscreen, value: list[float]) -> None:
    factor, x, y = map(float, value)
    screen.app.view = screen.app.view.zoomed(factor, x, y)
    screen.app.ask()


def _pan(screen: Offscreen, value: list[float]) -> None:
    dx, dy = map(float, value)
    screen.app.view = screen.app.view.panned(dx, dy)
    screen.app.ask()


def _region(screen: Offscreen, value: list[int]) -> None:
    x, y, width, height = map(int, value)
    screen.app.roi = (x, y, width, height)


def _loupe(screen: Offscreen, value: list[float]) -> None:
    x, y = map(float, value)
    screen.app.loupe = (x, y)


def _split(screen: Offscreen, value: bool) -> None:
    screen.app.before = screen.app.best if value else None


def _photosites(screen: Offscreen, value: bool) -> None:
    screen.app.mode = "photosites" if value else "developed"


def _event(screen: Offscreen, value: dict[str, Any]) -> None:
    given = dict(value)
    screen.event(given.pop("event_type"), **given)


def _wait(screen: Offscreen, value: str) -> None:
    if value not in KINDS:
        raise ValueError(f"one of {', '.join(KINDS)}")
    screen.settle(value, LONGEST_S)


def _screenshot(screen: Offscreen, value: str) -> None:
    save_screen(screen, Path(value))


def save_screen(screen: Offscreen, path: Path) -> None:
    """Save the screen as a picture.

    Raises
    ------
    UserError
        The file cannot be written.
    """
    screen.frame()
    try:
        Image.fromarray(screen.frame()[..., :3]).save(path)
    except (OSError, ValueError) as error:
        raise UserError(
            f"the screenshot cannot be written: {error}", file=path, allowed="a file NAME.png"
        ) from error


STEPS: dict[str, Callable[[Offscreen, Any], None]] = {
    "turn": _turn,
    "zoom": _zoom,
    "pan": _pan,
    "region": _region,
    "loupe": _loupe,
    "split": _split,
    "photosites": _photosites,
    "certify": lambda screen, value: screen.app.ask(int(value)),
    "event": _event,
    "wait": _wait,
    "screenshot": _screenshot,
    "save": lambda screen, value: screen.app.save() if value else None,
}

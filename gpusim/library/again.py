"""Recipes of raws: what stands in the JSON file beside a raw, and the same raw made of it again.

A recipe is that of a light (`gpusim.render.recipe`), or the name of a JSON file beside it that has
one, and with it how the light was read and what the file says.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim.camera import Camera
from gpusim.config.mistakes import checked
from gpusim.config.text import read_json
from gpusim.errors import UserError
from gpusim.formats.ready import load_ready
from gpusim.lens.prescription import Prescription
from gpusim.library.expose import lit
from gpusim.plan import Accuracy
from gpusim.plan.costs import costs_of
from gpusim.render.checks import rectangle
from gpusim.render.recipe import exact, given
from gpusim.render.renderer import Renderer
from gpusim.scene.make import made_again
from gpusim.sensor.readout import Shot
from gpusim.sensor.sensor import Sensor

if TYPE_CHECKING:
    from gpusim.library.frame import Frame
    from gpusim.plan.tiles import Rect

FORMAT = "gpusim recipe 1"
ALLOWED = "the JSON file beside a raw that gpusim render, burst or batch wrote"
DIGESTS = {
    "shaders": "the shaders are not those of then",
    "plan": "the plan is not that of then",
    "scene": "the scene is not that of then",
}
_FIGURES: deque[tuple[Sensor, dict[str, Any]]] = deque(maxlen=8)  # of the last sensors


def _figures(sensor: Sensor) -> dict[str, Any]:
    """Return a sensor in JSON types; frames one after the other mostly share theirs."""
    for known, figures in tuple(_FIGURES):
        if known is sensor:
            return figures
    figures = exact(sensor.model_dump(mode="json"))
    _FIGURES.append((sensor, figures))
    return figures


def recipe_of_raw(
    light: Mapping[str, Any] | str,
    sensor: Sensor,
    planned: Mapping[str, Any],
    rect: Rect,
    shot: Shot,
    *,
    raw: Path,
    noise: bool,
    ev: float,
    taken: datetime,
) -> dict[str, Any]:
    """Return what makes a raw again, in JSON types.

    Parameters
    ----------
    light : mapping or str
        The recipe of its light, or the name of a file beside it that has it.
    sensor : Sensor
        What read the light.
    planned : mapping
        The recipe of the light: its sensor is left out here where it is the same.
    rect : (row, col, rows, cols)
        What was read.
    shot : Shot
    raw : Path
        The file, which is there.
    noise : bool
        Whether noise was drawn.
    ev, taken
        As of `gpusim.isp.dng.write_dng`.
    """
    row, col, rows, cols = rect
    own = _figures(sensor)
    return {
        "format": FORMAT,
        "light": light,
        "tile": None if rect == sensor.frame.read else [col, row, cols, rows],
        "sensor": None if own == planned["camera"]["sensor"] else own,
        "exposure_s": float(shot.exposure_s),
        "seed": int(shot.seed),
        "frame": int(shot.frame),
        "temperature_c": None if shot.temperature_c is None else float(shot.temperature_c),
        "noise": noise,
        "ev": float(ev),
        "taken": taken.isoformat(),
        "raw": raw.name,
        "sha256": hashlib.sha256(raw.read_bytes()).hexdigest(),
    }


def recipe_of_frame(
    frame: Frame, raw: Path, taken: datetime, *, light: str | None = None, ev: float = 0.0
) -> dict[str, Any]:
    """Return the recipe of a frame whose raw is there; `light`: name of the file with its light."""
    made = frame.light.recipe
    given = light or made, frame.light.sensor, made, frame.light.rect, frame.shot
    return recipe_of_raw(*given, raw=raw, noise=frame.noise, ev=ev, taken=taken)


@dataclass(frozen=True, eq=False)
class Again:
    """A raw that was made again.

    Attributes
    ----------
    frame : Frame
    name : str
        The raw file.
    ev : float
    taken : datetime
    sha256 : str
        Digest of the raw that the recipe is of.
    changed : tuple of str
        What is no longer as it was then, in words.
    """

    frame: Frame
    name: str
    ev: float
    taken: datetime
    sha256: str
    changed: tuple[str, ...]

    def write(self, path: Path) -> bool:
        """Write the raw; return whether it is the one of then, byte for byte."""
        self.frame.write_raw(path, self.ev, self.taken)
        return hashlib.sha256(path.read_bytes()).hexdigest() == self.sha256


def made_raw(path: Path, progress: Callable[[str, int, int], None] | None = None) -> Again:
    """Return the raw of a recipe, made again.

    Parameters
    ----------
    path : Path
        A JSON file with a recipe.
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    UserError
        It has none, or its scene or lens is gone or cannot be made again.
    """
    try:
        recipe, light = _read(path)
        taken = datetime.fromisoformat(recipe["taken"])
        shot = {name: recipe[name] for name in ("seed", "frame", "temperature_c", "noise")}
        exposure_s, sensor, tile = recipe["exposure_s"], recipe["sensor"], recipe["tile"]
        ending = str(recipe["raw"]), float(recipe["ev"]), str(recipe["sha256"])
        renderer = _renderer(light, path, progress)
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"no whole recipe: {error!r}", file=path, allowed=ALLOWED) from None
    try:
        before = light["made_by"]
        changed = tuple(_changes(before, renderer.recipe["made_by"]))
        found = lit(renderer, rectangle(tile and tuple(tile), renderer.camera.sensor), progress)
    finally:
        renderer.release()
    if sensor is not None:
        found = found.at(sensor=checked(Sensor, sensor, path))
    name, ev, sha256 = ending
    return Again(found.capture(exposure_s, **shot), name, ev, taken, sha256, changed)


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the recipes of a raw and of its light."""
    content = read_json(path, "the recipe")
    recipe = content.get("recipe") if isinstance(content, dict) else None
    if not isinstance(recipe, dict) or recipe.get("format") != FORMAT:
        raise UserError("the file has no recipe of a raw", file=path, allowed=ALLOWED)
    light = recipe["light"]
    if isinstance(light, str):
        light = read_json(path.parent / Path(light).name, "the recipe of the light")
    return given(recipe), given(light)


def _renderer(
    light: dict[str, Any], path: Path, progress: Callable[[str, int, int], None] | None
) -> Renderer:
    camera = light["camera"]
    for name, part in (("scene", light["scene"]), ("lens", camera["lens"])):
        if part is None:
            raise UserError(
                f"the {name} was made in Python: it cannot be made again",
                file=path,
                field=f"recipe.light.{name}",
                allowed="the raw of a chart, a picture and a lens that have names or files",
            )
    if "file" in camera["lens"]:
        lens = load_ready(camera["lens"]["file"])
    else:
        lens = checked(Prescription, camera["lens"]["prescription"], path)
    return Renderer(
        Camera(lens, checked(Sensor, camera["sensor"], path), camera["title"]),
        made_again(light["scene"]),
        Accuracy(
            light["tolerance"],
            0,
            light["tolerance_unit"],
            light["best_effort"],
            aim=light.get("aim"),  # what gpusim wrote before it planned anew has none
        ),
        progress=progress,
        exposure_s=light["longest_exposure_s"],
        costs=costs_of(light["costs"]),
        noise=light["noise"],
        method=light["method"],
    )


def _changes(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Say what a light is made by now, and was not then."""
    said = []
    for name in sorted({*before, *now}):
        if before.get(name) == now.get(name):
            continue
        then = f"{before.get(name)} then, {now.get(name)} now"
        said.append(DIGESTS.get(name) or f"{name}: {then}")
    return said

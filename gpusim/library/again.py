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
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, field_validator

from gpusim.camera import Camera
from gpusim.config.mistakes import checked
from gpusim.config.model import Strict, wrong
from gpusim.config.text import read_json
from gpusim.errors import UserError
from gpusim.formats.ready import load_ready
from gpusim.isp.settings import check_ev
from gpusim.lens.prescription import Prescription
from gpusim.library.expose import lit
from gpusim.optics.methods import check_method
from gpusim.plan import Accuracy
from gpusim.plan.costs import Costs, costs_of
from gpusim.render.checks import check_shot, rectangle
from gpusim.render.recipe import exact, given
from gpusim.render.renderer import Renderer
from gpusim.scene.make import made_again
from gpusim.scene.scene import Scene
from gpusim.sensor.readout import Shot
from gpusim.sensor.sensor import Sensor
from gpusim.sensor.strict import Positive

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


class CameraRecipe(Strict):
    """The camera of a light; ``lens``: a prescription, or the file of a ready-made one."""

    title: str
    lens: dict[str, Any] | None
    sensor: dict[str, Any]


class LightRecipe(Strict):
    """What makes a light again: see `gpusim.render.recipe.recipe_of`."""

    camera: CameraRecipe
    scene: dict[str, Any] | None
    tolerance: float
    tolerance_unit: str
    best_effort: bool
    aim: Positive | None = None  # what gpusim wrote before it planned anew has none
    longest_exposure_s: Annotated[float, Field(gt=0, allow_inf_nan=True)]
    noise: bool
    method: str | None
    costs: dict[str, Any]
    made_by: dict[str, str]


class RawRecipe(Strict):
    """What makes a raw again: see `recipe_of_raw`."""

    format: str
    light: dict[str, Any] | str
    tile: tuple[int, int, int, int] | None
    sensor: dict[str, Any] | None
    exposure_s: float
    seed: int
    frame: int
    temperature_c: float | None
    noise: bool
    ev: float
    taken: datetime
    raw: str
    sha256: str

    @field_validator("raw")
    @classmethod
    def _name(cls, value: str) -> str:
        """Refuse what names no file of the folder that the raw is written into."""
        if Path(value).name != value or Path(value).suffix not in (".dng", ".tif"):
            raise wrong("no name of a raw", "NAME.dng or NAME.tif, without a folder")
        return value


@dataclass(frozen=True, eq=False)
class Recipe:
    """A recipe that was read, and what it stands for.

    Attributes
    ----------
    raw : RawRecipe
    light : LightRecipe
    camera : Camera
    scene : Scene
    accuracy : Accuracy
    costs : Costs
    rect : (row, col, rows, cols)
        What is read.
    sensor : Sensor or None
        What reads the light, where it is not the camera's.
    """

    raw: RawRecipe
    light: LightRecipe
    camera: Camera
    scene: Scene
    accuracy: Accuracy
    costs: Costs
    rect: Rect
    sensor: Sensor | None


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
    recipe = read_recipe(path)
    light, raw = recipe.light, recipe.raw
    renderer = Renderer(
        recipe.camera,
        recipe.scene,
        recipe.accuracy,
        progress=progress,
        exposure_s=light.longest_exposure_s,
        costs=recipe.costs,
        noise=light.noise,
        method=light.method,
    )
    try:
        changed = tuple(_changes(light.made_by, renderer.recipe["made_by"]))
        found = lit(renderer, recipe.rect, progress)
    finally:
        renderer.release()
    if recipe.sensor is not None:
        found = found.at(sensor=recipe.sensor)
    shot = {name: getattr(raw, name) for name in ("seed", "frame", "temperature_c", "noise")}
    frame = found.capture(raw.exposure_s, **shot)
    return Again(frame, raw.raw, raw.ev, raw.taken, raw.sha256, changed)


def read_recipe(path: Path) -> Recipe:
    """Read a recipe, with its lens and scene; nothing is rendered.

    Raises
    ------
    UserError
        As of `made_raw`.
    """
    content = read_json(path, "the recipe")
    recipe = content.get("recipe") if isinstance(content, dict) else None
    if not isinstance(recipe, dict) or recipe.get("format") != FORMAT:
        raise UserError("the file has no recipe of a raw", file=path, allowed=ALLOWED)
    raw = checked(RawRecipe, given(recipe), path)
    made = raw.light
    if isinstance(made, str):
        made = given(read_json(path.parent / Path(made).name, "the recipe of the light"))
    light = checked(LightRecipe, made, path)
    for name, part in (("scene", light.scene), ("camera.lens", light.camera.lens)):
        if part is None:
            raise UserError(
                f"the {name.rpartition('.')[2]} was made in Python: it cannot be made again",
                file=path,
                field=f"recipe.light.{name}",
                allowed="the raw of a chart, a picture and a lens that have names or files",
            )
    try:
        return _whole(raw, light, path)
    except UserError as error:
        error.file = error.file or path
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(f"no whole recipe: {error!r}", file=path, allowed=ALLOWED) from None


def _whole(raw: RawRecipe, light: LightRecipe, path: Path) -> Recipe:
    """Return a recipe with what its parts stand for, each checked as where it comes from."""
    said = light.camera.lens or {}
    if "file" in said:
        lens = load_ready(said["file"])
    else:
        lens = checked(Prescription, said["prescription"], path)
    sensor = checked(Sensor, light.camera.sensor, path)
    own = None if raw.sensor is None else checked(Sensor, raw.sensor, path)
    check_method(light.method)
    check_shot(raw.exposure_s, raw.seed, raw.frame)
    (own or sensor).dark_current_at(raw.temperature_c)  # refuses what is no temperature
    check_ev(raw.ev)
    unit, best = light.tolerance_unit, light.best_effort
    return Recipe(
        raw=raw,
        light=light,
        camera=Camera(lens, sensor, light.camera.title),
        scene=made_again(light.scene or {}),
        accuracy=Accuracy(light.tolerance, 0, unit, best, aim=light.aim),
        costs=costs_of(light.costs),
        rect=rectangle(raw.tile, sensor),
        sensor=own,
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

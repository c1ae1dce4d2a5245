"""The same raw again, of the recipe in the JSON file beside it: see `gpusim.library.recipe`."""

from __future__ import annotations

import hashlib
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
from gpusim.library.irradiance import Irradiance
from gpusim.library.recipe import FORMAT
from gpusim.optics.methods import check_method
from gpusim.plan import Accuracy
from gpusim.plan.costs import Costs, costs_of
from gpusim.render.checks import check_shot, rectangle
from gpusim.render.recipe import given
from gpusim.render.renderer import Renderer
from gpusim.scene.make import made_again
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor
from gpusim.sensor.strict import Positive

if TYPE_CHECKING:
    from gpusim.library.frame import Frame
    from gpusim.library.light import Light
    from gpusim.plan.tiles import Rect

ALLOWED = "the JSON file beside a raw that gpusim or Frame.save wrote"
RAWS = (".dng", ".tif", ".tiff")
DIGESTS = {
    "shaders": "the shaders are not those of then",
    "plan": "the plan is not that of then",
    "scene": "the scene is not that of then",
    "irradiance": "the irradiance is not that of then",
}


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


class IrradianceRecipe(Strict):
    """What makes the light of an irradiance again; ``irradiance``: its file."""

    camera: CameraRecipe
    irradiance: str | None
    made_by: dict[str, str]


class RawRecipe(Strict):
    """What makes a raw again: see `gpusim.library.recipe.recipe_of_raw`."""

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
        if Path(value).name != value or Path(value).suffix.lower() not in RAWS:
            raise wrong("no name of a raw", "NAME.dng, .tif or .tiff, without a folder")
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

    def lit(self, progress: Callable[[str, int, int], None] | None) -> Light:
        """Return the light, made again by the optics."""
        light = self.light
        renderer = Renderer(
            self.camera,
            self.scene,
            self.accuracy,
            progress=progress,
            exposure_s=light.longest_exposure_s,
            costs=self.costs,
            noise=light.noise,
            method=light.method,
        )
        try:
            return lit(renderer, self.rect, progress)
        finally:
            renderer.release()


@dataclass(frozen=True, eq=False)
class OfIrradiance:
    """A recipe of a raw whose light is an irradiance.

    Attributes
    ----------
    raw : RawRecipe
    light : IrradianceRecipe
    own, sensor
        Sensor of the light; what reads it, where that is another.
    """

    raw: RawRecipe
    light: IrradianceRecipe
    own: Sensor
    sensor: Sensor | None

    def lit(self, progress: Callable[[str, int, int], None] | None) -> Light:
        """Return the light of the irradiance's file."""
        given = Irradiance.load(self.light.irradiance or "")
        return given.light(self.own, self.light.camera.title)


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
        It has none, or its scene, lens or irradiance is gone or cannot be made again.
    """
    recipe = read_recipe(path)
    raw, found = recipe.raw, recipe.lit(progress)
    changed = tuple(_changes(recipe.light.made_by, found.recipe["made_by"]))
    if recipe.sensor is not None:
        found = found.at(sensor=recipe.sensor)
    shot = {name: getattr(raw, name) for name in ("seed", "frame", "temperature_c", "noise")}
    frame = found.capture(raw.exposure_s, **shot)
    return Again(frame, raw.raw, raw.ev, raw.taken, raw.sha256, changed)


def read_recipe(path: Path) -> Recipe | OfIrradiance:
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
    try:
        if isinstance(made, dict) and "irradiance" in made:
            return _of_irradiance(raw, checked(IrradianceRecipe, made, path), path)
        return _whole(raw, checked(LightRecipe, made, path), path)
    except UserError as error:
        error.file = error.file or path
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(f"no whole recipe: {error!r}", file=path, allowed=ALLOWED) from None


def _there(part: object, name: str, path: Path) -> None:
    """Refuse a part of a light that has neither name nor file."""
    if part is None:
        raise UserError(
            f"the {name.rpartition('.')[2]} was made in Python: it cannot be made again",
            file=path,
            field=f"recipe.light.{name}",
            allowed="the raw of a chart, a picture, an irradiance and a lens of names or files",
        )


def _of_irradiance(raw: RawRecipe, light: IrradianceRecipe, path: Path) -> OfIrradiance:
    """Return a recipe with what its sensors stand for."""
    _there(light.irradiance, "irradiance", path)
    return OfIrradiance(raw, light, *_sensors(raw, light.camera, path))


def _sensors(raw: RawRecipe, camera: CameraRecipe, path: Path) -> tuple[Sensor, Sensor | None]:
    """Return the sensor of a light, and the other that read it; both checked with the shot."""
    sensor = checked(Sensor, camera.sensor, path)
    own = None if raw.sensor is None else checked(Sensor, raw.sensor, path)
    check_shot(raw.exposure_s, raw.seed, raw.frame)
    (own or sensor).dark_current_at(raw.temperature_c)  # refuses what is no temperature
    check_ev(raw.ev)
    return sensor, own


def _whole(raw: RawRecipe, light: LightRecipe, path: Path) -> Recipe:
    """Return a recipe with what its parts stand for, each checked as where it comes from."""
    _there(light.scene, "scene", path)
    _there(light.camera.lens, "camera.lens", path)
    said = light.camera.lens or {}
    if "file" in said:
        lens = load_ready(said["file"])
    else:
        lens = checked(Prescription, said["prescription"], path)
    sensor, own = _sensors(raw, light.camera, path)
    check_method(light.method)
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

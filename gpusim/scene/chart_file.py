"""Reads a chart from YAML: fills, and shapes with outlines or one pattern drawn on samples.

title: a slanted edge
unit: mm                    # half-heights of the sensor's image without it; or pixels
height: 200                 # of the chart in that unit, that fills the sensor's height; without it
                            # a chart in mm stands as large as it is at the object's distance
fills: {paper: 0.8, ink: {density: 1.3}}
background: paper
shapes:
  - {shape: rectangle, at: [0, 0], size: [40, 40], angle_deg: 5, fill: ink}
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from gpusim.config.mistakes import checked, user_error
from gpusim.config.model import Strict
from gpusim.config.names import perhaps
from gpusim.config.text import read_yaml
from gpusim.errors import UserError
from gpusim.lens.projection import RECTILINEAR, Projection
from gpusim.scene.chart import Chart
from gpusim.scene.chart_shapes import MOST_SHAPES, SHAPES, Grid, Shape
from gpusim.scene.fills import Fill, read_fill
from gpusim.scene.framing import Height
from gpusim.scene.patterns import PATTERNS, Drawn, Frame, Pattern
from gpusim.scene.raster import Raster
from gpusim.scene.shapes import Primitive

MOST_FILLS = 256  # materials of a chart


class ChartFile(Strict):
    """The fields of a chart's file; shapes, pattern and fills as the file has them."""

    title: str
    source: str = ""
    unit: Literal["half-heights", "mm", "pixels"] = "half-heights"
    height: Annotated[float, Field(gt=0, le=1e6)] | None = None
    fills: dict[str, Any] = {}  # noqa: RUF012 - the model is frozen
    background: Any
    shapes: list[dict[str, Any]] | None = None
    pattern: dict[str, Any] | None = None


@dataclass(frozen=True)
class Laid:
    """A chart that is read.

    Attributes
    ----------
    title : str
    source : Chart or Raster
        Lengths in half-heights of the sensor.
    fills : tuple of Fill
        Fills of its materials, or planes.
    notes : tuple of str
        What its reader should know: how a pattern was sampled.
    """

    title: str
    source: Chart | Raster
    fills: tuple[Fill, ...]
    notes: tuple[str, ...] = ()

    def reflectances(
        self, wavelengths_nm: np.ndarray, white_luminance_cd_m2: float = 1.0
    ) -> np.ndarray:
        """Return the reflectances (M, K) of the fills: see `Fill.reflectance`."""
        given = wavelengths_nm, white_luminance_cd_m2
        return np.stack([fill.reflectance(*given) for fill in self.fills])


class _Materials:
    """The fills of a chart in the making, by number."""

    def __init__(self, listed: dict[str, Any], path: Path) -> None:
        self.path, self.fills = path, []
        self.named = {
            name: read_fill(given, name, f"fills.{name}", path) for name, given in listed.items()
        }

    def number(self, given: object, field: str) -> int:
        """Return the number of a fill, by a name in the list or by what it is."""
        listed = self.named.get(given) if isinstance(given, str) else None
        fill = listed or read_fill(given, None, field, self.path)
        if fill not in self.fills:
            if len(self.fills) == MOST_FILLS or fill.name in [one.name for one in self.fills]:
                raise UserError(
                    "too many fills, or two of one name",
                    file=self.path,
                    field=field,
                    value=fill.name,
                    allowed=f"{MOST_FILLS} fills of different names",
                )
            self.fills.append(fill)
        return self.fills.index(fill)


def read_chart(
    path: Path,
    frame: Frame | None = None,
    height: Height | None = None,
    projection: Projection = RECTILINEAR,
) -> Laid:
    """Read a chart.

    Parameters
    ----------
    path : Path
        A YAML file.
    frame : Frame, optional
        The camera that it is for: a sensor of 1520 rows, 4:3, without.
    height : Height, optional
        How large in the scene what fills the sensor's height is otherwise.
    projection : Projection
        How it lies on the ideal image plane: for a height.

    Raises
    ------
    UserError
        Where a field is unknown, missing or wrong, a fill cannot be read, or shapes cross.
    """
    frame = frame or Frame()
    data = checked(ChartFile, read_yaml(path, "the chart"), path)
    if (data.shapes is None) == (data.pattern is None):
        raise UserError(
            "a chart has shapes, or one pattern", file=path, field="shapes, pattern",
            value="both" if data.shapes else "neither", allowed="one of them",
        )  # fmt: skip
    scale = _half_heights(data, frame, height, projection, path)
    materials = _Materials(data.fills, path)
    background = materials.number(data.background, "background")
    if data.pattern is not None:
        drawn = _drawn(data.pattern, materials, background, scale=scale, frame=frame, path=path)
        fills = tuple(materials.fills[number] for number in drawn.materials)
        source = Raster(drawn.planes, half_um=drawn.half_um, waves=drawn.waves)
        return Laid(data.title, source, fills, (drawn.note,))
    primitives: list[Primitive] = []
    for number, given in enumerate(data.shapes, start=1):
        shape = _shape(given, f"shapes.{number}", path)
        primitives += _laid(shape, materials, primitives, f"shapes.{number}", path)
        if len(primitives) > MOST_SHAPES:
            raise UserError(
                "too many shapes", file=path, field=f"shapes.{number}", value=len(primitives),
                allowed=f"{MOST_SHAPES:,} in a chart",
            )  # fmt: skip
    names = tuple(fill.name for fill in materials.fills)
    try:
        chart = Chart(names, background, tuple(one.scaled(scale) for one in primitives))
    except ValueError as error:
        raise UserError(
            f"the shapes make no chart: {error}",
            file=path,
            field="shapes",
            allowed="shapes beside one another, or one within an earlier one; they may touch",
        ) from error
    return Laid(data.title, chart, tuple(materials.fills))


def _half_heights(
    data: ChartFile, frame: Frame, height: Height | None, projection: Projection, path: Path
) -> float:
    """Return how many half-heights of the sensor one of the chart's unit is."""
    whole = {"half-heights": 2.0, "pixels": float(frame.rows), "mm": None}[data.unit]
    own = data.height or whole
    if height is None and own is not None:
        return 2.0 / own
    if height is not None and data.unit == "pixels":
        raise UserError(
            "a chart in pixels has no other height", file=path, field="chart-height",
            value=f"{height.value:g}{height.unit}", allowed="with a chart in another unit",
        )  # fmt: skip
    if height is None and frame.object_mm is None:
        raise UserError(
            "a chart in mm does not say what of it fills the sensor's height",
            file=path,
            field="height",
            allowed="mm, above 0; none before a camera with an object distance",
        )
    true_size = Height(own or 1.0, "mm")
    return 2.0 * (height or true_size).half_heights(frame, projection) / true_size.value


def _shape(given: object, field: str, path: Path) -> Shape:
    """Return one entry under shapes as what it is; in it those of a grid."""
    kind = given.get("shape") if isinstance(given, dict) else given
    model = SHAPES.get(kind) if isinstance(kind, str) else None
    if model is None:
        raise UserError(
            f"there is no such shape{perhaps(kind, SHAPES)}",
            file=path,
            field=f"{field}.shape",
            value=kind,
            allowed=", ".join(SHAPES),
        )
    found = _checked(model, given, field, path)
    if isinstance(found, Grid):
        if found.of.get("shape") == "grid":
            raise UserError(
                "a grid of grids", file=path, field=f"{field}.of.shape", value="grid",
                allowed=", ".join(name for name in SHAPES if name != "grid"),
            )  # fmt: skip
        found = found.of_shape(_shape(found.of, f"{field}.of", path))
    return found


def _checked(model: type[Strict], given: object, field: str, path: Path) -> Any:
    try:
        return model.model_validate(given)
    except ValidationError as error:
        made = user_error(error, model, path)
        made.field = ".".join(part for part in (field, made.field) if part)
        raise made from error


def _laid(
    shape: Shape, materials: _Materials, seen: list[Primitive], field: str, path: Path
) -> list[Primitive]:
    inner = f"{field}.of" if isinstance(shape, Grid) else field
    try:
        return list(shape.laid(lambda given, at: materials.number(given, f"{inner}.{at}"), seen))
    except ValueError as error:
        raise UserError(
            f"a shape is wrong: {error}", file=path, field=field, value=shape.shape
        ) from error


def _drawn(
    given: dict[str, Any],
    materials: _Materials,
    background: int,
    *,
    scale: float,
    frame: Frame,
    path: Path,
) -> Drawn:
    kind = given.get("pattern")
    model = PATTERNS.get(kind) if isinstance(kind, str) else None
    if model is None:
        raise UserError(
            f"there is no such pattern{perhaps(kind, PATTERNS)}",
            file=path,
            field="pattern.pattern",
            value=kind,
            allowed=", ".join(PATTERNS),
        )
    pattern: Pattern = _checked(model, given, "pattern", path)
    numbers = [
        materials.number(one, f"pattern.fills.{place}")
        for place, one in enumerate(pattern.fills, start=1)
    ]
    fills = [materials.fills[number] for number in (background, *numbers)]
    try:
        return pattern.drawn(fills, (background, *numbers), scale, frame)
    except ValueError as error:
        raise UserError(
            f"the pattern cannot be drawn: {error}", file=path, field="pattern", value=kind
        ) from error

"""Recipes of raws: what stands in the JSON file beside a raw, with which it can be made again.

A recipe is that of a light (`gpusim.render.recipe`), or the name of a JSON file beside it that has
one, and with it how the light was read and what the file says. `gpusim.library.again` makes the
raw of it.
"""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim.render.recipe import exact
from gpusim.sensor.readout import Shot
from gpusim.sensor.sensor import Sensor

if TYPE_CHECKING:
    from gpusim.library.frame import Frame
    from gpusim.plan.tiles import Rect

FORMAT = "gpusim recipe 1"
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


def write_sidecar(frame: Frame, raw: Path, taken: datetime, *, ev: float = 0.0) -> None:
    """Write the recipe of a frame whose raw is there into the JSON file beside it."""
    said = {"recipe": recipe_of_frame(frame, raw, taken, ev=ev)}
    raw.with_suffix(".json").write_text(json.dumps(said, indent=1, allow_nan=False) + "\n")

"""What may be asked of a frame: its exposure, seed, number and rectangle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gpusim.errors import UserError
from gpusim.plan.tiles import Rect
from gpusim.sensor.sensor import Sensor

if TYPE_CHECKING:
    from gpusim.render.renderer import Renderer


def rectangle(tile: tuple[int, int, int, int] | None, sensor: Sensor) -> Rect:
    """Return a tile (x, y, width, height) as rows and columns; without one all that is read."""
    if tile is None:
        return sensor.frame.read
    x, y, width, height = tile
    inside = 0 <= x < x + width <= sensor.cols and 0 <= y < y + height <= sensor.rows
    allowed = f"x, y, width, height of pixels within {sensor.cols} x {sensor.rows}"
    check("tile", tile, inside, allowed)
    return (y, x, height, width)


def check_shot(exposure_s: float, seed: int, frame: int) -> None:
    """Refuse an exposure, a seed or a frame number that is none.

    Raises
    ------
    UserError
    """
    check("exposure", exposure_s, 0 < exposure_s < np.inf, "seconds above 0")
    check("seed", seed, 0 <= seed < 2**64, "0 to 2^64 - 1")
    check("frame", frame, 0 <= frame < 2**32, "0 to 2^32 - 1")


def check_planned(renderer: Renderer, exposure_s: float, tile_px: int | None) -> None:
    """Refuse an exposure and a size of tiles that a renderer's plan is not for.

    Raises
    ------
    UserError
    """
    if renderer.accuracy.unit == "sigma":
        longest = renderer.longest_s
        allowed = f"{longest:g} s or less, for which the tolerance in sigmas was planned"
        check("exposure", exposure_s, exposure_s <= longest, allowed)
    if tile_px is not None:
        check("tile-size", tile_px, tile_px >= renderer.period, f"{renderer.period} or more")


def check(field: str, value: object, valid: bool, allowed: str) -> None:
    """Refuse a value that is not valid.

    Raises
    ------
    UserError
    """
    if not valid:
        raise UserError(f"The {field} is out of range.", field=field, value=value, allowed=allowed)

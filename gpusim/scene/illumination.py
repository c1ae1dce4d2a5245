"""An uneven light on a photographed target: a map by which its radiance is multiplied, relative.

What a lamp does to the target is part of the target's radiance, so the map is folded into the
coefficients of the scene, sample by sample, before anything else sees them: the renderer, the
point sources, the halo, the veiling glare and the exact model take the same scene. A stage of
its own on the sim grid would multiply what was low-passed before, which is another picture wherever
the light is not even, and would have to be judged besides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.scene.exr import read_exr
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene

# x to the right and y down, half-heights of the image from its middle, to a relative light.
LightMap = Callable[[np.ndarray, np.ndarray], np.ndarray]
GREY = 1e-4  # of a map's largest value, by which its channels may differ: what primaries round to
BAND_ROWS = 256  # that are multiplied at once


def illuminated(scene: Scene, light: np.ndarray | LightMap, name: str = "a map") -> Scene:
    """Return a photograph under an uneven light.

    Parameters
    ----------
    scene : Scene
        A scene whose source is a raster.
    light : ndarray (rows, cols), or callable
        Relative, none negative; it is divided by its own value in the middle. An array covers the
        picture, samples at the middles of its cells, straight between them and beyond the outer
        ones as there. A function takes x and y, arrays in half-heights of the picture from its
        middle, to the right and down.
    name : str
        Name of the map, for the report.

    Raises
    ------
    UserError
        For a chart, or a map that is negative, not finite or dark in the middle.
    """
    if not isinstance(scene.source, Raster):
        raise UserError(
            "a chart is lit evenly: its materials are one radiance each",
            field="illumination",
            value=name,
            allowed="with a photograph",
        )
    planes = scene.source.planes
    _, rows, cols = planes.shape
    of_place = light if callable(light) else _between(np.asarray(light, np.float64), cols / rows)
    x, y = ((np.arange(count) + 0.5 - count / 2) / (rows / 2) for count in (cols, rows))
    middle = float(np.asarray(of_place(np.zeros((1, 1)), np.zeros((1, 1))))[0, 0])
    if not 0 < middle < np.inf:
        raise _wrong(name, f"{middle:g} in the middle", "above 0 there")
    lit = np.empty_like(planes)
    low, high = np.inf, -np.inf
    for first in range(0, rows, BAND_ROWS):
        band = slice(first, first + BAND_ROWS)
        share = np.asarray(of_place(*np.meshgrid(x, y[band]))) / middle
        low, high = min(low, float(share.min())), max(high, float(share.max()))
        if not 0 <= low <= high < np.inf:  # NaN compares false
            raise _wrong(name, f"{low * middle:g} to {high * middle:g}", "finite, 0 or more")
        lit[:, band] = planes[:, band] * share
    words = f"{name}: {low:.3g} to {high:.3g} of the middle's light, in the scene's radiance"
    source = replace(scene.source, planes=lit)
    return replace(scene, source=source, illumination=words, made_from=None)


def unevenly_lit(scene: Scene, path: Path) -> Scene:
    """Return a photograph under the uneven light of a map in a file: see `illuminated`.

    Raises
    ------
    UserError
        As of `illuminated` and `read_illumination`.
    """
    lit = illuminated(scene, read_illumination(path), path.name)
    if scene.made_from is None:
        return lit
    return replace(lit, made_from={**scene.made_from, "illumination": str(path.resolve())})


def read_illumination(path: str | Path) -> np.ndarray:
    """Read a map of light (rows, cols) from a grey EXR.

    Raises
    ------
    UserError
        Where it cannot be read, or is not grey.
    """
    rgb = read_exr(path, needs_luminance=False).rgb
    apart = float(np.ptp(rgb, axis=0).max())
    if apart > GREY * float(rgb.max()):
        raise UserError(
            "the map of light has colours",
            file=path,
            field="illumination",
            value=f"channels up to {apart:.3g} apart",
            allowed="one channel, Y, or R, G and B alike",
        )
    return rgb[1].astype(np.float64)


def _wrong(name: str, value: str, allowed: str) -> UserError:
    given = {"field": "illumination", "value": value, "allowed": allowed}
    return UserError(f"{name} is no map of light", **given)


def _between(values: np.ndarray, aspect: float) -> LightMap:
    """Return a map over a picture as a function of place, straight between its cells' middles."""
    from scipy.ndimage import map_coordinates

    rows, cols = values.shape

    def at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        places = (y + 1) * rows / 2 - 0.5, (x / aspect + 1) * cols / 2 - 0.5
        return map_coordinates(values, places, order=1, mode="nearest")

    return at

"""Scenes by name or from a file: the one door to charts and pictures."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.config.names import perhaps
from gpusim.errors import UserError
from gpusim.lens.projection import ANGULAR, PROJECTIONS, RECTILINEAR, Projection
from gpusim.scene.chart_file import Laid
from gpusim.scene.charts import CHARTS, is_chart, load_chart
from gpusim.scene.fills import Fill
from gpusim.scene.framing import Height
from gpusim.scene.illumination import unevenly_lit
from gpusim.scene.panorama import PANORAMA, by_angle
from gpusim.scene.patterns import Frame
from gpusim.scene.pictures import PICTURES, is_picture, picture_scene
from gpusim.scene.raster import Raster
from gpusim.scene.scene import DEFAULT_ILLUMINANT, DEFAULT_WHITE_LUMINANCE_CD_M2, Scene
from gpusim.scene.spectra import WAVELENGTHS_NM, illuminant_known, white_radiance


def make_scene(
    name_or_path: str | Path,
    luminance_cd_m2: float | None = None,
    illuminant: str | None = None,
    projection: str = RECTILINEAR.name,
    frame: Frame | None = None,
    *,
    transfer: str | None = None,
    upsampling: str | None = None,
    chart_height: str | None = None,
) -> Scene:
    """Return a chart of the project, one of a YAML file, or a picture from a file.

    Parameters
    ----------
    name_or_path : str or path
        A name in `CHARTS`, the path of a chart's YAML, or of a picture: see `picture_scene`.
    luminance_cd_m2 : float, optional
        Luminance of the white: of a chart's perfect diffuser; of a photograph's RGB (1, 1, 1),
        where it replaces the file's own ``whiteLuminance``. Without either, 300.
    illuminant : str, optional
        Light on a chart or on a picture of reflectances, D50 by default: a CIE name, or a
        blackbody's temperature ("5100K"), that of CIE daylight ("D57", "D5700K"), or a file of a
        spectrum. An RGB photograph has its own light in it: its spectra are lit by D65.
    projection : str
        How it lies on the ideal image plane: "rectilinear", or "angular" for lenses that see far
        to the sides; "equirectangular" for a photograph that is a panorama of 360 x 180 degrees,
        in whose middle the camera stands and at whose centre it looks.
    frame : Frame, optional
        The camera (`gpusim.camera.Camera.frame`): for charts that count in its pixels, are drawn
        on samples, or have a size in the scene.
    transfer : str, optional
        What light the values of a TIFF, PNG or JPEG stand for: "srgb", "linear", "rec709",
        "gamma2.2", or the .cube file of a table: see `gpusim.scene.medium`.
    upsampling : str, optional
        Method by which an RGB photograph's colours become spectra: "mallett-2019" if not given,
        "jakob-2019" or "smits-1999".
    chart_height : str, optional
        How large a chart stands in the scene: of what fills the sensor's height otherwise, the
        size at the object's distance ("850mm") or the angle ("40deg").

    Raises
    ------
    UserError
        For an unknown name, illuminant or projection, a luminance that is not positive, or an
        unusable file.
    """
    _check(luminance_cd_m2)
    panorama = projection == PANORAMA
    name, plane = str(name_or_path), plane_of(projection)
    made_from = {
        "name_or_path": _found(name),
        "luminance_cd_m2": luminance_cd_m2,
        "illuminant": illuminant and _found(illuminant),
        "projection": projection,
        "frame": frame and asdict(frame),
        "transfer": transfer and _found(transfer),
        "upsampling": upsampling,
        "chart_height": chart_height,
    }
    if is_chart(name):
        _check_chart(projection, transfer, upsampling)
        level = luminance_cd_m2 or DEFAULT_WHITE_LUMINANCE_CD_M2
        height = None if chart_height is None else Height.parse(chart_height)
        laid = load_chart(name, frame, height=height, projection=plane)
        scene = _chart(name, laid, level, illuminant or DEFAULT_ILLUMINANT)
        return replace(scene, projection=plane, made_from=made_from)
    path = Path(name_or_path)
    if is_picture(path):
        if chart_height is not None:
            raise UserError(
                "a picture is no chart",
                field="chart-height",
                value=chart_height,
                allowed="with a chart; a picture fills the sensor",
            )
        scene = picture_scene(path, luminance_cd_m2, illuminant, transfer, upsampling)
        if panorama:
            whole = Raster(by_angle(scene.source.planes), half_efl=(np.pi, np.pi))
            scene = replace(scene, source=whole)
        return replace(scene, projection=plane, made_from=made_from)
    raise UserError(
        "a file of a kind that is not read"
        if os.path.isfile(path)  # also of a name that no file can have
        else f"unknown scene{perhaps(name, CHARTS)}",
        field="scene",
        value=name,
        allowed=f"{', '.join(CHARTS)}; a chart's NAME.yaml; or a picture: {PICTURES}",
    )


def _check(luminance_cd_m2: float | None) -> None:
    """Refuse a luminance that is not positive."""
    if luminance_cd_m2 is not None and not 0 < luminance_cd_m2 < np.inf:
        raise UserError(
            "impossible luminance",
            field="luminance_cd_m2",
            value=luminance_cd_m2,
            allowed="above 0",
        )


def plane_of(projection: str) -> Projection:
    """Return how a scene of a projection's name lies: a panorama by angle.

    Raises
    ------
    UserError
        There is no such name.
    """
    if projection not in PROJECTIONS and projection != PANORAMA:
        raise UserError(
            "there is no such projection",
            field="projection",
            value=projection,
            allowed=f"{', '.join(PROJECTIONS)}; {PANORAMA} for photographs of 360 x 180 degrees",
        )
    return ANGULAR if projection == PANORAMA else PROJECTIONS[projection]


def _check_chart(projection: str, transfer: str | None, upsampling: str | None) -> None:
    """Refuse what only pictures have."""
    if projection == PANORAMA:
        raise UserError(
            "a chart is no panorama",
            field="projection",
            value=projection,
            allowed=f"{', '.join(PROJECTIONS)} for charts",
        )
    if transfer is not None:
        raise UserError(
            "a chart has no transfer function",
            field="transfer",
            value=transfer,
            allowed="with a TIFF, PNG or JPEG",
        )
    if upsampling is not None:
        raise UserError(
            "a chart has spectra of its own",
            field="upsampling",
            value=upsampling,
            allowed="with an RGB picture",
        )


def made_again(made_from: Mapping[str, Any]) -> Scene:
    """Return the scene that has this `Scene.made_from`.

    Raises
    ------
    UserError
        As of `make_scene`; or what is given are no options of it.
    """
    options = dict(made_from)
    illumination = options.pop("illumination", None)
    try:
        frame = options.pop("frame", None)
        scene = make_scene(**options, frame=None if frame is None else Frame(**frame))
    except TypeError as error:
        raise UserError(f"no scene can be made of this: {error}", field="scene") from None
    return scene if illumination is None else unevenly_lit(scene, Path(illumination))


def _found(name: str) -> str:
    """Return the whole path of a file, and a name as it is."""
    path = Path(name)
    return str(path.resolve()) if path.suffix and os.path.isfile(path) else name


def _lit(
    fills: Sequence[Fill], level: float, lamp: str, wavelengths_nm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectra of a chart's fills under a lamp, and that of white."""
    white = white_radiance(lamp, level, wavelengths_nm)
    return np.stack([fill.reflectance(wavelengths_nm, level) for fill in fills]) * white, white


def _chart(name: str, laid: Laid, level: float, lamp: str) -> Scene:
    source, fills = laid.source, laid.fills
    if isinstance(source, Raster) and all(fill.grey for fill in fills):
        # One spectrum, in one plane, in which points of light stand out from what is around them.
        shares = laid.reflectances(WAVELENGTHS_NM[:1], level)[:, 0].astype(np.float32)
        plane = np.tensordot(shares, source.planes, axes=1)
        source, fills = replace(source, planes=plane[None]), (Fill("white", 1.0),)

    light = partial(_lit, fills, level, lamp)
    spectra, white = light(WAVELENGTHS_NM)
    known = dict.fromkeys((illuminant_known(lamp), *(fill.known for fill in fills)))
    made_of = tuple(one for one in known if one is not None)
    given = {"notes": laid.notes, "light": light, "made_of": made_of}
    return Scene(Path(name).name, spectra, source, Path(lamp).name, white, **given)

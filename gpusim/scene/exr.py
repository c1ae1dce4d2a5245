"""Linear RGB photographs in OpenEXR files, in and out."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, rgb_to_xyz
from gpusim.scene.highlights import OUTLIER

# Resampling and colour conversion leave small negatives in good photographs: those of the OpenEXR
# sample images stay within 6e-5 of the brightest sample. The sun excuses none: what counts is the
# brightest sample that is no outlier.
SMALL_NEGATIVE = 1e-3


@dataclass(frozen=True, eq=False)
class Photograph:
    """An EXR's picture in linear Rec.709.

    Attributes
    ----------
    rgb : ndarray (3, rows, cols), float32
        None negative.
    white_rgb : tuple of 3 float
        The file's own RGB (1, 1, 1) in Rec.709: other than (1, 1, 1) where the file's white is not
        D65.
    white_luminance_cd_m2 : float or None
        Luminance of RGB (1, 1, 1), where the file gives it.
    notes : tuple of str
        What was changed on the way.
    """

    rgb: np.ndarray
    white_rgb: tuple[float, float, float]
    white_luminance_cd_m2: float | None
    notes: tuple[str, ...]


@contextmanager
def _library_messages() -> Iterator[list[str]]:
    """Catch what the OpenEXR library prints: its core on stderr, its binding by `print`."""
    lines: list[str] = []
    with tempfile.TemporaryFile() as caught, redirect_stdout(io.StringIO()):
        stderr = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            caught.seek(0)
            lines += caught.read().decode(errors="replace").splitlines()


def _open(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Return the header of the first part that holds a picture, and its channels as stored."""
    import OpenEXR

    if not path.is_file():
        raise UserError("no such scene file", file=path)
    parts = []
    try:
        with _library_messages() as messages:
            parts = OpenEXR.File(str(path), separate_channels=True).parts
    except (RuntimeError, ValueError) as error:
        messages.append(str(error))
    if not parts:
        reason = messages[0].removeprefix(f"{path}: ") if messages else "it holds no readable part"
        raise UserError(
            "not a readable OpenEXR file",
            file=path,
            value=reason,
            allowed="scan lines or tiles, flat",
        )
    for part in parts:
        channels = {name: channel.pixels for name, channel in part.channels.items()}
        if {"R", "G", "B"} <= channels.keys() or ("Y" in channels and "RY" not in channels):
            return part.header, channels
    raise UserError(
        "no picture channels in the EXR",
        file=path,
        field="channels",
        value=", ".join(channels),
        allowed="R, G, B, or Y alone",
    )


def _check(path: Path, name: str, plane: np.ndarray, peak: float) -> None:
    """Refuse a plane with samples that no radiance has."""
    for problem, bad in (
        ("NaN or infinite radiance", ~np.isfinite(plane)),
        ("negative radiance", plane < -SMALL_NEGATIVE * peak),
    ):
        if bad.any():
            row, col = np.argwhere(bad)[0]
            first = f"first {plane[row, col]:g} at row {row}, column {col}"
            raise UserError(
                problem,
                file=path,
                field=f"channel {name}",
                value=f"{np.count_nonzero(bad)} samples, {first}",
                allowed=f"finite, at least {-SMALL_NEGATIVE:g} of the brightest sample ({peak:g}; "
                f"of {OUTLIER:g} times the median where there are brighter ones)",
            )


def read_exr(path: str | Path) -> Photograph:
    """Read the picture of a linear RGB(A) or grey EXR file.

    Colours are converted from the file's primaries to Rec.709 through XYZ, without adaptation: the
    light keeps its chromaticity. A colour outside Rec.709, and a small negative, moves towards the
    grey of its own luminance until no component is negative. Alpha is ignored: the picture is
    premultiplied, over black.

    Parameters
    ----------
    path : path
        Of the file. The first part with R, G, B or with Y alone is taken, over its display window.

    Raises
    ------
    UserError
        If the file is missing, corrupt, has no such channels or oblong pixels, or its samples are
        not a radiance.
    """
    path = Path(path)
    header, channels = _open(path)
    aspect = float(header.get("pixelAspectRatio", 1.0))
    if abs(aspect - 1) > 1e-3:
        raise UserError(
            "oblong pixels", file=path, field="pixelAspectRatio", value=aspect, allowed="1"
        )
    names = ("R", "G", "B") if "R" in channels else ("Y",)
    planes = {name: channels[name].astype(np.float32) for name in names}
    lit = np.concatenate([plane[np.isfinite(plane) & (plane > 0)] for plane in planes.values()])
    peak = float(min(lit.max(), OUTLIER * np.median(lit))) if lit.size else 0.0
    for name, plane in planes.items():
        _check(path, name, plane, peak)
    rgb = np.stack([planes[name] for name in names]).astype(np.float64)
    notes = []

    space = rgb_to_xyz(REC709_CHROMATICITIES)
    own = np.eye(3)
    if "chromaticities" in header and len(names) == 3:
        chromaticities = tuple(float(v) for v in np.ravel(header["chromaticities"]))
        # OpenEXR rounds Rec.709's own values to float32: no other gamut is as close as 1e-4.
        if np.abs(np.subtract(chromaticities, REC709_CHROMATICITIES)).max() > 1e-4:
            own = np.linalg.solve(space, rgb_to_xyz(chromaticities))
            rgb = np.einsum("ij,jrc->irc", own, rgb)
            notes.append(f"converted from the file's primaries {chromaticities} to Rec.709")
    if len(names) == 1:
        rgb = np.repeat(rgb, 3, axis=0)
    rgb, moved = _into_gamut(rgb, space[1])
    if moved:
        notes.append(
            f"{moved} pixels outside Rec.709 or negative moved to its boundary, luminance kept"
        )

    rgb = _over_display_window(rgb, header)
    if rgb.shape[1:] != planes[names[0]].shape:
        notes.append("data window cut or filled with black to the display window")
    luminance = header.get("whiteLuminance")
    return Photograph(
        rgb=rgb.astype(np.float32),
        white_rgb=tuple(own @ np.ones(3)),
        white_luminance_cd_m2=None if luminance is None else float(luminance),
        notes=tuple(notes),
    )


def _into_gamut(rgb: np.ndarray, luminance_weights: np.ndarray) -> tuple[np.ndarray, int]:
    """Return RGB (3, rows, cols) mixed with equal-luminance grey until it is not negative."""
    lowest = rgb.min(axis=0)
    outside = lowest < 0
    colour = rgb[:, outside]
    luminance = np.maximum(luminance_weights @ colour, 0.0)
    share = luminance / (luminance - lowest[outside])
    result = rgb.copy()
    result[:, outside] = np.maximum(luminance + share * (colour - luminance), 0.0)
    return result, colour.shape[1]


def _over_display_window(rgb: np.ndarray, header: dict) -> np.ndarray:
    """Return the picture over the display window: cut to it, black where there are no data."""
    (x0, y0), (x1, y1) = np.asarray(header["displayWindow"], int)
    left, top = np.asarray(header["dataWindow"][0], int)
    rows, cols = rgb.shape[1:]
    out = np.zeros((3, y1 - y0 + 1, x1 - x0 + 1))
    ya, yb = max(y0, top), min(y1 + 1, top + rows)
    xa, xb = max(x0, left), min(x1 + 1, left + cols)
    if ya < yb and xa < xb:
        out[:, ya - y0 : yb - y0, xa - x0 : xb - x0] = rgb[
            :, ya - top : yb - top, xa - left : xb - left
        ]
    return out


def write_exr(
    path: str | Path,
    channels: dict[str, np.ndarray],
    white_luminance_cd_m2: float | None = None,
) -> None:
    """Write planes to an EXR file, which appears whole or not at all.

    Parameters
    ----------
    path : path
        Of the file.
    channels : dict of str to ndarray (rows, cols), or (rows, cols, 3) under the name ``"RGB"``
        Written as float32. RGB is linear Rec.709.
    white_luminance_cd_m2 : float, optional
        Luminance of RGB (1, 1, 1), kept as the attribute ``whiteLuminance`` that `read_exr` obeys.

    Raises
    ------
    UserError
        If the file cannot be written.
    """
    import OpenEXR

    path = Path(path)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709_CHROMATICITIES,
    }
    if white_luminance_cd_m2 is not None:
        header["whiteLuminance"] = float(white_luminance_cd_m2)
    planes = {name: np.ascontiguousarray(plane, np.float32) for name, plane in channels.items()}
    partial = path.with_name(f".{path.name}.part")
    try:
        with _library_messages():
            OpenEXR.File(header, planes).write(str(partial))
        partial.replace(path)
    except (OSError, RuntimeError) as error:
        partial.unlink(missing_ok=True)
        raise UserError("cannot write the EXR", file=path, value=str(error)) from None

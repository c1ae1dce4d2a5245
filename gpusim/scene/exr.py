"""Linear RGB photographs in OpenEXR files, in and out."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.disk import whole
from gpusim.errors import UserError
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, rgb_to_xyz

# Files claim what they like: of the picture 134 MP, 3 GiB while its colours are converted in
# float64; of all channels and parts together 4 GiB in float32.
MOST_PIXELS = 1 << 27
MOST_SAMPLES = 1 << 30
MOST_OF_TILE = 1 << 24  # pixels: a tile is unpacked whole, however little of it is in the picture
# White is some 100 cd/m^2 and the sun 1.6e9. Beyond 1e20 sums over a picture leave float32.
LARGEST = 1e20
# OpenEXR's filter from chroma at every other sample to those between: weights of the 1st, 3rd ...
# neighbour on either side (RgbaYca.reconstructChromaHoriz of the OpenEXR library).
BETWEEN = (0.627123, -0.186077, 0.087929, -0.043159, 0.019597, -0.007540, 0.002128)
PICTURES = (("R", "G", "B"), ("Y", "RY", "BY"), ("Y",))


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
def library_messages() -> Iterator[list[str]]:
    """Catch what a library prints: OpenEXR's core and LibRaw on stderr, a binding by `print`."""
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


def _parts(path: Path, **how: bool) -> list:
    """Return the parts that the OpenEXR library reads from a file."""
    import OpenEXR

    parts = []
    try:
        with library_messages() as messages:
            parts = OpenEXR.File(str(path), separate_channels=True, **how).parts
    except Exception as error:  # the library has its own, and the binding those of a wrong header
        messages.append(str(error) or type(error).__name__)
    if not parts:
        reason = messages[0].removeprefix(f"{path}: ") if messages else "it holds no readable part"
        raise UserError(
            "not a readable OpenEXR file",
            file=path,
            value=reason,
            allowed="scan lines or tiles, flat",
        )
    return parts


def units_of(path: Path) -> str | None:
    """Return what an EXR's header says in ``units``; None where it says nothing.

    Raises
    ------
    UserError
        Where it is no EXR.
    """
    headers = [part.header for part in _parts(path, header_only=True)]
    return next((str(header["units"]) for header in headers if "units" in header), None)


def _open(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Return the header of the first part that holds a picture, and its channels as stored."""
    if not os.path.isfile(path):
        raise UserError("no such scene file", file=path)
    # The headers alone first: they say how much memory the samples need.
    headers = [part.header for part in _parts(path, header_only=True)]
    samples = 0
    for header in headers:
        pixels = _pixels(header, "dataWindow")
        samples += pixels * max(len(header.get("channels", ())), 1)
        for window in ("dataWindow", "displayWindow"):
            if _pixels(header, window) > MOST_PIXELS or samples > MOST_SAMPLES:
                (x0, y0), (x1, y1) = np.asarray(header[window], int)
                raise UserError(
                    "the picture is larger than any that is read",
                    file=path,
                    field=window,
                    value=f"{x1 - x0 + 1} x {y1 - y0 + 1} pixels",
                    allowed=f"{MOST_PIXELS:,} pixels; {MOST_SAMPLES:,} samples of all channels",
                )
        tiles = header.get("tiles")
        if tiles is not None and tiles.xSize * tiles.ySize > MOST_OF_TILE:
            raise UserError(
                "tiles larger than any that are read",
                file=path,
                field="tiles",
                value=f"{tiles.xSize} x {tiles.ySize} pixels",
                allowed=f"{MOST_OF_TILE:,} pixels",
            )
    if all("deep" in str(header.get("type")) for header in headers):
        raise UserError(
            "a deep picture: samples at many depths in each pixel",
            file=path,
            field="type",
            value=str(headers[0].get("type")).rpartition(".")[2],
            allowed="scan lines or tiles, flat",
        )
    for part in _parts(path):
        channels = {name: channel.pixels for name, channel in part.channels.items()}
        for names in PICTURES:
            found = [channels.get(name) for name in names]
            if all(getattr(one, "ndim", 0) == 2 for one in found):
                return part.header, dict(zip(names, found, strict=True))
    raise UserError(
        "no picture channels in the EXR",
        file=path,
        field="channels",
        value=", ".join(channels),
        allowed="R, G, B; Y, RY, BY; or Y alone",
    )


def _pixels(header: dict, window: str) -> int:
    (x0, y0), (x1, y1) = np.asarray(header[window], int)
    return int(x1 - x0 + 1) * int(y1 - y0 + 1)


def _check(path: Path, name: str, plane: np.ndarray) -> None:
    """Refuse a plane with samples that no radiance has."""
    # Not "larger": comparisons with NaN are false.
    bad = ~(np.abs(plane) <= LARGEST)
    if bad.any():
        row, col = np.argwhere(bad)[0]
        first = f"first {plane[row, col]:g} at row {row}, column {col}"
        problem = (
            "a radiance beyond all light"
            if np.isfinite(plane[bad]).all()
            else ("NaN or infinite radiance")
        )
        raise UserError(
            problem,
            file=path,
            field=f"channel {name}",
            value=f"{np.count_nonzero(bad)} samples, {first}",
            allowed=f"finite, up to {LARGEST:g}",
        )


def read_exr(path: str | Path, *, needs_luminance: bool = True) -> Photograph:
    """Read the picture of a linear RGB(A), luminance-chroma or grey EXR file.

    Colours are converted from the file's primaries to Rec.709 through XYZ, without adaptation: the
    light keeps its chromaticity. A colour outside Rec.709, and a negative, moves towards the
    grey of its own luminance until no component is negative. Alpha is ignored: the picture is
    premultiplied, over black.

    Parameters
    ----------
    path : path
        Path of the file. The first part with R, G, B, with Y, RY, BY or with Y alone is taken, over
        its display window.
    needs_luminance : bool
        Whether a ``whiteLuminance`` that is none is a mistake; else it is left out.

    Raises
    ------
    UserError
        If the file is missing, corrupt, larger than `MOST_PIXELS`, has no such channels or oblong
        pixels, its samples are not a radiance, or its primaries make no colours.
    """
    path = Path(path)
    header, channels = _open(path)
    aspect = _number(header, "pixelAspectRatio", 1.0)
    if not abs(aspect - 1) <= 1e-3:
        raise UserError(
            "oblong pixels", file=path, field="pixelAspectRatio", value=aspect, allowed="1"
        )
    luminance = _number(header, "whiteLuminance", None)
    if luminance is not None and not 0 < luminance < LARGEST:
        if needs_luminance:
            raise UserError(
                "the file's luminance of white is none",
                file=path,
                field="whiteLuminance",
                value=header["whiteLuminance"],
                allowed="cd/m^2, above 0; --luminance says it in the file's place",
            )
        luminance = None
    channels = {name: plane.astype(np.float32) for name, plane in channels.items()}
    for name, plane in channels.items():
        _check(path, name, plane)
    to_xyz, notes = _primaries(path, header, needed=len(channels) == 3), []
    planes = _colours(path, channels, to_xyz[1])
    rgb = _over_display_window(planes, header)
    if rgb.shape[1:] != planes.shape[1:]:
        notes.append("data window cut or filled with black to the display window")

    space = rgb_to_xyz(REC709_CHROMATICITIES)
    own = np.eye(3)
    if not np.array_equal(to_xyz, space):
        own = np.linalg.solve(space, to_xyz)
        rgb = np.einsum("ij,jrc->irc", own, rgb)
        given = tuple(float(v) for v in np.ravel(header["chromaticities"]))
        notes.insert(0, f"converted from the file's primaries {given} to Rec.709")
    rgb, moved = _into_gamut(rgb, space[1])
    if moved:
        notes.append(
            f"{moved} pixels outside Rec.709 or negative moved to its boundary, luminance kept"
        )
    return Photograph(
        rgb=rgb.astype(np.float32),
        white_rgb=tuple(own @ np.ones(3)),
        white_luminance_cd_m2=luminance,
        notes=tuple(notes),
    )


def _number(header: dict, name: str, default: float | None) -> float | None:
    """Return a number of the header; NaN where it is none."""
    try:
        return float(header[name]) if name in header else default
    except (TypeError, ValueError):
        return float("nan")


def _primaries(path: Path, header: dict, needed: bool) -> np.ndarray:
    """Return the matrix (3, 3) from a file's RGB to XYZ; Rec.709's where it names no primaries."""
    given = header.get("chromaticities")
    if given is None or not needed:
        return rgb_to_xyz(REC709_CHROMATICITIES)
    try:
        chromaticities = np.asarray(np.ravel(given), float)
        if chromaticities.shape != (8,):
            raise ValueError(f"{chromaticities.size} numbers")
        # OpenEXR rounds Rec.709's own values to float32: no other gamut is as close as 1e-4.
        if np.abs(chromaticities - REC709_CHROMATICITIES).max() <= 1e-4:
            chromaticities = REC709_CHROMATICITIES
        return rgb_to_xyz(tuple(chromaticities))
    except (TypeError, ValueError) as error:
        raise UserError(
            f"the file's primaries make no colours: {error}",
            file=path,
            field="chromaticities",
            value=", ".join(f"{v:g}" for v in np.ravel(given)) if np.size(given) == 8 else given,
            allowed="x, y of red, green, blue and white: three colours with white between them",
        ) from error


def _colours(path: Path, channels: dict[str, np.ndarray], weights: np.ndarray) -> np.ndarray:
    """Return RGB in the file's own primaries, float64 (3, rows, cols)."""
    planes = {name: plane.astype(np.float64) for name, plane in channels.items()}
    names = tuple(planes)
    if "RY" in names:
        y = planes["Y"]
        for name in ("RY", "BY"):
            # Chroma of every other row and column has half as many, rounded up or down.
            for axis in (0, 1):
                if planes[name].shape[axis] != y.shape[axis]:
                    planes[name] = _between(planes[name], y.shape[axis], axis)
        red, blue = (y * (1 + planes[name]) for name in ("RY", "BY"))
        green = (y - weights[0] * red - weights[2] * blue) / weights[1]
        return np.stack([red, green, blue])
    shapes = {plane.shape for plane in planes.values()}
    if len(shapes) > 1:
        raise UserError(
            "the channels are not of one size",
            file=path,
            field="channels",
            value=", ".join(f"{name} {p.shape[1]} x {p.shape[0]}" for name, p in planes.items()),
            allowed="R, G and B at every pixel",
        )
    return np.stack([planes[name] for name in (names if len(names) == 3 else 3 * names)])


def _between(chroma: np.ndarray, count: int, axis: int) -> np.ndarray:
    """Return chroma at each of `count` samples along an axis from that at every other one."""
    known = np.moveaxis(chroma, axis, 0)
    out = np.empty((count, *known.shape[1:]))
    reach = len(BETWEEN)
    edge = [(reach, reach + 1)] + [(0, 0)] * (known.ndim - 1)
    padded = np.pad(known, edge, mode="edge")
    odd = sum(
        weight * (padded[reach - n : len(padded) - reach - 1 - n][: len(known)]
                  + padded[reach + 1 + n :][: len(known)])
        for n, weight in enumerate(BETWEEN)
    )  # fmt: skip
    out[0::2], out[1::2] = known[: len(out[0::2])], odd[: len(out[1::2])]
    return np.moveaxis(out, 0, axis)


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
    if (x0, y0) == (left, top) and (y1 - y0 + 1, x1 - x0 + 1) == (rows, cols):
        return rgb
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
    units: str | None = None,
    more: Mapping[str, str] | None = None,
) -> None:
    """Write planes to an EXR file, which appears whole or not at all.

    Parameters
    ----------
    path : path
        Path of the file.
    channels : dict of str to ndarray (rows, cols), or (rows, cols, 3) under the name ``"RGB"``
        Written as float32. RGB is linear Rec.709.
    white_luminance_cd_m2 : float, optional
        Luminance of RGB (1, 1, 1), kept as the attribute ``whiteLuminance`` that `read_exr` obeys.
    units : str, optional
        Kept as the attribute ``units``.
    more : mapping, optional
        Attributes besides.

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
    if units is not None:
        header["units"] = units
    header |= more or {}
    planes = {name: np.ascontiguousarray(plane, np.float32) for name, plane in channels.items()}
    try:
        with library_messages(), whole(path) as part:
            OpenEXR.File(header, planes).write(str(part))
    except (OSError, RuntimeError) as error:
        raise UserError("cannot write the EXR", file=path, value=str(error)) from None

"""Frames on disk: a folder with a list of them, ``frames.csv``, and what the camera is.

``frames.csv`` has a line for each frame, in the order in which they were taken::

    file,exposure_s,photons,wavelength_nm
    frame-00000.tif,0.01,0,
    frame-00001.tif,0.01,0,
    frame-00002.tif,0.01,219.3,530

``photons`` is the mean number per pixel during the exposure, 0 in the dark. In its place may stand
``irradiance_w_m2``; then ``camera.json`` gives ``pixel_pitch_um``. Frames with equal exposure time,
light and wavelength belong together: two make a pair for the temporal variance, more also a stack
for the non-uniformities. ``camera.json`` is optional: ``name``, ``pattern`` (of the filters from
the first pixel, rows of channels: [["R", "G"], ["G", "B"]]; of a monochrome camera none) and
``pixel_pitch_um``. Frames are .npy, .tif, .tiff, .png or .dng,
of whole numbers.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.config.arrays import read_npy, read_png, read_tiff
from gpusim.config.text import read_bytes, read_json, read_text
from gpusim.errors import UserError
from gpusim.metrics.flat_field import Light
from gpusim.metrics.statistics import Accumulator, Level
from gpusim.scene.exr import library_messages

LIST, CAMERA = "frames.csv", "camera.json"
KINDS = (".npy", ".tif", ".tiff", ".dng", ".png")
PLANCK_J_S, LIGHT_M_S = 6.62607015e-34, 299792458.0  # SI, exact
LEAST_SIDE = 8  # photosites of a channel along each side: fewer have no statistics
MONOCHROME = (("W",),)

Key = tuple[float, float, float | None]  # exposure time, photons, wavelength


@dataclass(frozen=True)
class Frames:
    """A list of frames, read and checked; the frames themselves are not.

    Attributes
    ----------
    folder : Path
    name : str
        Name of the camera.
    pattern : tuple of tuple of str
        Filter pattern.
    groups : dict
        Files of each exposure time, number of photons and wavelength.
    bit_depth : int or None
        Bit depth of the frames; None where the list does not say it.
    pixel_pitch_um : float or None
    """

    folder: Path
    name: str
    pattern: tuple[tuple[str, ...], ...]
    groups: dict[Key, list[Path]]
    bit_depth: int | None = None
    pixel_pitch_um: float | None = None

    @property
    def sites(self) -> tuple[str, ...]:
        """Channel of each site of the filter pattern, row by row."""
        return tuple(name for row in self.pattern for name in row)


def find_frames(path: Path) -> Frames:
    """Read the list of frames of a folder.

    Parameters
    ----------
    path : Path
        The folder, or its frames.csv.

    Raises
    ------
    UserError
        No list, or none that can be read; a column that is missing or unknown; a number that is
        none; a frame that is missing, or alone where two are needed.
    """
    if not os.path.exists(path):
        raise UserError("no such folder", file=path, allowed=f"a folder with {LIST}, or that file")
    listed = path / LIST if os.path.isdir(path) else path
    folder = listed.parent
    camera = _camera(folder / CAMERA)
    groups: dict[Key, list[Path]] = {}
    for number, row in _lines(listed):
        file = folder / row["file"]
        if file.suffix.lower() not in KINDS:
            raise UserError(
                "not a kind of file that frames may have",
                file=listed,
                field=f"file, line {number}",
                value=row["file"],
                allowed=", ".join(KINDS),
            )
        if not os.path.isfile(file):
            raise UserError("a frame is missing", file=file, field=f"file, line {number} of {LIST}")
        groups.setdefault(_key(row, number, listed, camera), []).append(file)
    if not groups:
        raise UserError(
            "there are no frames", file=listed, allowed="a line for each frame below the titles"
        )
    refuse_single(groups)
    pattern = tuple(tuple(row) for row in camera.get("pattern", MONOCHROME))
    name, pitch = camera.get("name", folder.resolve().name), camera.get("pixel_pitch_um")
    return Frames(folder, name, pattern, groups, pixel_pitch_um=pitch)


def refuse_single(groups: dict[Key, list[Path]]) -> None:
    """Refuse a level with one frame.

    Raises
    ------
    UserError
        There is one.
    """
    for (exposure, photons, _), files in groups.items():
        if len(files) < 2:
            raise UserError(
                "one frame where two are needed: the temporal noise is that of their difference",
                file=files[0],
                field="exposure_s, photons",
                value=f"{exposure:g}, {photons:g}",
                allowed="two frames or more of each light and exposure time",
            )


def measure(
    frames: Frames, progress: Callable[[str, int, int], None] = lambda phase, done, total: None
) -> Iterator[Level]:
    """Read the frames light by light, and yield their statistics.

    Raises
    ------
    UserError
        A frame that cannot be read, that is no image of whole numbers, or of another size.
    """
    period = len(frames.pattern), len(frames.pattern[0])
    total, done, shape = sum(map(len, frames.groups.values())), 0, None
    for (exposure, photons, wavelength), files in frames.groups.items():
        statistics = Accumulator(period)
        for file in files:
            frame = read_frame(file)
            rows, cols = (
                side // step * step for side, step in zip(frame.shape, period, strict=True)
            )
            if min(rows // period[0], cols // period[1]) < LEAST_SIDE:
                raise UserError(
                    "the frame is too small",
                    file=file,
                    value=f"{frame.shape[0]} x {frame.shape[1]}",
                    allowed=f"{LEAST_SIDE} filter patterns or more along each side",
                )
            shape = shape or frame.shape
            if frame.shape != shape:
                raise UserError(
                    "the frames are not of one size",
                    file=file,
                    value=f"{frame.shape[0]} x {frame.shape[1]}",
                    allowed=f"{shape[0]} x {shape[1]}, as the first",
                )
            statistics.add(frame[:rows, :cols])
            done += 1
            progress("frames", done, total)
        yield Level(exposure, photons, wavelength, statistics.sites())


def read_frame(file: Path) -> np.ndarray:
    """Read a frame: (rows, cols), digital numbers.

    Raises
    ------
    UserError
        It cannot be read, or is no image of whole numbers, one a pixel.
    """
    try:
        frame = _READERS[file.suffix.lower()](file)
    except Exception as error:  # whatever a library says of a broken file
        raise UserError(f"the frame cannot be read: {error}", file=file) from error
    if frame.ndim != 2 or frame.dtype.kind not in "ui" or not frame.size or frame.min() < 0:
        raise UserError(
            "not an image of digital numbers",
            file=file,
            value=f"{frame.dtype} {' x '.join(map(str, frame.shape))}",
            allowed="whole numbers from 0 up, rows x columns",
        )
    return frame


def _read_dng(file: Path) -> np.ndarray:
    import rawpy

    with library_messages(), rawpy.imread(str(file)) as raw:
        return raw.raw_image_visible.copy()


def _read_png(file: Path) -> np.ndarray:
    return read_png(read_bytes(file, "the frame"), indices=True)


_READERS = {
    ".png": _read_png,
    ".npy": read_npy,
    ".tif": read_tiff,
    ".tiff": read_tiff,
    ".dng": _read_dng,
}


def _camera(file: Path) -> dict:
    """Read what the camera is; nothing where the file is not there."""
    if not os.path.isfile(file):
        return {}
    camera = read_json(file, "the file of the camera")
    known = ("name", "pattern", "pixel_pitch_um")
    if not isinstance(camera, dict) or set(camera) - set(known):
        raise UserError("not what a camera is", file=file, allowed=", ".join(known))
    pattern = camera.get("pattern", MONOCHROME)
    if not (
        isinstance(pattern, list | tuple)
        and pattern
        and all(isinstance(row, list | tuple) and len(row) == len(pattern[0]) for row in pattern)
        and all(name and isinstance(name, str) for row in pattern for name in row)
        and pattern[0]
    ):
        raise UserError(
            "not a filter pattern",
            file=file,
            field="pattern",
            value=pattern,
            allowed='rows of equal length: [["R", "G"], ["G", "B"]]',
        )
    pitch = camera.get("pixel_pitch_um", 1.0)
    if not isinstance(pitch, int | float) or not 0 < pitch < math.inf:
        raise UserError(
            "not a pixel pitch", file=file, field="pixel_pitch_um", value=pitch, allowed="> 0"
        )
    return camera


def _lines(listed: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield number and fields of each line of the list."""
    text = read_text(listed, "the list of frames")
    reader = csv.DictReader(text.splitlines(), restkey="")
    titles = tuple(reader.fieldnames or ())
    light = [name for name in ("photons", "irradiance_w_m2") if name in titles]
    lacking = {"file", "exposure_s"} - set(titles)
    unknown = set(titles) - {"file", "exposure_s", "photons", "irradiance_w_m2", "wavelength_nm"}
    if lacking or unknown or len(light) != 1:
        raise UserError(
            "the list of frames has other columns",
            file=listed,
            value=", ".join(titles) or "none",
            allowed="file, exposure_s, photons (or irradiance_w_m2) and, if known, wavelength_nm",
        )
    for row in reader:
        if "" in row or None in row.values():
            raise UserError(
                "a line has more or fewer fields than there are columns",
                file=listed,
                field=f"line {reader.line_num}",
            )
        yield reader.line_num, row


def _key(row: dict[str, str], number: int, listed: Path, camera: dict) -> Key:
    """Return exposure time, photons and wavelength of a line."""

    def value(name: str, least: float, allowed: str) -> float:
        try:
            found = float(row[name])
        except ValueError:
            found = math.nan
        if not least <= found < math.inf:
            raise UserError(
                "not a number that this may be",
                file=listed,
                field=f"{name}, line {number}",
                value=row[name],
                allowed=allowed,
            )
        return found

    exposure = value("exposure_s", 0.0, "seconds, from 0 up")
    wavelength = None
    if row.get("wavelength_nm", "").strip():
        wavelength = value("wavelength_nm", 1e-3, "nanometres, above 0")
    if "photons" in row:
        photons = value("photons", 0.0, "per pixel, from 0 up")
    else:
        photons = value("irradiance_w_m2", 0.0, "W/m^2, from 0 up")
        if photons:
            photons *= _photons_per_irradiance(wavelength, camera, number, listed) * exposure
    return exposure, photons, wavelength if photons else None


def _photons_per_irradiance(
    wavelength_nm: float | None, camera: dict, number: int, listed: Path
) -> float:
    """Return A lambda / (h c): EMVA 1288 R3.1, section 2.1, equation (4) in SI units."""
    if wavelength_nm is None or "pixel_pitch_um" not in camera:
        raise UserError(
            "an irradiance is not enough to know the number of photons",
            file=listed,
            field=f"irradiance_w_m2, line {number}",
            allowed=f"wavelength_nm in the same line, and pixel_pitch_um in {CAMERA}",
        )
    area = (camera["pixel_pitch_um"] * 1e-6) ** 2
    return area * wavelength_nm * 1e-9 / (PLANCK_J_S * LIGHT_M_S)


class Kept:
    """Writes the frames of a simulated measurement, and at the end their list.

    Parameters
    ----------
    folder : Path
        It must be there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._rows: list[tuple[str, str, str, str]] = []

    def frame(self, light: Light, number: int, frame: np.ndarray) -> None:
        """Write one frame."""
        import tifffile

        name = f"frame-{number:05}.tif"
        tifffile.imwrite(self.folder / name, frame)
        wavelength = "" if light.wavelength_nm is None else f"{light.wavelength_nm:.17g}"
        self._rows.append((name, f"{light.exposure_s:.17g}", f"{light.photons:.17g}", wavelength))

    def close(self, name: str, pattern: list[list[str]], pixel_pitch_um: float) -> None:
        """Write the list of frames and what the camera is."""
        with (self.folder / LIST).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(("file", "exposure_s", "photons", "wavelength_nm"))
            writer.writerows(self._rows)
        camera = {"name": name, "pattern": pattern, "pixel_pitch_um": pixel_pitch_um}
        (self.folder / CAMERA).write_text(json.dumps(camera, indent=1) + "\n")

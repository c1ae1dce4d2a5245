"""TIFF files of one picture with an Exif part (TIFF 6.0, sections 2 and 3; Exif 2.3)."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO

import numpy as np

from gpusim.disk import beside
from gpusim.errors import UserError

BYTE, ASCII, SHORT, LONG, RATIONAL, UNDEFINED, SRATIONAL, DOUBLE = 1, 2, 3, 4, 5, 7, 10, 12
# What one value of each type takes: bytes, and the letter by which struct packs its parts.
TYPES = {
    BYTE: (1, "B"),
    ASCII: (1, "B"),
    SHORT: (2, "H"),
    LONG: (4, "I"),
    RATIONAL: (8, "I"),
    UNDEFINED: (1, "B"),
    SRATIONAL: (8, "i"),
    DOUBLE: (8, "d"),
}
EXIF_IFD = 34665
WIDTH, LENGTH, BITS, COMPRESSION, SAMPLES = 256, 257, 258, 259, 277
STRIP_OFFSETS, ROWS_PER_STRIP, STRIP_BYTES, PLANAR = 273, 278, 279, 284
MAX_SHORT = 65535
MAX_BYTES = 2**32 - 1  # places in a file have 32 bits
LARGEST = {RATIONAL: 2**32 - 1, SRATIONAL: 2**31 - 1}  # of numerator and denominator

Tags = Mapping[int, tuple[int, object]]


def rational(value: float, kind: int = RATIONAL) -> tuple[int, int]:
    """Return numerator and denominator of the nearest rational that a tag can hold.

    To 1e-9 of the value from 1e-9 to 1e9. Nothing but zero becomes 0, and nothing more than the
    largest rational: 2.3e-10 stands for whatever lies between 0 and it.
    """
    most = LARGEST[kind]
    size = abs(value)
    if size == 0:
        return 0, 1
    if size < 1:
        above, below = _nearest(1 / size, most)
        near = below, above
    else:
        near = _nearest(size, most)
    return (-near[0] if value < 0 else near[0]), near[1]


@lru_cache(maxsize=1024)  # frames of one camera have the same: a third of a DNG's time
def _nearest(value: float, most: int) -> tuple[int, int]:
    """Return the nearest rational of a number from 1 up, with both parts up to `most`."""
    if value >= most:
        return most, 1
    # The simplest one that is as near as doubles are: 1/60 is 1 and 60.
    near = Fraction(value).limit_denominator(1000)
    if not math.isclose(near, value, rel_tol=1e-12):
        near = Fraction(value).limit_denominator(max(1, int(most / (value + 1))))
    return near.numerator, near.denominator


def rationals(values: Iterable[float], kind: int = RATIONAL) -> list[int]:
    """Return numerators and denominators of numbers, in turns."""
    return [part for value in values for part in rational(float(value), kind)]


def ascii_text(text: str) -> str:
    """Return a text as a tag can hold it: characters that ASCII has not become ``?``."""
    return text.encode("ascii", "replace").decode("ascii")


def write_tiff(path: Path, pixels: np.ndarray, tags: Tags, exif: Tags) -> None:
    """Write a picture of 16 bits, little-endian and not compressed, in one strip.

    Parameters
    ----------
    path : Path
        File to write. It appears whole or not at all.
    pixels : ndarray (rows, cols), uint16
    tags : mapping of int to (type, values)
        Tags of the picture, beside those that say where its pixels lie. Texts are str. Rationals
        are numerators and denominators in turns.
    exif : mapping of int to (type, values)
        The tags of the Exif part.

    Raises
    ------
    UserError
        If the file cannot be written, or has more bytes than TIFF can count.
    """
    rows, cols = pixels.shape
    size = 2 * pixels.size
    whole = dict(tags) | {
        WIDTH: (LONG, (cols,)),
        LENGTH: (LONG, (rows,)),
        BITS: (SHORT, (16,)),
        COMPRESSION: (SHORT, (1,)),
        SAMPLES: (SHORT, (1,)),
        STRIP_OFFSETS: (LONG, (0,)),
        ROWS_PER_STRIP: (LONG, (rows,)),
        STRIP_BYTES: (LONG, (min(size, MAX_BYTES),)),
        PLANAR: (SHORT, (1,)),
        EXIF_IFD: (LONG, (0,)),
    }
    exif_at = 8 + len(_directory(whole, 8))
    pixels_at = exif_at + len(_directory(exif, exif_at))
    whole |= {STRIP_OFFSETS: (LONG, (pixels_at,)), EXIF_IFD: (LONG, (exif_at,))}
    partial = beside(path)  # a batch that is resumed sweeps such names away
    try:
        if pixels_at + size > MAX_BYTES:
            raise OSError(f"{size} bytes of pixels, and a TIFF has at most {MAX_BYTES}")
        with partial.open("wb") as file:
            file.write(struct.pack("<2sHI", b"II", 42, 8))
            file.write(_directory(whole, 8))
            file.write(_directory(exif, exif_at))
            np.ascontiguousarray(pixels, "<u2").tofile(file)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise UserError("cannot write the raw file", file=path, value=str(error)) from None


def _directory(tags: Tags, start: int) -> bytes:
    """Return a directory and behind it the values that do not fit into it."""
    entries, values = b"", b""
    behind = start + 2 + 12 * len(tags) + 4
    for tag, (kind, given) in sorted(tags.items()):
        count, data = _packed(kind, given)
        if len(data) > 4:
            place = struct.pack("<I", behind + len(values))
            values += data + bytes(len(data) % 2)  # values begin at even places
        else:
            place = data.ljust(4, b"\0")
        entries += struct.pack("<HHI", tag, kind, count) + place
    return struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0) + values


def _packed(kind: int, given: object) -> tuple[int, bytes]:
    """Return how many values there are, and their bytes."""
    if kind == ASCII:
        data = ascii_text(str(given)).encode("ascii") + b"\0"
    elif isinstance(given, bytes):
        data = given
    else:
        numbers = [value.item() if isinstance(value, np.generic) else value for value in given]
        data = struct.pack(f"<{len(numbers)}{TYPES[kind][1]}", *numbers)
    return len(data) // TYPES[kind][0], data


def read_tags(path: Path) -> tuple[dict[int, tuple[int, object]], dict[int, tuple[int, object]]]:
    """Return the tags of a file's first picture and of its Exif part, as `write_tiff` takes them.

    Raises
    ------
    ValueError
        The file is no TIFF, or a damaged one.
    """
    with path.open("rb") as file:
        try:
            order = {b"II*\0": "<", b"MM\0*": ">"}[file.read(4)]
            tags = _read_directory(file, order, *struct.unpack(f"{order}I", file.read(4)))
            exif = _read_directory(file, order, tags[EXIF_IFD][1][0]) if EXIF_IFD in tags else {}
        except (struct.error, LookupError, OverflowError, MemoryError, TypeError) as error:
            raise ValueError(f"no TIFF, or a damaged one: {error}") from None
    return tags, exif


def _read_directory(file: BinaryIO, order: str, place: int) -> dict[int, tuple[int, object]]:
    file.seek(place)
    (count,) = struct.unpack(f"{order}H", file.read(2))
    entries, tags = file.read(12 * count), {}
    for tag, kind, number, value in struct.iter_unpack(f"{order}HHI4s", entries):
        size, letter = TYPES.get(kind, (1, "B"))
        if number * size > len(value):
            file.seek(*struct.unpack(f"{order}I", value))
            value = file.read(number * size)
        value = value[: number * size]
        if kind == ASCII:
            tags[tag] = kind, value.rstrip(b"\0").decode("ascii", "replace")
        else:
            parts = len(value) // struct.calcsize(letter)
            whole = value[: parts * struct.calcsize(letter)]
            tags[tag] = kind, struct.unpack(f"{order}{parts}{letter}", whole)
    return tags


def numbers(entry: tuple[int, object]) -> np.ndarray:
    """Return the values of a tag as float64; of rationals their quotients."""
    kind, values = entry
    found = np.array(values, np.float64)
    if kind in LARGEST:
        above, below = found.reshape(-1, 2).T
        found = above / np.where(below == 0, np.nan, below)
    return found

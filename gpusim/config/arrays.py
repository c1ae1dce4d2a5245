"""Arrays in files, which may claim any size: looked at before they are read."""

from __future__ import annotations

import io
import logging
import math
import struct
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

if TYPE_CHECKING:
    from tifffile import TiffFile

# All arrays of a file together: a mask of 200 MP in float64 has 1.5 GiB, a bank some 0.1 GiB.
MOST_BYTES = 2 << 30
MOST_PIXELS = 1 << 27  # of a PNG or JPEG, as of other pictures
# Deflate shortens nothing to less than 1/1032 (https://zlib.net/zlib_tech.html).
MOST_RATIO = 1100
# Where sizes, bits and colour type stand in a PNG, and a pixel's samples by that type (PNG, third
# edition, 11.2.1).
PNG_START, PNG_HEADER = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", slice(16, 26)
PNG_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}


def read_npy(path: Path) -> np.ndarray:
    """Return the array in a .npy file.

    Raises
    ------
    OSError, ValueError
        It is none, is shorter than it says or larger than any of ours, or holds objects.
    """
    found = np.load(path, mmap_mode="r", allow_pickle=False)  # refuses what the file does not hold
    if not isinstance(found, np.ndarray):
        raise ValueError("an archive, not one array")
    _check(found.shape, found.dtype, "the array")
    return np.array(found)


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays in a .npz file.

    Raises
    ------
    OSError, ValueError, zipfile.BadZipFile
        It is none, an array is shorter than it says, all are larger than any of ours, or one holds
        objects.
    """
    with zipfile.ZipFile(path) as archive:
        total = 0
        for member in archive.infolist():
            with archive.open(member) as file:
                shape, _, dtype = _header(file)
            nbytes = _check(shape, dtype, member.filename)
            if nbytes > member.file_size:
                raise ValueError(
                    f"{member.filename} says that it holds {nbytes:,} bytes, and has "
                    f"{member.file_size:,}"
                )
            total += nbytes
        if total > min(MOST_BYTES, MOST_RATIO * path.stat().st_size):
            raise ValueError(f"its arrays have {total:,} bytes, more than {MOST_BYTES:,}")
    with np.load(path, allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def read_tiff(path: Path) -> np.ndarray:
    """Return the first picture in a TIFF file.

    Raises
    ------
    Exception
        Whatever tifffile says of a broken file; ValueError where it is larger than any of ours.
    """
    with opened_tiff(path) as file:
        series = file.series[0]
        _check(series.shape, series.dtype, "the picture", MOST_RATIO * path.stat().st_size)
        return series.asarray()


@contextmanager
def opened_tiff(source: Path | BinaryIO) -> Iterator[TiffFile]:
    """Open a TIFF, and keep tifffile from printing what it finds wrong: our errors say that."""
    import tifffile

    logger = logging.getLogger("tifffile")
    before, logger.disabled = logger.disabled, True
    try:
        with tifffile.TiffFile(source) as file:
            yield file
    finally:
        logger.disabled = before


def read_png(content: bytes, *, indices: bool = False) -> np.ndarray:
    """Return the samples of a PNG, with all the bits that it has.

    Parameters
    ----------
    content : bytes
    indices : bool
        Whether samples that point into a palette stay as they are; else they become its colours.

    Returns
    -------
    ndarray (rows, cols) or (rows, cols, n), bool, uint8 or uint16

    Raises
    ------
    Exception
        Whatever Pillow says of a broken file; ValueError where it is none, or larger than any of
        ours.
    """
    from PIL import Image

    if not content.startswith(PNG_START) or len(content) < PNG_HEADER.stop:
        raise ValueError("no PNG")
    cols, rows, bits, colour = struct.unpack(">2I2B", content[PNG_HEADER])
    samples = PNG_SAMPLES.get(colour, 4)
    held = rows * -(-cols * samples * bits // 8)
    if rows * cols > MOST_PIXELS or held > MOST_RATIO * len(content):
        raise ValueError(f"a picture of {cols} x {rows} pixels in {len(content):,} bytes")
    if bits == 16 and samples == 2:
        raise ValueError("16 bits of grey with transparency; without it they are read")

    def pixels(unpacked: str | None = None) -> np.ndarray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pictures that Pillow finds large
            with Image.open(io.BytesIO(content), formats=["PNG"]) as image:
                if unpacked is not None:
                    image.tile = [(*part[:3], unpacked) for part in image.tile]
                colours = image.convert("RGB") if image.mode == "P" and not indices else image
                return np.array(colours)

    if bits == 16 and samples > 1:
        # Pillow keeps one byte of each two: the first where it takes them for big-endian, which
        # they are, the second where it takes them for little-endian.
        high, low = (pixels(f"{'RGB' if samples == 3 else 'RGBA'};16{end}") for end in "BL")
        return np.uint16(256) * high + low
    found = pixels()
    return found.astype(np.uint16) if found.dtype == np.int32 else found


def read_jpeg(content: bytes) -> np.ndarray:
    """Return the samples of a JPEG (rows, cols) or (rows, cols, 3), uint8, upright by its Exif.

    Raises
    ------
    Exception
        Whatever Pillow says of a broken file; ValueError where it is larger than any of ours, or
        its colours are those of print.
    """
    from PIL import Image, ImageOps

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pictures that Pillow finds large
        with Image.open(io.BytesIO(content), formats=["JPEG"]) as image:
            if math.prod(image.size) > MOST_PIXELS:
                raise ValueError("a picture of {} x {} pixels".format(*image.size))
            if image.mode not in ("L", "RGB"):
                raise ValueError(f"colours {image.mode}")
            return np.array(ImageOps.exif_transpose(image))


def _header(file) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(file)
    return np.lib.format.read_array_header_2_0(file)


def _check(shape: tuple[int, ...], dtype: np.dtype, what: str, most: int = MOST_BYTES) -> int:
    nbytes = math.prod(shape) * np.dtype(dtype).itemsize
    if nbytes > min(most, MOST_BYTES):
        size = " x ".join(map(str, shape))
        raise ValueError(f"{what} of {size} has {nbytes:,} bytes, more than it can have")
    return nbytes

"""Arrays in files, which may claim any size: looked at before they are read."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path

import numpy as np

# All arrays of a file together: a mask of 200 MP in float64 has 1.5 GiB, a bank some 0.1 GiB.
MOST_BYTES = 2 << 30
# Deflate shortens nothing to less than 1/1032 (https://zlib.net/zlib_tech.html).
MOST_RATIO = 1100


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
    import tifffile

    with tifffile.TiffFile(path) as file:
        series = file.series[0]
        _check(series.shape, series.dtype, "the picture", MOST_RATIO * path.stat().st_size)
        return series.asarray()


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

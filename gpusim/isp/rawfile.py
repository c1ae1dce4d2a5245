"""Raw files that `gpusim.isp.dng` wrote, read again: light by photosite, and its colours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.isp import tiff
from gpusim.isp.dng import BLACK_IS_ZERO, CFA, LINEAR_RAW, MAKE, TAGS
from gpusim.sensor.cfa import CFA_LETTERS

RAW_FILES = "a raw frame: a DNG, or what else LibRaw reads"


@dataclass(frozen=True, eq=False)
class RawFile:
    """A raw frame.

    Attributes
    ----------
    signal_dn : ndarray (rows, cols), float32
        Signal of the lit pixels: linear, less the black level and the mean of the masked pixels.
    span_dn : float
        The same of a saturated pixel.
    pattern : tuple of str
        Rows of the filter pattern, from the first of these pixels; ``W`` where there are no
        filters.
    tags, exif : dict of int to (type, values)
        All that the file says: see `gpusim.isp.tiff`.
    """

    signal_dn: np.ndarray
    span_dn: float
    pattern: tuple[str, ...]
    tags: dict[int, tuple[int, object]]
    exif: dict[int, tuple[int, object]]

    @property
    def colours(self) -> str:
        """Letters of the filters, in the order of AsShotNeutral and of the matrices' rows."""
        return "".join(sorted(set("".join(self.pattern)), key=CFA_LETTERS.index))

    def value(self, name: str) -> np.ndarray:
        """Return the values of a tag."""
        return tiff.numbers(self.tags[TAGS[name]])


@dataclass(frozen=True, eq=False)
class CodedFile:
    """A raw frame as it lies in its file.

    Attributes
    ----------
    codes : ndarray (rows, cols), uint16
        Codes of the lit pixels.
    table : ndarray (codes,), uint16, optional
        What a linear converter would have given in place of each code.
    black : ndarray (PY, PX), float64
        What a pixel without light has, by site from the first lit pixel: the black level and the
        mean signal of the masked pixels, in the units of the table.
    span_dn : float
        From black to saturation, in the same units.
    pattern, tags, exif
        As in `RawFile`.
    """

    codes: np.ndarray
    table: np.ndarray | None
    black: np.ndarray
    span_dn: float
    pattern: tuple[str, ...]
    tags: dict[int, tuple[int, object]]
    exif: dict[int, tuple[int, object]]


def read_raw(path: Path) -> RawFile | None:
    """Read a raw file; None where it is not as `write_dng` writes them.

    Raises
    ------
    ValueError
        It is, and is damaged.
    """
    found = read_codes(path)
    if found is None:
        return None
    signal = found.codes if found.table is None else found.table[found.codes]
    signal = signal - repeated(found.black.astype(np.float32), signal.shape)
    return RawFile(signal, found.span_dn, found.pattern, found.tags, found.exif)


def repeated(pattern: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return a pattern repeated over a frame, from its first pixel."""
    row, col = (np.arange(n) % period for n, period in zip(shape, pattern.shape, strict=True))
    return pattern[np.ix_(row, col)]


def read_codes(path: Path) -> CodedFile | None:
    """Read a raw file as it is; None where it is not as `write_dng` writes them.

    Raises
    ------
    ValueError
        It is, and is damaged.
    """
    try:
        tags, exif = tiff.read_tags(path)
    except ValueError:
        return None
    kind = tags.get(TAGS["PhotometricInterpretation"], (0, (None,)))[1][0]
    if tags.get(TAGS["Make"], (0, ""))[1] != MAKE or kind not in (BLACK_IS_ZERO, CFA, LINEAR_RAW):
        return None
    try:
        return _read(path, tags, exif, kind)
    except (LookupError, OSError, TypeError) as error:
        raise ValueError(f"a damaged raw file: {error}") from None


def _read(path: Path, tags: dict, exif: dict, kind: int) -> CodedFile:
    def whole(tag: int) -> list[int]:
        return [int(value) for value in tags[tag][1]]

    (rows,), (cols,), (place,) = (
        whole(tag) for tag in (tiff.LENGTH, tiff.WIDTH, tiff.STRIP_OFFSETS)
    )
    held = (path.stat().st_size - place) // 2
    if not 0 <= rows * cols <= held:
        raise ValueError(f"a damaged raw file: {max(held, 0)} of {rows * cols} pixels")
    codes = np.fromfile(path, "<u2", rows * cols, offset=place)
    top, left, bottom, right = whole(TAGS["ActiveArea"])
    codes = codes.reshape(rows, cols)
    table = None
    if TAGS["LinearizationTable"] in tags:
        table = np.array(tags[TAGS["LinearizationTable"]][1], np.uint16)
        if codes.max(initial=0) >= table.size:
            raise ValueError(f"a damaged raw file: codes beyond the {table.size} of its table")
    # The pattern of black levels begins at the first lit pixel.
    black = tiff.numbers(tags[TAGS["BlackLevel"]]).reshape(whole(TAGS["BlackLevelRepeatDim"]))
    pattern = ("W",)
    if kind != LINEAR_RAW:
        width = whole(TAGS["CFARepeatPatternDim"])[1]
        sites = "".join(CFA_LETTERS[code] for code in whole(TAGS["CFAPattern"]))
        pattern = tuple(sites[at : at + width] for at in range(0, len(sites), width))
    span = whole(TAGS["WhiteLevel"])[0] - float(black.mean())
    if TAGS["MaskedAreas"] in tags:  # what shielded pixels collected, lit ones did as well
        areas = np.reshape(whole(TAGS["MaskedAreas"]), (-1, 4))
        shielded = []
        for r0, c0, r1, c1 in areas:
            part = codes[r0:r1, c0:c1]
            level = part if table is None else table[part]
            period = np.roll(black, (top - r0, left - c0), (0, 1))
            shielded.append((level - repeated(period, part.shape)).ravel())
        dark = float(np.concatenate(shielded).mean())
        black, span = black + dark, span - dark
    return CodedFile(codes[top:bottom, left:right], table, black, span, pattern, tags, exif)

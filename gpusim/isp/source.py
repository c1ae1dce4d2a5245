"""Raw files as the ISP takes them: codes, levels, filters and colours, of our files and others."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gpusim.isp import tiff
from gpusim.isp.dng import TAGS
from gpusim.isp.opcodes import corrections_of
from gpusim.isp.rawfile import CodedFile, read_codes, repeated
from gpusim.isp.rectify import Rectification
from gpusim.isp.shading import Shading
from gpusim.isp.white import D65_KELVIN, LIGHT_KELVIN
from gpusim.sensor.cfa import CFA_LETTERS

# Variance of a frame whose file says nothing of its noise: 1 % of saturation squared, which all but
# the noisiest frames stay below.
UNKNOWN_NOISE = (0.0, 1e-4)
LONGEST_PERIOD = 8  # pixels, of a filter pattern
# Quarter turns to the left by LibRaw's `flip`.
TURNS = {0: 0, 3: 2, 5: 1, 6: 3}


@dataclass(frozen=True, eq=False)
class Source:
    """A raw frame.

    Attributes
    ----------
    codes : ndarray (rows, cols), uint16
        Codes of the lit pixels.
    table : ndarray (codes,), optional
        What a linear converter would have given in place of each code.
    black : ndarray (PY, PX)
        By site from the first pixel, in the units of the table.
    span : float
        From black to saturation, in the same units.
    pattern : tuple of str
        Rows of the filter pattern, from the first pixel.
    neutral : ndarray (colours,), optional
        What white makes in each colour as shot, the largest 1; None where the file has none.
    matrices : dict of float to ndarray (colours, 3)
        From XYZ to the camera's colours, by the light's temperature, K; none of less than three
        colours.
    shading : Shading, optional
    noise : (float, float)
        Variance of light x: noise[0] x + noise[1].
    ev : float
        By how many stops the file asks to be shown brighter.
    turns : int
        Quarter turns to the left that make the picture upright.
    rectification : Rectification, optional
        What undoes the lens's distortion and lateral colour.
    forward : dict of float to ndarray (3, colours)
        From balanced colours to XYZ beside D50, by the light's temperature, K; none of a file
        without.
    """

    codes: np.ndarray
    table: np.ndarray | None
    black: np.ndarray
    span: float
    pattern: tuple[str, ...]
    neutral: np.ndarray | None
    matrices: dict[float, np.ndarray]
    shading: Shading | None = None
    noise: tuple[float, float] = UNKNOWN_NOISE
    ev: float = 0.0
    turns: int = 0
    rectification: Rectification | None = None
    forward: dict[float, np.ndarray] = field(default_factory=dict)

    @property
    def colours(self) -> str:
        """Letters of the filters, in the order of the neutral and of the matrices' rows."""
        return "".join(sorted(set("".join(self.pattern)), key=CFA_LETTERS.index))

    def light_of(self, colour: str, rect: tuple[int, int, int, int]) -> np.ndarray:
        """Return the light at the sites of a colour within a rectangle: 0 is black, 1 saturation.

        ``rect`` is row, column, rows and columns.
        """
        row, col, rows, cols = rect
        codes = self.codes[row : row + rows, col : col + cols]
        found = []
        for y, line in enumerate(self.pattern):
            for x, letter in enumerate(line):
                if letter != colour:
                    continue
                below, right = (y - row) % len(self.pattern), (x - col) % len(line)
                sites = codes[below :: len(self.pattern), right :: len(line)]
                level = sites if self.table is None else self.table[sites]
                at = row + below + len(self.pattern) * np.arange(sites.shape[0])
                across = col + right + len(line) * np.arange(sites.shape[1])
                black = self.black[np.ix_(at % self.black.shape[0], across % self.black.shape[1])]
                found.append(((level - black) / self.span).ravel())
        return np.concatenate(found)


def like(source: Source, other: Source) -> Source:
    """Return a frame with the pedestal, the white and the matrices of another camera's file.

    The pedestal is that of each colour, in codes: it stays where a table makes the codes linear.
    Saturation stays the frame's own.

    Raises
    ------
    ValueError
        The other has filters of other colours.
    """
    if source.colours != other.colours:
        raise ValueError(f"its filters are {other.colours}, those of the raw {source.colours}")
    black, span = source.black, source.span
    if source.table is None:
        sites = np.array([list(line) for line in other.pattern])
        both = tuple(map(math.lcm, sites.shape, other.black.shape))
        sites, level = repeated(sites, both), repeated(other.black, both)
        levels = {colour: float(level[sites == colour].mean()) for colour in other.colours}
        black = np.array([[levels[letter] for letter in line] for line in source.pattern])
        span = source.span + float(source.black.mean() - black.mean())
    colours = {"neutral": other.neutral, "matrices": other.matrices, "forward": other.forward}
    return replace(source, black=black, span=span, **colours)


def read_source(path: Path) -> Source:
    """Read a raw file: one of ours, or one that LibRaw knows.

    Raises
    ------
    ValueError, rawpy.LibRawError
        It is none, or damaged; or its filters are none that are developed here.
    """
    ours = read_codes(path)
    found = _of_libraw(path) if ours is None else _of_ours(ours)
    _check(found)
    return found


def _check(source: Source) -> None:
    """Refuse levels and colours that no camera has."""
    number = len(source.colours)
    gain = () if source.shading is None else (*source.shading.k, *source.shading.axis)
    if not (np.isfinite([source.span, *source.noise, *gain]).all() and source.span > 0):
        raise ValueError("levels that are none, or no level between black and white")
    if not np.isfinite(source.black).all() or source.codes.size == 0:
        raise ValueError("a frame without pixels, or without a level of black")
    neutral = source.neutral
    if neutral is not None and (neutral.shape != (number,) or not _positive(neutral)):
        raise ValueError("a white that is none")
    both = (*source.matrices.values(), *(one.T for one in source.forward.values()))
    if any(one.shape != (number, 3) or not np.isfinite(one).all() for one in both):
        raise ValueError("a colour matrix that is none")


def _positive(values: np.ndarray) -> bool:
    return bool(np.isfinite(values).all() and (values > 0).all())


def _of_ours(file: CodedFile) -> Source:
    def value(name: str) -> np.ndarray:
        return tiff.numbers(file.tags[TAGS[name]])

    has_colours = len(set("".join(file.pattern))) > 1
    noise = value("NoiseProfile")[:2]
    shading, rectification = corrections_of(file.tags, TAGS["OpcodeList3"])
    return Source(
        file.codes,
        file.table,
        file.black,
        file.span_dn,
        file.pattern,
        value("AsShotNeutral") if has_colours else None,
        _matrices(file.tags, "ColorMatrix", (-1, 3)),
        shading,
        (float(noise[0]), float(noise[1])),
        float(value("BaselineExposure")[0]),
        rectification=rectification,
        forward=_matrices(file.tags, "ForwardMatrix", (3, -1)),
    )


def _matrices(
    tags: dict[int, tuple[int, object]], name: str, shape: tuple[int, int]
) -> dict[float, np.ndarray]:
    """Return the matrices of a name in a DNG's tags by temperature; none where it has none."""
    found = {}
    for number in (1, 2):
        matrix = tags.get(TAGS[f"{name}{number}"])
        light = tags.get(TAGS[f"CalibrationIlluminant{number}"])
        if matrix is None:
            continue
        kelvin = LIGHT_KELVIN.get(int(light[1][0])) if light is not None else None
        # A light of no known temperature serves where there is no other.
        if kelvin is not None or not found:
            found[kelvin or D65_KELVIN] = tiff.numbers(matrix).reshape(shape)
    return found


def _of_libraw(path: Path) -> Source:
    import rawpy

    with rawpy.imread(str(path)) as raw:
        if raw.raw_type is not rawpy.RawType.Flat:
            raise ValueError("a file without a filter array, its colours already side by side")
        sites = raw.raw_colors_visible
        names = raw.color_desc.decode()
        pattern = _period(sites)
        letters = tuple("".join(names[int(code)] for code in row) for row in pattern)
        if not set("".join(letters)) <= set(CFA_LETTERS):
            raise ValueError(f"filters of colours {names}")
        black = np.array(raw.black_level_per_channel, np.float64)[pattern]
        # One code for each colour: LibRaw counts the second green apart.
        codes = {names[code]: code for code in sorted(set(pattern.ravel().tolist()), reverse=True)}
        order = [codes[name] for name in sorted(codes, key=CFA_LETTERS.index)]
        gains = np.array(raw.camera_whitebalance, np.float64)[order]
        neutral = None
        if len(order) > 1 and _positive(gains):
            neutral = gains.min() / gains
        matrices = _dng_matrices(path, "ColorMatrix", (len(order), 3))
        shading, rectification = corrections_of(_dng_tags(path), TAGS["OpcodeList3"])
        known = np.array(raw.rgb_xyz_matrix, np.float64)[order]
        if not matrices and len(order) >= 3 and known.any():
            matrices = {D65_KELVIN: known}
        return Source(
            raw.raw_image_visible.copy(),
            None,  # LibRaw has made the codes linear
            black,
            float(raw.white_level) - float(black.mean()),
            letters,
            neutral,
            matrices,
            shading,
            ev=baseline_ev(path),
            rectification=rectification,
            turns=TURNS.get(raw.sizes.flip, 0),
            forward=_dng_matrices(path, "ForwardMatrix", (3, len(order))),
        )


def _period(sites: np.ndarray) -> np.ndarray:
    """Return one period of a filter array."""
    rows, cols = (
        next(
            (n for n in range(1, LONGEST_PERIOD + 1) if np.array_equal(along[n:], along[:-n])), None
        )
        for along in (sites, sites.T)
    )
    if rows is None or cols is None:
        raise ValueError("filters of no pattern")
    return sites[:rows, :cols]


def _dng_tags(path: Path) -> dict[int, tuple[int, object]]:
    """Return the tags of a DNG; none of what is none."""
    try:
        tags = tiff.read_tags(path)[0]
    except ValueError:
        return {}
    return tags if TAGS["DNGVersion"] in tags else {}


def _dng_matrices(path: Path, name: str, shape: tuple[int, int]) -> dict[float, np.ndarray]:
    """Return the matrices of a name of another's DNG; LibRaw passes only one of them on."""
    try:
        found = _matrices(_dng_tags(path), name, shape)
    except ValueError:
        return {}
    return found if all(np.isfinite(one).all() for one in found.values()) else {}


def baseline_ev(path: Path) -> float:
    """Return by how many stops a DNG asks to be shown brighter; 0 where it does not, or is none."""
    tags = _dng_tags(path)
    if TAGS["BaselineExposure"] not in tags:
        return 0.0
    (stops,) = tiff.numbers(tags[TAGS["BaselineExposure"]])
    return float(stops) if np.isfinite(stops) else 0.0

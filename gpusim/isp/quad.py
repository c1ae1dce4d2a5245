"""Quad Bayer: filters of one colour over 2 x 2 photosites each, made into Bayer frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gpusim.isp import tiff
from gpusim.isp.dng import EXIF, TAGS
from gpusim.isp.rawfile import RawFile
from gpusim.isp.tiff import ASCII, BYTE, DOUBLE, LONG, RATIONAL, SHORT
from gpusim.sensor.cfa import CFA_LETTERS

BAYER = ("RGGB", "BGGR", "GRBG", "GBRG")
PERIOD = 4  # pixels, of the filter pattern
# Around a frame: colour differences count up to 3 beyond it, and their greens come from 2 more.
RIM = 2 * PERIOD
# Share of saturation below which differences say nothing of where an edge runs: noise.
FLAT = 0.002


def quad_phase(pattern: tuple[str, ...] | list[list[str]]) -> tuple[int, int] | None:
    """Return the row and column at which the first cell of 2 x 2 begins; None: no quad Bayer."""
    sites = np.array([list(row) for row in pattern])
    if sites.shape != (PERIOD, PERIOD):
        return None
    for phase in np.ndindex(2, 2):
        cells = np.roll(sites, (-phase[0], -phase[1]), (0, 1))
        corner = cells[::2, ::2]
        whole = corner.repeat(2, axis=0).repeat(2, axis=1)
        if "".join(corner.ravel()) in BAYER and np.array_equal(cells, whole):
            return phase
    return None


def bayer_of(pattern: tuple[str, ...], phase: tuple[int, int]) -> tuple[str, str]:
    """Return the Bayer pattern of the cells, from the first whole one."""
    cells = np.roll(np.array([list(row) for row in pattern]), (-phase[0], -phase[1]), (0, 1))
    return "".join(cells[0, ::2]), "".join(cells[2, ::2])


def write_bayer(raw: RawFile, path: Path, *, binned: bool) -> None:
    """Write the Bayer frame of a quad Bayer one, with all else that its file says.

    Parameters
    ----------
    raw : RawFile
        Raw picture of a quad Bayer array.
    path : Path
    binned : bool
        Add the charge of 2 x 2 photosites of one filter: half as many pixels along each side, and a
        quarter of the noise's variance. Else each photosite gets the colour that a Bayer array has
        there, see `remosaiced`.

    Raises
    ------
    UserError
        If the file cannot be written.
    """
    phase = quad_phase(raw.pattern)
    black = float(raw.value("BlackLevel").mean())
    (white,) = raw.tags[TAGS["WhiteLevel"]][1]
    tags, exif = dict(raw.tags), dict(raw.exif)
    for name in ("LinearizationTable", "MaskedAreas"):
        tags.pop(TAGS[name], None)
    first, second = bayer_of(raw.pattern, phase)
    if binned:
        # As many times a single code as 16 bits hold: four, or less.
        times = min(4, tiff.MAX_SHORT // white)
        signal = times / 4 * binned_cells(raw.signal_dn, phase)
        black, white = times * black, times * white
        profile = np.array(tags[TAGS["NoiseProfile"]][1]) / 4
        tags[TAGS["NoiseProfile"]] = (DOUBLE, tuple(profile))
        for name in ("FocalPlaneXResolution", "FocalPlaneYResolution"):
            (per_cm,) = tiff.numbers(exif[EXIF[name]])
            exif[EXIF[name]] = (RATIONAL, tiff.rational(per_cm / 2))
    else:
        signal = remosaiced(raw, phase)
        # Cells that begin off the first pixel: the pattern as it is there.
        sites = np.array([list(first), list(second)])
        first, second = ("".join(row) for row in np.roll(sites, phase, (0, 1)))
    codes = np.clip(np.round(signal + black), 0, tiff.MAX_SHORT).astype(np.uint16)
    rows, cols = codes.shape
    what = "binned" if binned else "remosaiced"
    tags |= {
        TAGS["ImageDescription"]: (ASCII, f"{tags[TAGS['ImageDescription']][1]}, {what}"),
        TAGS["CFARepeatPatternDim"]: (SHORT, (2, 2)),
        TAGS["CFAPattern"]: (BYTE, [CFA_LETTERS.index(site) for site in first + second]),
        TAGS["BlackLevelRepeatDim"]: (SHORT, (1, 1)),
        TAGS["BlackLevel"]: (RATIONAL, tiff.rational(black)),
        TAGS["WhiteLevel"]: (LONG, (white,)),
        TAGS["DefaultCropSize"]: (LONG, (cols, rows)),
        TAGS["ActiveArea"]: (LONG, (0, 0, rows, cols)),
    }
    tiff.write_tiff(path, codes, tags, exif)


def binned_cells(signal: np.ndarray, phase: tuple[int, int]) -> np.ndarray:
    """Return the sums over the whole cells of 2 x 2 photosites."""
    rows, cols = ((n - first) // 2 for n, first in zip(signal.shape, phase, strict=True))
    whole = signal[phase[0] : phase[0] + 2 * rows, phase[1] : phase[1] + 2 * cols]
    return whole.reshape(rows, 2, cols, 2).sum(axis=(1, 3))


def remosaiced(raw: RawFile, phase: tuple[int, int]) -> np.ndarray:
    """Return the signal of a Bayer array: (rows, cols), float32.

    Photosites that have their colour keep their value. Green comes from the green photosites along
    the row or the column, each weighed by how little these differ; red and blue from their
    difference to green, which changes slowly over a picture where the channels are balanced to its
    white (the assumption of all demosaicing by colour differences).
    """
    rows, cols = raw.signal_dn.shape
    # Around the frame the pattern goes on: whole periods of the frame's own rim.
    at = [_beyond(n) for n in (rows, cols)]
    sites = sites_of(raw.pattern, (rows + 2 * RIM, cols + 2 * RIM))
    white = np.zeros(sites.shape, np.float32)
    for colour, share in zip(raw.colours, raw.value("AsShotNeutral"), strict=True):
        white[sites == colour] = share
    signal = raw.signal_dn[np.ix_(*at)] / white
    inside = slice(RIM, RIM + rows), slice(RIM, RIM + cols)
    green = sites == "G"
    flat = (FLAT * raw.span_dn) ** 2
    total = np.zeros_like(signal)
    weights = np.zeros_like(signal)
    for axis in (0, 1):
        value, step = _between(signal, phase[axis], axis)
        weight = 1 / (step**2 + flat)
        total += weight * value
        weights += weight
    whole = np.where(green, signal, total / weights)
    corner = bayer_of(raw.pattern, phase)
    wanted = np.roll(np.array([list(row) for row in corner]), phase, (0, 1))
    wanted = sites_of(tuple("".join(row) for row in wanted), signal.shape)
    found = np.where(wanted == "G", whole, signal)
    for colour in "RB":
        difference = spread(signal - whole, sites == colour, PERIOD)
        found = np.where(wanted == colour, whole + difference, found)
    for colour, share in zip(raw.colours, raw.value("AsShotNeutral"), strict=True):
        found[wanted == colour] *= share
    return np.where(wanted == sites, signal * white, found)[inside].astype(np.float32)


def _between(signal: np.ndarray, first: int, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what lies between the photosites of the next cells, on a line, and their difference.

    A photosite has the one of the next cell on one side beside it, and on the other 2 away.
    """
    place = np.arange(signal.shape[axis])
    is_first = ((place - first) % 2 == 0).reshape((-1, 1) if axis == 0 else (1, -1))
    before, after = (
        {step: np.roll(signal, sign * step, axis) for step in (1, 2)} for sign in (1, -1)
    )
    near = np.where(is_first, before[1], after[1])
    far = np.where(is_first, after[2], before[2])
    return (2 * near + far) / 3, near - far


def _beyond(count: int) -> np.ndarray:
    """Return the numbers of rows or columns with periods of the pattern before and behind them."""
    place = np.arange(-RIM, count + RIM)
    last = count - 1
    place = np.where(place < 0, place % PERIOD, place)
    return np.where(place > last, last - (last - place) % PERIOD, place)


def spread(signal: np.ndarray, own: np.ndarray, reach: int) -> np.ndarray:
    """Return at each pixel the mean of some pixels by a tent that is 0 from `reach` off on."""
    from scipy.ndimage import convolve1d

    tent = reach - np.abs(np.arange(1 - reach, reach)).astype(np.float32)
    sums = []
    for part in (np.where(own, signal, 0).astype(np.float32), own.astype(np.float32)):
        for axis in (0, 1):
            part = convolve1d(part, tent, axis=axis, mode="constant")
        sums.append(part)
    return sums[0] / np.maximum(sums[1], np.float32(1e-6))


def sites_of(pattern: tuple[str, ...], shape: tuple[int, int]) -> np.ndarray:
    """Return the letter of each photosite: (rows, cols)."""
    sites = np.array([list(row) for row in pattern])
    rows, cols = (np.arange(n) % period for n, period in zip(shape, sites.shape, strict=True))
    return sites[np.ix_(rows, cols)]

"""A raw frame developed on the GPU, band by band, by the stages of ``shaders/isp``."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu import Array, Device, Recording
from gpusim.isp.balance import record_balance
from gpusim.isp.bilinear import record_bilinear
from gpusim.isp.curve import record_curve
from gpusim.isp.directional import record_directional
from gpusim.isp.guided import record_guided
from gpusim.isp.linear import record_linear
from gpusim.isp.malvar import record_malvar
from gpusim.isp.matrix import record_matrix
from gpusim.isp.pack import record_pack, unpacked
from gpusim.isp.quad import BAYER
from gpusim.isp.rectify import IDENTITY, record_rectify
from gpusim.isp.repair import record_repair
from gpusim.isp.roll_off import record_roll_off
from gpusim.isp.settings import LARGEST_EV, PATCH, Settings
from gpusim.isp.shading import record_shading
from gpusim.isp.source import Source
from gpusim.isp.transfer import SPACES, record_transfer
from gpusim.isp.white import LEAST_NEUTRAL, neutral_of, to_picture
from gpusim.scene.spectra import white_radiance, xyz

# Rows and columns around a band that its stages reach into: repair 2, directional 8, guided 10
# at most (two tents of up to 5, and 3 of the guide). A multiple of 4, as columns are.
RIM = 12
MOST_PIXELS = 24 << 20  # samples of all planes of a band: 96 MiB of the 128 that a binding has
BAND_PIXELS = 1 << 20  # of a band, its rim not counted: 60 MB on the device
SATURATED = 0.99  # share of the span from which on a pixel does not count for a white
STEPS = 5  # pixels from one to the next that count for the grey world, in patterns


@dataclass(frozen=True, eq=False)
class Developed:
    """A picture, and how it was made.

    Attributes
    ----------
    picture : ndarray (rows, cols, 3), uint8 or uint16
    left_out : dict of str to str
        Stages that had nothing to do, and why.
    times_s : dict of str to float
        Seconds of each stage on the device.
    """

    picture: np.ndarray
    left_out: dict[str, str]
    times_s: dict[str, float]


def demosaicing(source: Source, settings: Settings) -> str | None:
    """Return the way colours are interpolated; None of a frame without filters.

    Raises
    ------
    UserError
        A method for Bayer arrays, and the frame has another.
    """
    if len(source.colours) == 1:
        return None
    bayer = _red_site(source.pattern) is not None
    if settings.demosaic in ("malvar", "directional") and not bayer:
        raise UserError(
            "this method is for Bayer arrays",
            field="demosaic",
            value=settings.demosaic,
            allowed="guided, bilinear",
        )
    return settings.demosaic or ("directional" if bayer else "guided")


def neutral_for(source: Source, settings: Settings) -> np.ndarray:
    """Return what white makes in each colour, the largest 1.

    Raises
    ------
    UserError
        Nothing in the file or the picture tells.
    """
    wanted = settings.white_balance
    if wanted == "as-shot":
        if source.neutral is None:
            raise _no_white("the file has no white balance as shot", wanted)
        return source.neutral
    if wanted == "grey-world":
        return _mean_colours(source, (0, 0, *source.codes.shape), wanted, STEPS)
    if patch := PATCH.fullmatch(wanted):
        row, col, rows, cols = map(int, patch.groups())
        if row + rows > source.codes.shape[0] or col + cols > source.codes.shape[1]:
            raise _no_white("the patch lies beyond the frame", wanted)
        return _mean_colours(source, (row, col, rows, cols), wanted, 1)
    if not source.matrices:
        raise _no_white("the file says nothing of the camera's colours", wanted)
    return neutral_of(xyz(white_radiance(wanted, 1.0)), source.matrices)


def _mean_colours(source: Source, rect: tuple, wanted: str, step: int) -> np.ndarray:
    means = []
    for colour in source.colours:
        light = source.light_of(colour, rect)[::step]
        light = light[light < SATURATED]
        means.append(light.mean() if light.size else 0.0)
    if min(means) <= 0:
        raise _no_white("a colour has no light there, or is saturated", wanted)
    return np.maximum(np.array(means) / max(means), LEAST_NEUTRAL)


def _no_white(problem: str, wanted: str) -> UserError:
    return UserError(problem, field="white_balance", value=wanted, allowed="another white balance")


def _red_site(pattern: tuple[str, ...]) -> tuple[int, int] | None:
    """Return row and column of red in a Bayer pattern; None of another."""
    if len(pattern) != 2 or "".join(pattern) not in BAYER:
        return None
    row = 0 if "R" in pattern[0] else 1
    return row, pattern[row].index("R")


def develop_source(
    source: Source,
    settings: Settings,
    device: Device,
    bits: int = 8,
    progress: Callable[[int, int], None] | None = None,
) -> Developed:
    """Develop a raw frame.

    Parameters
    ----------
    source : Source
    settings : Settings
    device : Device
    bits : int
        Bits of each colour of the picture: 8 or 16.
    progress : callable, optional
        Called with (bands done, bands in all).

    Raises
    ------
    UserError
        The settings do not fit the frame.
    """
    chain = _Chain(source, settings, bits)
    rows, cols = source.codes.shape
    picture = np.empty((rows, cols, 3), np.uint8 if bits == 8 else np.uint16)
    times: Counter[str] = Counter()
    bands = chain.bands()
    for number, (start, stop) in enumerate(bands, start=1):
        rec = Recording(device)
        label, above = chain.record(rec, start, stop)
        result = rec.run()
        part = unpacked(result[label])[above:, chain.left : chain.left + cols]
        picture[start:stop] = part[: stop - start]
        times.update(result.times_s)
        if progress is not None:
            progress(number, len(bands))
    return Developed(np.rot90(picture, source.turns), chain.left_out, dict(times))


@dataclass(frozen=True, eq=False)
class Whole:
    """A recorded development of a frame in one band.

    Attributes
    ----------
    label : str
        The picture that is downloaded: rows of codes of 32 bits, red lowest.
    rows, cols : ndarray of int
        Which row and column of the frame each row and column of the padded codes is.
    top, left : int
        Where the frame begins in the picture.
    """

    label: str
    rows: np.ndarray
    cols: np.ndarray
    top: int
    left: int


def record_whole(rec: Recording, source: Source, settings: Settings) -> Whole:
    """Record the development of a frame of one band, 8 bits a colour: for `gpusim.web`.

    Raises
    ------
    UserError
        The settings do not fit the frame, or the frame is larger than a band.
    """
    chain = _Chain(source, settings, 8)
    rows = source.codes.shape[0]
    if len(chain.bands()) > 1:
        raise UserError(
            "the frame is too large to be developed at once",
            field="tile",
            value=f"{source.codes.size} pixels",
            allowed=f"some {BAND_PIXELS:,} pixels at most",
        )
    label, top = chain.record(rec, 0, rows)
    row_of, col_of = (
        np.pad(np.arange(count), around, mode="reflect")
        for count, around in zip(source.codes.shape, chain.padding, strict=True)
    )
    high = rows + chain.top + RIM + 1
    return Whole(label, row_of[: high - high % 2], col_of, top, chain.left)


class _Chain:
    """The stages of one frame, and the bands it is cut into."""

    def __init__(self, source: Source, settings: Settings, bits: int) -> None:
        self.source, self.settings, self.bits = source, settings, bits
        self.left_out: dict[str, str] = {}
        self.method = demosaicing(source, settings)
        self.ev = float(np.clip(settings.ev + source.ev, -LARGEST_EV, LARGEST_EV))
        self.space = SPACES[settings.space]
        self._colour()
        self._listed()
        rows, cols = source.codes.shape
        # The mirrored rim begins such that red, of Bayer arrays, is at even rows and columns.
        row, col = _red_site(source.pattern) or (0, 0)
        self.top, self.left = RIM + row, RIM + col
        self.period = math.lcm(2, len(source.pattern), source.black.shape[0])
        self.padding = (
            (self.top, RIM + rows % 2 + row),
            (self.left, RIM + -(cols + self.left) % 4),
        )
        self.codes = np.pad(source.codes, self.padding, mode="reflect")
        self.black = self._rolled(source.black)
        sites = np.array([list(line) for line in source.pattern])
        self.pattern = tuple("".join(line) for line in self._rolled(sites))

    def _rolled(self, pattern: np.ndarray) -> np.ndarray:
        """Return a pattern from the first pixel of the padded frame, of that of the frame."""
        return np.roll(pattern, (self.top, self.left), (0, 1))

    def _colour(self) -> None:
        """Set the neutral, and the matrix from balanced colours to the space's."""
        colours = self.source.colours
        if len(colours) == 1:
            self.neutral, self.matrix = np.ones(1), np.ones((3, 1))
            return
        self.neutral = neutral_for(self.source, self.settings)
        if len(colours) < 3 or not self.source.matrices:
            # Grey, of two colours; the camera's own, where nothing is known of them.
            own = np.eye(3) if colours == "RGB" else np.ones((3, len(colours)))
            self.matrix = own / own.sum(axis=1, keepdims=True)
            return
        forward = self.source.forward if self.settings.matrix_fit == "lab" else None
        if forward == {}:
            raise UserError(
                "the file has no ForwardMatrix", field="matrix_fit", value="lab", allowed="xyz"
            )
        self.matrix = to_picture(
            self.neutral, self.source.matrices, self.space.chromaticities, forward
        )

    def _listed(self) -> None:
        """Note the stages that have nothing to do."""
        source, settings = self.source, self.settings
        if not settings.defects:
            self.left_out["repair"] = "not asked for"
        if source.shading is None:
            self.left_out["shading"] = "the file says nothing of the lens's"
        elif not settings.shading:
            self.left_out["shading"] = "not asked for"
        elif not any(source.shading.k):
            self.left_out["shading"] = "its gain is 1 everywhere"
        if source.rectification is None:
            self.left_out["rectify"] = "the file says nothing of the lens's distortion"
        elif not settings.rectify:
            self.left_out["rectify"] = "not asked for"
        elif len(source.rectification.maps) not in (1, len(source.colours)):
            self.left_out["rectify"] = "the file's maps are of other colours"
        elif all(one == IDENTITY for one in source.rectification.maps):
            self.left_out["rectify"] = "the file's maps move nothing"
        if self.method is None:
            self.left_out |= dict.fromkeys(("balance", "demosaicing"), "there are no filters")
        if self.ev == 0:
            self.left_out["roll_off"] = "no stops"
        if self.space.transfer is None:
            self.left_out["transfer"] = "light is stored as it is"
        if settings.curve is None:
            self.left_out["curve"] = "not asked for"
        elif all(given == shown for given, shown in settings.curve):
            self.left_out["curve"] = "it is a straight line from 0 to 1"

    def bands(self) -> list[tuple[int, int]]:
        """Return the rows of the picture, from and before, that are made at once.

        Raises
        ------
        UserError
            The lens's distortion spreads a line of the picture over more than the device takes.
        """
        rows, cols = self.source.codes.shape
        band = max(BAND_PIXELS // cols // self.period, 1) * self.period
        if "rectify" in self.left_out:
            return [(start, min(start + band, rows)) for start in range(0, rows, band)]
        most = MOST_PIXELS // (cols * max(len(self.source.colours), 3))
        found, start = [], 0
        while start < rows:
            high = band
            while True:
                stop = min(start + high, rows)
                first, last = self._seen(start, stop)
                if last - first <= most:
                    break
                if high == 1:
                    raise UserError(
                        "the lens's distortion is too large to be undone",
                        field="rectify",
                        value=f"{last - first} rows of the raw for one of the picture",
                        allowed=f"up to {most}",
                    )
                high = max(high // 2, 1)
            found.append((start, stop))
            start = stop
        return found

    def _seen(self, start: int, stop: int) -> tuple[int, int]:
        """Return the rows of the frame that some of the picture are made of: whole periods."""
        if "rectify" in self.left_out:
            return start, stop
        frame = self.source.codes.shape
        first, last = self.source.rectification.rows_for(frame, start, stop)
        return first // self.period * self.period, last

    def record(self, rec: Recording, start: int, stop: int) -> tuple[str, int]:
        """Record the rows from start to before stop; return label and first row of the picture."""
        source, out = self.source, self.left_out
        made = start, stop - start
        start, stop = self._seen(start, stop)
        rows = stop - start + self.top + RIM + 1
        codes = self.codes[start : start + rows - rows % 2]
        light = record_linear(rec, codes, self.black, source.span, table=source.table)
        if "repair" not in out:
            light = record_repair(rec, light, self._step(), source.noise)
        if "shading" not in out:
            first = start - self.top, -self.left
            record_shading(rec, light, source.shading, source.codes.shape, first)
        colours, above = self._planes(rec, light, start), self.top
        if "rectify" not in out:
            first = start - self.top, -self.left
            frame = source.codes.shape
            colours = record_rectify(
                rec, colours, source.rectification, frame, first=first, rows=made
            )
            above = 0
        colours = record_matrix(rec, colours, self.matrix)
        if "roll_off" not in out:
            record_roll_off(rec, colours, self.ev, self.settings.roll_off)
        if "transfer" not in out:
            record_transfer(rec, colours, self.space.transfer)
        if "curve" not in out:
            record_curve(rec, colours, self.settings.curve)
        return record_pack(rec, colours, self.bits), above

    def _planes(self, rec: Recording, light: Array, start: int) -> Array:
        if self.method is None:
            return light
        shares = dict(zip(self.source.colours, self.neutral, strict=True))
        gain = np.array([[1 / shares[letter] for letter in line] for line in self.pattern])
        record_balance(rec, light, gain)  # an even white too: light ends at 1 here
        if self.method == "malvar":
            return record_malvar(rec, light)
        if self.method == "directional":
            return record_directional(rec, light)
        rows, cols = self.source.codes.shape
        # What of the frame lies in this band: the rim beyond it is mirrored, and does not count.
        top = max(self.top - start, 0)
        last = min(rows + self.top - start, light.shape[0])
        frame = (top, self.left, last - top, cols)
        record = record_guided if self.method == "guided" else record_bilinear
        return record(rec, light, self.pattern, self.source.colours, frame)

    def _step(self) -> int:
        """Return the pixels between sites of one colour, for the stage that mends defects."""
        if self.method is None:
            return 1
        if _red_site(self.source.pattern) is None:
            raise UserError(
                "pixels that stand out are mended in Bayer arrays and without filters",
                field="defects",
                value=True,
                allowed="false",
            )
        return 2

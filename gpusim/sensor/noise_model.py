"""What a sensor file says of noise beyond its plain figures: lines, reset, laws, masks, defects."""

from __future__ import annotations

import hashlib
import math
from collections import Counter, OrderedDict
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from gpusim.config.arrays import read_npy, read_tiff
from gpusim.config.model import Strict, wrong
from gpusim.errors import UserError
from gpusim.sensor.strict import NotNegative, Positive

BOLTZMANN_J_PER_K = 1.380649e-23  # exact in the SI of 2019, as is
ELEMENTARY_CHARGE_C = 1.602176634e-19
ZERO_C_IN_K = 273.15


class LineNoise(Strict):
    """What the pixels of a row or a column have in common (EMVA 1288 R4.0, section 8).

    Attributes
    ----------
    prnu_row_percent, prnu_column_percent : float
        Standard deviation of the response between rows and between columns, per cent of the signal;
        ``prnu_percent`` is that of the pixels, and the variances add up to the whole.
    dsnu_row_e, dsnu_column_e : float
        Standard deviation of the fixed offset between rows and between columns, electrons; beside
        ``dsnu_e``.
    row_noise_e, column_noise_e : float
        Standard deviation of the offset that a row or a column has in one frame, electrons; beside
        ``temporal_dark_noise_e``.
    """

    prnu_row_percent: float = Field(default=0, ge=0, le=100)
    prnu_column_percent: float = Field(default=0, ge=0, le=100)
    dsnu_row_e: NotNegative = 0
    dsnu_column_e: NotNegative = 0
    row_noise_e: NotNegative = 0
    column_noise_e: NotNegative = 0


class ResetNoise(Strict):
    """Noise of the reset of a sense node, where no double sampling takes it away.

    Attributes
    ----------
    noise_e : float, optional
        Electrons.
    capacitance_ff : float, optional
        Capacitance of the node, in femtofarads, in place of ``noise_e``.
    """

    noise_e: Positive | None = None
    capacitance_ff: Positive | None = None

    @model_validator(mode="after")
    def _one_of_two(self) -> ResetNoise:
        if (self.noise_e is None) == (self.capacitance_ff is None):
            raise wrong("reset noise is given twice or not at all", "noise_e or capacitance_ff")
        return self

    def at(self, temperature_c: float) -> float:
        """Return the noise, electrons: sqrt(k T C) / e (Johnson 1928) of a capacitance."""
        if self.noise_e is not None:
            return self.noise_e
        charge2 = BOLTZMANN_J_PER_K * (temperature_c + ZERO_C_IN_K) * self.capacitance_ff * 1e-15
        return math.sqrt(charge2) / ELEMENTARY_CHARGE_C


class ReadNoiseLaw(Strict):
    """The law of the read noise, where it is not normal: its quantiles.

    Between the quantiles, and beyond them, the value is linear in the deviate of the normal law
    that is as probable: a straight line in a normal plot stays one. Mean and spread of the values
    do not matter: they are taken off, and ``temporal_dark_noise_e`` remains the standard deviation.

    Attributes
    ----------
    probabilities : list of float
        Rising, between 0 and 1.
    values : list of float
        Read noise in any unit, never falling. The share of the law below each value is its
        probability.
    """

    probabilities: tuple[float, ...] = Field(min_length=2)
    values: tuple[float, ...] = Field(min_length=2)

    @model_validator(mode="after")
    def _rising(self) -> ReadNoiseLaw:
        p, x = np.array(self.probabilities), np.array(self.values)
        if p.min() <= 0 or p.max() >= 1 or np.any(np.diff(p) <= 0):
            raise wrong(
                "the probabilities do not rise from 0 to 1", "each more than the one before"
            )
        if p.size != x.size:
            raise wrong(f"there are {x.size} values", f"{p.size}, as probabilities")
        if np.any(np.diff(x) < 0) or x[0] == x[-1]:
            raise wrong("the values do not rise", "the quantiles of a law, none below the last")
        return self

    def quantiles(self, deviates: np.ndarray) -> np.ndarray:
        """Return the law at deviates of the normal one, with mean 0 and standard deviation 1."""
        from scipy.special import ndtri

        z, x = ndtri(self.probabilities), np.array(self.values)
        # Mean and variance by sums out to 8 sigmas, on cells of 2.4e-4 sigmas.
        fine = np.linspace(-8, 8, 2**16 + 1)
        weights = np.exp(-(fine**2) / 2)
        values = _extended(fine, z, x)
        mean = np.average(values, weights=weights)
        sigma = math.sqrt(np.average((values - mean) ** 2, weights=weights))
        return (_extended(deviates, z, x) - mean) / sigma


def _extended(at: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Interpolate, and go on along the first and the last line."""
    inside = np.interp(at, x, y)
    first, last = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
    return inside + first * np.minimum(at - x[0], 0) + last * np.maximum(at - x[-1], 0)


class Masks(Strict):
    """A camera's fixed pattern as a pair of masks, each a file of the sensor's size.

    One multiplies the signal, the other is added to it (Short, Williams & Jones 1999, section 2.2).
    Files are .npy, .exr (one channel) or .tif; a path begins at the sensor file.

    Attributes
    ----------
    gain : str, optional
        Relative response of each pixel, of the light.
    offset_e : str, optional
        What is added to each pixel when it is read, electrons.
    area : (row, col, rows, cols), optional
        What the masks cover of the chip; by default what the sensor file describes.
    """

    gain: str | None = None
    offset_e: str | None = None
    area: tuple[int, int, int, int] | None = None

    _digests: dict[str, str] = PrivateAttr(default_factory=dict)  # of each mask's values

    @property
    def is_placed(self) -> bool:
        """Whether its files were found and read: `placed`."""
        return bool(self._digests)

    def placed(self, folder: Path, area: tuple[int, int, int, int]) -> Masks:
        """Return the masks with their files found and their size checked.

        Raises
        ------
        UserError
            A file that cannot be read, of another size, or with a wrong value.
        """
        area = self.area or area
        digests = {}
        paths = {
            name: str(folder / path)
            for name in ("gain", "offset_e")
            if (path := getattr(self, name)) is not None
        }
        for name, path in paths.items():
            plane = read_mask(path)
            digests[name] = _kept(plane)
            if plane.shape != area[2:]:
                raise UserError(
                    "the mask is not of the sensor's size",
                    file=path,
                    field=f"masks.{name}",
                    value=" x ".join(map(str, plane.shape)),
                    allowed=f"{area[2]} x {area[3]}, rows and columns",
                )
            if not np.isfinite(plane).all() or (name == "gain" and plane.min() < 0):
                raise UserError(
                    "the mask has values that are none",
                    file=path,
                    field=f"masks.{name}",
                    allowed="finite numbers" + ", none negative" * (name == "gain"),
                )
        placed = self.model_copy(update={**paths, "area": area})
        placed._digests = digests
        return placed

    def plane(self, name: str) -> np.ndarray:
        """Return a mask as it was when the sensor was loaded: (rows, cols), float32, read-only.

        Raises
        ------
        UserError
            It is read again, and its file has changed since.
        """
        path, digest = getattr(self, name), self._digests.get(name)
        if digest in _PLANES:
            return _PLANES[digest]
        plane = read_mask(path)
        if digest not in (None, _kept(plane)):
            raise UserError(
                "the mask has changed since the sensor was loaded",
                file=path,
                field=f"masks.{name}",
                allowed="the same values until the work is done",
            )
        return plane

    def part(self, name: str, origin: tuple[int, int], shape: tuple[int, int]) -> np.ndarray:
        """Return a mask on a rectangle of the chip: (rows, cols), float32.

        Beside the lit area, on the border, it changes nothing.
        """
        part = np.full(shape, 1 if name == "gain" else 0, np.float32)
        area = self.plane(name)
        into, of = [], []
        for first, count, start, size in zip(
            origin, shape, self.area[:2], self.area[2:], strict=True
        ):
            begin, end = max(first, start), min(first + count, start + size)
            into.append(slice(begin - first, max(end, begin) - first))
            of.append(slice(begin - start, max(end, begin) - start))
        part[tuple(into)] = area[tuple(of)]
        return part


# Masks by the digest of their values, the last ones used: a path may come to hold others.
_PLANES: OrderedDict[str, np.ndarray] = OrderedDict()
MOST_PLANES = 4


def _kept(plane: np.ndarray) -> str:
    """Keep a mask and return the digest of its shape and values."""
    digest = hashlib.sha256(repr(plane.shape).encode() + plane.tobytes()).hexdigest()
    _PLANES[digest] = plane
    _PLANES.move_to_end(digest)
    while len(_PLANES) > MOST_PLANES:
        _PLANES.popitem(last=False)
    return digest


def read_mask(path: str) -> np.ndarray:
    """Return the plane in a file: (rows, cols), float32, read-only.

    Raises
    ------
    UserError
        It cannot be read, or holds no plane.
    """
    try:
        match Path(path).suffix.lower():
            case ".npy":
                plane = read_npy(Path(path))
            case ".tif" | ".tiff":
                plane = read_tiff(Path(path))
            case ".exr":
                import OpenEXR

                with OpenEXR.File(path, separate_channels=True) as file:
                    (plane,) = (channel.pixels for channel in file.channels().values())
            case _:
                raise ValueError("unknown kind of file")
        if plane.dtype.kind not in "fiu":
            raise ValueError(f"values of type {plane.dtype}")
        plane = np.asarray(plane, np.float32)
        if plane.ndim != 2:
            raise ValueError(f"{plane.ndim} dimensions")
    except Exception as error:  # each library has its own
        raise UserError(
            f"the mask cannot be read: {error}",
            file=path,
            field="masks",
            allowed="one plane of numbers in a .npy, .exr or .tif file",
        ) from error
    plane.flags.writeable = False
    return plane


class DefectPixel(Strict):
    """One pixel that is not like the others.

    Attributes
    ----------
    row, col : int
        On the chip: ``first_row``, ``first_col`` are those of the first lit pixel.
    kind : str
        "dead": sees no light. "hot": more dark current. "stuck": gives the same always.
    value : float
        Electrons per second of a hot pixel beside the dark current, at the reference temperature;
        for a stuck one, the electrons that are read.
    """

    row: int = Field(ge=0)
    col: int = Field(ge=0)
    kind: Literal["dead", "hot", "stuck"]
    value: NotNegative | None = None

    @model_validator(mode="after")
    def _value_where_needed(self) -> DefectPixel:
        if (self.value is None) != (self.kind == "dead"):
            raise wrong(
                f"a {self.kind} pixel has {'no' if self.value is None else 'a'} value",
                "value for hot (e-/s) and stuck (e-), none for dead",
            )
        return self


class Defects(Strict):
    """Pixels that are not like the others: those of a list, and as many as a piece has by chance.

    Attributes
    ----------
    pixels : list of DefectPixel
    dead_fraction, hot_fraction, stuck_fraction : float
        Shares of all pixels. Which pixels they are depends on the serial number alone.
    hot_e_per_s : float
        Mean of the hot pixels' further dark current, which has an exponential law; at the reference
        temperature.
    """

    pixels: tuple[DefectPixel, ...] = Field(default=())
    dead_fraction: float = Field(default=0, ge=0, le=0.1)
    hot_fraction: float = Field(default=0, ge=0, le=0.1)
    stuck_fraction: float = Field(default=0, ge=0, le=0.1)
    hot_e_per_s: NotNegative = 0

    @model_validator(mode="after")
    def _each_once(self) -> Defects:
        for place, count in Counter((pixel.row, pixel.col) for pixel in self.pixels).items():
            if count > 1:
                raise wrong(f"pixel {place} is listed {count} times", "each row and col once")
        if self.hot_fraction > 0 and self.hot_e_per_s == 0:
            raise wrong("hot pixels have no dark current", "hot_e_per_s above 0")
        return self

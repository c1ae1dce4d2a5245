"""What a sensor file says of the read-out: gains, non-linearity, column offsets, dual gain."""

from __future__ import annotations

import math
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from gpusim.config.model import Strict, wrong
from gpusim.config.text import read_text
from gpusim.errors import UserError
from gpusim.sensor.strict import NotNegative, Positive

MAX_POINTS = 4096  # of a measured response
LINEAR_SHARES = (0.05, 0.95)  # of saturation, between which EMVA 1288 judges the linearity
LEVELS = 901  # between these; the fit leans on the lowest, so that a hundred give 1 % other figures


class GainStep(Strict):
    """One step of the analogue gain.

    Attributes
    ----------
    gain : float
        Factor by which ``system_gain_dn_per_e`` is multiplied.
    iso : int, optional
        What the camera calls it.
    temporal_dark_noise_e : float, optional
        At this gain, electrons; by default that of the sensor.
    """

    gain: Positive
    iso: int | None = Field(default=None, gt=0, le=65535)  # Exif holds 16 bits
    temporal_dark_noise_e: NotNegative | None = None


class Linearity(Strict):
    """A measured response: what the converter is given for the electrons of a pixel.

    It runs straight between its points, and on below the first and beyond the last: read noise
    takes the charge there.

    Attributes
    ----------
    electrons : list of float
        Collected, from 0 to the full well or beyond, rising.
    read_e : list of float, optional
        What is read of them, electrons, rising.
    deviation_percent : list of float, optional
        In place of that: by how much more is read, per cent.
    """

    electrons: tuple[NotNegative, ...] = Field(min_length=2, max_length=MAX_POINTS)
    read_e: tuple[float, ...] | None = None
    deviation_percent: tuple[float, ...] | None = None

    @model_validator(mode="after")
    def _monotone(self) -> Linearity:
        if (self.read_e is None) == (self.deviation_percent is None):
            raise wrong("the response has no or two columns", "read_e or deviation_percent")
        given = self.read_e if self.deviation_percent is None else self.deviation_percent
        if len(given) != len(self.electrons):
            raise wrong(
                "the columns of the response are of unlike length",
                f"{len(self.electrons)}, as electrons",
                value=f"{len(given)} values",
            )
        if self.electrons[0] != 0:
            raise wrong(
                "the response does not begin in the dark",
                "a first point at 0",
                field="electrons",
                value=self.electrons[0],
            )
        for name, values in (("electrons", self.electrons), ("what is read", self.response)):
            for before, value in pairwise(values):
                if value <= before:
                    raise wrong(
                        f"the response is not monotone: {name} goes from {before:g} to {value:g}",
                        "rising values",
                    )
        return self

    @cached_property
    def response(self) -> np.ndarray:
        """Electrons that are read at each point."""
        if self.deviation_percent is None:
            return np.array(self.read_e, float)
        return np.array(self.electrons) * (1 + np.array(self.deviation_percent) / 100)

    def read(self, electrons: np.ndarray) -> np.ndarray:
        """Return what is read of a charge, electrons."""
        return _straight(electrons, np.array(self.electrons), self.response)

    def collected(self, read_e: np.ndarray) -> np.ndarray:
        """Return the charge of which so much is read, electrons."""
        return _straight(read_e, self.response, np.array(self.electrons))

    def pieces(self) -> np.ndarray:
        """Return where each straight piece begins, what is read there, and its slope: (N, 3)."""
        start, read = np.array(self.electrons), self.response
        return np.stack([start[:-1], read[:-1], np.diff(read) / np.diff(start)], axis=1)

    def error_percent(self, saturation_e: float) -> tuple[float, float]:
        """Return least and largest deviation from a straight line (EMVA 1288 R3.1, section 6.7).

        The line is fitted to the response between 5 and 95 % of saturation, by least squares of
        the deviations relative to the response.
        """
        level = np.linspace(*(share * saturation_e for share in LINEAR_SHARES), LEVELS)
        response = self.read(level)
        columns = np.stack([np.ones(LEVELS), level], axis=1) / response[:, None]
        line = columns @ np.linalg.lstsq(columns, np.ones(LEVELS), rcond=None)[0] * response
        deviation = 100 * (response - line) / line
        return float(deviation.min()), float(deviation.max())


class ColumnOffset(Strict):
    """Offsets of the columns' converters: the same in every frame.

    Attributes
    ----------
    sigma_dn : float, optional
        Standard deviation between columns, DN: drawn, keyed by the sensor's serial number.
    offsets_dn : list of float, optional
        Or each column's own, DN, those of the optical black included. In a file ``file: NAME`` may
        stand for it: a number a line, and ``#`` before remarks.
    """

    sigma_dn: Positive | None = None
    offsets_dn: tuple[float, ...] | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, data: object, info: ValidationInfo) -> object:
        if not isinstance(data, dict) or "file" not in data:
            return data
        path = (info.context or {}).get("folder", Path()) / str(data["file"])
        rest = {name: value for name, value in data.items() if name != "file"}
        if "offsets_dn" in rest:
            raise wrong("both file and offsets_dn", "one or the other")
        return rest | {"offsets_dn": read_numbers(path)}

    @model_validator(mode="after")
    def _one(self) -> ColumnOffset:
        if (self.sigma_dn is None) == (self.offsets_dn is None):
            raise wrong("column offsets drawn as well as given, or neither", "sigma_dn, offsets_dn")
        return self


class DualGain(Strict):
    """The read at low conversion gain, beside the sensor's own, which is that at high gain.

    A pixel whose high-gain code lies below the switch keeps it, to the bit. The other pixels take
    the low-gain read, scaled to the high-gain line:
    ``black_level_dn + K_high / K_low (code_low - black_low)``, rounded. So the raw is linear, with
    codes beyond those of the converter.

    Attributes
    ----------
    system_gain_dn_per_e : float
        K of the low gain.
    temporal_dark_noise_e : float
    black_level_dn : float
    switch_dn : int
        Code of the high-gain read from which on the low-gain read counts.
    """

    system_gain_dn_per_e: Positive
    temporal_dark_noise_e: NotNegative
    black_level_dn: NotNegative
    switch_dn: int = Field(gt=0)


def read_numbers(path: Path) -> list[float]:
    """Read a number a line.

    Raises
    ------
    UserError
        The file cannot be read, or a line is no number.
    """
    lines = read_text(path, "the table").splitlines()
    numbers = []
    for place, line in enumerate(lines, start=1):
        if text := line.partition("#")[0].strip():
            try:
                numbers.append(float(text))
            except ValueError:
                numbers.append(math.nan)
            if not math.isfinite(numbers[-1]):
                raise UserError(
                    "a line of the table is no number",
                    file=path,
                    field=f"line {place}",
                    value=text,
                    allowed="a number a line: -0.35",
                )
    return numbers


def _straight(at: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Interpolate straight between points, and go straight on beyond them."""
    piece = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    slope = np.diff(y) / np.diff(x)
    return y[piece] + (at - x[piece]) * slope[piece]

"""The model of a sensor: what its data sheet says, in EMVA 1288's terms.

Symbols of EMVA Standard 1288, release 3.1 (European Machine Vision Association, 2016): system gain
K, temporal dark noise sigma_d, dark current mu_I, dark signal and photo response non-uniformity
DSNU and PRNU.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from functools import cached_property
from itertools import chain, pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import Field, ValidationError, field_validator, model_validator

from gpusim.errors import UserError
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.frame import Border, Frame
from gpusim.sensor.mistakes import read_yaml, user_error
from gpusim.sensor.strict import NotNegative, Positive, Strict, wrong

PRESETS = Path(__file__).resolve().parents[1] / "data" / "sensors"
# Red, green, blue, cyan, magenta, yellow, white (no filter): those that a DNG can name.
CFA_LETTERS = "RGBCMYW"
MAX_SIDE = 65535  # pixels
ABSOLUTE_ZERO_C = -273.15

Value = TypeVar("Value", float, np.ndarray)


class ColourFilterArray(Strict):
    """The filter pattern, from the upper left pixel: a channel for each photosite, row by row.

    A channel is a letter of :data:`CFA_LETTERS`, which is the colour of its filter, and may have
    more after it: Gr and Gb are green photosites of unlike response.
    """

    pattern: list[list[str]]

    @property
    def letters(self) -> list[list[str]]:
        """The pattern of the filters' colours."""
        return [[name[0] for name in row] for row in self.pattern]

    @field_validator("pattern")
    @classmethod
    def _rectangle_of_letters(cls, pattern: list[list[str]]) -> list[list[str]]:
        if not pattern or not pattern[0] or any(len(row) != len(pattern[0]) for row in pattern):
            raise wrong("the pattern is no rectangle", "rows of equal length: [[R, G], [G, B]]")
        for name in chain(*pattern):
            if name[:1] not in tuple(CFA_LETTERS):
                raise wrong(f"unknown filter colour {name!r}", ", ".join(CFA_LETTERS))
        return pattern


class QuantumEfficiency(Strict):
    """Quantum efficiency of each channel, filters included, on a wavelength grid of its own."""

    wavelengths_nm: list[Positive]
    channels: dict[str, list[NotNegative]]

    @model_validator(mode="after")
    def _on_one_grid(self) -> QuantumEfficiency:
        grid = self.wavelengths_nm
        if any(b <= a for a, b in pairwise(grid)):
            raise wrong("the wavelengths do not rise", "nm, each more than the one before")
        first, last = WAVELENGTHS_NM[[0, -1]]
        if not grid or grid[0] > first or grid[-1] < last:
            raise wrong("the wavelengths end too soon", f"{first:g} to {last:g} nm, or beyond")
        for name, curve in self.channels.items():
            if len(curve) != len(grid):
                raise wrong(
                    f"channel {name} has {len(curve)} values", f"{len(grid)}, as wavelengths"
                )
            if not np.interp(WAVELENGTHS_NM, grid, curve).any():
                raise wrong(
                    f"channel {name} sees nothing",
                    f"values above 0 between {first:g} and {last:g} nm",
                    field=f"channels.{name}",
                )
            if (most := max(curve)) > 1:
                at = grid[curve.index(most)]
                warnings.warn(
                    f"the quantum efficiency of {name} exceeds 1: {most:g} at {at:g} nm",
                    stacklevel=2,
                )
        return self


class Sensor(Strict):
    """A sensor, or a region of one.

    Attributes
    ----------
    name : str
    serial_number : int
        Which piece of this type: it keys the fixed pattern (PRNU, DSNU).
    rows, cols : int
        Pixels that see light.
    first_row, first_col : int
        Where these begin on the chip; multiples of the filter pattern.
    pixel_pitch_um : float
    fill_factor : float
        Area of the square pixel aperture over that of the pixel.
    cfa : ColourFilterArray
    quantum_efficiency : QuantumEfficiency
        Electrons per incident photon, filters included. See :attr:`qe`.
    system_gain_dn_per_e : float
        K, DN per electron.
    black_level_dn : float
    bit_depth : int
    full_well_e : float
        Saturation capacity, electrons.
    temporal_dark_noise_e : float
        sigma_d, electrons.
    dark_current_e_per_s : float
        mu_I at ``reference_temperature_c``, electrons per second and pixel.
    reference_temperature_c : float
    doubling_temperature_c : float
        Rise of temperature that doubles the dark current, kelvin.
    dsnu_e : float
        Standard deviation of the fixed offset between pixels, electrons.
    prnu_percent : float
        Standard deviation of the response between pixels, per cent of the signal.
    veiling_glare : float
        Uniform light in the image over its mean, 0..1.
    optical_black : Border, optional
        Pixels around those, shielded from light, which are read out with them: whole filter
        patterns above and to the left, for the pattern goes on there. A region (`roi`) keeps the
        border, as wide, around itself.
    sources : dict of str to str
        Where each figure comes from, by field.
    """

    name: str
    serial_number: int = Field(default=0, ge=0, lt=2**64)
    rows: int = Field(ge=1, le=MAX_SIDE)
    cols: int = Field(ge=1, le=MAX_SIDE)
    first_row: int = Field(default=0, ge=0, le=MAX_SIDE)
    first_col: int = Field(default=0, ge=0, le=MAX_SIDE)
    pixel_pitch_um: Positive
    fill_factor: float = Field(gt=0, le=1)
    cfa: ColourFilterArray
    quantum_efficiency: QuantumEfficiency
    system_gain_dn_per_e: Positive
    black_level_dn: NotNegative
    bit_depth: int = Field(ge=1, le=16)
    full_well_e: float = Field(gt=0, le=1e7)
    temporal_dark_noise_e: NotNegative
    dark_current_e_per_s: NotNegative
    reference_temperature_c: float = Field(gt=ABSOLUTE_ZERO_C)
    doubling_temperature_c: Positive
    dsnu_e: NotNegative
    prnu_percent: float = Field(ge=0, le=100)
    veiling_glare: float = Field(ge=0, lt=1)
    optical_black: Border | None = None
    sources: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> Sensor:
        letters, curves = set(self.site_channels()), set(self.quantum_efficiency.channels)
        if letters != curves:
            raise wrong(
                f"the filter pattern has {', '.join(sorted(letters))}, "
                f"quantum_efficiency has {', '.join(sorted(curves))}",
                "the same channels in both",
                field="cfa.pattern",
            )
        if self.black_level_dn >= self.max_dn:
            raise wrong(
                "the black level leaves no range",
                f"below {self.max_dn} (DN)",
                field="black_level_dn",
                value=self.black_level_dn,
            )
        black, (down, across) = self.optical_black, self.period
        if black and (black.top % down or black.left % across):
            raise wrong(
                f"optical_black has {black.top} rows above and {black.left} columns to the left",
                f"multiples of {down} and {across}, as the filter pattern",
            )
        if unknown := set(self.sources) - set(type(self).model_fields):
            raise wrong(
                f"sources names no field: {', '.join(sorted(unknown))}",
                "fields of this file",
                field="sources",
            )
        return self

    @property
    def max_dn(self) -> int:
        """Highest code of the analogue-to-digital converter, DN."""
        return 2**self.bit_depth - 1

    @property
    def frame(self) -> Frame:
        """The areas that are read out."""
        lit = (0, 0, self.rows, self.cols)
        pixels = lit if self.optical_black is None else self.optical_black.around(lit)
        return Frame(lit, pixels, pixels)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels, by the colours of their filters in the order of :data:`CFA_LETTERS`."""
        return tuple(
            sorted(
                self.quantum_efficiency.channels,
                key=lambda name: (CFA_LETTERS.index(name[0]), name),
            )
        )

    @property
    def period(self) -> tuple[int, int]:
        """Rows and columns of the filter pattern."""
        return len(self.cfa.pattern), len(self.cfa.pattern[0])

    def site_channels(self) -> tuple[str, ...]:
        """Return the channel of each site of the filter pattern, row by row."""
        return tuple(chain(*self.cfa.pattern))

    @cached_property
    def qe(self) -> dict[str, np.ndarray]:
        """Quantum efficiency of each channel at ``WAVELENGTHS_NM``: (61,), read-only."""
        measured = self.quantum_efficiency
        curves = {}
        for name in self.channels:
            curves[name] = np.interp(
                WAVELENGTHS_NM, measured.wavelengths_nm, measured.channels[name]
            )
            curves[name].flags.writeable = False
        return curves

    @property
    def colour_qe(self) -> dict[str, np.ndarray]:
        """Mean quantum efficiency of the photosites of each filter colour, by letter: (61,)."""
        return self.by_colour(self.qe)

    def by_colour(self, of_channel: Mapping[str, Value]) -> dict[str, Value]:
        """Return the mean over the photosites of each filter colour, by letter."""
        sites = self.site_channels()
        return {
            letter: np.mean([of_channel[name] for name in sites if name[0] == letter], axis=0)
            for letter in dict.fromkeys(name[0] for name in self.channels)
        }

    def dark_current_at(self, temperature_c: float) -> float:
        """Return the dark current at a temperature, electrons per second (EMVA 1288, section 3.2).

        Parameters
        ----------
        temperature_c : float
            Temperature of the sensor, degrees Celsius.

        Raises
        ------
        UserError
            Not a temperature above absolute zero.
        """
        if not ABSOLUTE_ZERO_C < temperature_c < math.inf:
            raise UserError(
                "not a temperature of a sensor",
                field="temperature_c",
                value=temperature_c,
                allowed=f"above {ABSOLUTE_ZERO_C} degrees Celsius",
            )
        rise = temperature_c - self.reference_temperature_c
        return self.dark_current_e_per_s * 2 ** (rise / self.doubling_temperature_c)

    def roi(self, rows: int, cols: int) -> Sensor:
        """Return the region of rows x cols pixels about the centre.

        It begins on a whole filter pattern, so that the phase of the pattern is kept: less than
        one pattern above and to the left of the central position.

        Raises
        ------
        UserError
            Larger than the sensor, or without a pixel.
        """
        for field, wanted, available in (("rows", rows, self.rows), ("cols", cols, self.cols)):
            if not 1 <= wanted <= available:
                raise UserError(
                    f"the region does not fit the sensor {self.name}",
                    field=field,
                    value=wanted,
                    allowed=f"1 to {available}",
                )
        (first_row, first_col), (py, px) = (self.rows - rows, self.cols - cols), self.period
        return self.model_copy(
            update={
                "rows": rows,
                "cols": cols,
                "first_row": self.first_row + first_row // 2 // py * py,
                "first_col": self.first_col + first_col // 2 // px * px,
            }
        )

    def cut(self, row: int, col: int) -> Sensor:
        """Return this sensor with a filter pattern that begins at a pixel, for files of a part."""
        rows = [
            line[col % self.period[1] :] + line[: col % self.period[1]] for line in self.cfa.pattern
        ]
        first = row % self.period[0]
        pattern = ColourFilterArray(pattern=rows[first:] + rows[:first])
        return self.model_copy(update={"cfa": pattern})


def presets() -> list[str]:
    """Return the names of the sensors that come with the package."""
    return sorted(path.stem for path in PRESETS.glob("*.yaml"))


def load_sensor(name_or_path: str | Path) -> Sensor:
    """Load a sensor file, or a preset by its name.

    Raises
    ------
    UserError
        Unknown preset; a file that cannot be read or is no YAML; a wrong field.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = PRESETS / f"{name_or_path}.yaml"
        if not path.exists():
            raise UserError(
                "there is no sensor of that name",
                field="sensor",
                value=name_or_path,
                allowed=f"a .yaml file, or one of: {', '.join(presets())}",
            )
    data = read_yaml(path)
    try:
        return Sensor.model_validate(data)
    except ValidationError as error:
        raise user_error(error, Sensor, path) from error

"""A sensor: its gains, its areas, its colours and its temperature, of what its data sheet says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import ValidationInfo, model_validator

from gpusim.config.model import Fixed, wrong
from gpusim.errors import UserError
from gpusim.known import Known
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.adc_model import GainStep
from gpusim.sensor.aperture import Response, response_of
from gpusim.sensor.cfa import CFA_LETTERS, ColourFilterArray
from gpusim.sensor.checks import check_fields
from gpusim.sensor.datasheet import ABSOLUTE_ZERO_C, DataSheet
from gpusim.sensor.effects import NOISE, running
from gpusim.sensor.eqe_model import read_eqe
from gpusim.sensor.filters_model import passed
from gpusim.sensor.frame import Frame, Overscan
from gpusim.sensor.misregistration import mixed

# What a step of the analogue gain changes: all of it acts when the charge is read.
OF_GAIN = ("analogue_gain", "system_gain_dn_per_e", "temporal_dark_noise_e")
HOTTEST_C = 200.0  # silicon conducts by itself well above; the doubling of dark current ends before

Value = TypeVar("Value", float, np.ndarray)


class Sensor(DataSheet):
    """A sensor, or a region of one: the figures of its data sheet, and what follows from them.

    The figures are listed with `gpusim.sensor.datasheet.DataSheet`.
    """

    @model_validator(mode="before")
    @classmethod
    def _with_map(cls, data: object, info: ValidationInfo) -> object:
        """Read the map of the quantum efficiency; at normal incidence it is the one without."""
        given = data.get("eqe_map") if isinstance(data, dict) else None
        if not isinstance(given, dict) or "channels" in given or "file" not in given:
            return data
        if given.keys() != {"file"} or "quantum_efficiency" in data:
            raise wrong(
                "eqe_map gives the quantum efficiency, and something else does",
                "eqe_map: {file: NAME.json} without quantum_efficiency",
                field="eqe_map",
            )
        path = (info.context or {}).get("folder", Path()) / str(given["file"])
        found = read_eqe(path)
        return data | {"eqe_map": found, "quantum_efficiency": found.at_normal_incidence()}

    @model_validator(mode="after")
    def _consistent(self, info: ValidationInfo) -> Sensor:
        """Check the fields against each other; mix shifted filters, and find the masks' files."""
        check_fields(self)
        # Validation may not return another model: what these two change is put into this one.
        self.__dict__.update(mixed(self).__dict__)
        if self.masks is not None and not self.masks.is_placed:
            folder = (info.context or {}).get("folder", Path())
            area = (self.first_row, self.first_col, self.rows, self.cols)
            self.__dict__["masks"] = self.masks.placed(folder, area)
        return self

    def __repr__(self) -> str:
        return (
            f"Sensor({self.name!r}, {self.cols} x {self.rows} pixels of "
            f"{self.pixel_pitch_um:g} um, {self.bit_depth} bit, full well {self.full_well_e:g} e-)"
        )

    __str__ = __repr__

    @property
    def response_um(self) -> float | Response:
        """Side of the square pixel aperture, um; or the response in space of any other."""
        if self.aperture is None and self.scan_motion_px is None:
            return self.pixel_pitch_um * math.sqrt(self.fill_factor)
        in_pixels = response_of(self.aperture, self.fill_factor, self.scan_motion_px)
        return in_pixels / (1 / self.pixel_pitch_um)

    @property
    def max_dn(self) -> int:
        """Highest code of the analogue-to-digital converter, DN."""
        return 2**self.bit_depth - 1

    @property
    def raw_max_dn(self) -> int:
        """Highest code of the raw, DN: that of the converter, or of the merged reads."""
        if (dual := self.dual_gain) is None:
            return self.max_dn
        ratio = self.system_gain_dn_per_e / dual.system_gain_dn_per_e
        return math.floor(self.black_level_dn + ratio * (self.max_dn - dual.black_level_dn) + 0.5)

    @property
    def saturation_e(self) -> float:
        """Electrons at which a pixel saturates: its full well, or where the converter clips."""
        clipped = (self.raw_max_dn - self.black_level_dn) / self.system_gain_dn_per_e
        if self.linearity is not None:
            clipped = float(self.linearity.collected(clipped))
        return min(self.full_well_e, clipped)

    @property
    def site_black_dn(self) -> tuple[float, ...]:
        """Black level of each site of the filter pattern, row by row, DN."""
        given = self.channel_black_level_dn or {}
        return tuple(given.get(name, self.black_level_dn) for name in self.site_channels())

    @property
    def iso(self) -> int | None:
        """What the camera calls its gain, if the file says so."""
        steps = (step.iso for step in self.analogue_gains if step.gain == self.analogue_gain)
        return next(steps, None)

    def at_gain(self, gain: float) -> Sensor:
        """Return the sensor at a step of its analogue gain.

        The system gain is multiplied; full well and all else in electrons stays, so that the
        converter clips at fewer of them. The temporal dark noise is the step's, where it has one.

        Raises
        ------
        UserError
            The file lists no such step.
        """
        steps = {step.gain: step for step in self.analogue_gains} or {1.0: GainStep(gain=1.0)}
        if gain not in steps or self.analogue_gain != 1:
            listed = ", ".join(f"{known:g}" for known in steps)
            raise UserError(
                f"the sensor {self.name} has no such step of its analogue gain",
                field="gain",
                value=gain,
                allowed=listed if self.analogue_gain == 1 else f"none: at {self.analogue_gain:g}",
            )
        noise_e = steps[gain].temporal_dark_noise_e
        return self.model_copy(
            update={
                "analogue_gain": gain,
                "system_gain_dn_per_e": gain * self.system_gain_dn_per_e,
                "temporal_dark_noise_e": self.temporal_dark_noise_e if noise_e is None else noise_e,
            }
        )

    def at_iso(self, iso: int) -> Sensor:
        """Return the sensor at the step of its analogue gain that has this ISO speed.

        Raises
        ------
        UserError
            The file lists no such step.
        """
        steps = {step.iso: step for step in self.analogue_gains if step.iso is not None}
        if iso not in steps:
            raise UserError(
                f"the sensor {self.name} has no such ISO speed",
                field="iso",
                value=iso,
                allowed=", ".join(map(str, steps)) or "none: its file lists no speeds; see --gain",
            )
        return self.at_gain(steps[iso].gain)

    def collects_as(self, other: Sensor) -> bool:
        """Return whether it is the same sensor, or another step of its gain: see `at_gain`."""
        return other is self or all(
            getattr(self, name) is getattr(other, name)
            for name in type(self).model_fields
            if name not in OF_GAIN
        )

    def at_low_gain(self) -> Sensor:
        """Return the sensor as it reads at the low gain of two.

        Examples
        --------
        >>> import gpusim as gs
        >>> low = {
        ...     "system_gain_dn_per_e": 0.04, "temporal_dark_noise_e": 12.0,
        ...     "black_level_dn": 256.0, "switch_dn": 3800.0,
        ... }
        >>> two = {"analogue_gains": (), "dual_gain": low}
        >>> gs.Sensor.load("imx477").model_copy(update=two).at_low_gain().system_gain_dn_per_e
        0.04
        """
        dual = self.dual_gain
        return self.model_copy(
            update={
                "system_gain_dn_per_e": dual.system_gain_dn_per_e,
                "temporal_dark_noise_e": dual.temporal_dark_noise_e,
                "black_level_dn": dual.black_level_dn,
                "dual_gain": None,
            }
        )

    @property
    def frame(self) -> Frame:
        """The areas that are read out."""
        lit = (0, 0, self.rows, self.cols)
        pixels = lit if self.optical_black is None else self.optical_black.around(lit)
        after = self.overscan or Overscan()
        row, col, rows, cols = pixels
        return Frame(lit, pixels, (row, col, rows + after.rows, cols + after.cols))

    @property
    def is_ccd(self) -> bool:
        """Whether charge is shifted through other pixels on its way to the read-out."""
        parts = (self.overscan, self.smear, self.parallel_cti, self.serial_cti)
        return self.bloom or any(part is not None for part in parts)

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
    def qe(self) -> Fixed[str, np.ndarray]:
        """Quantum efficiency of each channel at ``WAVELENGTHS_NM``: (61,), read-only.

        With the filters in front of the sensor.
        """
        curves = self.qe_at(WAVELENGTHS_NM)
        for curve in curves.values():
            curve.flags.writeable = False
        return Fixed(curves)

    def qe_at(self, wavelengths_nm: np.ndarray) -> dict[str, np.ndarray]:
        """Return the same at wavelengths (K,), beyond `known` as at its ends."""
        measured, light = self.quantum_efficiency, passed(self.filters, wavelengths_nm)
        return {
            name: light * np.interp(wavelengths_nm, measured.wavelengths_nm, curve)
            for name, curve in ((one, measured.channels[one]) for one in self.channels)
        }

    @property
    def known(self) -> tuple[Known, ...]:
        """Over which wavelengths quantum efficiency and filters are known."""
        own = self.quantum_efficiency.wavelengths_nm
        return (
            Known("the sensor's quantum efficiency", own[0], own[-1]),
            *(
                Known(f"filter {one.name}", one.wavelengths_nm[0], one.wavelengths_nm[-1])
                for one in self.filters
            ),
        )

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

    @property
    def effects(self) -> frozenset[str]:
        """What of noise and fixed patterns this sensor has, by the names of the plan."""
        return running(self) - running(self, noise=False) - {NOISE.name}

    def lit_place(self, origin: tuple[int, int]) -> tuple[int, int]:
        """Return where a pixel lies on the chip's lit area, by row and col, for files that list it.

        ``origin`` counts from the first pixel that is read, and the border comes before the lit
        area: there numbers are below those of the first lit pixel.
        """
        row, col = self.frame.read[:2]
        return origin[0] + row + self.first_row, origin[1] + col + self.first_col

    def dark_current_factor(self, temperature_c: float | None) -> float:
        """Return the dark current at a temperature over that at the reference temperature.

        It doubles with each ``doubling_temperature_c`` (EMVA 1288, section 3.2).

        Parameters
        ----------
        temperature_c : float or None
            Temperature of the sensor, degrees Celsius; None: the reference temperature.

        Raises
        ------
        UserError
            Not a temperature above absolute zero.
        """
        rise = self._checked(temperature_c) - self.reference_temperature_c
        return 2 ** (rise / self.doubling_temperature_c)

    def dark_current_at(self, temperature_c: float | None) -> float:
        """Return the dark current at a temperature, electrons per second: see above."""
        return self.dark_current_e_per_s * self.dark_current_factor(temperature_c)

    def reset_noise_at(self, temperature_c: float | None) -> float:
        """Return the reset noise at a temperature, electrons; 0 where there is none."""
        known = self._checked(temperature_c)
        return 0.0 if self.reset_noise is None else self.reset_noise.at(known)

    def _checked(self, temperature_c: float | None) -> float:
        """Return a temperature of the sensor, degrees Celsius; None: the reference temperature."""
        if temperature_c is None:
            return self.reference_temperature_c
        if not ABSOLUTE_ZERO_C < temperature_c <= HOTTEST_C:
            raise UserError(
                "not a temperature of a sensor",
                field="temperature_c",
                value=temperature_c,
                allowed=f"above {ABSOLUTE_ZERO_C}, up to {HOTTEST_C:g} degrees Celsius",
            )
        return temperature_c

    def roi(self, rows: int, cols: int) -> Sensor:
        """Return the region of rows x cols pixels about the centre.

        It begins on a whole filter pattern, so that the phase of the pattern is kept: less than
        one pattern above and to the left of the central position.

        Raises
        ------
        UserError
            Larger than the sensor, or without a pixel.

        Examples
        --------
        >>> import gpusim as gs
        >>> part = gs.Sensor.load("imx477").roi(480, 640)
        >>> part.rows, part.cols, part.first_row % 2
        (480, 640, 0)
        """
        for field, wanted, available in (("rows", rows, self.rows), ("cols", cols, self.cols)):
            if not 1 <= wanted <= available:
                raise UserError(
                    f"the region does not fit the sensor {self.name}",
                    field=field,
                    value=wanted,
                    allowed=f"1 to {available}",
                )
        (above, left), (py, px) = (self.rows - rows, self.cols - cols), self.period
        first_row = self.first_row + above // 2 // py * py
        first_col = self.first_col + left // 2 // px * px
        part = {"rows": rows, "cols": cols, "first_row": first_row, "first_col": first_col}
        # Lists of the chip's pixels and columns end with the region: what lies beyond is not read.
        if self.defects is not None:
            inside = range(first_row, first_row + rows), range(first_col, first_col + cols)
            pixels = [one for one in self.defects.pixels if one.row in inside[0]]
            pixels = tuple(one for one in pixels if one.col in inside[1])
            part["defects"] = self.defects.model_copy(update={"pixels": pixels})
        if self.column_offset is not None and self.column_offset.offsets_dn is not None:
            read = first_col + cols + self.frame.read[3] - self.cols
            offsets_dn = self.column_offset.offsets_dn[:read]
            part["column_offset"] = self.column_offset.model_copy(update={"offsets_dn": offsets_dn})
        return self.model_copy(update=part)

    def cut(self, row: int, col: int) -> Sensor:
        """Return this sensor with a filter pattern that begins at a pixel, for files of a part."""
        rows = [
            line[col % self.period[1] :] + line[: col % self.period[1]] for line in self.cfa.pattern
        ]
        first = row % self.period[0]
        pattern = ColourFilterArray(pattern=rows[first:] + rows[:first])
        return self.unchecked(cfa=pattern)  # the same filters, as right as before

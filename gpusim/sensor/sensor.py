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
from itertools import chain
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from gpusim.errors import UserError
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.adc_model import ColumnOffset, DualGain, GainStep, Linearity
from gpusim.sensor.aperture import AREA_ROUNDING, Aperture, Response
from gpusim.sensor.crosstalk_model import Crosstalk
from gpusim.sensor.cti_model import Cti
from gpusim.sensor.eqe_model import EqeMap, MicroLens, read_eqe
from gpusim.sensor.filters_model import Filter, passed
from gpusim.sensor.frame import Border, Frame, Overscan
from gpusim.sensor.misregistration import mixed_pattern
from gpusim.sensor.mistakes import read_yaml, user_error
from gpusim.sensor.noise_model import Defects, LineNoise, Masks, ReadNoiseLaw, ResetNoise
from gpusim.sensor.smear_model import Smear
from gpusim.sensor.strict import NotNegative, Positive, Strict, check_grid, wrong

PRESETS = Path(__file__).resolve().parents[1] / "data" / "sensors"
# Red, green, blue, cyan, magenta, yellow, white (no filter): those that a DNG can name.
CFA_LETTERS = "RGBCMYW"
# By the names under which they are known; W is what RCCB and RCCC call C, clear.
PATTERNS = {
    "RGGB": ("RG", "GB"),
    "BGGR": ("BG", "GR"),
    "GRBG": ("GR", "BG"),
    "GBRG": ("GB", "RG"),
    "RCCB": ("RW", "WB"),
    "RCCC": ("RW", "WW"),
    "RGBW": ("RG", "BW"),
    "quad Bayer": ("RRGG", "RRGG", "GGBB", "GGBB"),
    "X-Trans": ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG"),
    "monochrome": ("W",),
}
MAX_CHANNELS = 16  # that the shaders tell apart
MAX_SIDE = 65535  # pixels
MAX_MOTION_PX = 4
ABSOLUTE_ZERO_C = -273.15
MAX_RAW_DN = 65535  # raw files hold 16 bits

Value = TypeVar("Value", float, np.ndarray)


class ColourFilterArray(Strict):
    """The filter pattern, from the upper left pixel: a channel for each photosite, row by row.

    A channel is a letter of :data:`CFA_LETTERS`, which is the colour of its filter, and may have
    more after it: Gr and Gb are green photosites of unlike response. A file may also give one of
    the names of :data:`PATTERNS`, in which C is clear: a photosite without a filter, W.

    Attributes
    ----------
    pattern : list of list of str
    shift_px : (float, float)
        x, y by which the filters lie to the right of their pixels, and below, pixels. What is
        loaded from a file has the mixtures that its pixels then see: see :meth:`Sensor.mixed`.
    """

    pattern: list[list[str]]
    shift_px: tuple[float, float] = (0.0, 0.0)

    @field_validator("pattern", mode="before")
    @classmethod
    def _by_name(cls, pattern: object) -> object:
        if not isinstance(pattern, str):
            return pattern
        if pattern not in PATTERNS:
            raise wrong(f"there is no pattern {pattern!r}", f"a table, or {', '.join(PATTERNS)}")
        return [list(row) for row in PATTERNS[pattern]]

    @field_validator("shift_px")
    @classmethod
    def _within_a_pixel(cls, shift: tuple[float, float]) -> tuple[float, float]:
        if max(map(abs, shift)) > 1:
            raise wrong("the filters are shifted by more than a pixel", "x, y from -1 to 1 pixel")
        return shift

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
        check_grid(grid)
        first, last = WAVELENGTHS_NM[[0, -1]]
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
        Electrons per incident photon, filters included; at normal incidence. See :attr:`qe`.
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
    analogue_gain : float
        At which the figures hold.
    analogue_gains : list of GainStep
        The steps that there are: see :meth:`at_gain`.
    linearity : Linearity, optional
        Measured response of the read-out.
    channel_black_level_dn : dict of str to float, optional
        Of the channels whose black level is another than ``black_level_dn``.
    column_offset : ColumnOffset, optional
        Fixed offsets of the columns' converters.
    dual_gain : DualGain, optional
        A second read of the same charge at a lower gain, for a higher dynamic range; the other
        figures are those of the read at high gain.
    optical_black : Border, optional
        Pixels around those, shielded from light, which are read out with them: whole filter
        patterns above and to the left, for the pattern goes on there. A region (`roi`) keeps the
        border, as wide, around itself.
    overscan : Overscan, optional
        Of a CCD, rows and columns that are read after the last ones: see `gpusim.sensor.ccd`.
    smear : Smear, optional
        Of a CCD, light that is collected while charge is shifted.
    bloom : bool
        Whether a CCD has no anti-blooming: charge above the full well then flows along the column.
    parallel_cti, serial_cti : Cti, optional
        Of a CCD, charge that is left behind along columns and along rows.
    dcnu_percent : float
        Standard deviation of the dark current between pixels, per cent of its mean; log-normal.
    full_well_knee : float
        Share of the full well from which on it fills ever more slowly, 0..1; 1: a hard limit.
    lines : LineNoise, optional
        What rows and columns have in common, fixed and temporal.
    reset_noise : ResetNoise, optional
    read_noise_law : ReadNoiseLaw, optional
        The shape of the temporal dark noise, where it is not normal.
    gaussian_variance_per_e : float, optional
        Temporal noise by two numbers in place of Poisson's law and read noise: normal, its variance
        the square of ``temporal_dark_noise_e`` and this for each electron of the signal.
    masks : Masks, optional
        A fixed pattern from files.
    defects : Defects, optional
        Dead, hot and stuck pixels.
    crosstalk : Crosstalk, optional
        Shares of the signal that are found at other pixels.
    eqe_map : EqeMap, optional
        Quantum efficiency by wavelength and angle, in place of ``quantum_efficiency``: in a file
        ``{file: NAME.json}``, see ``gpusim.sensor.eqe_model``.
    micro_lens : MicroLens, optional
        Their shift over the field, with ``eqe_map``.
    filters : list of Filter
        In front of the sensor, where ``quantum_efficiency`` does not include them.
    aperture : Aperture, optional
        What of the pixel sees light, where it is no square in its middle; ``fill_factor`` is its
        area.
    scan_motion_px : (float, float), optional
        x, y by which the image moves over the sensor while a pixel of a scanning system is
        exposed, pixels: the middle of the way is where it stands still in other sensors.
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
    analogue_gain: Positive = 1.0
    analogue_gains: list[GainStep] = Field(default=[])
    linearity: Linearity | None = None
    channel_black_level_dn: dict[str, NotNegative] | None = None
    column_offset: ColumnOffset | None = None
    dual_gain: DualGain | None = None
    optical_black: Border | None = None
    overscan: Overscan | None = None
    smear: Smear | None = None
    bloom: bool = False
    parallel_cti: Cti | None = None
    serial_cti: Cti | None = None
    dcnu_percent: NotNegative = 0
    full_well_knee: float = Field(default=1, gt=0, le=1)
    lines: LineNoise | None = None
    reset_noise: ResetNoise | None = None
    read_noise_law: ReadNoiseLaw | None = None
    gaussian_variance_per_e: NotNegative | None = None
    masks: Masks | None = None
    defects: Defects | None = None
    crosstalk: Crosstalk | None = None
    eqe_map: EqeMap | None = None
    micro_lens: MicroLens | None = None
    filters: list[Filter] = Field(default_factory=list)
    aperture: Aperture | None = None
    scan_motion_px: tuple[float, float] | None = None
    sources: dict[str, str] = Field(default_factory=dict)

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
    def _consistent(self) -> Sensor:
        letters, curves = set(self.site_channels()), set(self.quantum_efficiency.channels)
        if self.eqe_map is not None and set(self.eqe_map.channels) != letters:
            raise UserError(
                "the channels are not those of the filter pattern",
                file=self.eqe_map.file,
                field="channels",
                value=", ".join(sorted(self.eqe_map.channels)),
                allowed=", ".join(sorted(letters)),
            )
        if letters != curves:
            raise wrong(
                f"the filter pattern has {', '.join(sorted(letters))}, "
                f"quantum_efficiency has {', '.join(sorted(curves))}",
                "the same channels in both",
                field="cfa.pattern",
            )
        if len(curves) > MAX_CHANNELS:
            raise wrong(
                "there are too many channels",
                f"{MAX_CHANNELS} at most",
                field="quantum_efficiency.channels",
                value=len(curves),
            )
        if self.micro_lens is not None and self.eqe_map is None:
            raise wrong(
                "micro_lens shifts what no eqe_map gives",
                "both, or neither",
                field="micro_lens",
            )
        if self.black_level_dn >= self.max_dn:
            raise wrong(
                "the black level leaves no range",
                f"below {self.max_dn} (DN)",
                field="black_level_dn",
                value=self.black_level_dn,
            )
        self._check_read_out()
        black, (down, across) = self.optical_black, self.period
        if black and (black.top % down or black.left % across):
            raise wrong(
                f"there are {black.top} rows above and {black.left} columns to the left",
                f"multiples of {down} and {across}, as the filter pattern",
                field="optical_black",
            )
        if self.gaussian_variance_per_e is not None:
            for field in ("read_noise_law", "dual_gain"):
                if getattr(self, field) is not None:
                    raise wrong(
                        f"{field} gives a read noise that gaussian_variance_per_e replaces",
                        "one of the two",
                    )
        for pixel in self.defects.pixels if self.defects else ():
            row, col = pixel.row - self.first_row, pixel.col - self.first_col
            if not (0 <= row < self.rows and 0 <= col < self.cols):
                raise wrong(
                    f"the defect pixel {pixel.row}, {pixel.col} lies beside the sensor",
                    f"rows from {self.first_row}, {self.rows} of them; columns from "
                    f"{self.first_col}, {self.cols} of them",
                )
        shifts = (self.overscan, self.smear, self.parallel_cti, self.serial_cti)
        if self.crosstalk and (self.bloom or any(one is not None for one in shifts)):
            raise wrong(
                "cross-talk is simulated of sensors that do not shift their charge",
                "no overscan, smear, bloom or cti beside it",
                field="crosstalk",
            )
        if self.aperture and abs(self.aperture.area / self.fill_factor - 1) > AREA_ROUNDING:
            raise wrong(
                "the aperture has another area than the fill factor says",
                f"{self.aperture.area:.4g}",
                field="fill_factor",
                value=self.fill_factor,
            )
        if self.scan_motion_px and math.hypot(*self.scan_motion_px) > MAX_MOTION_PX:
            raise wrong(
                "the image moves too far while a pixel is exposed",
                f"{MAX_MOTION_PX} pixels at most",
                field="scan_motion_px",
            )
        for kind in ("optical", "electrical"):
            if self.crosstalk and (kernels := getattr(self.crosstalk, kind)):
                kernels.check(f"crosstalk.{kind}", self.cfa.pattern)
        if unknown := set(self.sources) - set(type(self).model_fields):
            raise wrong(
                f"sources names no field: {', '.join(sorted(unknown))}",
                "fields of this file",
                field="sources",
            )
        return self

    def _check_read_out(self) -> None:
        """Refuse what does not fit in the figures of the converter."""
        for name, level in (self.channel_black_level_dn or {}).items():
            if name not in self.site_channels():
                raise wrong(
                    "the filter pattern has no such channel",
                    ", ".join(self.channels),
                    field="channel_black_level_dn",
                    value=name,
                )
            if level >= self.max_dn:
                raise wrong(
                    "the black level leaves no range",
                    f"below {self.max_dn} (DN)",
                    field=f"channel_black_level_dn.{name}",
                    value=level,
                )
        if self.linearity and self.linearity.electrons[-1] < self.full_well_e:
            raise wrong(
                "the response ends before the full well",
                f"a last point at {self.full_well_e:g} electrons or beyond",
                field="linearity.electrons",
                value=self.linearity.electrons[-1],
            )
        given = self.column_offset and self.column_offset.offsets_dn
        columns = self.first_col + self.frame.read[3]
        if given is not None and len(given) != columns:
            raise wrong(
                f"there are offsets of {len(given)} columns",
                f"{columns}, one for each column that is read",
                field="column_offset.offsets_dn",
                value=f"{len(given)} values",
            )
        if self.bloom and self.full_well_knee < 1:
            raise wrong(
                "a soft full well where charge blooms",
                "1, or no bloom",
                field="full_well_knee",
                value=self.full_well_knee,
            )
        if self.dual_gain and self.is_ccd:
            raise wrong(
                "dual_gain in a CCD", "one read of each packet: no dual_gain", field="dual_gain"
            )
        if dual := self.dual_gain:
            self._check_dual_gain(dual)

    def _check_dual_gain(self, dual: DualGain) -> None:
        if self.analogue_gains or self.channel_black_level_dn:
            raise wrong(
                "two reads go with one analogue gain and one black level for all channels",
                "no analogue_gains and no channel_black_level_dn beside it",
                field="dual_gain",
            )
        if dual.system_gain_dn_per_e >= self.system_gain_dn_per_e:
            raise wrong(
                "the low gain is not the lower",
                f"below {self.system_gain_dn_per_e:g}, the system_gain_dn_per_e of the high gain",
                field="dual_gain.system_gain_dn_per_e",
                value=dual.system_gain_dn_per_e,
            )
        if not self.black_level_dn < dual.switch_dn <= self.max_dn:
            raise wrong(
                "the switch is no code of a signal",
                f"above the black level, {self.black_level_dn:g}, up to {self.max_dn} (DN)",
                field="dual_gain.switch_dn",
                value=dual.switch_dn,
            )
        if dual.black_level_dn >= self.max_dn:
            raise wrong(
                "the black level leaves no range",
                f"below {self.max_dn} (DN)",
                field="dual_gain.black_level_dn",
                value=dual.black_level_dn,
            )
        if self.raw_max_dn > MAX_RAW_DN:
            raise wrong(
                f"the merged codes go up to {self.raw_max_dn}",
                f"up to {MAX_RAW_DN}: gains closer to each other, or fewer bits",
                field="dual_gain.system_gain_dn_per_e",
                value=dual.system_gain_dn_per_e,
            )

    @property
    def response_um(self) -> float | Response:
        """Side of the square pixel aperture, um; or the response in space of any other."""
        if self.aperture is None and self.scan_motion_px is None:
            return self.pixel_pitch_um * math.sqrt(self.fill_factor)
        side = math.sqrt(self.fill_factor)
        square = [((1 - side) / 2, (1 - side) / 2, side, side, 1.0)]
        parts = self.aperture.parts if self.aperture else square
        whole = sum(w * h * response for _, _, w, h, response in parts)
        centred = tuple(
            (x + w / 2 - 0.5, y + h / 2 - 0.5, w, h, w * h * response / whole)
            for x, y, w, h, response in parts
        )
        motion = self.scan_motion_px or (0.0, 0.0)
        return Response(centred, motion) / (1 / self.pixel_pitch_um)

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
    def qe(self) -> dict[str, np.ndarray]:
        """Quantum efficiency of each channel at ``WAVELENGTHS_NM``: (61,), read-only.

        With the filters in front of the sensor.
        """
        measured, light = self.quantum_efficiency, passed(self.filters)
        curves = {}
        for name in self.channels:
            curves[name] = light * np.interp(
                WAVELENGTHS_NM, measured.wavelengths_nm, measured.channels[name]
            )
            curves[name].flags.writeable = False
        return curves

    @property
    def colour_qe(self) -> dict[str, np.ndarray]:
        """Mean quantum efficiency of the photosites of each filter colour, by letter: (61,)."""
        return self.by_colour(self.qe)

    def mixed(self) -> Sensor:
        """Return the sensor whose channels are the mixtures that its pixels see.

        Of a filter array that lies beside its pixels (``cfa.shift_px``) each photosite sees the
        filters over it in proportion to the part of its aperture that they cover, and sites of one
        letter become unlike channels (Gr, Gb). Scene and image are sampled as before; the aperture
        is taken to see one mixture all over.

        Raises
        ------
        UserError
            Another field tells channels apart by their names, which change here.
        """
        if not any(self.cfa.shift_px):
            return self
        by_name = {
            "channel_black_level_dn": self.channel_black_level_dn,
            "eqe_map": self.eqe_map,
            "aperture": self.aperture,
        }
        if self.crosstalk:
            kernels = (self.crosstalk.optical, self.crosstalk.electrical)
            by_name["crosstalk"] = any(one and set(one.root) != {"*"} for one in kernels)
        for field, given in by_name.items():
            if given:
                raise UserError(
                    "the filters' shift makes other channels, of a square aperture",
                    field=field,
                    allowed="no such field, or the same for all channels; or cfa.pattern and "
                    "quantum_efficiency with the mixtures, and no shift",
                )
        names, mixtures = mixed_pattern(
            self.cfa.pattern, self.cfa.shift_px, math.sqrt(self.fill_factor)
        )
        measured = self.quantum_efficiency
        curves = {
            name: sum(share * np.array(measured.channels[one]) for one, share in mixture).tolist()
            for name, mixture in mixtures.items()
        }
        return self.model_copy(
            update={
                "cfa": ColourFilterArray(pattern=names),
                "quantum_efficiency": measured.model_copy(update={"channels": curves}),
            }
        )

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
        lines, masks = self.lines or LineNoise(), self.masks or Masks()
        two_numbers = self.gaussian_variance_per_e is not None
        has = {
            "prnu": self.prnu_percent > 0,
            "prnu lines": lines.prnu_row_percent > 0 or lines.prnu_column_percent > 0,
            "dcnu": self.dcnu_percent > 0,
            "gain mask": masks.gain is not None,
            "defects": self.defects is not None,
            "two numbers": two_numbers,
            "knee": self.full_well_knee < 1,
            "dsnu": self.dsnu_e > 0,
            "dsnu lines": lines.dsnu_row_e > 0 or lines.dsnu_column_e > 0,
            "offset mask": masks.offset_e is not None,
            "reset noise": self.reset_noise is not None,
            "read noise": not two_numbers
            and (self.temporal_dark_noise_e > 0 or self.dual_gain is not None),
            "line noise": lines.row_noise_e > 0 or lines.column_noise_e > 0,
        }
        return frozenset(name for name, needed in has.items() if needed)

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
        if not ABSOLUTE_ZERO_C < temperature_c < math.inf:
            raise UserError(
                "not a temperature of a sensor",
                field="temperature_c",
                value=temperature_c,
                allowed=f"above {ABSOLUTE_ZERO_C} degrees Celsius",
            )
        return temperature_c

    def at_low_gain(self) -> Sensor:
        """Return the sensor as it reads at the low gain of two."""
        dual = self.dual_gain
        return self.model_copy(
            update={
                "system_gain_dn_per_e": dual.system_gain_dn_per_e,
                "temporal_dark_noise_e": dual.temporal_dark_noise_e,
                "black_level_dn": dual.black_level_dn,
                "dual_gain": None,
            }
        )

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
        sensor = Sensor.model_validate(data, context={"folder": path.parent}).mixed()
    except ValidationError as error:
        raise user_error(error, Sensor, path) from error
    if sensor.masks is None:
        return sensor
    area = (sensor.first_row, sensor.first_col, sensor.rows, sensor.cols)
    return sensor.model_copy(update={"masks": sensor.masks.placed(path.parent, area)})


class _Filters(Strict):
    """Filters of a camera file, with the name that they have in a sensor's."""

    filters: list[Filter]


def load_filters(data: object, path: Path) -> list[Filter]:
    """Return the filters in front of a lens, of a camera file that lies at a path.

    Raises
    ------
    UserError
        A wrong field, or a spectrum that cannot be read.
    """
    try:
        found = _Filters.model_validate({"filters": data}, context={"folder": path.parent})
    except ValidationError as error:
        raise user_error(error, _Filters, path) from error
    return found.filters

"""The model of a sensor: what its data sheet says, in EMVA 1288's terms.

Symbols of EMVA Standard 1288, release 3.1 (European Machine Vision Association, 2016): system gain
K, temporal dark noise sigma_d, dark current mu_I, dark signal and photo response non-uniformity
DSNU and PRNU.
"""

from __future__ import annotations

from pydantic import Field

from gpusim.config.model import Fixed, Strict, Table
from gpusim.sensor.adc_model import ColumnOffset, DualGain, GainStep, Linearity
from gpusim.sensor.aperture import Aperture
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.crosstalk_model import Crosstalk
from gpusim.sensor.cti_model import Cti
from gpusim.sensor.eqe_model import EqeMap, MicroLens
from gpusim.sensor.filters_model import Filter
from gpusim.sensor.frame import Border, Overscan
from gpusim.sensor.noise_model import Defects, LineNoise, Masks, ReadNoiseLaw, ResetNoise
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.smear_model import Smear
from gpusim.sensor.strict import NotNegative, Positive

MAX_SIDE = 65535  # pixels
ABSOLUTE_ZERO_C = -273.15


class DataSheet(Strict):
    """The figures of a sensor, or of a region of one.

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
        Electrons per incident photon, filters included; at normal incidence. See `Sensor.qe`.
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
        Gain at which the figures hold.
    analogue_gains : tuple of GainStep
        The steps that there are: see `Sensor.at_gain`.
    linearity : Linearity, optional
        Measured response of the read-out.
    channel_black_level_dn : dict of str to float, optional
        Black levels of the channels whose black level is not ``black_level_dn``.
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
        CCDs only: rows and columns that are read after the last ones: see `gpusim.sensor.ccd`.
    smear : Smear, optional
        CCDs only: light that is collected while charge is shifted.
    bloom : bool
        Whether a CCD has no anti-blooming: charge above the full well then flows along the column.
    parallel_cti, serial_cti : Cti, optional
        CCDs only: charge that is left behind along columns and along rows.
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
    filters : tuple of Filter
        In front of the sensor, where ``quantum_efficiency`` does not include them.
    aperture : Aperture, optional
        What of the pixel sees light, where it is no square in its middle; ``fill_factor`` is its
        area.
    scan_motion_px : (float, float), optional
        x, y by which the image moves over the sensor while a pixel of a scanning system is
        exposed, pixels: the middle of the way is where it stands still in other sensors.
    sources : dict of str to str
        Where each figure comes from, by field.

    Examples
    --------
    >>> import gpusim as gs
    >>> sheet = gs.Sensor.load("imx477")
    >>> sheet.full_well_e, sheet.bit_depth, sheet.cfa.pattern
    (8180.0, 12, (('B', 'G'), ('G', 'R')))
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
    analogue_gains: tuple[GainStep, ...] = Field(default=())
    linearity: Linearity | None = None
    channel_black_level_dn: Table[NotNegative] | None = None
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
    filters: tuple[Filter, ...] = Field(default=())
    aperture: Aperture | None = None
    scan_motion_px: tuple[float, float] | None = None
    sources: Table[str] = Field(default=Fixed())

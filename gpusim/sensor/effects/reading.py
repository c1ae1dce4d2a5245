"""What is added when the charge is read, and what makes digital numbers of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gpusim.sensor.effects.effect import Effect, each_pixel, lines_of, masks_of

if TYPE_CHECKING:
    from gpusim.sensor.sensor import Sensor


def _linearity(sensor: Sensor) -> str:
    low, high = sensor.linearity.error_percent(sensor.saturation_e)
    return f"linearity error {low:+.2g} to {high:+.2g} % (EMVA 1288), in adc"


def _converter(sensor: Sensor) -> str:
    text = f"{sensor.bit_depth} bit"
    if sensor.analogue_gain != 1:
        text += f", analogue gain {sensor.analogue_gain:g}"
    if sensor.channel_black_level_dn:
        text += ", a black level for each channel"
    return text


DSNU = Effect(
    "dsnu",
    "noise",
    ("dsnu_e",),
    "offset of each pixel, a fixed pattern",
    lambda sensor: sensor.dsnu_e > 0,
    lambda sensor: f"{sensor.dsnu_e:g} e-",
    "all pixels have the same offset",
    random=True,
    forced=True,
    override="DSNU",
    read_out=True,
)
DSNU_LINES = Effect(
    "dsnu lines",
    "noise",
    ("lines.dsnu_row_e", "lines.dsnu_column_e"),
    "offsets of rows and columns, a fixed pattern",
    lambda sensor: lines_of(sensor).dsnu_row_e > 0 or lines_of(sensor).dsnu_column_e > 0,
    lambda sensor: (
        f"rows {lines_of(sensor).dsnu_row_e:g} e-, columns {lines_of(sensor).dsnu_column_e:g} e-"
    ),
    "all rows and columns have the same offset",
    random=True,
    forced=True,
    override="DSNU_LINES",
    read_out=True,
)
OFFSET_MASK = Effect(
    "offset mask",
    "noise",
    ("masks.offset_e",),
    "offset of each pixel, from a file",
    lambda sensor: masks_of(sensor).offset_e is not None,
    lambda sensor: masks_of(sensor).offset_e,
    "the sensor file names no additive mask",
    random=True,
    override="MASK",
    read_out=True,
)
RESET_NOISE = Effect(
    "reset noise",
    "noise",
    ("reset_noise",),
    "kTC noise",
    lambda sensor: sensor.reset_noise is not None,
    lambda sensor: f"{sensor.reset_noise_at(None):.3g} e- at the reference temperature",
    "none is left",
    random=True,
    forced=True,
    override="RESET",
    read_out=True,
)
READ_NOISE = Effect(
    "read noise",
    "noise",
    ("temporal_dark_noise_e", "read_noise_law"),
    "noise of each read",
    lambda sensor: (
        sensor.gaussian_variance_per_e is None
        and (sensor.temporal_dark_noise_e > 0 or sensor.dual_gain is not None)
    ),
    lambda sensor: (
        f"{sensor.temporal_dark_noise_e:g} e-"
        + ", by its table" * (sensor.read_noise_law is not None)
    ),
    lambda sensor: (
        "the sensor has no temporal dark noise"
        if sensor.gaussian_variance_per_e is None
        else "it is one of the two numbers"
    ),
    random=True,
    forced=True,
    override="READ_NOISE",
    read_out=True,
)
LINE_NOISE = Effect(
    "line noise",
    "noise",
    ("lines.row_noise_e", "lines.column_noise_e"),
    "noise of rows and columns, new in each frame",
    lambda sensor: lines_of(sensor).row_noise_e > 0 or lines_of(sensor).column_noise_e > 0,
    lambda sensor: (
        f"rows {lines_of(sensor).row_noise_e:g} e-, columns {lines_of(sensor).column_noise_e:g} e-"
    ),
    "rows and columns are as quiet as their pixels",
    random=True,
    forced=True,
    override="LINES",
    read_out=True,
)
LINEARITY = Effect(
    "linearity",
    "adc",
    ("linearity",),
    "measured response in place of a straight line",
    lambda sensor: sensor.linearity is not None,
    _linearity,
    "the response is a straight line",
)
COLUMN_FPN = Effect(
    "column fpn",
    "adc",
    ("column_offset",),
    "fixed offsets of the columns' converters",
    lambda sensor: sensor.column_offset is not None,
    lambda sensor: "offsets of the columns' converters, in adc",
    "the converters of all columns are alike",
    random=True,
    forced=True,
)
ADC = Effect(
    "adc",
    "adc",
    ("system_gain_dn_per_e", "black_level_dn", "bit_depth"),
    "system gain, black level, quantisation, clip",
    lambda sensor: True,
    _converter,
    "",
    work=each_pixel("adc"),
)
MERGE = Effect(
    "merge",
    "merge",
    ("dual_gain",),
    "reads at two gains, merged into one linear code",
    lambda sensor: sensor.dual_gain is not None,
    lambda sensor: f"reads at two gains, switched at {sensor.dual_gain.switch_dn} DN",
    "the sensor reads at one gain",
    work=each_pixel("merge"),
)

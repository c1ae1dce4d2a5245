"""What a sensor file must keep across its fields: each may be right, and they contradict."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from gpusim.config.model import wrong
from gpusim.errors import UserError
from gpusim.sensor.aperture import AREA_ROUNDING

if TYPE_CHECKING:
    from gpusim.sensor.sensor import Sensor

MAX_CHANNELS = 16  # that the shaders tell apart
MAX_MOTION_PX = 4
MAX_RAW_DN = 65535  # raw files hold 16 bits


def check_fields(sensor: Sensor) -> None:
    """Refuse a sensor whose fields contradict each other.

    Raises
    ------
    PydanticCustomError
        See :func:`gpusim.config.model.wrong`.
    UserError
        The file of the quantum efficiency by angle has other channels.
    """
    _check_channels(sensor)
    _check_black("black_level_dn", sensor.black_level_dn, sensor)
    _check_readout(sensor)
    _check_dual_gain(sensor)
    _check_border(sensor)
    _check_noise(sensor)
    _check_defects(sensor)
    _check_crosstalk(sensor)
    _check_pixel(sensor)
    if unknown := set(sensor.sources) - set(type(sensor).model_fields):
        raise wrong(
            f"sources names no field: {', '.join(sorted(unknown))}",
            "fields of this file",
            field="sources",
        )


def _check_channels(sensor: Sensor) -> None:
    letters, curves = set(sensor.site_channels()), set(sensor.quantum_efficiency.channels)
    if sensor.eqe_map is not None and set(sensor.eqe_map.channels) != letters:
        raise UserError(
            "the channels are not those of the filter pattern",
            file=sensor.eqe_map.file,
            field="channels",
            value=", ".join(sorted(sensor.eqe_map.channels)),
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
    if sensor.micro_lens is not None and sensor.eqe_map is None:
        raise wrong(
            "micro_lens shifts what no eqe_map gives", "both, or neither", field="micro_lens"
        )


def _check_black(field: str, level_dn: float, sensor: Sensor) -> None:
    if level_dn >= sensor.max_dn:
        raise wrong(
            "the black level leaves no range",
            f"below {sensor.max_dn} (DN)",
            field=field,
            value=level_dn,
        )


def _check_readout(sensor: Sensor) -> None:
    for name, level_dn in (sensor.channel_black_level_dn or {}).items():
        if name not in sensor.site_channels():
            raise wrong(
                "the filter pattern has no such channel",
                ", ".join(sensor.channels),
                field="channel_black_level_dn",
                value=name,
            )
        _check_black(f"channel_black_level_dn.{name}", level_dn, sensor)
    if sensor.linearity and sensor.linearity.electrons[-1] < sensor.full_well_e:
        raise wrong(
            "the response ends before the full well",
            f"a last point at {sensor.full_well_e:g} electrons or beyond",
            field="linearity.electrons",
            value=sensor.linearity.electrons[-1],
        )
    given = sensor.column_offset and sensor.column_offset.offsets_dn
    columns = sensor.first_col + sensor.frame.read[3]
    if given is not None and len(given) != columns:
        raise wrong(
            f"there are offsets of {len(given)} columns",
            f"{columns}, one for each column that is read",
            field="column_offset.offsets_dn",
            value=f"{len(given)} values",
        )
    if sensor.bloom and sensor.full_well_knee < 1:
        raise wrong(
            "a soft full well where charge blooms",
            "1, or no bloom",
            field="full_well_knee",
            value=sensor.full_well_knee,
        )


def _check_dual_gain(sensor: Sensor) -> None:
    dual = sensor.dual_gain
    if dual is None:
        return
    if sensor.is_ccd:
        raise wrong(
            "dual_gain in a CCD", "one read of each packet: no dual_gain", field="dual_gain"
        )
    if sensor.analogue_gains or sensor.channel_black_level_dn:
        raise wrong(
            "two reads go with one analogue gain and one black level for all channels",
            "no analogue_gains and no channel_black_level_dn beside it",
            field="dual_gain",
        )
    if dual.system_gain_dn_per_e >= sensor.system_gain_dn_per_e:
        raise wrong(
            "the low gain is not the lower",
            f"below {sensor.system_gain_dn_per_e:g}, the system_gain_dn_per_e of the high gain",
            field="dual_gain.system_gain_dn_per_e",
            value=dual.system_gain_dn_per_e,
        )
    if not sensor.black_level_dn < dual.switch_dn <= sensor.max_dn:
        raise wrong(
            "the switch is no code of a signal",
            f"above the black level, {sensor.black_level_dn:g}, up to {sensor.max_dn} (DN)",
            field="dual_gain.switch_dn",
            value=dual.switch_dn,
        )
    _check_black("dual_gain.black_level_dn", dual.black_level_dn, sensor)
    if sensor.raw_max_dn > MAX_RAW_DN:
        raise wrong(
            f"the merged codes go up to {sensor.raw_max_dn}",
            f"up to {MAX_RAW_DN}: gains closer to each other, or fewer bits",
            field="dual_gain.system_gain_dn_per_e",
            value=dual.system_gain_dn_per_e,
        )


def _check_border(sensor: Sensor) -> None:
    black, (down, across) = sensor.optical_black, sensor.period
    if black and (black.top % down or black.left % across):
        raise wrong(
            f"there are {black.top} rows above and {black.left} columns to the left",
            f"multiples of {down} and {across}, as the filter pattern",
            field="optical_black",
        )


def _check_noise(sensor: Sensor) -> None:
    if sensor.gaussian_variance_per_e is not None:
        for field in ("read_noise_law", "dual_gain"):
            if getattr(sensor, field) is not None:
                raise wrong(
                    f"{field} gives a read noise that gaussian_variance_per_e replaces",
                    "one of the two",
                )


def _check_defects(sensor: Sensor) -> None:
    for pixel in sensor.defects.pixels if sensor.defects else ():
        row, col = pixel.row - sensor.first_row, pixel.col - sensor.first_col
        if not (0 <= row < sensor.rows and 0 <= col < sensor.cols):
            raise wrong(
                f"the defect pixel {pixel.row}, {pixel.col} lies beside the sensor",
                f"rows from {sensor.first_row}, {sensor.rows} of them; columns from "
                f"{sensor.first_col}, {sensor.cols} of them",
            )


def _check_crosstalk(sensor: Sensor) -> None:
    if sensor.crosstalk is None:
        return
    if sensor.is_ccd:
        raise wrong(
            "cross-talk is simulated of sensors that do not shift their charge",
            "no overscan, smear, bloom or cti beside it",
            field="crosstalk",
        )
    for kind in ("optical", "electrical"):
        if kernels := getattr(sensor.crosstalk, kind):
            kernels.check(f"crosstalk.{kind}", sensor.cfa.pattern)


def _check_pixel(sensor: Sensor) -> None:
    aperture, motion = sensor.aperture, sensor.scan_motion_px
    if aperture and abs(aperture.area / sensor.fill_factor - 1) > AREA_ROUNDING:
        raise wrong(
            "the aperture has another area than the fill factor says",
            f"{aperture.area:.4g}",
            field="fill_factor",
            value=sensor.fill_factor,
        )
    if motion and math.hypot(*motion) > MAX_MOTION_PX:
        raise wrong(
            "the image moves too far while a pixel is exposed",
            f"{MAX_MOTION_PX} pixels at most",
            field="scan_motion_px",
        )

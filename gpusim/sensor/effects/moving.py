"""What moves light or charge to other pixels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from gpusim.sensor.crosstalk_model import Kernels
from gpusim.sensor.cti_model import Cti
from gpusim.sensor.effects.effect import Effect, Work, each_pixel

if TYPE_CHECKING:
    from gpusim.sensor.sensor import Sensor


def _kernels(sensor: Sensor, kind: str) -> Kernels | None:
    return sensor.crosstalk and getattr(sensor.crosstalk, kind)


def _crosstalk(name: str, kind: str, what: str, words: str) -> Effect:
    """Return the row of optical or electrical cross-talk."""

    def used(sensor: Sensor) -> str:
        side = _kernels(sensor, kind).side
        return f"{side} x {side} pixels {words}"

    def work(sensor: Sensor) -> Work:
        side = _kernels(sensor, kind).side
        return "crosstalk", math.prod(sensor.frame.pixels[2:]) * side**2

    return Effect(
        name,
        "crosstalk",
        (f"crosstalk.{kind}",),
        what,
        lambda sensor: _kernels(sensor, kind) is not None,
        used,
        f"the sensor file gives no {kind} cross-talk",
        work=work,
    )


def _ccd_lacks(sensor: Sensor) -> str:
    return "the sensor file gives none" if sensor.is_ccd else "the charge is not shifted"


def _transfer(name: str, field: str, what: str) -> Effect:
    """Return the row of the charge that one of the two transfers leaves behind."""

    def cti(sensor: Sensor) -> Cti | None:
        return getattr(sensor, field)

    def used(sensor: Sensor) -> str:
        found = cti(sensor)
        if found.traps:
            return f"{len(found.traps)} kinds of traps, {found.groups} groups of transfers"
        return f"{found.inefficiency:g} of each packet left behind in each transfer"

    def work(sensor: Sensor) -> Work:
        pixels, found = math.prod(sensor.frame.read[2:]), cti(sensor)
        return ("traps", pixels * (found.groups + 1) / 2) if found.traps else ("cti", pixels)

    return Effect(
        name,
        "cti",
        (field,),
        what,
        lambda sensor: cti(sensor) is not None,
        used,
        _ccd_lacks,
        work=work,
    )


def _smeared(sensor: Sensor) -> str:
    smear = sensor.smear
    by = "line by line" if smear.leak is None else f"{smear.leak:g} of the light leaks"
    return f"{smear.kind.replace('_', ' ')}, {by}"


CROSSTALK = _crosstalk(
    "crosstalk",
    "optical",
    "light and diffusing charge that reach other pixels",
    "of light and diffusing charge",
)
SMEAR = Effect(
    "smear",
    "smear",
    ("smear",),
    "light that reaches the packets of whole columns on their way",
    lambda sensor: sensor.smear is not None,
    _smeared,
    _ccd_lacks,
    work=each_pixel("smear"),
)
BLOOM = Effect(
    "bloom",
    "bloom",
    ("bloom",),
    "charge above the full well flows along the columns",
    lambda sensor: bool(sensor.bloom),
    lambda sensor: "charge above the full well flows along the columns",
    _ccd_lacks,
    work=each_pixel("bloom"),
)
PARALLEL_CTI = _transfer(
    "parallel cti", "parallel_cti", "charge that transfers along the columns leave behind"
)
SERIAL_CTI = _transfer(
    "serial cti", "serial_cti", "charge that transfers along the rows leave behind"
)
ELECTRICAL_CROSSTALK = _crosstalk(
    "electrical crosstalk",
    "electrical",
    "collected charge that is seen at other pixels; correlates the noise",
    "of collected charge, by the crosstalk stage",
)

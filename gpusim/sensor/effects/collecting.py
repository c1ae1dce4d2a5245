"""What happens until pixels have collected their charge: light, response, shot noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gpusim.sensor.effects.effect import Effect, each_pixel, lines_of, masks_of

if TYPE_CHECKING:
    from gpusim.sensor.sensor import Sensor


def _border(sensor: Sensor) -> str:
    black = sensor.optical_black
    rows, cols = f"{black.top} + {black.bottom} rows", f"{black.left} + {black.right} columns"
    return f"{rows} and {cols} of optical black"


def _mosaicked(sensor: Sensor) -> str:
    sites = len(sensor.site_channels())
    return f"{sites} CFA sites" if sites > 1 else "adds the veiling glare"


MOSAIC = Effect(
    "mosaic",
    "mosaic",
    ("cfa",),
    "each photosite's own light",
    lambda sensor: len(sensor.site_channels()) > 1 or sensor.veiling_glare > 0,
    _mosaicked,
    "a sensor without filters or veiling glare: the plane is the frame",
    forced=True,
    work=each_pixel("mosaic"),
)
FLARE = Effect(
    "flare",
    "mosaic",
    ("veiling_glare",),
    "uniform light over the image's mean",
    lambda sensor: sensor.veiling_glare > 0,
    lambda sensor: f"veiling glare {sensor.veiling_glare:.2%} of the mean, added by mosaic",
    "the sensor file gives none",
)
BORDER = Effect(
    "border",
    "border",
    ("optical_black",),
    "no light on the optical black",
    lambda sensor: sensor.optical_black is not None,
    _border,
    "the sensor file gives no optical black",
    work=each_pixel("border"),
)
PRNU = Effect(
    "prnu",
    "exposure",
    ("prnu_percent",),
    "response of each pixel, a fixed pattern",
    lambda sensor: sensor.prnu_percent > 0,
    lambda sensor: f"{sensor.prnu_percent:g} % of the signal",
    "all pixels respond alike",
    random=True,
    forced=True,
    override="PRNU",
)
PRNU_LINES = Effect(
    "prnu lines",
    "exposure",
    ("lines.prnu_row_percent", "lines.prnu_column_percent"),
    "response of rows and columns, a fixed pattern",
    lambda sensor: (
        lines_of(sensor).prnu_row_percent > 0 or lines_of(sensor).prnu_column_percent > 0
    ),
    lambda sensor: (
        f"rows {lines_of(sensor).prnu_row_percent:g} %, "
        f"columns {lines_of(sensor).prnu_column_percent:g} %"
    ),
    "all rows and columns respond alike",
    random=True,
    forced=True,
    override="PRNU_LINES",
)
GAIN_MASK = Effect(
    "gain mask",
    "exposure",
    ("masks.gain",),
    "response of each pixel, from a file",
    lambda sensor: masks_of(sensor).gain is not None,
    lambda sensor: masks_of(sensor).gain,
    "the sensor file names no multiplicative mask",
    random=True,
    override="MASK",
)
DCNU = Effect(
    "dcnu",
    "exposure",
    ("dcnu_percent",),
    "dark current of each pixel, a fixed pattern",
    lambda sensor: sensor.dcnu_percent > 0,
    lambda sensor: f"{sensor.dcnu_percent:g} % of the dark current",
    "dark current is even",
    random=True,
    forced=True,
    override="DCNU",
)
EXPOSURE = Effect(
    "exposure",
    "exposure",
    ("dark_current_e_per_s",),
    "exposure time, dark current",
    lambda sensor: True,
    lambda sensor: "exposure time, dark current",
    "",
    work=each_pixel("exposure"),
)
DEFECTS = Effect(
    "defects",
    "defects",
    ("defects",),
    "dead and hot pixels; stuck ones when the charge is read",
    lambda sensor: sensor.defects is not None,
    lambda sensor: "dead, hot and stuck pixels",
    "the sensor file lists none",
    random=True,
)
TWO_NUMBERS = Effect(
    "two numbers",
    "noise",
    ("gaussian_variance_per_e",),
    "a normal law in place of Poisson's",
    lambda sensor: sensor.gaussian_variance_per_e is not None,
    lambda sensor: "a normal law in place of Poisson's",
    "shot noise has Poisson's law",
    random=True,
    override="GAUSSIAN",
)
SOFT_SATURATION = Effect(
    "soft saturation",
    "noise",
    ("full_well_knee",),
    "a full well that fills softly",
    lambda sensor: sensor.full_well_knee < 1,
    lambda sensor: f"soft from {sensor.full_well_knee:.0%} of the full well on",
    "the full well is a hard limit",
    random=True,
    override="SOFT_SATURATION",
)
NOISE = Effect(
    "noise",
    "noise",
    ("full_well_e",),
    "shot noise of light and dark current, full well",
    lambda sensor: True,
    lambda sensor: "shot noise, full well",
    "",
    random=True,
    work=each_pixel("noise"),
)

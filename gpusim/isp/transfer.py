"""Output spaces and their transfer curves. Stage ``shaders/isp/transfer.wgsl``."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gpusim.gpu import Array, Kernel, Recording
from gpusim.isp.line import line
from gpusim.scene.colorimetry import REC709_CHROMATICITIES


@dataclass(frozen=True)
class Transfer:
    """y = slope x up to the cut; above, (1 + offset) x^power - offset."""

    slope: float
    cut: float
    offset: float
    power: float


@dataclass(frozen=True)
class Space:
    """What a picture's numbers mean.

    Attributes
    ----------
    title : str
    chromaticities : tuple of 8 float
        x, y of red, green, blue and white.
    transfer : Transfer, optional
        None where light is stored as it is.
    """

    title: str
    chromaticities: tuple[float, ...]
    transfer: Transfer | None


_SRGB = Transfer(12.92, 0.0031308, 0.055, 1 / 2.4)  # IEC 61966-2-1
_WHITE = REC709_CHROMATICITIES[6:]
SPACES = {
    "srgb": Space("sRGB", REC709_CHROMATICITIES, _SRGB),
    # SMPTE EG 432-1 with the white and the curve of sRGB.
    "p3": Space("Display P3", (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *_WHITE), _SRGB),
    # ITU-R BT.2020, tables 3 and 4; the constants to the digits that make the pieces meet.
    "rec2020": Space(
        "Rec. 2020",
        (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_WHITE),
        Transfer(4.5, 0.018053968510807, 0.09929682680944, 0.45),
    ),
    "linear": Space("linear, primaries of sRGB", REC709_CHROMATICITIES, None),
}


def record_transfer(rec: Recording, light: Array, transfer: Transfer) -> None:
    """Record a transfer curve, in place.

    Parameters
    ----------
    rec : Recording
    light : Array, f32
        1 is white; a multiple of 4 samples.
    transfer : Transfer
    """
    kernel = Kernel("isp/transfer")
    groups, params = line(kernel, math.prod(light.shape))
    kernel.record(rec, groups, params | vars(transfer), light=light)

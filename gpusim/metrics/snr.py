"""Signal-to-noise ratio of even patches in one picture, and the dynamic range that follows.

The noise of a patch is what a parabola through its pixels leaves: light falls off and slants, noise
does not. It is the noise of one picture, temporal and fixed together. Over the patches it follows

    sigma^2 = r + g S + p S^2,

read noise, shot noise and unlike pixels (EMVA 1288 R3.1, equations (15) and (54)), none of them
negative. The dynamic range is the highest signal over the one whose SNR is 1 (ISO 15739:2023).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from gpusim.errors import UserError
from gpusim.metrics.figure import Figure
from gpusim.metrics.picture import Plane

LEAST_PIXELS = 64  # of a patch in a channel: its noise is then known to 9 %
LEAST_PATCHES = 4  # for the law of three parts


@dataclass(frozen=True)
class Patch:
    """One patch in one channel.

    Attributes
    ----------
    number : int
    region : (x, y, width, height)
    signal : Figure
        Mean, in the picture's unit, less the black level of a raw frame.
    noise : Figure
        Standard deviation of a pixel.
    clipped : bool
        Some pixels are black or saturated: its noise is not whole, and no law counts it.
    """

    number: int
    region: tuple[int, int, int, int]
    signal: Figure
    noise: Figure
    clipped: bool

    @property
    def snr(self) -> Figure:
        """Return signal over noise."""
        return self.signal.over(self.noise)


@dataclass(frozen=True)
class Range:
    """What the patches of a channel say together.

    Attributes
    ----------
    channel : str
    patches : tuple of Patch
    law : (float, float, float) or None
        r, g and p; None where there are fewer than four patches.
    least, highest : float or None
        Signals between which the range lies: where SNR is 1, and the end of the scale.
    to_scale_end : bool
        The highest is where the scale ends, else the brightest patch, and the range is at least
        that.
    """

    channel: str
    patches: tuple[Patch, ...]
    law: tuple[float, float, float] | None
    least: float | None
    highest: float | None
    to_scale_end: bool

    @property
    def decibels(self) -> float | None:
        """Return the dynamic range, dB."""
        if self.least is None or self.least <= 0:
            return None
        return 20 * math.log10(self.highest / self.least)

    def noise(self, signal: np.ndarray) -> np.ndarray:
        """Return the law's noise at signals."""
        return np.sqrt(np.polynomial.polynomial.polyval(signal, self.law))


def measure_snr(plane: Plane, channel: str, regions: Sequence[tuple[int, int, int, int]]) -> Range:
    """Measure even patches.

    Parameters
    ----------
    plane : Plane
    channel : str
        Its name.
    regions : sequence of (x, y, width, height)

    Raises
    ------
    UserError
        A region leaves the picture, or has too few pixels of the channel.
    """
    patches = tuple(_patch(plane, number, one) for number, one in enumerate(regions, start=1))
    whole = [one for one in patches if not one.clipped]
    if len(whole) < LEAST_PATCHES:
        return Range(channel, patches, None, None, None, False)
    signal = np.array([one.signal.value for one in whole])
    square = np.array([one.noise.value**2 for one in whole])
    # A variance is known in proportion to itself.
    unit = float(np.abs(signal).max())
    design = np.stack([np.ones_like(signal), signal / unit, (signal / unit) ** 2], 1)
    found, _ = nnls(design / square[:, None], np.ones(len(whole)))
    law = float(found[0]), float(found[1]) / unit, float(found[2]) / unit**2
    ended = bool(np.isfinite(plane.clip[1]))
    highest = float(plane.clip[1]) if ended else unit
    return Range(channel, patches, law, _least(law), highest, ended)


def _least(law: tuple[float, float, float]) -> float | None:
    """Return the signal whose SNR is 1: S^2 = r + g S + p S^2; None where there is none."""
    r, g, p = law
    if p >= 1:
        return None
    return (g + math.sqrt(g * g + 4 * (1 - p) * r)) / (2 * (1 - p))


def _patch(plane: Plane, number: int, region: tuple[int, int, int, int]) -> Patch:
    left, top, width, height = region
    tall, wide = plane.values.shape
    if not (0 <= left < left + width <= wide and 0 <= top < top + height <= tall):
        allowed = f"x,y,width,height within {wide} x {tall}"
        raise UserError(
            "The region leaves the picture.", field="--roi", value=region, allowed=allowed
        )
    rows, cols = np.mgrid[top : top + height, left : left + width]
    own = np.ones(rows.shape, bool)
    if plane.sites is not None:
        own = plane.sites[rows % plane.sites.shape[0], cols % plane.sites.shape[1]]
    value = plane.values[rows[own], cols[own]].astype(np.float64)
    if value.size < LEAST_PIXELS:
        raise UserError(
            "The region is too small for a noise.",
            field="--roi",
            value=region,
            allowed=f"{LEAST_PIXELS} pixels of the channel or more, here {value.size}",
        )
    x, y = (2 * (at[own] - at.min()) / max(np.ptp(at), 1) - 1 for at in (cols, rows))
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], 1)
    rest = value - design @ np.linalg.lstsq(design, value, rcond=None)[0]
    freedom = value.size - design.shape[1]
    noise = float(np.sqrt(rest @ rest / freedom))
    return Patch(
        number,
        region,
        Figure(float(value.mean()), noise / math.sqrt(value.size)),
        Figure(noise, noise / math.sqrt(2 * freedom)),
        bool(np.any((value <= plane.clip[0]) | (value >= plane.clip[1]))),
    )

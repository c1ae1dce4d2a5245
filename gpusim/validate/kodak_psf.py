"""PSFs at three image points for green light (figure 6): ours, and an independent tracer's.

The tracer's pupil function is summed as equation 1 of the paper has it,

    h(x, y) = | integral P(u, v) exp(2 pi i (u y + v x) / lambda) du dv |^2,

directly at each sample of the paper's 0.5 um, without a fast transform.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.lens.prescription import Prescription
from gpusim.library.lens import Lens
from gpusim.sensor.load import load_sensor
from gpusim.validate.bars import Bar
from gpusim.validate.kodak import SENSOR
from gpusim.validate.kodak_table import TABLE_1
from gpusim.validate.predict import Predictor

WAVELENGTH_NM = 550.0
PITCH_UM, SAMPLES = 0.5, 128  # the paper's sampling of PSFs; a window of 64 um
POINTS = {"centre": 1, "mid-field": 3, "corner": 9}  # by the number of a place of table 1
# Sum of the differences' sizes over twice the light: the share of light that lies elsewhere.
BAR = 0.01


@dataclass(frozen=True, eq=False)
class PointSpread:
    """A PSF (n, n), share of the light per sample: ours and as predicted.

    Rows lie across the radius, columns along it, outwards; the chief ray lands on [n / 2, n / 2].
    """

    where: str
    field_deg: float
    own: np.ndarray
    predicted: np.ndarray

    @property
    def elsewhere(self) -> float:
        """Share of the light that lies elsewhere than predicted, within the window."""
        own, other = (one / one.sum() for one in (self.own, self.predicted))
        return float(np.abs(own - other).sum() / 2)


@dataclass(frozen=True, eq=False)
class PointSpreads:
    """The PSFs of figure 6."""

    found: Sequence[PointSpread]

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        name = f"PSFs at {len(self.found)} image points, {WAVELENGTH_NM:g} nm: misplaced light"
        return [Bar.largest(name, [one.elsewhere for one in self.found], BAR, "of the light")]


def measure_psfs(lens: Prescription, predictor: Predictor) -> PointSpreads:
    """Trace the PSFs, and predict them."""
    found, shown = [], Lens(**dict(lens))
    pitch_um = load_sensor(SENSOR).pixel_pitch_um
    for where, number in POINTS.items():
        place = next(one for one in TABLE_1 if one.number == number)
        radius_um = pitch_um * math.hypot(place.x, place.y)
        field = float(predictor.field_rad(np.array(radius_um), WAVELENGTH_NM))
        predicted = predictor.point_spread(field, WAVELENGTH_NM, PITCH_UM, SAMPLES)
        share, window_um = field / predictor.widest_rad, PITCH_UM * SAMPLES
        own = shown.psf(share, WAVELENGTH_NM, window_um=window_um, samples=SAMPLES)
        found.append(PointSpread(where, own.field_deg, own.values, predicted))
    return PointSpreads(found)

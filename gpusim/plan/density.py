"""What a lens's bank is expected to err by, as densely as it is sampled: the planner's part of it.

`gpusim.render.survey` asks the lens and chooses where it is sampled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from gpusim.plan.accuracy import SMALLEST
from gpusim.plan.stage import PlanStage
from gpusim.psf.beyond import landing_share
from gpusim.psf.field_bank import FieldBank

MOST_SHARE = 0.85  # of the tolerance: a bank that leaves more is refused
# The engine errs by at most this share of what it is planned for: measured over five scenes and
# three lenses at three tolerances.
ENGINE = 0.78
# Mean square of (1 - 4 t^2) (9 - 4 t^2) / 9, the error of a cubic between its middle nodes at
# t = -1/2 and 1/2 over that half-way.
MEAN = 0.5167
LOOKED_AT = 17  # distances from the middle to the corner at which light from far off may land


class AnyDensity(Protocol):
    """What a density says of a bank, whether its lens has an axis or not."""

    ratio: float

    @property
    def worst(self) -> float:
        """The largest error on the sensor."""

    @property
    def rms(self) -> float:
        """What is expected of the whole sensor."""

    @property
    def sampling(self) -> dict[str, np.ndarray]:
        """What `gpusim.camera.Camera.bank` takes."""

    @property
    def why(self) -> str:
        """Why it cannot be less."""

    @property
    def text(self) -> str:
        """What was chosen, in words."""


@dataclass(frozen=True, eq=False)
class Density:
    """Where a bank is sampled, and what it is expected to err by, relative to the local signal.

    Attributes
    ----------
    field_deg, wavelengths_nm : ndarray (F,), (L,)
    height_um : ndarray (F,)
        Heights of the fields.
    fields_error : ndarray (F - 1,)
        Half-way between the fields; 0 beyond the sensor's corners.
    lines_um, lines_error : ndarray (A,)
        Heights, and what the lines leave there.
    pupil_error : float
        What the generator errs by at the nodes themselves: it samples the pupil's rim in cells.
    contrast : float
        Contrast of the edges that the bank was made for, 1 where the scene has none.
    ratio : float
        Contrast of the scene's own edges.
    """

    field_deg: np.ndarray
    wavelengths_nm: np.ndarray
    height_um: np.ndarray
    fields_error: np.ndarray
    lines_um: np.ndarray
    lines_error: np.ndarray
    pupil_error: float
    contrast: float
    ratio: float

    def at(self, radius_um: float) -> float:
        """Return the error at an image height."""
        place = int(np.searchsorted(self.height_um, radius_um, "right")) - 1
        of_fields = self.fields_error[min(max(place, 0), len(self.fields_error) - 1)]
        of_lines = np.interp(radius_um, self.lines_um, self.lines_error)
        return math.hypot(of_fields, of_lines, self.pupil_error)

    @property
    def worst(self) -> float:
        """The largest error on the sensor."""
        middles = (self.height_um[1:] + self.height_um[:-1]) / 2
        used = [r for r, error in zip(middles, self.fields_error, strict=True) if error > 0]
        return max(map(self.at, used), default=0.0)

    @property
    def rms(self) -> float:
        """What is expected of the whole sensor: the root of the mean square over its area.

        Each interval between fields counts by its ring. Towards the fields the error falls.
        """
        ends = self.height_um
        middles = (ends[1:] + ends[:-1]) / 2
        used = self.fields_error > 0
        if not used.any():
            return 0.0
        area = (ends[1:] ** 2 - ends[:-1] ** 2)[used]
        of_lines = np.interp(middles[used], self.lines_um, self.lines_error)
        squares = MEAN * self.fields_error[used] ** 2 + of_lines**2 + self.pupil_error**2
        return float(np.sqrt(np.average(squares, weights=area)))

    @property
    def sampling(self) -> dict[str, np.ndarray]:
        """What `gpusim.camera.Camera.bank` takes."""
        return {"wavelengths_nm": self.wavelengths_nm, "field_deg": self.field_deg}

    @property
    def why(self) -> str:
        """Why it cannot be less."""
        if self.pupil_error > self.worst / math.sqrt(2):
            return f"PSFs err by {self.pupil_error:.1e}, for the pupil's rim is sampled in cells"
        fields, lines = len(self.field_deg), len(self.wavelengths_nm)
        return (
            f"between {fields} fields and {lines} wavelengths the lens's PSFs are interpolated, "
            f"which errs by {self.worst:.1e}, and a bank takes no more than 2 GiB"
        )

    @property
    def text(self) -> str:
        """What was chosen, in words."""
        fields, lines = len(self.field_deg), len(self.wavelengths_nm)
        return f"PSFs of {fields} fields x {lines} wavelengths, what lies between interpolated"


@dataclass(frozen=True, eq=False)
class PlaneDensity:
    """Where a bank is sampled, and what it is expected to err by, relative to the local signal.

    Attributes
    ----------
    side_deg : ndarray (N,)
        Field angles, along x and along y.
    wavelengths_nm : ndarray (L,)
    fields_error : ndarray (C,)
        In the middles of the cells that were asked.
    lines_error, pupil_error : float
        What the lines leave; what the generator errs by at the fields themselves.
    ratio : float
        Contrast of the scene's own edges.
    """

    side_deg: np.ndarray
    wavelengths_nm: np.ndarray
    fields_error: np.ndarray
    lines_error: float
    pupil_error: float
    ratio: float

    @property
    def worst(self) -> float:
        """The largest error on the sensor."""
        return math.hypot(self.fields_error.max(), self.lines_error, self.pupil_error)

    @property
    def rms(self) -> float:
        """What is expected of the whole sensor: towards the fields the error falls."""
        of_fields = MEAN * np.mean(np.square(self.fields_error))
        return math.sqrt(of_fields + self.lines_error**2 + self.pupil_error**2)

    @property
    def sampling(self) -> dict[str, np.ndarray]:
        """What `gpusim.camera.Camera.bank` takes."""
        sides = {"field_x_deg": self.side_deg, "field_y_deg": self.side_deg}
        return {"wavelengths_nm": self.wavelengths_nm} | sides

    @property
    def why(self) -> str:
        """Why it cannot be less."""
        if self.pupil_error > self.worst / math.sqrt(2):
            return f"PSFs err by {self.pupil_error:.1e}, for the pupil's rim is sampled in cells"
        return (
            f"between {self._many} the lens's PSFs are interpolated, "
            f"which errs by {self.worst:.1e}, and a bank takes no more fields"
        )

    @property
    def text(self) -> str:
        """What was chosen, in words."""
        return f"PSFs of {self._many}, what lies between interpolated"

    @property
    def _many(self) -> str:
        side, lines = len(self.side_deg), len(self.wavelengths_nm)
        return f"{side} x {side} fields x {lines} wavelengths"


@dataclass(frozen=True, eq=False)
class LensShare:
    """What a tolerance leaves to the engine: the rest is the bank's, and of light beyond it.

    Attributes
    ----------
    density : AnyDensity
    bank : FieldBank
        Bank that was made so.
    corner_um : float
        From the middle of the sensor to its corner.
    """

    density: AnyDensity
    bank: FieldBank
    corner_um: float

    @cached_property
    def window(self) -> float:
        """What the light beyond the last level costs: it is spread evenly, and dark pixels lack it.

        In a scene half black and half white, a black pixel lacks half of it times the contrast, as
        far as it lands on the sensor.
        """
        beyond = getattr(self.bank, "beyond_energy", None)
        if beyond is None:
            return 0.0
        farthest = min(self.corner_um, self.bank.rectilinear_circle_um)
        landing = landing_share(self.bank, np.linspace(0.0, farthest, LOOKED_AT))
        share = float(beyond.max() * landing.max())
        contrast = self.density.ratio
        return share * (1 + 1 / contrast) / 2 * math.sqrt((contrast**2 + 1) / 2)

    def excess(self, tolerance: float) -> float:
        """Return what is not the engine's over what it may be of a tolerance, at most."""
        return (self.density.worst + self.window) / (MOST_SHARE * tolerance)

    def left_of(self, tolerance: float) -> float:
        """Return the engine's part of a tolerance: squares add, but for light that is lost."""
        most = MOST_SHARE * tolerance
        window = min(self.window, most)
        of_bank = min(self.density.worst, most - window)
        left = math.sqrt((tolerance - window) ** 2 - of_bank**2) / ENGINE
        return min(max(left, SMALLEST), tolerance)

    @property
    def stages(self) -> tuple[PlanStage, ...]:
        """Describe them."""
        return (
            PlanStage("bank", True, self.density.text, self.density.rms),
            PlanStage("window", True, "light beyond the bank's widest level", self.window),
        )

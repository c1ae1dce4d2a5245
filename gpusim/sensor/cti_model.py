"""What a sensor file says of charge-transfer inefficiency, along columns or along rows."""

from __future__ import annotations

from pydantic import Field, model_validator

from gpusim.config.model import Strict, wrong
from gpusim.sensor.strict import NotNegative, Positive

MAX_SPECIES = 4


class Species(Strict):
    """One kind of charge trap.

    Attributes
    ----------
    density : float
        Traps in each element that the charge is shifted through.
    release_transfers : float
        Time constant of the release, in transfers: an element's dwell time is 1.
    """

    density: NotNegative
    release_transfers: Positive


class Cti(Strict):
    """Charge left behind in transfers: a constant fraction, or what traps hold for a while.

    Attributes
    ----------
    inefficiency : float
        The linear model: fraction of each packet that each transfer leaves behind.
    traps : tuple of Species
        The model of traps (Massey et al. 2009, 2014), in its place: up to four kinds.
    well_fill_power : float
        beta: a packet of n electrons fills ((n - notch) / (full well - notch))^beta of the volume
        of an element, and all traps therein.
    well_e : float
        The full well of that law, electrons; by default the sensor's.
    notch_e : float
        Electrons that are held where there are no traps.
    groups : int
        Into how many groups the transfers of the farthest packet are gathered: the more, the
        closer to one transfer after the other.
    """

    inefficiency: float | None = Field(default=None, gt=0, lt=1)
    traps: tuple[Species, ...] = Field(default=(), max_length=MAX_SPECIES)
    well_fill_power: Positive = 0.58
    well_e: Positive | None = None
    notch_e: NotNegative = 0.0
    groups: int = Field(default=2, ge=1, le=4096)

    @model_validator(mode="after")
    def _one_model(self) -> Cti:
        if (self.inefficiency is None) == (not self.traps):
            given = "both an inefficiency and traps" if self.traps else "neither of the models"
            raise wrong(f"the file gives {given}", "inefficiency, or traps")
        if self.well_e is not None and self.notch_e >= self.well_e:
            raise wrong(
                f"notch_e {self.notch_e:g} holds the whole well", f"below well_e {self.well_e:g}"
            )
        return self

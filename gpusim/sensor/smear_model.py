"""What a sensor file says of a CCD's smear."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from gpusim.config.model import Strict, wrong
from gpusim.sensor.strict import Positive


class Smear(Strict):
    """Light that makes charge while the charge is shifted along the columns, towards row 0.

    Attributes
    ----------
    kind : str
        "interline": the vertical registers beside the photosites are clocked, line by line, while
        the next frame is exposed; ``leak`` of the light reaches them. "frame_transfer": the lit
        photosites themselves are shifted into a store.
    row_s : float
        Seconds that a packet stays in each row: of an interline sensor the time of a line, of
        frame transfer the period of the fast vertical clock.
    leak : float
        Interline only: share of a photosite's light that makes charge in the register.
    cleared_by_shift : bool
        Frame transfer only: the columns were shifted through before the exposure too, by the clear
        or by the transfer of the frame before. Each packet's well then came from the far end.
    """

    kind: Literal["interline", "frame_transfer"]
    row_s: Positive
    leak: float | None = Field(default=None, gt=0, lt=1)
    cleared_by_shift: bool = True

    @model_validator(mode="after")
    def _by_kind(self) -> Smear:
        if (self.kind == "interline") != (self.leak is not None):
            raise wrong(
                f"smear of kind {self.kind} {'without' if self.leak is None else 'with'} a leak",
                "leak with interline, and with nothing else",
            )
        return self

    @property
    def weight_s(self) -> float:
        """Electrons for each electron/s of each row that is passed."""
        return self.row_s * (1.0 if self.leak is None else self.leak)

"""What the models of sensor files share: strict fields, and errors that say what is allowed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

from gpusim.scene.spectra import WAVELENGTHS_NM

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class Strict(BaseModel):
    """A part of a sensor file: no unknown fields, no NaN, nothing to change afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values, without what was worked out from those before."""
        copied = super().model_copy(update=update, deep=deep)
        for name in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[name]
        return copied


def wrong(
    problem: str, allowed: str, *, field: str | None = None, value: object = None
) -> PydanticCustomError:
    """Return what a validator raises; one of several fields says of which, and its value."""
    known = {"problem": problem, "allowed": allowed, "field": field, "value": value}
    return PydanticCustomError("sensor", "{problem}", known)


def check_grid(wavelengths_nm: Sequence[float]) -> None:
    """Refuse wavelengths that do not rise or do not reach over the grid of all spectra."""
    if any(b <= a for a, b in pairwise(wavelengths_nm)):
        raise wrong("the wavelengths do not rise", "nm, each more than the one before")
    first, last = WAVELENGTHS_NM[[0, -1]]
    if not wavelengths_nm or wavelengths_nm[0] > first or wavelengths_nm[-1] < last:
        raise wrong("the wavelengths end too soon", f"{first:g} to {last:g} nm, or beyond")

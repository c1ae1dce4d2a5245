"""What the models of sensor files share: strict fields, and errors that say what is allowed."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class Strict(BaseModel):
    """A part of a sensor file: no unknown fields, no NaN, nothing to change afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def wrong(
    problem: str, allowed: str, *, field: str | None = None, value: object = None
) -> PydanticCustomError:
    """Return what a validator raises; one of several fields says of which, and its value."""
    known = {"problem": problem, "allowed": allowed, "field": field, "value": value}
    return PydanticCustomError("sensor", "{problem}", known)

"""The base of all that is read from a file: strict fields, frozen values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any, Self, get_args

from pydantic import BaseModel, ConfigDict, field_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from gpusim.config.text import UNSEEN


class Strict(BaseModel):
    """A part of a file: no unknown fields, no NaN, no yes or no for a number, nothing to change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _plain(cls, value: object, info: Any) -> object:
        """Refuse true and false where numbers stand, and texts that steer a terminal.

        Python takes the former for 1 and 0.
        """
        if info.field_name not in _plain_fields(cls):
            return value
        for leaf in _leaves(value):
            if isinstance(leaf, bool):
                raise PydanticCustomError(
                    "truth", "Input should be a number or a text, not true or false"
                )
            if isinstance(leaf, str) and UNSEEN.search(leaf):
                raise PydanticCustomError("unseen", "a text without control characters")
        return value

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values, without what was worked out from those before."""
        copied = super().model_copy(update=update, deep=deep)
        for name in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[name]
        return copied


def wrong(
    problem: str, allowed: str, *, field: str | None = None, value: object = None
) -> PydanticCustomError:
    """Return what a validator of several fields raises: it names one of them, and its value."""
    known = {"problem": problem, "allowed": allowed, "field": field, "value": value}
    return PydanticCustomError("contradiction", "{problem}", known)


@lru_cache(maxsize=None)
def _plain_fields(model: type[BaseModel]) -> frozenset[str]:
    """Return the fields of a model in which no truth value, model or arbitrary value stands."""
    return frozenset(name for name, info in model.model_fields.items() if not _may(info))


def _may(info: FieldInfo) -> bool:
    waiting = [info.annotation]
    while waiting:
        one = waiting.pop()
        if one in (bool, object, Any) or (isinstance(one, type) and issubclass(one, BaseModel)):
            return True
        waiting.extend(get_args(one))
    return False


def _leaves(value: object) -> Iterator[object]:
    if isinstance(value, list | tuple | dict):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _leaves(one)
    else:
        yield value

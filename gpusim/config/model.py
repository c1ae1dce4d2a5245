"""The base of all that is read from a file: strict fields, frozen values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Annotated, Any, NoReturn, Self, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    ValidationError,
    ValidatorFunctionWrapHandler,
    field_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError
from pydantic_core.core_schema import no_info_wrap_validator_function

from gpusim.config.mistakes import user_error
from gpusim.config.text import UNSEEN

_SURE = frozenset({float, int, type(None)})  # the most of all fields: nothing to look for

Key = TypeVar("Key")
Value = TypeVar("Value")


class Fixed(dict[Key, Value]):
    """A dict that nothing can change: what a frozen model holds by name.

    A dict still, for JSON and pickles; `types.MappingProxyType` is neither written nor hashed.
    """

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TypeError("the value cannot be changed in place; model_copy gives a changed one")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __hash__(self) -> int:
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[type[Self], tuple[dict[Key, Value]]]:
        return type(self), (dict(self),)


# A table of a frozen model, by name; its lists are tuples.
Table = Annotated[dict[str, Value], AfterValidator(Fixed)]


class Strict(BaseModel):
    """A part of a file: no unknown fields, no NaN, no yes or no for a number, nothing to change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def __get_pydantic_core_schema__(
        cls, source: type[BaseModel], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Take a part that is made already as it is: it was checked, and cannot have changed."""

        def unless_made(value: object, check: ValidatorFunctionWrapHandler) -> object:
            return value if isinstance(value, cls) else check(value)

        return no_info_wrap_validator_function(unless_made, handler(source))

    @field_validator("*", mode="before")
    @classmethod
    def _plain(cls, value: object, info: Any) -> object:
        """Refuse true and false where numbers stand, and texts that steer a terminal.

        Python takes the former for 1 and 0.
        """
        if type(value) in _SURE or info.field_name not in _plain_fields(cls):
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
        """Return a copy with other values, without what was worked out from those before.

        Raises
        ------
        UserError
            A value is wrong, unknown, or contradicts another.
        """
        if not update:
            return self.unchecked(deep=deep)
        own = {name: self.__dict__[name] for name in type(self).model_fields}
        try:
            made = type(self).model_validate({**own, **update})
        except ValidationError as error:
            raise user_error(error, type(self)) from error
        # Private attributes stay, and so do the values that neither caller nor checks changed.
        changed = {
            name: made.__dict__[name]
            for name, before in own.items()
            if name in update or made.__dict__[name] != before
        }
        return self.unchecked(deep=deep, **changed)

    def unchecked(self, *, deep: bool = False, **update: object) -> Self:
        """Return a copy with values that no file may hold, for stages that want them so."""
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

"""What a finding in a sensor file means to its user: one clear screen."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError

from gpusim.errors import UserError

# What the end of a field's name says of its value; of two that fit, the first.
UNITS = {
    "_dn_per_e": "DN per electron",
    "_e_per_s": "electrons per second",
    "_nm": "nm",
    "_um": "um",
    "_s": "seconds",
    "_e": "electrons",
    "_dn": "DN",
    "_percent": "per cent",
    "_c": "degrees Celsius; absolute zero is -273.15",
}
LONGEST_VALUE = 60  # characters that a screen shows


def read_yaml(path: Path) -> object:
    """Return what a sensor file holds.

    Raises
    ------
    UserError
        It cannot be read, or is no YAML.
    """
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"the sensor file cannot be read: {error}", file=path) from error
    except yaml.YAMLError as error:
        raise UserError(f"the sensor file is not YAML: {error}", file=path) from error


def user_error(error: ValidationError, model: type[BaseModel], path: Path) -> UserError:
    """Return the first finding in a file as the user's mistake.

    Parameters
    ----------
    error : ValidationError
        Of the file's content.
    model : type of BaseModel
        What the file was held against.
    path : Path
        The file.
    """
    first = error.errors()[0]
    where, value = first["loc"], first["input"]
    field = ".".join(str(part) for part in where) or None
    match first["type"]:
        case "sensor":
            known = first["ctx"]
            inner = ".".join(part for part in (field, known["field"]) if part)
            return UserError(
                known["problem"],
                file=path,
                field=inner or None,
                value=_shown(value) if known["value"] is None else known["value"],
                allowed=known["allowed"],
            )
        case "missing":
            fields = _fields(model, where[:-1])
            needed = [name for name, info in fields.items() if info.is_required()]
            return UserError(
                "a field is missing", file=path, field=field, allowed=f"all of {', '.join(needed)}"
            )
        case "extra_forbidden":
            fields = list(_fields(model, where[:-1]))
            near = get_close_matches(str(where[-1]), fields, n=1)
            hint = f": perhaps {near[0]} is meant" if near else ""
            return UserError(
                f"unknown field{hint}",
                file=path,
                field=field,
                value=_shown(value),
                allowed=", ".join(fields),
            )
        case "model_type":
            names = ", ".join(_fields(model, where))
            found = "nothing" if value is None else f"{_shown(value) or type(value).__name__}"
            return UserError(
                "no fields with values where these should be",
                file=path,
                field=field,
                value=found,
                allowed=f"lines `field: value` of {names}",
            )
    allowed = first["msg"].removeprefix("Input should be ")
    names = [part for part in where if isinstance(part, str)]
    unit = next((unit for end, unit in UNITS.items() if names and names[-1].endswith(end)), None)
    return UserError(
        "a field is wrong",
        file=path,
        field=field,
        value=value,
        allowed=allowed if unit is None else f"{allowed} ({unit})",
    )


def _fields(model: type[BaseModel], where: tuple[str | int, ...]) -> dict:
    """Return the fields of the model that stands at a place inside another."""
    for part in where:
        info = model.model_fields.get(part)
        inner = None if info is None else _model_in(info.annotation)
        if inner is not None:
            model = inner
    return model.model_fields


def _model_in(annotation: object) -> type[BaseModel] | None:
    """Return the model that an annotation names: alone, optional, or as items of a list."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) in (Union, UnionType, list, tuple, dict):
        found = (_model_in(one) for one in get_args(annotation))
        return next((one for one in found if one is not None), None)
    return None


def _shown(value: object) -> str | None:
    """Return a value as a screen shows it; a large one is not shown."""
    text = str(value)
    return None if isinstance(value, dict) or len(text) > LONGEST_VALUE else text

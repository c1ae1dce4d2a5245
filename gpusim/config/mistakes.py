"""What a finding in a file means to its user: one clear screen."""

from __future__ import annotations

from pathlib import Path
from types import UnionType
from typing import Annotated, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from gpusim.config.names import nearest, perhaps
from gpusim.errors import UserError

# What the end of a field's name says of its value; of two that fit, the first.
UNITS = {
    "_dn_per_e": "DN per electron",
    "_e_per_s": "electrons per second",
    "_deg": "degrees",
    "_mm": "mm",
    "_nm": "nm",
    "_um": "um",
    "_s": "seconds",
    "_e": "electrons",
    "_dn": "DN",
    "_percent": "per cent",
    "_c": "degrees Celsius; absolute zero is -273.15",
}
# What pydantic says of a value of another kind, in our words: a text that is no number, a fraction.
KINDS = {
    **dict.fromkeys(("int_type", "int_parsing", "int_parsing_size"), "a whole number"),
    "int_from_float": "a whole number",
    "tuple_type": "a list",
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
}
LONGEST_VALUE = 60  # characters that a screen shows

Model = TypeVar("Model", bound=BaseModel)


def checked(model: type[Model], data: object, path: Path, **context: object) -> Model:
    """Return the model of what a file holds.

    Parameters
    ----------
    model : type of BaseModel
    data : object
    path : Path
        The file.
    **context
        What the model's validators need.

    Raises
    ------
    UserError
        A field is wrong, unknown or missing.
    """
    try:
        return model.model_validate(data, context=context)
    except ValidationError as error:
        raise user_error(error, model, path) from error
    except UserError as error:  # of a model that told its mistake itself: it knew no file
        error.file = error.file or path
        raise
    except RecursionError as error:
        raise UserError("lists and mappings are too deep", file=path) from error


def user_error(
    error: ValidationError, model: type[BaseModel], path: Path | None = None
) -> UserError:
    """Return what was found in a file as the user's mistake.

    That is the first unknown field, with the one that is likely meant; else the first wrong one;
    else all that are missing. Whatever it is, it names the missing ones too. Places in lists count
    from 1.

    Parameters
    ----------
    error : ValidationError
        What is wrong with the file's content.
    model : type of BaseModel
        What the file was held against.
    path : Path, optional
        The file; none where the fields came from Python.
    """
    found = error.errors()
    missing = [one for one in found if one["type"] == "missing"]
    unknown = [one for one in found if one["type"] == "extra_forbidden"]
    others = [one for one in found if one not in missing and one not in unknown]
    if unknown:
        # A wrong name explains a missing field: it is told first, where it explains one.
        lacking = {one["loc"][-1] for one in missing}
        unknown.sort(
            key=lambda one: nearest(one["loc"][-1], _fields(model, one["loc"][:-1])) not in lacking
        )
        made = _unknown(unknown[0], model, path)
    elif others:
        made = _wrong(others[0], model, path)
    else:
        return _missing(missing, model, path)
    if missing:
        made.problem += f"; missing: {', '.join(_place(one['loc']) for one in missing)}"
    return made


def _unknown(finding: dict, model: type[BaseModel], path: Path | None) -> UserError:
    where = finding["loc"]
    fields = list(_fields(model, where[:-1]))
    return UserError(
        f"unknown field{perhaps(where[-1], fields)}",
        file=path,
        field=_place(where),
        value=_shown(finding["input"]),
        allowed=", ".join(fields),
    )


def _missing(findings: list[dict], model: type[BaseModel], path: Path | None) -> UserError:
    fields = _fields(model, findings[0]["loc"][:-1])
    needed = [name for name, info in fields.items() if info.is_required()]
    return UserError(
        "a field is missing" if len(findings) == 1 else f"{len(findings)} fields are missing",
        file=path,
        field=", ".join(_place(one["loc"]) for one in findings),
        allowed=f"all of {', '.join(needed)}",
    )


def _wrong(finding: dict, model: type[BaseModel], path: Path | None) -> UserError:
    where, value = finding["loc"], finding["input"]
    field = _place(where) or None
    if finding["type"] == "contradiction":
        known = finding["ctx"]
        inner = ".".join(part for part in (field, known["field"]) if part)
        return UserError(
            known["problem"],
            file=path,
            field=inner or None,
            value=_shown(value) if known["value"] is None else known["value"],
            allowed=known["allowed"],
        )
    if finding["type"] == "model_type":
        return UserError(
            "no fields with values where these should be",
            file=path,
            field=field,
            value="nothing" if value is None else f"{_shown(value) or type(value).__name__}",
            allowed=f"lines `field: value` of {', '.join(_fields(model, where))}",
        )
    told = (
        finding["msg"]
        .removeprefix("Input should be ")
        .removeprefix("Value error, ")
        .replace("Tuple", "List")
    )
    allowed = KINDS.get(finding["type"], told)
    names = [part for part in where if isinstance(part, str)]
    unit = next((unit for end, unit in UNITS.items() if names and names[-1].endswith(end)), None)
    return UserError(
        "a field is wrong",
        file=path,
        field=field,
        value=_shown(value),
        allowed=allowed if unit is None else f"{allowed} ({unit})",
    )


def _place(location: tuple[str | int, ...]) -> str:
    """Return the dotted place of a field, the entries of lists counted from 1."""
    return ".".join(str(part + 1) if isinstance(part, int) else str(part) for part in location)


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
    if get_origin(annotation) in (Union, UnionType, Annotated, list, tuple, dict):
        found = (_model_in(one) for one in get_args(annotation))
        return next((one for one in found if one is not None), None)
    return None


def _shown(value: object) -> object:
    """Return a value as a screen shows it; a large one is not shown."""
    if isinstance(value, int | float):
        return value
    if isinstance(value, dict | list | tuple) and len(value) > LONGEST_VALUE:
        return None
    text = str(value)
    return None if isinstance(value, dict) or len(text) > LONGEST_VALUE else text

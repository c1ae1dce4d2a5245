"""Values of Speos' sensor files: mappings, and numbers with their units."""

from __future__ import annotations

import math
from pathlib import Path

from gpusim.errors import UserError


def mapping(file: Path, value: object, field: str) -> dict:
    """Return a mapping with its keys in small letters."""
    if not isinstance(value, dict):
        raise UserError(
            "no keys with values where these should be", file=file, field=field, value=value
        )
    return {str(key).strip().lower(): inner for key, inner in value.items()}


def only(file: Path, path: str, found: dict, known: tuple[str, ...]) -> None:
    """Refuse keys that the exporter's documentation does not list."""
    for key in found:
        if key not in known:
            raise UserError(
                "unknown key",
                file=file,
                field=f"{path}.{key}".removeprefix("."),
                value=found[key],
                allowed=", ".join(known),
            )


def number(file: Path, field: str, value: object) -> float:
    """Return a finite number; refuse what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UserError("not a number", file=file, field=field, value=value, allowed="a number")
    return value


def split(file: Path, field: str, value: object) -> tuple[float, str | None]:
    """Return a number and its unit in small letters, which need not be there."""
    unit = None
    if isinstance(value, dict):
        inner = mapping(file, value, field)
        only(file, field, inner, ("value", "unit"))
        value, unit = inner.get("value"), inner.get("unit")
    return number(file, field, value), None if unit is None else str(unit).strip().lower()


def with_unit(file: Path, field: str, value: object, units: dict[str, float]) -> float:
    """Return a number in the first of some units, from any of them."""
    found, unit = split(file, field, value)
    if unit is not None and unit not in units:
        raise unit_error(file, field, unit, tuple(units))
    return found * (next(iter(units.values())) if unit is None else units[unit])


def unit_error(file: Path, field: str, unit: str, known: tuple[str, ...]) -> UserError:
    """Return the mistake of a unit that is not among those known."""
    return UserError(
        "unknown unit", file=file, field=f"{field}.Unit", value=unit, allowed=", ".join(known)
    )

"""One number of a lens changed: a surface's shape, place or glass, or where an element lies.

Names: ``NUMBER.WHAT`` of a surface, ``element.FIRST-LAST.WHAT`` of an element as one rigid body.
``all`` in place of the number, or of FIRST-LAST, stands for each that has such a number.
"""

from __future__ import annotations

import math
import re
from itertools import pairwise
from typing import Any

import numpy as np
from pydantic import ValidationError

from gpusim.config.mistakes import user_error
from gpusim.errors import UserError
from gpusim.lens.glass import surface_index, surface_known
from gpusim.lens.prescription import Prescription
from gpusim.lens.surface import Dispersion, Surface

OF_ELEMENT = ("decentre_x_mm", "decentre_y_mm", "tilt_x_deg", "tilt_y_deg")
OF_SURFACE = ("radius", "curvature", "thickness", "nd", *OF_ELEMENT)
_NAME = re.compile(r"(?:(\d+)|element\.(\d+)-(\d+)|(all|element\.all))\.(\w+)", re.ASCII)
# A glass whose index is moved gets a formula through its own indices, which it meets within 3e-7
# from 400 to 700 nm (tests/lens/test_perturb.py).
FITTED_NM = (380.0, 1100.0)
EXTENDED_3, POWERS = 13, (0, 2, 4, -2, -4, -6, -8, -10, -12)


def names_part(name: str, *, several: bool = False) -> bool:
    """Return whether a name has the form of one number of a lens; ``several``: or of ``all``."""
    found = _NAME.fullmatch(name)
    if found is None or (found[4] and not several):
        return False
    surface = found[1] or found[4] == "all"
    return found[5] in (OF_SURFACE if surface else OF_ELEMENT)


def parts(lens: Prescription, name: str) -> list[str]:
    """Return the names that a name with ``all`` stands for; of another, itself."""
    found = _NAME.fullmatch(name)
    if not found[4]:
        return [name]
    what = found[5]
    if found[4] == "element.all":
        return [f"element.{a}-{b}.{what}" for a, b in elements(lens)]
    numbers = range(1, len(lens.surfaces) + 1)
    return [f"{n}.{what}" for n in numbers if _has(lens, n, what)]


def elements(lens: Prescription) -> list[tuple[int, int]]:
    """Return the first and last surface, from 1, of each run of glass between air and air."""
    glass = [False, *(surface.glass is not None for surface in lens.surfaces)]
    first, found = 0, []
    for number, (before, behind) in enumerate(pairwise(glass), start=1):
        if behind and not before:
            first = number
        elif before and not behind:
            found.append((first, number))
    return found


def _has(lens: Prescription, number: int, what: str) -> bool:
    surface = lens.surfaces[number - 1]
    before = lens.surfaces[number - 2].glass if number > 1 else None
    if what == "thickness":
        return number < len(lens.surfaces)
    if what == "nd":
        return surface.glass is not None
    if what == "radius" and (surface.radius is None or math.isinf(surface.radius)):
        return False
    # A diaphragm in air bends nothing.
    return surface.glass is not None or before is not None


def perturbed(lens: Prescription, name: str, value: float, field: str) -> Prescription:
    """Return a lens with one number changed by a value.

    Parameters
    ----------
    lens : Prescription
    name : str
        As `names_part` takes it.
    value : float
        Change: mm, 1/mm, degrees, or of the index.
    field : str
        What the error names.

    Raises
    ------
    UserError
        The lens has no such surface, or the surface no such number.
    """
    if not hasattr(lens, "surfaces"):
        raise UserError("a ready-made lens has no surfaces", field=field, allowed="none")
    number, first, last, _, what = _NAME.fullmatch(name).groups()
    count = len(lens.surfaces)
    if not 1 <= int(number or first) <= int(number or last) <= count:
        raise UserError(
            "no such surface",
            field=field,
            value=number or f"{first}-{last}",
            allowed=f"1 to {count}",
        )
    if number is None:
        move = (value, 0.0) if "_x_" in what else (0.0, value)
        kind = "decentre_mm" if what.startswith("decentre") else "tilt_deg"
        return lens.with_element_moved(int(first), int(last), **{kind: move})
    surfaces = list(lens.surfaces)
    old = surfaces[int(number) - 1]
    update = _update(lens, int(number), what, value, field)
    try:
        surfaces[int(number) - 1] = Surface.model_validate(old.model_dump() | update)
    except ValidationError as error:
        raise user_error(error, Surface) from error
    return lens.derived(f"surface {number}: {what} {value:+g}", surfaces=tuple(surfaces))


def _update(lens: Prescription, number: int, what: str, value: float, field: str) -> dict[str, Any]:
    surface = lens.surfaces[number - 1]
    if what in OF_ELEMENT:
        along = 0 if "_x_" in what else 1
        name = "decentre_mm" if what.startswith("decentre") else "tilt_deg"
        moved = list(getattr(surface, name))
        moved[along] += value
        return {name: tuple(moved)}
    if what == "curvature":
        return {"radius": None, "curvature": surface.vertex_curvature + value}
    if what == "nd" and surface.glass not in (None, "model", "constant"):
        return {"dispersion": _moved_index(surface, number, lens, value)}
    old = getattr(surface, what)
    if old is None or math.isinf(old):
        raise UserError(
            f"surface {number} has no {what}" if old is None else f"surface {number} is a plane",
            field=field,
            allowed="a surface that has one; any has a curvature",
        )
    return {what: old + value}


def _moved_index(surface: Surface, number: int, lens: Prescription, value: float) -> Dispersion:
    """Return the dispersion of a glass whose index is moved by as much at every wavelength."""
    file = lens.file
    known = surface_known(surface, number, lens.glass_catalogues, file=file)
    low = FITTED_NM[0] if known is None else max(FITTED_NM[0], known.first_nm)
    high = FITTED_NM[1] if known is None else min(FITTED_NM[1], known.last_nm)
    # Even in 1 / wavelength, in which glass disperses nearly evenly.
    at = 1 / np.linspace(1 / low, 1 / high, 200)
    index = surface_index(surface, number, lens.glass_catalogues, at, file=file) + value
    if not (index > 1).all():
        raise UserError(
            f"the index of glass {surface.glass} of surface {number} cannot be moved so far",
            field="nd",
            value=f"{index.min():.4g}",
            allowed="greater than 1",
        )
    powers = (1e-3 * at)[:, None] ** np.array(POWERS)
    scale = powers.max(axis=0)
    found = np.linalg.lstsq(powers / scale, index**2, rcond=None)[0] / scale
    old = None if surface.dispersion is None else surface.dispersion.absorption
    return Dispersion(
        formula=EXTENDED_3,
        coefficients=tuple(float(one) for one in found),
        range_um=(1e-3 * low, 1e-3 * high),
        absorption=old,
    )

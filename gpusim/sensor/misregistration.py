"""A filter array that lies beside its pixels: each sees a mixture of the filters over it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from gpusim.errors import UserError
from gpusim.sensor.cfa import ColourFilterArray

if TYPE_CHECKING:
    from gpusim.sensor.sensor import Sensor

Names = list[list[str]]
Mixture = tuple[tuple[str, float], ...]


def shares_along(shift: float, low: float, high: float) -> list[tuple[int, float]]:
    """Return which filters lie over an aperture along one axis, and what share of it each covers.

    Parameters
    ----------
    shift : float
        Shift of the filters against the pixels, pixels; less than 1 in size.
    low, high : float
        Ends of the aperture, pixels from the pixel's middle.

    Returns
    -------
    list of (int, float)
        Filters, counted from the pixel's own; the shares sum to 1.
    """
    found = []
    for number in (-1, 0, 1):
        first = number + shift - 0.5
        covered = min(high, first + 1) - max(low, first)
        if covered > 0:
            found.append((number, covered / (high - low)))
    return found


def mixed_pattern(
    pattern: Names, shift: tuple[float, float], side: float
) -> tuple[Names, dict[str, Mixture]]:
    """Return the channels of the sites under a shifted filter array, and what they are made of.

    Sites of one letter whose neighbours are unlike become channels of their own: those that see the
    same mixture share a name, and the first of a letter keeps the pattern's.

    Parameters
    ----------
    pattern : list of list of str
        Channels of the filters, row by row.
    shift : (float, float)
        x, y of the filters against the pixels, pixels: to the right, and down.
    side : float
        Side of the square aperture in the middle of the pixel, pixels.

    Returns
    -------
    names : list of list of str
        By site.
    mixtures : dict of tuple
        For each name: channels of the filters, with their shares.
    """
    py, px = len(pattern), len(pattern[0])
    across, down = (shares_along(one, -side / 2, side / 2) for one in shift)
    names: Names = [[""] * px for _ in range(py)]
    found: dict[tuple[str, Mixture], str] = {}
    for row, col in np.ndindex(py, px):
        parts: dict[str, float] = {}
        for i, above in down:
            for j, beside in across:
                filter_ = pattern[(row + i) % py][(col + j) % px]
                parts[filter_] = parts.get(filter_, 0.0) + above * beside
        own = pattern[row][col]
        key = own, tuple(sorted((name, round(share, 12)) for name, share in parts.items()))
        if key not in found:
            alike = sum(name == own for name, _ in found)
            found[key] = own if not alike else f"{own}{alike + 1}"
        names[row][col] = found[key]
    return names, {name: mixture for (_, mixture), name in found.items()}


def mixed(sensor: Sensor) -> Sensor:
    """Return the sensor whose channels are the mixtures that its pixels see.

    A filter array may lie beside its pixels (``cfa.shift_px``). Each photosite then sees the
    filters over it in proportion to the part of its aperture that they cover. Sites of one letter
    become unlike channels (Gr, Gb). Scene and image are sampled as before; the aperture is taken to
    see one mixture all over.

    Raises
    ------
    UserError
        Another field tells channels apart by their names, which change here.
    """
    if not any(sensor.cfa.shift_px):
        return sensor
    by_name = {
        "channel_black_level_dn": sensor.channel_black_level_dn,
        "eqe_map": sensor.eqe_map,
        "aperture": sensor.aperture,
    }
    if sensor.crosstalk:
        kernels = (sensor.crosstalk.optical, sensor.crosstalk.electrical)
        by_name["crosstalk"] = any(one and set(one.root) != {"*"} for one in kernels)
    for field, given in by_name.items():
        if given:
            raise UserError(
                "the filters' shift makes other channels, of a square aperture",
                field=field,
                allowed="no such field, or the same for all channels; or cfa.pattern and "
                "quantum_efficiency with the mixtures, and no shift",
            )
    names, mixtures = mixed_pattern(
        sensor.cfa.pattern, sensor.cfa.shift_px, math.sqrt(sensor.fill_factor)
    )
    measured = sensor.quantum_efficiency
    curves = {
        name: sum(share * np.array(measured.channels[one]) for one, share in mixture).tolist()
        for name, mixture in mixtures.items()
    }
    return sensor.model_copy(
        update={
            "cfa": ColourFilterArray(pattern=names),
            "quantum_efficiency": measured.model_copy(update={"channels": curves}),
        }
    )

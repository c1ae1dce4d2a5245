"""A picture in a few numbers: what a table of many pictures holds of each."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gpusim.errors import UserError
from gpusim.metrics.colour import measure_colour
from gpusim.metrics.distortion import measure_distortion
from gpusim.metrics.picture import Plane, most_frequent
from gpusim.metrics.regions import find_regions
from gpusim.metrics.sfr import measure_sfr
from gpusim.metrics.shading import measure_shading

Planes = dict[str, Plane]


def _sfr(planes: Planes) -> dict[str, float]:
    plane = planes[most_frequent(planes)]
    falls = []
    for region in find_regions(plane):
        try:
            found = measure_sfr(plane.values, region.box, sites=plane.sites, clip=plane.clip)
        except UserError:  # a region that is too flat, too small or clipped: the others count
            continue
        half = found.falls_to(0.5)
        if half is not None:
            falls.append(half.value)
    if not falls:
        raise UserError("No slanted edge is found in the picture.")
    return {
        "edges": len(falls),
        "mtf50_median_cy_px": float(np.median(falls)),
        "mtf50_least_cy_px": min(falls),
    }


def _distortion(planes: Planes) -> dict[str, float]:
    found = measure_distortion(planes)
    farthest = int(found.radius.argmax())
    return {
        "marks": len(found.radius),
        "farthest": float(found.radius[farthest]),
        "lgd_percent": 100 * float(found.lgd[farthest]),
        "lateral_colour_px": max((abs(one.largest_px) for one in found.shifts), default=0.0),
    }


def _colour(planes: Planes) -> dict[str, float]:
    away = measure_colour(planes).fitted.delta_e["2000"]
    return {"de2000_mean": float(away.mean()), "de2000_largest": float(away.max())}


def _shading(planes: Planes) -> dict[str, float]:
    name = most_frequent(planes)
    found = measure_shading(planes[name], name)
    return {"darkest_corner": min(found.corners), "unevenness": found.unevenness}


_MEASURES = {"sfr": _sfr, "distortion": _distortion, "colour": _colour, "shading": _shading}
MEASURES = tuple(_MEASURES)


def summary(planes: Planes, names: Iterable[str]) -> tuple[dict[str, float], dict[str, str]]:
    """Measure a picture in several ways, each of which may fail.

    Parameters
    ----------
    planes : dict of str to Plane
    names : iterable of str
        Any of `MEASURES`: ``sfr`` of all edges that are found, ``distortion`` of a checkerboard or
        dots, ``colour`` of a ColorChecker under D65, ``shading`` of an even field.

    Returns
    -------
    figures : dict of str to float
        ``sfr.mtf50_median_cy_px`` and so on.
    failed : dict of str to str
        Why a measure has no figures: the picture does not show what it measures.
    """
    figures, failed = {}, {}
    for name in names:
        try:
            figures |= {f"{name}.{what}": value for what, value in _MEASURES[name](planes).items()}
        except UserError as error:
            failed[name] = error.problem
    return figures, failed

"""Aiming real rays at points of the stop, in float64: chief rays first, then any other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gpusim.lens.geometry import Geometry
from gpusim.lens.launch import Launch
from gpusim.lens.trace import entrance_pupil, trace

# The walk from the axis to a field takes steps of at most 5 deg and at least 5 / 2^5 deg.
WALK_STEP = np.radians(5.0)
WALK_HALVINGS = 5
# A miss of 1e-9 of the stop radius moves the chief ray by about 1e-9 f: 1e-5 um at f = 8 mm.
AIM_TOLERANCE = 1e-9
AIM_ITERATIONS = 15  # Newton: 3 to 5 on real lenses


def launch_field(
    geometry: Geometry,
    index: np.ndarray,
    theta: float,
    tolerance_mm: float,
    azimuth: float = 0.0,
    *,
    start: Launch | None = None,
) -> tuple[Launch, np.ndarray]:
    """Find the real chief rays of a field and the launch plane on them.

    The chief ray is walked out from the axis: each step turns the last one about the point where
    it met the one before, which is the real entrance pupil, and Newton does the rest. A step that
    loses the ray is halved.

    Parameters
    ----------
    geometry, index
        As for ``trace``.
    theta : float
        Field angle, rad.
    tolerance_mm : float
        Accepted miss at the centre of the stop.
    azimuth : float
        Azimuth of the field, rad.
    start : Launch, optional
        A field's of the same azimuth, from which the walk begins in place of the axis.

    Returns
    -------
    launch : Launch
        Its base is where the chief ray of each wavelength meets the first surface.
    found : ndarray of bool, shape (L,)
        False where no chief ray was found; the base means nothing then.
    """
    zero = np.zeros((index.shape[1], 1))

    def chief(guess: Launch) -> tuple[Launch, np.ndarray]:
        start, axis = (zero, zero), (0.0, 0.0)
        px, py, found = _newton(geometry, index, guess, start, axis, tolerance_mm=tolerance_mm)
        return replace(guess, base=guess.points(px, py)[:, :, 0]), found[:, 0]

    def field(angle: float) -> Launch:
        return Launch(angle, pivot, azimuth, geometry.source(angle, azimuth))

    pivot = np.zeros((3, index.shape[1]))
    pivot[2] = entrance_pupil(geometry, index)[0]
    if start is None:
        launch, found = chief(field(0.0))
    else:
        launch, found, pivot = start, np.ones(index.shape[1], bool), start.base
    step = WALK_STEP
    while found.all() and launch.theta != theta:
        left = theta - launch.theta
        angle = theta if abs(left) <= step else launch.theta + np.copysign(step, left)
        trial, reached = chief(field(angle))
        if reached.all():
            # Where the new chief ray crosses the old one, seen along the old field.
            e2, along = launch.e2, trial.direction
            apart = (e2 * (trial.base - launch.base)).sum(0) / (e2 * along).sum(0)
            pivot = trial.base - apart * along
            launch, step = trial, min(2 * step, WALK_STEP)
        elif step > WALK_STEP / 2**WALK_HALVINGS:
            step /= 2
        else:
            found = reached
    launch = replace(launch, theta=theta, source=geometry.source(theta, azimuth))
    rays = trace(geometry, index, launch, zero, zero, through=1)
    return replace(launch, base=rays.point[:, :, 0]), found & rays.ok[:, 0]


def aim(
    geometry: Geometry,
    index: np.ndarray,
    launch: Launch,
    stop_x: np.ndarray,
    stop_y: np.ndarray,
    *,
    tolerance_mm: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the rays that meet the stop surface at given points, by Newton on real rays.

    Parameters
    ----------
    geometry, index
        As for ``trace``.
    launch : Launch
        From ``launch_field``: the search starts at the chief ray.
    stop_x, stop_y : ndarray, shape (R,)
        Wanted intersections with the stop surface, from its own vertex, mm.
    tolerance_mm : float
        Accepted miss at the stop.

    Returns
    -------
    px, py : ndarray, shape (L, R)
        Where they cross the launch plane.
    ok : ndarray of bool, shape (L, R)
        False where no such ray was found.
    """
    zero = np.zeros((index.shape[1], 1))
    chief_x, chief_y, slopes, _ = _at_stop(
        geometry, index, launch, zero, zero, tolerance_mm=tolerance_mm
    )
    px, py, _ = _correction(slopes, stop_x - chief_x, stop_y - chief_y)
    return _newton(geometry, index, launch, (px, py), (stop_x, stop_y), tolerance_mm=tolerance_mm)


def _at_stop(geometry, index, launch, px, py, *, tolerance_mm):
    """Return where rays meet the stop, the derivatives of that, and which could be traced.

    The derivatives dx/dpx, dx/dpy, dy/dpx, dy/dpy are forward differences: their step only sets
    the rate of convergence; the miss is that of the real ray.
    """
    step = 1e5 * tolerance_mm  # 1e-4 of the stop's radius
    rays = trace(
        geometry,
        index,
        launch,
        np.concatenate([px, px + step, px], axis=1),
        np.concatenate([py, py, py + step], axis=1),
        through=geometry.stop + 1,
    )
    x0, x1, x2 = np.split(rays.own_x[-1], 3, axis=1)
    y0, y1, y2 = np.split(rays.own_y[-1], 3, axis=1)
    slopes = ((x1 - x0) / step, (x2 - x0) / step, (y1 - y0) / step, (y2 - y0) / step)
    return x0, y0, slopes, np.split(rays.ok, 3, axis=1)


def _correction(slopes, need_x, need_y):
    """Return the change of (px, py) that moves rays by the need at the stop, and where it exists.

    It is 0 where the derivatives are singular.
    """
    a, b, c, d = slopes
    det = a * d - b * c
    usable = np.abs(det) > 1e-9
    det = np.where(usable, det, np.inf)
    return (d * need_x - b * need_y) / det, (a * need_y - c * need_x) / det, usable


def _newton(geometry, index, launch, start, wanted, *, tolerance_mm):
    """Return px, py and success of the rays to wanted points of the stop, from a first guess."""
    px, py = (p.copy() for p in start)
    wanted_x, wanted_y = (np.broadcast_to(w, px.shape) for w in wanted)
    found = np.zeros(px.shape, dtype=bool)
    for _ in range(AIM_ITERATIONS):
        open_ = ~found.all(axis=0)
        x, y, slopes, traced = _at_stop(
            geometry, index, launch, px[:, open_], py[:, open_], tolerance_mm=tolerance_mm
        )
        need_x, need_y = wanted_x[:, open_] - x, wanted_y[:, open_] - y
        hit = traced[0] & (np.hypot(need_x, need_y) < tolerance_mm)
        found[:, open_] = hit
        if found.all():
            break
        step_x, step_y, usable = _correction(slopes, need_x, need_y)
        usable &= traced[0] & traced[1] & traced[2]
        for p, step in ((px, step_x), (py, step_y)):
            old = p[:, open_]
            # A start that does not reach the stop is drawn half-way to the chief ray.
            p[:, open_] = np.where(hit, old, np.where(usable, old + step, old / 2))
    return px, py, found

"""Raws of single cameras of a study, rendered, and the edges in them measured.

A black square stands at each of the nine places, turned by `EDGE_DEG`. Its left and right edges
give the SFR across upright edges, the others that across level ones: the same as a photograph of a
chart would, with all that the renderer knows of light and sensor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from yaml import safe_dump

from gpusim.camera import Camera
from gpusim.disk import whole
from gpusim.errors import UserError
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import conjugates
from gpusim.library.expose import lit
from gpusim.library.light import Light
from gpusim.metrics.picture import Plane
from gpusim.metrics.regions import filled
from gpusim.metrics.sfr import measure_sfr
from gpusim.plan import Accuracy
from gpusim.render.renderer import Renderer
from gpusim.scene import make_scene
from gpusim.tolerance.found import Found
from gpusim.tolerance.sfr import EDGE_DEG
from gpusim.tolerance.study import PARTS, Place, Study

SIDE_PX, AROUND_PX = 56, 24  # of a square, and of the raw around it
# The region of an edge: so far to either side, and so much of the side's length, off the corners.
REACH_PX, ALONG = 16, 0.6
# Relative, of the signal: MTF50 is the place of one half on a slope of two a cycle and pixel.
TOLERANCE, PROBES = 3e-3, 4
CHART = "edges.yaml"


@dataclass(frozen=True)
class Rendered:
    """Nine pieces of a camera's raw.

    Attributes
    ----------
    mtf50 : ndarray (9, 2)
        Cycles/px, across upright and level edges.
    total_rms : float
        The certificate's total, at the first place, a corner.
    picture : ndarray of uint8 (rows, cols, 3)
        The places as they are developed, and as they lie on the sensor.
    """

    mtf50: np.ndarray
    total_rms: float
    picture: np.ndarray


def squares_of(study: Study) -> list[Place]:
    """Return where the squares stand: at the study's places, or as near as the sensor's rim lets.

    Raises
    ------
    UserError
        The sensor is smaller than a square and what is around it.
    """
    sensor, side = study.camera.sensor, SIDE_PX + 2 * AROUND_PX
    if min(sensor.rows, sensor.cols) < side:
        raise UserError(
            "the sensor has no room for an edge that can be measured",
            field="raws",
            value=f"{sensor.cols} x {sensor.rows} pixels",
            allowed=f"{side} x {side} pixels or more; or raws: false",
        )
    most_x, most_y = (sensor.cols - side) / 2, (sensor.rows - side) / 2
    return [
        study.place(min(max(place.x_px, -most_x), most_x), min(max(place.y_px, -most_y), most_y))
        for place in study.places
    ]


def write_chart(study: Study) -> Path:
    """Write the chart of a study beside its parts: `gpusim render` takes it too."""
    sensor, lens = study.camera.sensor, study.lens
    distance_px = 1e3 * conjugates(lens).principal_distance_mm / sensor.pixel_pitch_um
    squares = []
    for place in squares_of(study):
        away = distance_px * math.tan(place.theta)
        at = [away * math.sin(place.azimuth), away * math.cos(place.azimuth)]
        squares.append(
            {
                "shape": "rectangle",
                "at": [round(value, 3) for value in at],
                "size": [SIDE_PX, SIDE_PX],
                "angle_deg": EDGE_DEG,
                "fill": "black",
            }
        )
    chart = {
        "title": f"squares at nine places before {lens.title}",
        "unit": "pixels",
        "height": sensor.rows,
        "fills": {"white": 0.8, "black": 0.05},
        "background": "white",
        "shapes": squares,
    }
    path = study.out / CHART
    with whole(path) as part:
        part.write_text(safe_dump(chart, sort_keys=False))
    return path


def rendered(study: Study, lens: Prescription, name: str) -> Rendered:
    """Render the nine places before a lens, and measure their edges.

    What was rendered under this name is read from the study's folder.

    Raises
    ------
    UserError
        The lens cannot be rendered, or an edge has no MTF50.
    """
    path = study.out / PARTS / f"rendered-{name}.npz"
    if not path.exists():
        found = _rendered(study, lens, name)
        with whole(path) as part, part.open("wb") as file:
            np.savez(file, **found.__dict__)
    with np.load(path) as kept:
        return Rendered(kept["mtf50"], float(kept["total_rms"]), kept["picture"])


def both(found: Found) -> tuple[Rendered, Rendered]:
    """Render the design, and the camera below which five in a hundred lie, each in its focus."""
    study, number = found.study, found.fifth
    fifth = study.moved(study.draws[number]).defocused(1e3 * float(found.focus_mm[number]))
    design = study.lens.defocused(1e3 * found.design_focus_mm)
    return rendered(study, design, "design"), rendered(study, fifth, f"{number:06d}")


def _rendered(study: Study, lens: Prescription, name: str) -> Rendered:
    camera = Camera(lens, study.camera.sensor, study.camera.title)
    scene = make_scene(write_chart(study), frame=camera.frame)
    accuracy = Accuracy(TOLERANCE, PROBES, best_effort=True)
    renderer = Renderer(camera, scene, accuracy)
    try:
        lights = []
        for number, rect in enumerate(_tiles(study)):
            study.progress(f"raw of {name}", number, len(study.places))
            lights.append(lit(renderer, rect))
            # A certificate takes longer than a place. The first one, in a corner, stands for all:
            # PSFs change fastest there, and one plan makes the nine.
            renderer.accuracy = replace(renderer.accuracy, probes=0)
        study.progress(f"raw of {name}", len(study.places), len(study.places))
    finally:
        renderer.release()
    certificate = lights[0].certificate
    assert certificate is not None
    tiles = [np.asarray(one.capture().develop()) for one in lights]
    rows = [np.concatenate(tiles[3 * row : 3 * row + 3], axis=1) for row in range(3)]
    return Rendered(
        np.array([_edges(study, one) for one in lights]),
        certificate.total_rms,
        np.concatenate(rows),
    )


def _tiles(study: Study) -> Iterator[tuple[int, int, int, int]]:
    """Yield row, column, rows and columns of each place, whole periods of the filter array."""
    sensor = study.camera.sensor
    side = SIDE_PX + 2 * AROUND_PX
    for place in squares_of(study):
        middle = sensor.rows / 2 + place.y_px, sensor.cols / 2 + place.x_px
        row, col = (
            min(max(2 * round((at - side / 2) / 2), 0), most - side)
            for at, most in zip(middle, (sensor.rows, sensor.cols), strict=True)
        )
        yield row, col, side, side


def _edges(study: Study, light: Light) -> list[float]:
    """Return MTF50 across the upright and the level edges of a square."""
    frame = light.capture(noise=False)
    own = np.array(light.sensor.cfa.letters) == study.channel.name
    row, col = light.rect[:2]
    sites = None if own.all() else np.roll(own, (-row, -col), axis=(0, 1))
    values = frame.truth_dn.astype(float)
    dark = filled(Plane(values, sites, (-np.inf, np.inf)))
    dark = dark < (dark.min() + dark.max()) / 2
    middle = [float(np.mean(at)) for at in np.nonzero(dark)]
    found = []
    for turned in (False, True):
        halves = []
        for side in (-1, 1):
            y, x = middle
            away = side * SIDE_PX / 2
            size = 2 * REACH_PX, ALONG * SIDE_PX
            if turned:
                y, size = y + away, size[::-1]
            else:
                x += away
            box = (round(x - size[0] / 2), round(y - size[1] / 2), round(size[0]), round(size[1]))
            half = measure_sfr(values, box, sites=sites).falls_to(0.5)
            if half is None:
                raise UserError("an edge of the rendered raw has no MTF50", value=light.title)
            halves.append(half.value)
        found.append(float(np.mean(halves)))
    return found

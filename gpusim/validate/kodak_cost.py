"""Error against run time at N samples a pixel (section 4 of the paper works with N = 2).

Two edges are rendered on sim grids of 2, 3, 4 and 8 samples for each pixel, with the same PSF
nodes. Two errors are told: that of the grid, against one of 16 samples; and those of the edge, its
place and its MTF, against the prediction. Frames are timed in turns, so that a machine that is
slower now is so for all.

The engine's grids have a power of two of samples for each pixel. N = 3 is therefore a sensor whose
pixels lie a third as far apart, each with the aperture of a whole one, on one sample for each:
every third of its pixels, both ways, is one of the camera's. Its time holds the others too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gpusim.camera import Camera
from gpusim.lens.prescription import Prescription
from gpusim.pareto.knobs import oversampled
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.sensor.sensor import Sensor
from gpusim.validate.bars import Bar
from gpusim.validate.edges import Target, compare, cut, lit, region_of
from gpusim.validate.kodak import (
    EXPOSURE_S,
    POSITION_BAR_PX,
    REFERENCE,
    band_of,
    even_light,
    mono_sensor,
)
from gpusim.validate.kodak_table import TABLE_1
from gpusim.validate.predict import Predictor

SAMPLES = (2, 3, 4, 8)  # per pixel
EDGES = (1, 5)  # of table 1: on the axis, where PSFs are sharpest, and the one of figures 9 and 12
FINEST = 16  # of the grid that the others are held against: its aliasing is predicted at 1.5e-7
TOLERANCE = 5e-3  # of the PSF nodes, which all grids share
ROUNDS = 5


@dataclass(frozen=True)
class Error:
    """What a sim grid costs in quality, at an edge.

    Attributes
    ----------
    grid_rms : float
        Error of the signal, over the pixels of the region, against the finest grid.
    position_px : float
        The edge's place, less the predicted one.
    mtf : float
        Largest error of the MTF to 1 cycle a pixel.
    """

    grid_rms: float
    position_px: float
    mtf: float


@dataclass(frozen=True)
class Cost:
    """A sim grid: its errors by edge, and its time.

    ``seconds`` are those of a frame of the first region by a prepared renderer, by round.
    """

    samples: int
    errors: Mapping[int, Error]
    seconds: Sequence[float]

    @property
    def median_s(self) -> float:
        """The median time."""
        return float(np.median(self.seconds))


@dataclass(frozen=True, eq=False)
class Costs:
    """All sim grids."""

    found: Sequence[Cost]

    def bars(self) -> list[Bar]:
        """Return what has to hold: where an edge lies does not go with N."""
        names = ", ".join(str(one.samples) for one in self.found)
        errors = [error.position_px for one in self.found for error in one.errors.values()]
        name = f"position of edges {EDGES[0]} and {EDGES[1]} at N = {names}"
        return [Bar.largest(name, errors, POSITION_BAR_PX, "px")]


def finer(sensor: Sensor, apart: int) -> Sensor:
    """Return a sensor with pixels so many times as close, and as large an aperture as before."""
    changes = {
        "rows": apart * sensor.rows,
        "cols": apart * sensor.cols,
        "pixel_pitch_um": sensor.pixel_pitch_um / apart,
        "fill_factor": apart**2 * sensor.fill_factor,  # apertures overlap: no file may say so
    }
    return sensor.unchecked(**changes)


def measure_costs(
    lens: Prescription,
    target: Target,
    predictor: Predictor,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Costs:
    """Render edges of a target at every N, and time it.

    Parameters
    ----------
    lens : Prescription
    target : Target
        The near-vertical edges.
    predictor : Predictor
    progress : callable
        Called with (what, done, total).
    """
    sensor, band = mono_sensor(REFERENCE), band_of(REFERENCE)
    scene = lit(target.chart)
    places = [place for place in TABLE_1 if place.number in EDGES]
    regions = [region_of(place, target.axis, sensor) for place in places]
    flat = even_light(sensor, predictor, band)
    camera = Camera(lens=lens, sensor=sensor, title="stand-in, sim grids")
    with ExitStack() as kept:
        takers, prepared = [], {}
        for number, samples in enumerate((*SAMPLES, FINEST)):
            progress("sim grids", number, len(SAMPLES) + 2)
            apart = samples if samples % 2 else 1
            seen = replace(camera, sensor=finer(sensor, apart))
            make = partial(Renderer, seen, scene, Accuracy(TOLERANCE, 0), noise=False)
            if apart not in prepared:
                prepared[apart] = make()
                kept.callback(prepared[apart].release)
            plan = oversampled(prepared[apart], samples // apart)
            renderer = make(plan=plan)
            kept.callback(renderer.release)
            takers.append(partial(taken, renderer, apart))
        *pictures, finest = [take(regions) for take in takers]
        progress("sim grids", len(SAMPLES) + 1, len(SAMPLES) + 2)
        for take in takers[:-1]:  # what a region's first frame prepares is not a frame's time
            take(regions[:1])
        seconds: list[list[float]] = [[] for _ in SAMPLES]
        for _ in range(ROUNDS):
            for take, times in zip(takers[:-1], seconds, strict=True):
                started = time.perf_counter()
                take(regions[:1])
                times.append(time.perf_counter() - started)
    progress("sim grids", len(SAMPLES) + 2, len(SAMPLES) + 2)

    def error(k: int, picture: np.ndarray) -> Error:
        shown = picture / cut(flat, regions[k])
        edge = compare(places[k], target, band, shown, sensor=sensor, predictor=predictor)
        rms = float(np.sqrt(np.mean((picture / finest[k] - 1) ** 2)))
        return Error(rms, float(edge.error_px), edge.mtf_error)

    return Costs(
        [
            Cost(samples, {place.number: error(k, own[k]) for k, place in enumerate(places)}, times)
            for samples, own, times in zip(SAMPLES, pictures, seconds, strict=True)
        ]
    )


def taken(
    renderer: Renderer, apart: int, regions: Sequence[tuple[int, int, int, int]]
) -> list[np.ndarray]:
    """Return the electrons/s of regions, made anew, at the camera's own pixels."""
    renderer.drop_light()
    found = []
    for x, y, width, height in regions:
        tile = apart * x, apart * y, apart * width, apart * height
        rate = renderer.capture(EXPOSURE_S, tile=tile, keep=("rate",)).rate
        found.append(rate[apart // 2 :: apart, apart // 2 :: apart].astype(float))
    return found

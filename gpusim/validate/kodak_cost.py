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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from gpusim.camera import Camera
from gpusim.formats.ready import ready_lens
from gpusim.lens.prescription import Prescription
from gpusim.pareto.knobs import oversampled
from gpusim.plan import Accuracy, Plan
from gpusim.render import Renderer
from gpusim.render.look import look
from gpusim.sensor.sensor import Sensor
from gpusim.validate.bars import Bar
from gpusim.validate.edges import Target, compare, cut, lit, region_of
from gpusim.validate.kodak import (
    EXPOSURE_S,
    LENS,
    POSITION_BAR_PX,
    REFERENCE,
    band_of,
    even_light,
    mono_sensor,
    targets,
    three_sensors,
)
from gpusim.validate.kodak import TOLERANCE as EDGES_TOLERANCE
from gpusim.validate.kodak_table import TABLE_1
from gpusim.validate.predict import Predictor

Tile = tuple[int, int, int, int]  # x, y, width, height

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


@dataclass(frozen=True, eq=False)
class Grids:
    """The plans of sim grids, and the errors of edges on them by place: each by N.

    ``halos`` are the plans of their halos' levels, by the pixels' distance: those of one sensor
    share them.
    """

    plans: Mapping[int, Plan]
    errors: Mapping[int, Mapping[int, Error]]
    halos: Mapping[int, dict[float, Plan]]


def measure_grids(
    lens: Prescription,
    predictor: Predictor,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Grids:
    """Render the near-vertical edges at every N, and hold them against the finest grid.

    Parameters
    ----------
    lens : Prescription
    predictor : Predictor
    progress : callable
        Called with (what, done, total).
    """
    sensor, band = mono_sensor(REFERENCE), band_of(REFERENCE)
    target = targets(predictor, sensor)[0]
    places = [place for place in TABLE_1 if place.number in EDGES]
    regions = regions_of(target)
    flat = even_light(sensor, predictor, band)
    plans: dict[int, Plan] = {}
    pictures: dict[int, list[np.ndarray]] = {}
    halos: dict[int, dict[float, Plan]] = {}
    with ExitStack() as kept:
        planned: dict[int, Renderer] = {}
        for samples in (*SAMPLES, FINEST):
            progress("sim grids", len(plans), len(SAMPLES) + 1)
            apart = apart_for(samples)
            if apart not in planned:
                planned[apart] = kept.enter_context(opened(lens, target, apart))
            plans[samples] = oversampled(planned[apart], samples // apart)
            with opened(lens, target, apart, plans[samples]) as renderer:
                renderer.coarse_plans |= halos.get(apart, {})
                pictures[samples] = taken(renderer, apart, regions)
                halos[apart] = dict(renderer.coarse_plans)
    progress("sim grids", len(SAMPLES) + 1, len(SAMPLES) + 1)
    del plans[FINEST]
    finest = pictures.pop(FINEST)

    def error(k: int, picture: np.ndarray) -> Error:
        shown = picture / cut(flat, regions[k])
        edge = compare(places[k], target, band, shown, sensor=sensor, predictor=predictor)
        rms = float(np.sqrt(np.mean((picture / finest[k] - 1) ** 2)))
        return Error(rms, float(edge.error_px), edge.mtf_error)

    errors = {
        samples: {place.number: error(k, own[k]) for k, place in enumerate(places)}
        for samples, own in pictures.items()
    }
    return Grids(plans, errors, halos)


Taker = Callable[[], object]  # takes a frame


@contextmanager
def prepared(lens: Prescription, target: Target, grids: Grids) -> Iterator[list[Taker]]:
    """Yield what takes the first region on each grid, by renderers that have taken it once.

    Parameters
    ----------
    lens : Prescription
    target : Target
        The near-vertical edges.
    grids : Grids
    """
    first = regions_of(target)[:1]
    with ExitStack() as kept:
        takers: list[Taker] = []
        for samples, plan in grids.plans.items():
            apart = apart_for(samples)
            renderer = kept.enter_context(opened(lens, target, apart, plan))
            renderer.coarse_plans |= grids.halos[apart]
            takers.append(partial(taken, renderer, apart, first))
            takers[-1]()  # what a region's first frame prepares is not a frame's time
        yield takers


def timed(
    takers: Sequence[Taker],
    grids: Grids,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Costs:
    """Time frames on every grid, in turns.

    Parameters
    ----------
    takers : sequence of callable
        See `prepared`.
    grids : Grids
    progress : callable
        Called with (what, done, total) rounds.
    """
    seconds: list[list[float]] = [[] for _ in takers]
    for number in range(ROUNDS):
        progress("sim grids, timed", number, ROUNDS)
        for take, times in zip(takers, seconds, strict=True):
            started = time.perf_counter()
            take()
            times.append(time.perf_counter() - started)
    progress("sim grids, timed", ROUNDS, ROUNDS)
    return Costs(
        [
            Cost(samples, grids.errors[samples], times)
            for samples, times in zip(grids.plans, seconds, strict=True)
        ]
    )


def apart_for(samples: int) -> int:
    """Return how many times as close pixels lie where N samples are asked for."""
    return samples if samples % 2 else 1


@contextmanager
def opened(
    lens: Prescription, target: Target, apart: int, plan: Plan | None = None
) -> Iterator[Renderer]:
    """Yield a renderer of a target before the sensor whose pixels are so many times as close.

    All have the PSFs of the report's edges: surveys for one band ask for other banks.
    """
    scene = lit(target.chart)
    edges = Camera(lens=lens, sensor=three_sensors(), title="stand-in, three bands")
    same = ready_lens(look(edges, scene, Accuracy(EDGES_TOLERANCE)).bank, "traced", LENS)
    sensor = finer(mono_sensor(REFERENCE), apart)
    camera = Camera(lens=same, sensor=sensor, title="stand-in, sim grids")
    renderer = Renderer(camera, scene, Accuracy(TOLERANCE, 0), noise=False, plan=plan)
    try:
        yield renderer
    finally:
        renderer.release()


def regions_of(target: Target) -> list[Tile]:
    """Return the regions of the edges."""
    sensor = mono_sensor(REFERENCE)
    return [region_of(place, target.axis, sensor) for place in TABLE_1 if place.number in EDGES]


def taken(renderer: Renderer, apart: int, regions: Sequence[Tile]) -> list[np.ndarray]:
    """Return the electrons/s of regions, made anew, at the camera's own pixels."""
    renderer.drop_light()
    found = []
    for region in regions:
        tile = tuple(apart * side for side in region)
        rate = renderer.capture(EXPOSURE_S, tile=tile, keep=("rate",)).rate
        found.append(rate[apart // 2 :: apart, apart // 2 :: apart].astype(float))
    return found

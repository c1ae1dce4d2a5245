"""The sim grid's error as it is predicted, against renders and the exact model.

Two figures of one error, both root mean squares over probes: of the planner's patches and of a
certificate's. They sample other pixels, so that they agree within a factor of two, as the page of
tools/alias_table.py has it for real lenses.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from optics import made
from optics.made import FLAT, StubCamera, bank, monochrome
from sampling import one_in

from gpusim.certify import ExactModel, Measure, Placed, certify
from gpusim.gpu import Device
from gpusim.optics.chief_ray import chief_ray_map
from gpusim.pareto.knobs import oversampled
from gpusim.plan import Accuracy
from gpusim.plan.choice import alias_of
from gpusim.plan.costs import LAVAPIPE
from gpusim.render import Renderer
from gpusim.scene.chart import Chart, Rect
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene

ROWS, COLS = 48, 64
TIGHT = Accuracy(1e-4, probes=0, best_effort=True)


def camera(sigma_um: float) -> StubCamera:
    """Return a lens that is alike all over its field: nodes err by nothing."""
    still = {"coma_um": 0.0, "falloff": 0.0, "distortion": 0.0, "lateral": (0.0, 0.0, 0.0)}
    lens = bank(sigma_um=(sigma_um,) * 3, **still)
    return StubCamera(lens, monochrome().roi(ROWS, COLS))


def edge(angle_deg: float) -> Scene:
    """Return dark squares on white, 16:1, wherever a certificate looks."""
    angle = math.radians(angle_deg)
    squares = tuple(
        Rect(0.42 * x + 0.013, 0.42 * y - 0.007, 0.12, 0.12, angle, 1)
        for x in range(-3, 4)
        for y in range(-2, 3)
    )
    return Scene("edge", np.stack([FLAT, FLAT / 16]), Chart(("a", "b"), 0, squares), "E", FLAT)


def photograph(values: np.ndarray) -> Scene:
    """Return a photograph of one spectrum."""
    return Scene("p", FLAT[None], Raster(values[None].astype(np.float32)), "E", FLAT)


def waves(cycles: float) -> Scene:
    """Return a photograph of a sinusoid, a sample a pixel."""
    row, col = np.indices((ROWS, COLS))
    return photograph(0.4 + 0.36 * np.cos(2 * np.pi * cycles * (col + 0.1 * row)))


def noise(fine: int) -> Scene:
    """Return a photograph of white noise, 4:1."""
    values = np.random.default_rng(7).uniform(0.2, 0.8, (fine * ROWS, fine * COLS))
    return photograph(values)


CASES = {
    "edge of 5 degrees": (edge(5.0), 0.95, 1),
    "edge of 5 degrees, two samples": (edge(5.0), 0.4, 2),
    "edge of 45 degrees": (edge(45.0), 0.7, 1),
    "1/3 cycles a pixel": (waves(1 / 3), 0.4, 2),
    "white noise, finer than the grid": (noise(4), 0.4, 2),
    "white noise, one sample a pixel": (noise(1), 0.4, 2),
}
# Among 48 probes, one that hits a square's corner makes the error 1.6 times as large.
PROBES = {"edge of 5 degrees, two samples": 96}


@pytest.mark.parametrize("name", one_in(3, CASES))
def test_what_is_predicted_is_found(device: Device, name: str):
    scene, sigma_um, samples = CASES[name]
    stub = camera(sigma_um)
    first = Renderer(stub, scene, TIGHT, device, costs=LAVAPIPE, noise=False, method="fft")
    plan = oversampled(first, samples)
    first.release()
    one = Renderer(stub, scene, TIGHT, device, plan=plan, costs=LAVAPIPE, noise=False)
    rate = one.capture(1 / 60, keep=("rate",)).rate
    exact = ExactModel(one.bank, stub.sensor, scene, one.placed)
    by = Measure(stub.sensor, 1 / 60, Accuracy(1e-4, PROBES.get(name, 48)))
    found = certify(exact, Placed(rate, (0, 0, *rate.shape)), one.glare, by).engine_rms
    one.release()
    predicted = alias_of(stub.bank(), stub.sensor, scene, TIGHT).error(samples)
    assert found > 1e-4  # far above float32's rounding
    assert 0.5 * found < predicted < 2.0 * found


def test_finer_grids_err_less_and_none_where_all_is_even():
    stub = camera(0.4)
    for scene in (edge(5.0), noise(1)):
        alias = alias_of(stub.bank(), stub.sensor, scene, TIGHT)
        errors = [alias.error(samples) for samples in (1, 2, 4, 8)]
        assert errors == sorted(errors, reverse=True) and errors[-1] < 1e-3 * errors[0]
    even = photograph(np.full((6, 8), 0.3))
    assert alias_of(stub.bank(), stub.sensor, even, TIGHT).error(1) < 1e-12


def test_edges_that_distortion_brings_onto_the_sensor_count():
    """By barrel distortion: on the ideal plane a square next to the corner lies beyond it."""
    stub = camera(0.4)
    lens = bank(distortion=-0.3, circle_um=100.0, sigma_um=(0.4,) * 3)
    corner = np.array([COLS, ROWS]) * stub.sensor.pixel_pitch_um / 2
    ideal = chief_ray_map(lens).ideal_um(corner) * 0.93
    assert (ideal > corner).all()
    there = ideal / corner[1]  # charts are in half-heights
    found = []
    for x, y in (there, 2 * there):
        subject = made.scene((Rect(float(x), float(y), 0.05, 0.05, 0.1, 1),))
        found.append(alias_of(lens, stub.sensor, subject, TIGHT).error(1))
    assert found[0] > 1e-4 and found[1] == 0.0


def test_a_chart_of_nothing_has_no_alias():
    stub = camera(0.4)
    scene = Scene("grey", FLAT[None], Chart(("a",), 0), "E", FLAT)
    assert alias_of(stub.bank(), stub.sensor, scene, TIGHT).error(1) == 0.0


@pytest.mark.parametrize("place", [(5, 7), (20, 33), (41, 58)])
def test_a_dark_spot_is_found_wherever_it_stands_and_many_count_for_more(place: tuple[int, int]):
    stub = camera(0.4)

    def predicted(spots: list[tuple[int, int]]) -> float:
        values = np.full((ROWS, COLS), 0.6)
        values[tuple(np.transpose(spots))] = 0.05
        return alias_of(stub.bank(), stub.sensor, photograph(values), TIGHT).error(2)

    everywhere = [(row, col) for row in range(2, ROWS, 5) for col in range(2, COLS, 5)]
    # An even photograph has below 1e-12.
    assert 1e-5 < predicted([place]) < predicted(everywhere)

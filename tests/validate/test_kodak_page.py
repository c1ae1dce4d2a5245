"""The Kodak report is written from any set of edges: all numbers, figures and tables."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.report.drawing import png
from gpusim.validate.bars import Bar
from gpusim.validate.certified import Certified
from gpusim.validate.edges import AXES, Found
from gpusim.validate.kodak import BANDS, REFERENCE, Edges, mono_sensor
from gpusim.validate.kodak_cost import EDGES, SAMPLES, Cost, Costs, Error, finer
from gpusim.validate.kodak_effects import Effect, Effects
from gpusim.validate.kodak_measured import Measured
from gpusim.validate.kodak_noise import INEFFICIENCIES, PATCHES, Hues, Moments, Noises
from gpusim.validate.kodak_page import report
from gpusim.validate.kodak_psf import POINTS, PointSpread, PointSpreads
from gpusim.validate.kodak_table import TABLE_1

DISTANCE_PX = np.linspace(-10, 10, 321)
LSF = np.exp(-(DISTANCE_PX**2))
MTF = np.exp(-3 * FREQUENCIES_CY_PX)


@pytest.fixture
def edges():
    found = {
        (band, axis, place.number): Found(
            place, axis, band, place.x + 0.01, place.x, MTF, MTF - 0.001,
            DISTANCE_PX, LSF, LSF, np.ones((64, 64)),
        )
        for band in BANDS for axis in AXES for place in TABLE_1
    }  # fmt: skip
    certificate = SimpleNamespace(total_rms=1e-4, total_worst=1e-3, met=True, probes=8)
    return Edges(found, {"R": Certified(certificate, 1e-3)}, "a tracer", False)


@pytest.fixture
def measured(edges):
    drawn = np.random.default_rng(1)
    bar = Bar("a law", 1e-4, 1e-3, "of the effect, RMS", 1)
    corner = drawn.uniform(0, 1e4, (80, 96))
    effects = [Effect(name, "so much", corner, corner + 1, bar) for name in ("flare", "ADC")]
    certificate = SimpleNamespace(total_rms=1e-4, total_worst=1e-3, met=True, probes=8)
    certificates = {"squares": Certified(certificate, 5e-3)}
    columns = np.arange(0, 64, 2)
    ratios = np.ones((len(INEFFICIENCIES), 2, columns.size))
    hue = np.zeros((len(INEFFICIENCIES), len(PATCHES) - 1, columns.size))
    delta_e = np.zeros((len(INEFFICIENCIES), len(PATCHES)))
    both = {"physical": 0.0, "parametric": 0.0}
    error = Error(1e-3, 0.004, 0.002)
    psf = np.outer(np.hanning(128), np.hanning(128))
    return Measured(
        edges,
        PointSpreads([PointSpread(where, 0.0, psf, psf) for where in POINTS]),
        Effects(np.ones((48, 64)), np.ones((64, 80, 3)), effects, certificates),
        Hues(columns, ratios, ratios, hue, delta_e),
        Noises(
            [
                Moments(
                    level, 4096, level + 625, 0.0, dict.fromkeys(both, level + 625.0), both, 0.0
                )
                for level in (30.0, 3000.0)
            ]
        ),
        Costs([Cost(n, dict.fromkeys(EDGES, error), (1.0, 2.0, 3.0)) for n in SAMPLES]),
    )


def test_all_of_it_is_written(measured):
    made = report(measured)
    facts = json.loads(json.dumps(made.facts(), allow_nan=False))
    assert len(facts["edges"]) == 60
    assert len(facts["bars"]) == 1 + 9 + 1 + 1 + 1 + 2 + 1 + 1 + 1
    # The tracer is ours.
    (lost,) = [bar["name"] for bar in facts["bars"] if not bar["held"]]
    assert lost.startswith("independent tracer")
    assert [one["samples"] for one in facts["cost"]] == list(SAMPLES)
    drawn = [one for one in made.sections if one.figure is not None]
    page = made.html({one.name: png(one.figure) for one in drawn})
    assert page.count("<figure>") == 9
    assert "NOT independent" in page
    text = made.markdown({one.name: one.name for one in drawn})
    # Each position, and red and blue to green, whose errors are nought.
    assert text.count("+0.0100") == 60 and text.count("+0.0000") == 40
    # The paper's table 1 is of near-vertical edges: its columns stand beside no others.
    assert text.count("R, paper") == 1 and text.count("predicted, paper") == 2
    assert text.count("| -0.059 | -0.068 | -0.065 |") == 1
    assert text.count("| -0.080 | -0.100 | -0.020 |") == 1


def test_an_edge_that_goes_with_the_sim_grid_is_seen(measured):
    errors = {1: Error(1e-3, 0.004, 0.002), 5: Error(1e-3, 0.03, 0.002)}
    costs = Costs([*measured.costs.found, Cost(16, errors, (1.0,))])
    assert not costs.bars()[0].held


def test_pixels_that_lie_closer_see_as_much():
    sensor = mono_sensor(REFERENCE)
    close = finer(sensor, 3)
    assert close.response_um == pytest.approx(sensor.response_um)
    assert (close.rows, close.cols) == (3 * sensor.rows, 3 * sensor.cols)

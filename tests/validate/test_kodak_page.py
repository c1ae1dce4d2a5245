"""The Kodak report is written from any set of edges: all numbers, figures and tables."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.report.drawing import png
from gpusim.validate.edges import AXES, Found
from gpusim.validate.kodak import BANDS, Edges
from gpusim.validate.kodak_page import report
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
    return Edges(found, {"R": SimpleNamespace(certificate=certificate)}, "a tracer", False)


def test_all_of_it_is_written(edges):
    made = report(edges)
    facts = json.loads(json.dumps(made.facts(), allow_nan=False))
    assert len(facts["edges"]) == 60
    assert all(bar["held"] for bar in facts["bars"])
    drawn = [one for one in made.sections if one.figure is not None]
    page = made.html({one.name: png(one.figure) for one in drawn})
    assert page.count("<figure>") == 3
    assert "NOT independent" in page
    text = made.markdown({one.name: one.name for one in drawn})
    assert text.count("+0.0100") == 60

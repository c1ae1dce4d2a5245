"""The figure of the quantum efficiency over the field, and its place in the report."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fake_capture import fake_capture
from optics.angled import angled, lens, unlike

from gpusim.optics.angular import AngularResponse
from gpusim.report.facts import facts
from gpusim.report.page import page
from gpusim.report.qe_figure import POINTS, draw, qe_facts
from gpusim.scene.spectra import WAVELENGTHS_NM

LENS = lens(falloff=0.0)
CAMERA = angled(unlike())
RESPONSE = AngularResponse(LENS, CAMERA)


def test_the_curves_are_the_means_over_the_cones():
    found = qe_facts(RESPONSE, CAMERA)
    assert len(found["height_mm"]) == POINTS
    assert found["height_mm"][-1] == pytest.approx(128 * 1.55e-3 / 2)
    curves = {name: np.array(one["quantum_efficiency"]) for name, one in found["channels"].items()}
    assert list(curves) == ["R", "Gb", "Gr", "B"]
    # In the middle it is the mean over the cone there; 550 nm is one of the bank's.
    green = found["channels"]["Gr"]["wavelength_nm"]
    expected = RESPONSE.at(0.0, 0.0)[2, WAVELENGTHS_NM == 550.0]
    assert expected == pytest.approx(RESPONSE.qe(0)[0, 2, 1, WAVELENGTHS_NM == 550.0], rel=1e-9)
    assert curves["Gr"][POINTS // 2] == RESPONSE.at(0.0, 0.0)[2, WAVELENGTHS_NM == green]
    for name in ("R", "B"):
        assert (np.diff(curves[name][POINTS // 2 :]) < 0).all()
        assert curves[name] == pytest.approx(curves[name][::-1], rel=1e-6)
    assert curves["Gr"] == pytest.approx(curves["Gb"][::-1], rel=1e-6)
    assert curves["Gr"][-1] > 1.1 * curves["Gb"][-1]


def test_the_figure_has_a_curve_for_each_channel():
    found = qe_facts(RESPONSE, CAMERA)
    (axes,) = draw(found).axes
    labels = [line.get_label() for line in axes.lines]
    assert [one.split()[0] for one in labels[:4]] == ["R", "Gb", "Gr", "B"]
    same_colour = [line for line in axes.lines if line.get_label()[:1] == "G"]
    assert len({line.get_linestyle() for line in same_colour}) == 2
    shown = axes.lines[2].get_ydata()
    assert list(shown) == found["channels"]["Gr"]["quantum_efficiency"]


def test_the_report_shows_it_where_there_is_one():
    developed = np.zeros((48, 64, 3), np.uint8)
    plain = fake_capture()
    told = facts(plain, files=[], command=[])
    assert told["qe_by_place"] is None
    assert "over the field</h2>" not in page(told, developed)
    plan = plain.plan
    plan.basis.elsewhere = SimpleNamespace(response=RESPONSE)
    angular = replace(plain, camera=replace(plain.camera, sensor=CAMERA))
    text = page(facts(angular, files=[], command=[]), developed)
    assert "Quantum efficiency over the field</h2>" in text
    assert '<img class="sheet" src="data:image/svg+xml' in text
    assert "Gr at 5" in text

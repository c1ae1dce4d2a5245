"""The Ansys report's bars hold where lens and picture agree, and break where an error is planted.

In place of renders the pictures are drawn from the lens's rays, so that what measures and compares
is tested without the engine; renders of its parts run behind the marker ``slow``.
"""

import json
import math

import numpy as np
import pytest
from ansys_findings import READING, drawn, even, sharp
from command_line import gpusim

from gpusim.lens.system import build
from gpusim.validate import ansys, ansys_measured, ansys_mtf, ansys_square
from gpusim.validate.spheres import SphereTracer
from gpusim.validate.tracers import OwnTracer


@pytest.fixture(scope="module")
def lens():
    return ansys.LensData(READING.lens, *ansys.weights(READING.sensor))


def lost(predicted, pictures):
    """Return the bars that do not hold."""
    found = ansys.Read(READING, predicted, *pictures)
    return {bar.name.split(",")[0] for bar in found.bars() if not bar.held}


def test_chief_rays_through_spheres_are_those_of_the_engine():
    system = build(READING.lens)
    own, other = SphereTracer(system), OwnTracer(system)  # the engine's
    fields = np.radians([0.5, 20, 50])
    # mm: the aims differ by 1e-9 of the stop
    assert own.chief_mm(fields, 550.0) == pytest.approx(other.chief_mm(fields, 550.0), abs=1e-8)


def test_pupils_through_spheres_are_those_of_the_engine():
    """Directions, paths and the light that enters, of a field 10 degrees off the axis."""
    system, field, nm = build(READING.lens), np.radians(10.0), 550.0
    found = SphereTracer(system).rays(field, nm)
    # The engine's rays, through the points of the stop where these go.
    other = OwnTracer(system).rays(field, nm)
    assert found.chief_mm == pytest.approx(other.chief_mm, abs=1e-8)
    assert found.chief_beta == pytest.approx(other.chief_beta, abs=1e-9)
    fits = []
    for one in (found, other):
        near = np.hypot(one.alpha, one.beta - one.chief_beta) < 0.17  # the pupil's rim
        x, y = one.alpha[near] / 0.17, (one.beta[near] - one.chief_beta) / 0.17
        powers = np.polynomial.chebyshev.chebvander2d(x**2, y, [6, 12])
        fits.append(np.linalg.lstsq(powers, one.wave_mm[near], rcond=None)[0])
    at = np.array([[0.0, 0.1, 0.5, 0.3], [0.0, 0.6, -0.4, -0.7]])
    powers = np.polynomial.chebyshev.chebvander2d(at[0] ** 2, at[1], [6, 12])
    # mm: a thousandth of a wave.
    np.testing.assert_allclose(powers @ fits[0], powers @ fits[1], rtol=0, atol=5.5e-7)


def test_pictures_as_predicted_hold_every_bar(lens):
    assert not lost(lens, drawn(lens))


def test_a_warp_that_is_off_by_a_thousandth_is_seen(lens):
    assert "LGD at every radius" in lost(lens, drawn(lens, stretch=0.001))


def test_a_mean_distortion_that_is_not_the_papers_is_seen(lens):
    assert "mean LGD against the paper's" in lost(lens, drawn(lens, stretch=0.01))


def test_corners_that_scatter_are_seen(lens):
    """By noise of a tenth of the step, where the curve through all of them still lies right."""
    assert lost(lens, drawn(lens, noise=0.036)) == {"scatter of corners"}


def test_corners_are_found_nearly_to_the_corner_of_the_picture(lens):
    read = ansys.Read(READING, lens, *drawn(lens))
    # 11 of 160 px from the sides, where the last corner lies.
    assert read.distortion.radius.max() == pytest.approx(1 - 11 / 160, abs=1e-3)
    assert read.radii[-1] > 0.9


def test_lens_data_that_are_off_are_seen(lens):
    surfaces = list(READING.lens.surfaces)
    surfaces[3] = surfaces[3].model_copy(update={"radius": 1.02 * surfaces[3].radius})
    wrong = READING.lens.model_copy(update={"surfaces": tuple(surfaces)})
    other = ansys.LensData(wrong, *ansys.weights(READING.sensor))
    assert "LGD at every radius" in lost(other, drawn(lens))


def test_a_wave_of_another_frequency_is_seen(lens):
    assert "peaks of 1/3" in lost(lens, drawn(lens, frequency=1.006))


def test_a_certificate_that_is_not_met_is_seen(lens):
    assert lost(lens, drawn(lens, rms=1.1 * ansys.TOLERANCE)) == {"certificates"}


@pytest.mark.parametrize("share", [1.0, 1.1])
def test_the_command_writes_its_pages_and_ends_with_1_where_a_bar_is_lost(
    lens, tmp_path, monkeypatch, share
):
    found = ansys.Read(READING, lens, *drawn(lens))
    rms = share * ansys_square.TOLERANCE
    edges = [sharp(rms=rms), sharp(rms=rms, by_rays=True)]
    gave = [even(), *([([], {})] * 2), *edges, found, found]
    monkeypatch.setattr(ansys_measured, "at_once", lambda parts, progress: gave)
    ended = gpusim("validate", "ansys", "--out", tmp_path)
    facts = json.loads((tmp_path / "ansys.json").read_text())
    lost = [bar["name"] for bar in facts["bars"] if not bar["held"]]
    assert bool(lost) == ended.code == (share > 1)
    assert (tmp_path / "ansys.html").exists() and len(list(tmp_path.glob("*.png"))) == 6


@pytest.mark.slow
@pytest.mark.parametrize("reading", ansys.READINGS, ids=lambda one: one.name[:11])
def test_rendered_distortion_and_waves_hold_their_bars(reading):
    assert [bar.name for bar in ansys.read(reading).bars() if not bar.held] == []


@pytest.mark.slow
def test_rendered_edges_hold_their_bars():
    """The reading whose focus is by rays alone."""
    found = ansys_mtf.sharpness(ansys.READINGS[-1])
    assert [bar.name for bar in found.bars() if not bar.held] == []


def test_a_tracer_of_spheres_refuses_other_lenses():
    with pytest.raises(ValueError, match="infinity"):
        SphereTracer(build(READING.lens.looking(math.inf)))
    surfaces = list(READING.lens.surfaces)
    surfaces[0] = surfaces[0].model_copy(update={"conic": 0.5})
    with pytest.raises(ValueError, match="no sphere"):
        SphereTracer(build(READING.lens.model_copy(update={"surfaces": tuple(surfaces)})))

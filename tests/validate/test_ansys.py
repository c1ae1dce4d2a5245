"""The Ansys report's bars hold where lens and picture agree, and break where an error is planted.

In place of renders the pictures are drawn from the lens's rays, so that what measures and compares
is tested without the engine; the whole command runs behind the marker ``slow``.
"""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import gpusim
from scipy.ndimage import gaussian_filter

from gpusim.lens.system import build
from gpusim.metrics.distortion import measure_distortion
from gpusim.metrics.picture import Plane
from gpusim.validate import ansys
from gpusim.validate.spheres import SphereTracer
from gpusim.validate.tracers import OwnTracer

READING = ansys.READINGS[0]
SUB = 4  # samples of a pixel along each side


@pytest.fixture(scope="module")
def lens():
    return ansys.LensData(READING.lens, *ansys.weights(READING.sensor))


def ideal_places(lens, stretch=0.0):
    """Return x and y (N, N) of samples on the ideal plane, mm; radii stretched by a share."""
    count = READING.pixels * SUB
    at = (np.arange(count) + 0.5 - count / 2) * 1e-3 * READING.pitch_um / SUB
    radius = np.hypot(at, at[:, None])
    half = READING.pixels * READING.pitch_um * 5e-4
    moved = radius * (1 + stretch * (radius / half) ** 2)
    scale = np.interp(moved, lens.real_mm, lens.ideal_mm) / radius
    return scale * at, scale * at[:, None]


def pixels(samples):
    """Return pixels of samples, slightly blurred as a lens does."""
    soft = gaussian_filter(samples, 0.7 * SUB)
    return soft.reshape(READING.pixels, SUB, READING.pixels, SUB).mean(axis=(1, 3))


def drawn(lens, stretch=0.0, frequency=1.0, rms=1e-4):
    """Return what a reading would give whose renders follow a lens."""
    x, y = ideal_places(lens, stretch)
    side = 2 * x.max() / 20
    # Soft edges: hard ones between samples would move corners by hundredths of a pixel.
    soft = np.tanh(6 * np.sin(np.pi * x / side) * np.sin(np.pi * y / side))
    board = pixels((ansys.BRIGHT + ansys.DARK + (ansys.BRIGHT - ansys.DARK) * soft) / 2)
    plane = Plane(board, None, (-math.inf, math.inf))
    peaks = []
    for period in ansys.PERIODS_PX:
        wave = np.cos(2 * np.pi * frequency * x / (1e-3 * period * READING.pitch_um))
        peaks.append(ansys.peak_of(pixels(wave), READING, lens, period))
    captures = {"all": SimpleNamespace(certificate=SimpleNamespace(total_rms=rms))}
    return board, measure_distortion({"W": plane}), peaks, captures


def lost(predicted, pictures):
    """Return the bars that do not hold."""
    board, distortion, peaks, captures = pictures
    found = ansys.Read(READING, predicted, distortion, board, peaks, captures)
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


@pytest.mark.slow
def test_the_command_holds_all_bars(tmp_path):
    """It takes minutes, so all is looked at in one test."""
    ended = gpusim("validate", "ansys", "--out", tmp_path)
    facts = json.loads((tmp_path / "ansys.json").read_text())
    assert [bar["name"] for bar in facts["bars"] if not bar["held"]] == []
    assert [len(one["peaks"]) for one in facts["readings"]] == [3, 3]
    assert ended.code == 0


def test_a_tracer_of_spheres_refuses_other_lenses():
    with pytest.raises(ValueError, match="infinity"):
        SphereTracer(build(READING.lens.looking(math.inf)))
    surfaces = list(READING.lens.surfaces)
    surfaces[0] = surfaces[0].model_copy(update={"conic": 0.5})
    with pytest.raises(ValueError, match="no sphere"):
        SphereTracer(build(READING.lens.model_copy(update={"surfaces": tuple(surfaces)})))

"""Differentials of the wavefront and the SFR they give, against lenses traced by themselves."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.camera import load_camera
from gpusim.lens.perturb import perturbed
from gpusim.psf.compute_plane import compute_plane_bank
from gpusim.sensor.crosstalk_model import Crosstalk
from gpusim.tolerance.budget import Mounted
from gpusim.tolerance.sfr import FREQUENCY_CY_PX, channel_of, mtf50, otfs, through_focus
from gpusim.tolerance.wave import Wave, wave_of

LINES_NM = np.array([486.0, 546.0, 656.0])
WEIGHT = np.array([0.2, 0.5, 0.3])
CY_MM = np.linspace(0, 80, 9)
FIELD, AZIMUTH = np.radians(11.0), np.radians(40.0)


@pytest.fixture(scope="module")
def lens():
    return Mounted.of(load_camera("machine-vision")).lens


@pytest.fixture(scope="module")
def wave(lens) -> Wave:
    return wave_of(lens, FIELD, AZIMUTH, LINES_NM)


def mtf(wave: Wave, coefficients=None, focus_mm=0.0) -> np.ndarray:
    if coefficients is None:
        coefficients = np.zeros((len(LINES_NM), len(wave.lines[0].basis)))
    return np.abs(otfs(wave, WEIGHT, coefficients[None], np.array([focus_mm]), CY_MM)[0])


def test_an_unchanged_lens_has_no_differential(lens, wave):
    coefficients, residual = wave.change(lens)
    assert np.abs(coefficients).max() < 1e-12 and residual < 1e-12


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("1.radius", 0.02),
        ("2.thickness", 0.03),
        ("element.1-2.decentre_x_mm", 0.03),
        ("element.1-2.tilt_x_deg", 0.1),
        ("1.nd", 2e-3),
    ],
)
def test_a_changed_wavefront_gives_the_mtf_of_the_changed_lens(lens, wave, name, value):
    """The changed lens is traced with a pupil and a fit of its own, on its own grid.

    2e-3: a grid of 64 nodes is within 1e-3 of a finer one, of either. The pupil's outline stays the
    design's: a radius that is 0.05 mm off widens the cone, and MTF misses 2.9e-3.
    """
    changed = perturbed(lens, name, value, name)
    coefficients, residual = wave.change(changed)
    alone = mtf(wave_of(changed, FIELD, AZIMUTH, LINES_NM))
    assert np.abs(alone - mtf(wave)).max() > 5e-3  # the change is seen at all
    assert mtf(wave, coefficients) == pytest.approx(alone, abs=2e-3)
    assert residual < 1e-3 * LINES_NM[0] * 1e-6


@pytest.mark.parametrize("focus_um", [-40, 60])
def test_focus_moves_the_image_plane_away_from_the_lens(lens, wave, focus_um):
    alone = mtf(wave_of(lens.defocused(focus_um), FIELD, AZIMUTH, LINES_NM))
    assert mtf(wave, focus_mm=1e-3 * focus_um) == pytest.approx(alone, abs=2e-3)
    assert np.abs(alone - mtf(wave, focus_mm=-1e-3 * focus_um)).max() > 2e-2


def test_through_focus_is_the_mtf_at_each_focus(wave):
    zero = np.zeros((1, len(LINES_NM), len(wave.lines[0].basis)))
    steps = {"steps": 2, "step_mm": 0.02, "frequency_cy_mm": CY_MM[3]}
    found = through_focus(wave, WEIGHT, zero, np.zeros(1), **steps)[:, 0]
    each = [mtf(wave, focus_mm=0.02 * step)[:, 3].mean() for step in range(-2, 3)]
    assert found == pytest.approx(each, abs=1e-9)


def test_pixel_and_crosstalk_lower_the_transfer():
    sensor = load_camera("machine-vision").sensor.model_copy(update={"crosstalk": None})
    plain = channel_of(sensor).transfer
    side = np.sqrt(sensor.fill_factor)
    turn = np.radians(5)
    along = [np.sinc(side * way(turn) * FREQUENCY_CY_PX) for way in (np.cos, np.sin)]
    assert plain == pytest.approx(np.abs(np.prod(along, axis=0))[None].repeat(2, 0), abs=1e-12)
    kernel = [[0, 0, 0], [0.1, 0.8, 0.1], [0, 0, 0]]
    spread = Crosstalk(optical={"*": kernel})
    ratio = channel_of(sensor.model_copy(update={"crosstalk": spread})).transfer / plain
    f = FREQUENCY_CY_PX
    assert ratio[0] == pytest.approx(np.abs(0.8 + 0.2 * np.cos(2 * np.pi * f * np.cos(turn))))
    assert ratio[1] == pytest.approx(np.abs(0.8 + 0.2 * np.cos(2 * np.pi * f * np.sin(turn))))


def test_mtf50_of_a_straight_fall():
    falling = np.maximum(1 - FREQUENCY_CY_PX / 0.66, 0)
    assert mtf50(np.stack([falling, np.ones_like(falling)])) == pytest.approx([0.33, 1.0])


PLACE_DEG, LINE_NM = 8.0, np.array([550.0])


@pytest.fixture(scope="module")
def tilted(lens):
    """Return a lens with an element that is tilted, and its PSFs to all sides."""
    for name, value in {"element.1-2.tilt_x_deg": 0.25, "element.1-2.tilt_y_deg": 0.15}.items():
        lens = perturbed(lens, name, value, name)
    ends = np.array([-PLACE_DEG, 0.0, PLACE_DEG])
    return lens, compute_plane_bank(lens, LINE_NM, ends, ends, reference_nm=LINE_NM[0])


@pytest.mark.parametrize("azimuth_deg", [0, 90, 180, 270])
def test_places_lie_as_in_a_bank_and_so_in_a_raw(tilted, azimuth_deg):
    """The wavefront at a place against the PSF that a bank has there."""
    lens, bank = tilted
    # x right, y down: the azimuth goes from y towards x.
    at = {0: (2, 1), 90: (1, 2), 180: (0, 1), 270: (1, 0)}[azimuth_deg]
    psf = bank.psf[at][0].astype(float)
    samples = (np.arange(len(psf)) - len(psf) // 2) * 1e-3 * bank.pitch_um
    turn = np.exp(-2j * np.pi * np.outer(CY_MM, samples))
    expected = np.abs([turn @ psf.sum(axis=axis) for axis in (0, 1)]) / psf.sum()
    chief_um = np.array([bank.chief_x_um[at][0], bank.chief_y_um[at][0]])
    away = np.radians(azimuth_deg)
    assert chief_um @ [np.sin(away), np.cos(away)] > 0.99 * np.hypot(*chief_um)

    def seen(azimuth: float) -> np.ndarray:
        one = wave_of(lens, np.radians(PLACE_DEG), azimuth, LINE_NM)
        nothing = np.zeros((1, 1, len(one.lines[0].basis)))
        return np.abs(otfs(one, np.ones(1), nothing, np.zeros(1), CY_MM)[0])

    # The window of 128 um holds all but 1 % of the light.
    assert seen(away) == pytest.approx(expected, abs=2e-2)
    assert np.abs(seen(away + np.pi) - expected).max() > 4e-2

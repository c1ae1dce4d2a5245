"""Lines for points of light: rings of a PSF at one wavelength average out over those of a bank."""

from types import SimpleNamespace

import numpy as np
import pytest
from optics.made import FLAT, monochrome, scene
from scipy.special import j1

from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan.fringes import LONE, MARGIN, cycles, lone_points, steps_for_fringes
from gpusim.psf.spreads import even_lines_nm
from gpusim.render.survey import Survey
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM

SINE = 1 / 5.6  # of an f/2.8 cone
CONE_SR = np.pi * SINE**2
REACH_UM = 64.0


def starry(brightness: float) -> Scene:
    """Return two stars far from each other on an even sky."""
    sky = np.ones((1, 40, 50), np.float32)
    sky[0, 5, 5] = sky[0, 30, 20] = brightness
    return Scene("stars", FLAT[None], Raster(sky), "E", FLAT)


def airy(radius_um: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """Return the PSF of a circular pupil, without its fall of 1 / r^3."""
    phase = 2e3 * np.pi * SINE * radius_um / wavelength_nm
    return phase * j1(phase) ** 2


def test_cycles_are_the_rings_that_a_band_runs_through():
    """Dark rings of Airy's pattern that pass a place between two wavelengths."""
    band = np.linspace(1 / 400, 1 / 700, 200_001)
    for radius in (20.0, 41.0, REACH_UM):
        rings = np.count_nonzero(np.diff(np.sign(j1(2e3 * np.pi * SINE * radius * band))))
        # Counts of whole rings.
        assert abs(rings - cycles(radius, CONE_SR, 400, 700)) <= 1


@pytest.mark.parametrize("reach_um", [20.0, REACH_UM])
def test_lines_that_are_asked_for_average_the_rings_out(reach_um):
    """Light of three channels at places as far as PSFs reach, of the lines and of 2000 others."""
    whole = even_lines_nm(1)
    steps = steps_for_fringes(whole, reach_um, CONE_SR)
    radius = np.linspace(reach_um / 2, reach_um, 500)[:, None]

    def light(lines: np.ndarray) -> np.ndarray:
        flat = np.ones(len(lines))
        bank = SimpleNamespace(
            wavelengths_nm=lines,
            projected_solid_angle_sr=flat,
            transmission=flat,
            relative_illumination=flat[None],
            spectral_degree=3,
        )
        off = (WAVELENGTHS_NM - np.array([[460], [540], [610]])) / 60
        bells = np.where(np.abs(off) < 1, np.cos(np.pi / 2 * off) ** 2, 0.0)
        weights = spectral_weights(bank, monochrome(4, 4), bells[:, None]).sum(axis=-1)
        return airy(radius, lines) @ weights.T

    true = light(1 / np.linspace(1 / 400, 1 / 700, 2001))
    found = light(even_lines_nm(steps))
    # The tolerance that the chart of points is for.
    error, of_few = (np.sqrt(np.mean((one / true - 1) ** 2)) for one in (found, light(whole)))
    assert error < 3e-3 < of_few / 10


def test_steps_rise_with_the_reach_and_end_at_the_most():
    lines = even_lines_nm(1)
    seen = cycles(REACH_UM, CONE_SR, 400, 700)
    assert steps_for_fringes(lines, REACH_UM, CONE_SR) == np.ceil(MARGIN * seen / 11) == 4
    assert steps_for_fringes(lines, 0.1, CONE_SR) == 1
    assert steps_for_fringes(lines, 1e4, CONE_SR) == 8


def test_points_count_where_they_bring_more_light_than_what_surrounds_them():
    # Two of 2000 samples are as bright as many times the others.
    assert lone_points(starry(1.01 + 1000 * LONE))
    assert not lone_points(starry(0.99 + 1000 * LONE))
    assert not lone_points(scene((), FLAT[None]))


def test_what_points_show_of_a_spread_is_its_change_over_itself():
    size, pitch_um = 64, 0.5
    at = np.arange(size) - size // 2
    own = np.broadcast_to(np.exp(-np.abs(at) / 6), (1, 2, size))
    off = 1e-3 * own * np.where(np.abs(at) < 4, 1.0, 0.0)
    middle = (-1.0) ** np.arange(size // 2 + 1)
    given = SimpleNamespace(
        contrast=5.0,
        size=size,
        sensor=monochrome(8, 8),
        pitch_um=pitch_um,
        points=True,
        told=14,
    )
    found = Survey.error(given, np.fft.rfft(off) * middle, np.fft.rfft(own) * middle)
    # 7 of 28 samples are off, both ways.
    assert found == pytest.approx(1e-3 * np.sqrt(7 / 28), rel=1e-6)

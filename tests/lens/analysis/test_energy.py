"""Encircled energy of an Airy disc, of a disc out of focus, and of two images side by side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lens.made import disc_samples
from scipy.special import j0, j1

from gpusim.lens.analysis.energy import centroid_um, encircled_energy, largest_radius_um
from gpusim.lens.wavefront import Pupil, pupils

LINE = np.array([550.0])
ONE = np.ones(1)
NA = 0.125


def disc(**shape) -> Pupil:
    return pupils(disc_samples(NA, **shape), LINE, 128.0, 256)[0]


def airy(radius_um: np.ndarray, wavelength_nm: float = 550.0) -> np.ndarray:
    """Return 1 - J0^2 - J1^2 (Born & Wolf, sec. 8.5.2, eq. 18)."""
    v = 2e3 * np.pi / wavelength_nm * NA * radius_um
    return 1 - j0(v) ** 2 - j1(v) ** 2


def energy(pupil: Pupil, radius_um: np.ndarray) -> np.ndarray:
    return encircled_energy([pupil], LINE, ONE, np.zeros((2, 1)), radius_um)


RADIUS = np.linspace(0, 60, 121)


def test_an_airy_disc_holds_what_born_and_wolf_say():
    # The rim's rounding on 256 nodes, as of the MTF: 1e-3 (`gpusim.psf.otf.PUPIL_NODES`).
    np.testing.assert_allclose(energy(disc(), RADIUS), airy(RADIUS), rtol=0, atol=1.5e-3)
    first_ring = 0.61 * 0.55 / NA
    assert energy(disc(), np.array([first_ring]))[0] == pytest.approx(0.838, abs=2e-3)


def test_a_whole_pupil_is_that_of_its_half():
    half = disc(opd=lambda a, b: 2e-3 * (a * a + 3 * b * b) + 0.02 * b**3)
    whole = replace(
        half,
        alpha=np.concatenate([-half.alpha[::-1], half.alpha]),
        coverage=np.concatenate([half.coverage[::-1], half.coverage]),
        opd_mm=np.concatenate([half.opd_mm[::-1], half.opd_mm]),
        entering=np.concatenate([half.entering[::-1], half.entering]),
        half=False,
    )
    np.testing.assert_allclose(energy(whole, RADIUS), energy(half, RADIUS), atol=1e-9)


def test_out_of_focus_it_is_that_of_the_round_integral():
    # W = c s^2: U(r) = integral exp(i k c s^2) J0(k r s) s ds, and 2 pi |U|^2 r dr summed up.
    defocus_um, k = 200.0, 2 * np.pi / 0.55
    s = (np.arange(2000) + 0.5) * NA / 2000
    r = (np.arange(1200) + 0.5) * 60 / 1200
    wave = np.exp(1j * k * defocus_um * s * s) * s * NA / 2000
    light = np.square(np.abs(j0(k * np.outer(r, s)) @ wave)) * r * 60 / 1200
    # Parseval: k^2 integral |U|^2 r dr = integral |P|^2 s ds = NA^2 / 2.
    expected = np.cumsum(light) * k * k / (NA * NA / 2)
    found = energy(disc(opd=lambda a, b: 1e-3 * defocus_um * (a * a + b * b)), r + 30 / 1200)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1.5e-3)
    # Rays land evenly over a disc of 2 c NA = 50 um.
    assert expected[600] == pytest.approx((30 / 50) ** 2, abs=0.03)


def test_a_circle_is_about_the_centre_of_mass():
    moved = disc(opd=lambda a, b: -5e-3 * b)  # every ray lands at y = 5 um
    assert centroid_um(moved) == (0.0, pytest.approx(5.0, abs=1e-6))
    np.testing.assert_allclose(energy(moved, RADIUS), energy(disc(), RADIUS), atol=2e-4)


def test_lateral_colour_puts_images_to_either_side():
    lines = np.array([550.0, 550.0])
    apart = np.array([[0.0, 0.0], [-12.0, 12.0]])
    radius = np.array([6.0, 20.0])
    found = encircled_energy([disc(), disc()], lines, np.ones(2), apart, radius)
    assert found[0] < 0.1 and found[1] > 0.9
    # Unequal light draws the centre to the brighter image.
    found = encircled_energy([disc(), disc()], lines, np.array([9.0, 1.0]), apart, radius)
    assert 0.7 < found[0] < 0.9


def test_the_largest_circle_is_half_the_image_that_repeats():
    assert largest_radius_um([disc()], LINE) >= 128

"""Light beyond the window: against closed forms of round pupils, rays, and a transform of it all."""

import numpy as np
import pytest
from scipy.fft import fft2, fftshift
from scipy.integrate import quad

from gpusim.gpu import default_device
from gpusim.lens.generator import Generator
from gpusim.lens.halo import SIZE, Wave, distances_um, fall, halo, pitches_um
from gpusim.lens.prescription import load_prescription, presets
from gpusim.lens.bank import compute_bank
from gpusim.lens.system import build

from gpusim.lens.wavefront import pupils, sample_field

PITCHES = pitches_um(0.5)
CORE_UM = 64.0


def round_pupil(sine, opd_um=lambda a, b: 0.0 * a, cut=None, turn=0.0, nodes=256):
    """Return the wave of a sharp disc in direction cosines, or of its half with alpha > cut."""
    step = 2.24 * sine / nodes
    line = (np.arange(nodes) - (nodes - 1) / 2) * step
    alpha, beta = np.meshgrid(line, line, indexing="ij")
    rho = np.hypot(alpha, beta)
    reach, light = (rho / sine) ** 2, np.clip((sine - rho) / step + 0.5, 0, 1)
    if cut is not None:
        turn = np.radians(turn)
        alpha = np.cos(turn) * alpha + np.sin(turn) * beta
        reach = np.maximum(reach, 1 - (alpha - cut) / sine)
        light = light * np.clip((alpha - cut) / step + 0.5, 0, 1)
    return Wave(line, line, opd_um(alpha, beta), reach, light)


def rises(r_um, from_um):
    """Return a weight that rises from 0 to 1 between a radius and twice it, smoothly."""
    part = np.clip(np.asarray(r_um) / from_um - 1, 0, 1)
    return part**2 * (3 - 2 * part)


def beyond(levels, outside, from_um):
    """Return the light of all levels, and beyond them, that a weight lets through."""
    held = [
        (level * rises(distances_um(SIZE, pitch), from_um)).sum()
        for level, pitch in zip(levels, PITCHES, strict=True)
    ]
    return sum(held) + outside


@pytest.mark.parametrize(("f_number", "wavelength_um"), [(1.4, 0.4), (2.8, 0.55), (8.0, 0.7)])
def test_a_round_pupil_throws_out_what_airys_pattern_does(f_number, wavelength_um):
    """1 - J0^2 - J1^2 is 2 lambda N / (pi^2 r) beyond r (Born and Wolf, sec. 8.5.2), fringes aside.

    The next term of Bessel's asymptotes is smaller by (lambda N / (pi r))^2 / 8: 3e-5 at f/8.
    Measured within 6e-4: bins of 4 % in radius, within which 1 / t^2 is not straight.
    """
    levels, outside = halo(round_pupil(0.5 / f_number), wavelength_um, CORE_UM, PITCHES)
    for from_um in (64.0, 150.0, 400.0, 1500.0, 5000.0):
        density = lambda r: 2 * wavelength_um * f_number / (np.pi * r) ** 2  # noqa: E731
        rising, _ = quad(lambda r: density(r) * rises(r, from_um), from_um, 2 * from_um)
        expected = rising + 2 * wavelength_um * f_number / (np.pi**2 * 2 * from_um)
        found = beyond(levels, outside, from_um)
        print(f_number, from_um, found / expected - 1)
        assert found == pytest.approx(expected, rel=2e-3)

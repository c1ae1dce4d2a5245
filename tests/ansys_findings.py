"""Findings of the Ansys validation without renders: from the rays of its lens and closed forms."""

import functools
import math
from types import SimpleNamespace

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from gpusim.metrics.distortion import measure_distortion
from gpusim.metrics.edge import samples_of
from gpusim.metrics.picture import Plane
from gpusim.metrics.sfr import FREQUENCIES_CY_PX, measure_sfr
from gpusim.validate import ansys, ansys_models, ansys_mtf, ansys_noise, ansys_square
from gpusim.validate.ansys_electrons import TOLERANCE, Electrons, EvenScene
from gpusim.validate.ansys_targets import BRIGHT, DARK
from gpusim.validate.certified import Certified
from gpusim.validate.edges import TILT_RAD

READING = ansys.READINGS[0]
F = FREQUENCIES_CY_PX
SUB = 4  # samples of a pixel along each side


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


def certified(rms, tolerance):
    """Return a certificate of a render that was planned for a tolerance."""
    own = SimpleNamespace(total_rms=rms, total_worst=1e-3, met=True, probes=8)
    return Certified(own, tolerance)


def drawn(lens, stretch=0.0, frequency=1.0, rms=1e-4, noise=0.0):
    """Return what a reading would give whose renders follow a lens."""
    x, y = ideal_places(lens, stretch)
    side = ansys.square_mm(READING, lens)
    # Soft edges: hard ones between samples would move corners by hundredths of a pixel.
    soft = np.tanh(6 * np.sin(np.pi * x / side) * np.sin(np.pi * y / side))
    board = pixels((BRIGHT + DARK + (BRIGHT - DARK) * soft) / 2)
    board = board + np.random.default_rng(4).normal(0, noise, board.shape)
    plane = Plane(board, None, (-math.inf, math.inf))
    peaks, (left, top, wide, high) = [], ansys.middle(READING)
    for period in ansys.PERIODS_PX:
        wave = np.cos(2 * np.pi * frequency * x / (1e-3 * period * READING.pitch_um))
        seen = pixels(wave)[top : top + high, left : left + wide]
        peaks.append(ansys.peak_of(seen, READING, lens, period))
    distortion = measure_distortion({"W": plane})
    return distortion, board, peaks, {"all": certified(rms, ansys.TOLERANCE)}, board


def frames_of(count, factor=1.0):
    """Return a soft edge's mean and frames with shot and read noise; the noise times a factor."""
    y, x = np.mgrid[:64, :64] + 0.5
    mean = 3000 + 3000 * (0.5 + 0.5 * erf((x - 32 - math.tan(TILT_RAD) * (y - 32)) / 1.2))
    draw = np.random.default_rng(8)
    noise = [draw.poisson(mean) - mean + draw.normal(0, 5.0, mean.shape) for _ in range(count)]
    return mean, [mean + factor * one for one in noise]


@functools.cache
def measured_of(count, factor=1.0):
    """Return what each of so many frames says of the edge."""
    return [measure_sfr(one, (0, 0, 64, 64)) for one in frames_of(count, factor)[1]]


@functools.cache
def noise_of(count, factor=1.0):
    mean, _ = frames_of(1)
    region = (0, 0, 64, 64)
    clean = measure_sfr(mean, region)
    pixels = samples_of(mean, region)
    covariance = ansys_noise.sfr_covariance(
        clean.line.distance(pixels.x, pixels.y),
        mean.ravel() + 5.0**2,
        step_e=3000.0,
        distance_px=clean.distance_px,
        lsf=clean.lsf,
        rise_px=clean.rise_px,
    )
    curves = np.array([one.sfr[: F.size] for one in measured_of(count, factor)])
    reach = float(clean.distance_px[-1])
    return ansys_noise.Noise(3, curves, clean.sfr[: F.size], covariance, reach)


def sharp(**planted):
    """Return a reading whose renders are as predicted, but for what is planted."""
    curve = np.exp(-2 * F)
    off = planted.get("sfr", 0.0)
    edge = SimpleNamespace(
        mtf_error=off, error_px=0.0, measured_mtf=curve + off * (F > 0.5), predicted_mtf=curve
    )
    maps = ("electrons",) if planted.get("by_rays") else ("electrons", "irradiance")
    edges = {(name, n): edge for name in maps for n in ansys_square.ROIS}
    noise = dict.fromkeys(ansys_square.ROIS, noise_of(20, planted.get("noise", 1.0)))
    focus = []
    for shift in (-10.0, 0.0, 10.0, 20.0):
        measured = None if planted.get("by_rays") else np.exp(-(2 + abs(shift) / 20) * F)
        predicted = np.exp(-(2 + planted.get("focus", 1.0) * abs(shift) / 20) * F)
        focus.append(ansys_mtf.Focus(shift, measured, predicted))
    certificates = {"all": certified(planted.get("rms", 1e-4), ansys_square.TOLERANCE)}
    names = "diffraction limit", "rays alone", "lens", "lens and pixel", "Gaussian", "no colour"
    models = dict.fromkeys((*names, "Gaussian, no colour"), np.ones(F.size))
    ways = [ansys_models.Opened("f/2", 2.0, 5.0)]
    regions = {1: (0, 0, 5, 5), 3: (2, 2, 5, 5)}
    return ansys_mtf.Sharpness(
        READING, 2.88, edges, noise, focus, models, ways, certificates, regions
    )


def even(off=0.0, rms=1e-4):
    """Return an even scene whose electrons are off by a share."""
    places = [Electrons(0.0, 0.0, 1000.0 * (1 + off), 1000.0, 0.3, 0.0, 0.0)]
    return EvenScene(places, certified(rms, TOLERANCE))

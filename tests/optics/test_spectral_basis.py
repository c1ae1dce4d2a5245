"""Spectral basis, and weights of wavelengths, against integrals and edge responses made here."""

from dataclasses import replace

import numpy as np
import pytest
from harness import assert_close
from optics.made import BLUE, FLAT, RED, bank, monochrome, sensor

from gpusim.optics import spectral_basis
from gpusim.optics.spectral_basis import (
    MAX_PLANES,
    RMS_SHARE,
    camera_basis,
    edge_responses,
    reduce_spectra,
    spectral_weights,
)
from gpusim.scene.spectra import WAVELENGTHS_NM, colorchecker
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.sensor import Sensor

LENS = bank(fields=5)
CAMERA = sensor()
PATCHES = np.stack(list(colorchecker().values())) * 1e-3


def reduced(spectra, tolerance, lens=LENS, camera=CAMERA, order=None):
    order = np.arange(len(spectra)) if order is None else np.array(order)
    weights = spectral_weights(lens, camera)
    return reduce_spectra(spectra, weights, edge_responses(lens), tolerance, order)


def test_electrons_of_a_flat_spectrum_in_closed_form():
    """A QE of one half, 1 sr, no losses: N = A L QE / (h c) (l2^2 - l1^2) / 2."""
    curve = QuantumEfficiency(wavelengths_nm=[400, 700], channels={"W": [0.5, 0.5]})
    camera = monochrome(quantum_efficiency=curve, fill_factor=0.64)
    ones = np.ones(3)
    lens = replace(LENS, projected_solid_angle_sr=ones, transmission=ones)
    weights = spectral_weights(lens, camera)
    assert weights.shape == (1, 3, 61)
    area_m2 = 0.64 * 1.55e-6**2
    hc = 6.62607015e-34 * 299792458.0
    # Per nm of bandwidth: the trapezoidal rule is exact for the straight line lambda / (h c).
    exact = area_m2 * 0.5 * (700**2 - 400**2) / 2 * 1e-9 / hc
    assert_close(weights.sum(), np.array(exact), rtol=1e-12)


def test_a_line_is_shared_by_the_wavelengths_of_the_bank():
    """Three wavelengths share it by the parabola in 1 / lambda: 1 at their own, 0 at the others."""
    weights = spectral_weights(LENS, CAMERA)
    at = list(WAVELENGTHS_NM).index(475.0)
    x, (a, b, c) = 1 / 475, 1 / LENS.wavelengths_nm
    shares = np.array(
        [
            (x - b) * (x - c) / ((a - b) * (a - c)),
            (x - a) * (x - c) / ((b - a) * (b - c)),
            (x - a) * (x - b) / ((c - a) * (c - b)),
        ]
    )
    assert shares[2] < -0.1  # a control: no mean of the nearest
    solid = shares @ (LENS.projected_solid_angle_sr * LENS.transmission)
    photons = 475e-9 / (6.62607015e-34 * 299792458.0) * 1.55e-6**2 * 5 * solid
    green = CAMERA.qe["G"][at] * photons
    assert_close(weights[1, :, at], green * shares, rtol=1e-12)
    assert_close(weights[1, :, at].sum(), np.array(green), rtol=1e-12)
    assert not weights[:, [0, 2], list(WAVELENGTHS_NM).index(550.0)].any()


def test_edge_responses_are_running_sums_of_the_psf():
    """Over the light of the brightest, to 1e-12: a level of a halo may hold a thousandth of it."""
    dim = replace(LENS, psf=np.float32(2**-10) * LENS.psf)
    assert_close(edge_responses(dim), edge_responses(LENS), atol=1e-15)
    edges = edge_responses(LENS)
    n = LENS.psf.shape[-1]
    brightest = max(LENS.psf[field].sum(axis=(1, 2), dtype=float).max() for field in (0, 2, 4))
    parts = edges.reshape(3, 3, 2, n // 2)  # wavelength, field, axis
    for at, field in enumerate((0, 2, 4)):
        for place in range(3):
            psf = LENS.psf[field, place].astype(float)
            psf /= brightest
            sagittal = psf.sum(axis=1).cumsum()[::2]
            assert_close(parts[place, at, 1], sagittal, atol=1e-12)
            shift = LENS.real_height_um[field, place] - LENS.real_height_um[field, 1]
            tangential = psf.sum(axis=0).cumsum()
            moved = np.interp(np.arange(n) - shift / 0.5, np.arange(n), tangential)[::2]
            assert_close(parts[place, at, 0], moved, atol=1e-12)


def check_honest(spectra, basis, lens=LENS, camera=CAMERA) -> float:
    """Return the largest error of an edge response, of spectra put together from the planes."""
    seen = np.einsum("clw,mw->mcl", spectral_weights(lens, camera), spectra)
    again = np.einsum("mj,jcl->mcl", basis.coefficients, basis.weights)
    edges = edge_responses(lens)
    error = np.abs((again - seen) @ edges).max(axis=2)
    signal = seen.sum(axis=2)
    return float((error[signal > 0] / signal[signal > 0]).max())


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-3, 1e-5])
def test_the_residual_is_the_error_and_within_the_tolerance(tolerance: float):
    basis = reduced(PATCHES, tolerance)
    assert basis.residual <= tolerance
    # Equal but for coefficients rounded to zero: 1e-9 of the rest.
    assert check_honest(PATCHES, basis) == pytest.approx(basis.residual, abs=1e-7)


def test_no_fewer_planes_would_do():
    """With one plane less the best subspace's error exceeds the tolerance."""
    for tolerance in (1e-2, 1e-3, 1e-4):
        planes = reduced(PATCHES, tolerance).coefficients.shape[1]
        fewer = [
            reduced(PATCHES, limit)
            for limit in (1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4)
            if reduced(PATCHES, limit).coefficients.shape[1] < planes
        ]
        assert fewer
        for basis in fewer:
            assert basis.residual > tolerance or basis.rms > RMS_SHARE * tolerance
        assert reduced(PATCHES, tolerance).rms <= RMS_SHARE * tolerance


def test_a_tighter_tolerance_never_gives_fewer_planes():
    counts = [reduced(PATCHES, 10.0**-k).coefficients.shape[1] for k in range(7)]
    assert counts == sorted(counts) and counts[0] < counts[-1] <= MAX_PLANES


def test_shades_of_one_spectrum_need_one_plane():
    shades = np.outer([1.0, 0.2, 0.05, 0.9], RED)
    basis = reduced(shades, 1e-6)
    assert basis.coefficients.shape == (4, 1) and basis.residual < 1e-12
    assert_close(
        basis.coefficients[:, 0] / basis.coefficients[0, 0],
        np.array([1, 0.2, 0.05, 0.9]),
        rtol=1e-12,
    )


def test_without_chromatic_aberration_three_channels_need_three_planes():
    lens = bank(sigma_um=(1.0, 1.0, 1.0), lateral=(0.0, 0.0, 0.0), falloff=0.0)
    basis = reduced(PATCHES, 1e-6, lens)
    assert basis.coefficients.shape[1] == 3
    assert reduced(PATCHES, 1e-6).coefficients.shape[1] > 3  # a control: with it they need more
    one = reduced(PATCHES, 1e-6, lens, monochrome())
    assert one.coefficients.shape[1] == 1


def test_the_commonest_spectra_need_the_first_planes_only():
    spectra = np.stack([FLAT, RED, BLUE, 0.3 * FLAT + 0.4 * RED, PATCHES[7]])
    order = [2, 0, 3, 1, 4]
    basis = reduced(spectra, 1e-5, order=order)
    planes = basis.coefficients.shape[1]
    assert planes >= 4
    for rank, spectrum in enumerate(order[: planes - 1]):
        assert not basis.coefficients[spectrum, rank + 1 :].any(), (rank, spectrum)
    assert basis.coefficients[2, 0] != 0
    assert check_honest(spectra, basis) <= 1e-5


def test_a_black_material_has_no_coefficients():
    basis = reduced(np.stack([np.zeros(61), FLAT, RED]), 1e-4, order=[0, 1, 2])
    assert np.isfinite(basis.coefficients).all() and np.isfinite(basis.weights).all()
    assert not basis.coefficients[0].any()
    assert not basis.coefficients[1, 1:].any()


def test_there_are_no_more_planes_than_may_be_and_the_residual_says_so(monkeypatch):
    # Three channels and three lines tell nine apart.
    monkeypatch.setattr(spectral_basis, "MAX_PLANES", 8)
    spectra = np.random.default_rng(4).uniform(0, 1e-3, (30, 61))
    basis = reduced(spectra, 1e-12)
    assert basis.coefficients.shape[1] == 8
    assert check_honest(spectra, basis) == pytest.approx(basis.residual, rel=1e-6)
    assert basis.residual > 1e-12


@pytest.mark.parametrize("camera", [CAMERA, monochrome()], ids=["bayer", "monochrome"])
def test_planes_are_for_what_a_spectral_scene_shows(camera: Sensor):
    """Bands of 10 nm, of which samples are smooth mixtures: fewer planes than bands do, signed."""
    lens = bank(
        sigma_um=tuple(np.linspace(0.9, 1.3, 13)), lateral=tuple(np.linspace(-4, 4, 13) / 1e3)
    )
    middles = np.linspace(400, 700, 31)[:, None]
    bands = 1e-3 * np.maximum(1 - np.abs(WAVELENGTHS_NM - middles) / 10, 0)
    rng = np.random.default_rng(8)
    bumps = np.exp(-((np.linspace(0, 1, 31) - rng.uniform(0, 1, (4, 1))) ** 2) / 0.1)
    shown = rng.uniform(0.01, 1, (60, 4)) @ bumps
    order, tolerance = np.arange(31), 5e-3
    given = bands, tolerance, order
    basis = camera_basis(lens, camera, *given, place_error=0.0, mixtures=shown)
    planes = basis.coefficients.shape[1]
    whole = camera_basis(lens, camera, *given, place_error=0.0).coefficients.shape[1]
    assert planes < whole <= 31 and planes <= 12
    assert basis.coefficients.shape == (31, planes) and (basis.coefficients < 0).any()
    mixed = replace(basis, coefficients=shown @ basis.coefficients)
    found = check_honest(shown @ bands, mixed, lens, camera)
    assert found <= tolerance
    assert found == pytest.approx(basis.residual, rel=1e-3)
    # The planes' spectra are what their weights say.
    weights = np.einsum("clw,jw->jcl", spectral_weights(lens, camera), basis.spectra)
    assert_close(basis.weights, weights, atol=1e-12 * np.abs(weights).max())


def test_a_scene_that_no_channel_sees_is_one_black_plane():
    lens = bank()
    found = reduce_spectra(
        np.zeros((3, 61)),
        spectral_weights(lens, sensor()),
        edge_responses(lens),
        1e-3,
        np.arange(3),
    )
    assert found.coefficients.shape == (3, 1) and not found.weights.any()
    assert found.residual == 0

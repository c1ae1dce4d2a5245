"""Between a bank's fields and wavelengths: engine and exact model against a lens in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from optics.made import FLAT, at_lines, bank, gaussian, monochrome

from gpusim.optics.images import field_images
from gpusim.optics.kernels import field_kernels
from gpusim.optics.sampling import sampled_kernels
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.psf.bank import Bank
from gpusim.reference.exact_model import ExactCore
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.qe import QuantumEfficiency

CIRCLE_UM = 160.0
PITCH_UM = 0.5
PLACES = ((20.3, 0.0), (-50.0, 42.0), (31.0, -118.0))  # none at a field


def width_um(u: np.ndarray, x: np.ndarray) -> np.ndarray:
    return 1.2 + 0.6 * u**2 + 0.2 * np.exp(5 * (x - 1))


def light(u: np.ndarray, x: np.ndarray) -> np.ndarray:
    return 1 - (0.3 + 0.1 * (x - 1)) * u**2 + 0.1 * u**4


def lateral_um(u: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the chief ray's distance from that at 550 nm: three times as far as it is wide."""
    return 2.0 * u * (np.exp(5 * (x - 1)) - 1)


def smooth(fields: int, lines: int) -> Bank:
    """Return a lens of Gaussians that change with u = r / R and x = 550 nm / lambda.

    Coma: they lie 1.5 u um farther out than their chief rays.
    """
    plain = bank(fields, 96, CIRCLE_UM, (1.0,) * lines, 0.0, distortion=0.0, lateral=(0.0,) * lines)
    u, x = np.linspace(0, 1, fields)[:, None], 550 / plain.wavelengths_nm
    at = (np.arange(96) - 48) * PITCH_UM
    sigma = width_um(u, x)[..., None]
    across, along = gaussian(at, sigma), gaussian(at - 1.5 * u[..., None], sigma)
    return replace(
        plain,
        real_height_um=plain.real_height_um + lateral_um(u, x),
        psf=(PITCH_UM**2 * across[..., :, None] * along[..., None, :]).astype(np.float32),
        relative_illumination=light(u, x),
        projected_solid_angle_sr=np.ones(lines),
        transmission=np.ones(lines),
    )


def camera(band: tuple[float, float] = (400.0, 700.0)):
    """Return a grey sensor that sees a band alone."""
    qe = np.where((WAVELENGTHS_NM >= band[0]) & (WAVELENGTHS_NM <= band[1]), 0.5, 0.0)
    curve = QuantumEfficiency(wavelengths_nm=WAVELENGTHS_NM.tolist(), channels={"W": qe.tolist()})
    return monochrome(quantum_efficiency=curve)


def exact(place: tuple[float, float], t: np.ndarray, of: object) -> np.ndarray:
    """Return H at t (..., 2) from a source point, of light 1: by samples of the spectrum."""
    radius = np.hypot(*place)
    cos, sin = np.array(place) / radius
    x, u = 550 / WAVELENGTHS_NM, radius / CIRCLE_UM
    electrons = of.qe["W"] * WAVELENGTHS_NM * np.where(np.arange(61) % 60, 1, 0.5)
    along, across = t[..., 0] * cos + t[..., 1] * sin, t[..., 1] * cos - t[..., 0] * sin
    total = np.zeros(along.shape)
    for share, one in zip(electrons / electrons.sum(), x, strict=True):
        if share:
            out, sigma = lateral_um(u, one) + 1.5 * u, width_um(u, one)
            spread = gaussian(along - out, sigma) * gaussian(across, sigma)
            total += share * light(u, one) * spread
    return total


def engine_error(lens: Bank, of: object, dots: bool = False) -> float:
    """Return the largest error of the engine's kernels, of their peak.

    With dots, all light lies at the chief rays of the bank's wavelengths.
    """
    rates = (spectral_weights(lens, of) * FLAT)[None]
    if dots:
        rates = at_lines(lens, rates.sum(axis=-1))
    images, places = field_images(lens, rates, 1e9)
    kernels = field_kernels(images, places, PITCH_UM, PITCH_UM, np.ones(images.shape[-2:]))
    at = (np.arange(64) - 32) * PITCH_UM
    t = np.stack(np.meshgrid(at, at), axis=-1)
    errors = []
    for place in PLACES:
        kernel = sampled_kernels(kernels, *place, PITCH_UM, 32, planes=1)[0, 0]
        found = kernel / (PITCH_UM**2 * rates.sum())
        expected = exact(place, t, of)
        errors.append(np.abs(found - expected)[1:, 1:].max() / expected.max())
    return max(errors)


def model_error(lens: Bank, of: object) -> float:
    """Return the same of the exact model's H."""
    model = ExactCore(lens, of, FLAT[None], WAVELENGTHS_NM)
    zone = model.zones[1]  # the inner one, with the peak
    rate = spectral_weights(lens, of).sum(axis=(0, 1)) @ FLAT / of.pixel_pitch_um**2
    errors = []
    for place in PLACES:
        source = np.array(place) + np.zeros_like(zone.t)
        found = model.spread.around(zone, 0, [0], source)[0] / rate
        expected = exact(place, zone.t, of)
        errors.append(np.abs(found - expected).max() / expected.max())
    return max(errors)


ERRORS = pytest.mark.parametrize("error", [engine_error, model_error])


@ERRORS
def test_between_fields_errors_fall_with_the_fourth_power_of_their_distance(error):
    found = [error(smooth(fields, 13), camera()) for fields in (6, 11)]
    print(error.__name__, "fields", found)
    assert found[1] < 1e-3
    # Straight lines gain 4; a cubic 16, and less where f32 and the splines' own error count.
    assert found[0] / found[1] > 10


@ERRORS
def test_between_lines_errors_fall_with_the_fourth_power_of_their_distance(error):
    found = [error(smooth(21, lines), camera((460.0, 490.0))) for lines in (7, 13)]
    print(error.__name__, "lines", found)
    assert found[1] < 1e-3
    assert found[0] / found[1] > 8  # straight lines gain less than 4


@ERRORS
def test_lateral_colour_is_a_streak(error):
    """Chief rays of neighbouring lines lie farther apart than PSFs are wide: no dots are seen."""
    lens = smooth(21, 5)
    apart = np.abs(np.diff(lens.real_height_um[-1]))
    assert apart.max() > 2 * 1.4
    # Splines between lines 75 nm apart: measured 2.2e-3.
    assert error(lens, camera()) < 4e-3
    assert engine_error(lens, camera(), dots=True) > 0.02  # a control

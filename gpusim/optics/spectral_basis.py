"""The few spectra that stand for a scene, for this lens and sensor: few planes are convolved.

Before the shot noise the chain is linear. The PSF about its own chief ray is a spline in wavelength
through those of the bank (`gpusim.psf.lines`), so the integral over wavelength reduces to one
weight per colour channel, scene spectrum and bank wavelength; where chief rays go with the
wavelength, to as many as there are samples of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from gpusim.optics.angular import AngularResponse, PlaceWeights
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.lines import line_shares
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.sensor import Sensor

PLANCK_J_S = 6.62607015e-34  # SI (2019), exact
LIGHT_M_S = 299792458.0  # SI (2019), exact
ROUNDING = 1e-9  # far above the rounding of a decomposition in float64, far below any tolerance
# Planes that a scene may need: one more than a spectral scene's 31 bands of 10 nm. Time, and room
# for kernels, go with their number.
MAX_PLANES = 32
# The root mean square of the errors over spectra and channels, as a part of the largest allowed: a
# scene of few colours may show the worst of them everywhere.
RMS_SHARE = 0.1


def spectral_weights(
    bank: FieldBank,
    sensor: Sensor,
    qe: np.ndarray | None = None,
    wavelengths_nm: np.ndarray = WAVELENGTHS_NM,
) -> np.ndarray:
    """Return the electrons/s of a unit of spectral radiance, by channel and wavelength.

    N = A Omega integral (lambda / hc) QE(lambda) T(lambda) L(lambda) d lambda (EMVA 1288 R4, eq. 1,
    with the irradiance of an extended source, E = L Omega), by the trapezoidal rule, shared out
    between the wavelengths of the bank.

    Parameters
    ----------
    bank : FieldBank
    sensor : Sensor
    qe : ndarray (..., C, 1 or L, K), optional
        In place of the quantum efficiency on the axis.
    wavelengths_nm : ndarray (K,)
        Samples of the spectra.

    Returns
    -------
    ndarray (..., C, L, K)
        Electrons/s per W m^-2 sr^-1 nm^-1 on the axis: channel, bank wavelength, sample.
    """
    step = np.gradient(wavelengths_nm)
    step[[0, -1]] /= 2
    area_m2 = sensor.fill_factor * (sensor.pixel_pitch_um * 1e-6) ** 2
    photons_per_joule = wavelengths_nm * 1e-9 / (PLANCK_J_S * LIGHT_M_S)
    shares = line_shares(bank.wavelengths_nm, bank.spectral_degree, wavelengths_nm)
    collected_sr = (bank.projected_solid_angle_sr * bank.transmission) @ shares
    if qe is None and sensor.eqe_map is not None:
        qe = AngularResponse(bank, sensor, wavelengths_nm).on_axis
    elif qe is None:
        qe = np.stack(list(sensor.qe_at(wavelengths_nm).values()))[:, None]
    return qe * photons_per_joule * area_m2 * collected_sr * step * shares


@dataclass(frozen=True)
class Basis:
    """Scene spectra as the camera sees them: sum_j coefficients[m, j] weights[j, c, l].

    Attributes
    ----------
    coefficients : ndarray (M, J)
        Coefficients of each scene spectrum.
    weights : ndarray (J, C, L)
        Electrons/s of each plane in each channel, by bank wavelength.
    residual : float
        Largest error of an edge response, relative to the signal of the same spectrum in the same
        channel.
    rms : float
        Root mean square of these errors over spectra and channels.
    spectra : ndarray (J, K)
        Spectra of the planes, W m^-2 sr^-1 nm^-1.
    response : ndarray (C, L, K)
        As `spectral_weights` returns it.
    elsewhere : PlaceWeights, optional
        Where the quantum efficiency goes with the place, `weights` off the axis.
    wavelengths_nm : ndarray (K,)
        Samples of the spectra.
    """

    coefficients: np.ndarray
    weights: np.ndarray
    residual: float
    rms: float
    spectra: np.ndarray
    response: np.ndarray
    elsewhere: PlaceWeights | None = None
    wavelengths_nm: np.ndarray = field(default_factory=lambda: WAVELENGTHS_NM)

    @property
    def rates(self) -> np.ndarray:
        """Electrons/s of each plane (J, C, L, K) by bank wavelength and sample of the spectra.

        Their sums over the samples are the weights.
        """
        return self.spectra[:, None, None] * self.response


def edge_responses(bank: FieldBank) -> np.ndarray:
    """Return edge-spread functions of the bank at axis, half and full field, along both axes.

    Returns
    -------
    ndarray (L, n_features)
        The last sample of each is the PSF's whole energy, over the largest one.
    """
    features = []
    positions = (np.arange(bank.psf.shape[-1]) - bank.psf.shape[-1] // 2) * bank.pitch_um
    for number in bank.probes:
        psf, shift_um, _ = bank.field(number)
        for axis, shifts in enumerate(shift_um.T):
            edges = np.cumsum(psf.sum(axis=1 + axis, dtype=np.float64), axis=-1)
            shifted = [
                np.interp(positions - d, positions, row)
                for d, row in zip(shifts, edges, strict=True)
            ]
            # Every second sample: 1 um, below half of the Airy radius.
            features.append(np.stack(shifted)[:, ::2])
    found = np.concatenate(features, axis=1)
    return found / found.max()


def camera_basis(
    bank: FieldBank,
    sensor: Sensor,
    spectra: np.ndarray,
    tolerance: float,
    common_first: np.ndarray,
    *,
    place_error: float,
    wavelengths_nm: np.ndarray = WAVELENGTHS_NM,
    mixtures: np.ndarray | None = None,
) -> Basis:
    """Find the fewest planes that give what a camera sees of scene spectra, at every place.

    A sensor whose quantum efficiency goes with the place is another camera at each: planes are as
    many as keep apart what any of them tells apart.

    Parameters
    ----------
    bank : FieldBank
    sensor : Sensor
    spectra, tolerance, common_first
        See `reduce_spectra`.
    place_error : float
        How much of a plane's light the weights elsewhere may leave out: see `PlaceWeights`.
    wavelengths_nm : ndarray (K,)
        Samples of the spectra.
    mixtures : ndarray (P, M), optional
        Coefficients of what the scene shows, where that is less than the spectra could make: planes
        are for these. None of a scene that shows its spectra as they are.
    """
    shown = spectra if mixtures is None else mixtures @ spectra
    order = common_first if mixtures is None else np.arange(len(shown))
    weights = spectral_weights(bank, sensor, wavelengths_nm=wavelengths_nm)
    edges = edge_responses(bank)
    if sensor.eqe_map is None:
        basis = reduce_spectra(shown, weights, edges, tolerance, order)
        if mixtures is not None:
            basis = replace(basis, coefficients=_projected(spectra, shown, basis, weights, edges))
        return replace(basis, wavelengths_nm=wavelengths_nm)
    response = AngularResponse(bank, sensor, wavelengths_nm)
    others = spectral_weights(bank, sensor, response.everywhere(), wavelengths_nm)
    everywhere = np.concatenate([weights, others.reshape(-1, *weights.shape[1:])])
    basis = reduce_spectra(shown, everywhere, edges, tolerance, order)
    if mixtures is not None:
        basis = replace(basis, coefficients=_projected(spectra, shown, basis, everywhere, edges))
    alike = np.ones((1, 1, wavelengths_nm.size))
    per_photon = spectral_weights(bank, sensor, alike, wavelengths_nm)[0]
    return replace(
        basis,
        wavelengths_nm=wavelengths_nm,
        weights=basis.weights[:, : len(weights)],
        response=weights,
        elsewhere=PlaceWeights(response, per_photon, basis.spectra, place_error),
    )


def reduce_spectra(
    spectra: np.ndarray,
    weights: np.ndarray,
    edges: np.ndarray,
    tolerance: float,
    common_first: np.ndarray,
) -> Basis:
    """Find the fewest planes that give every scene spectrum's edge response within a tolerance.

    A singular value decomposition in the space of edge responses: what the camera cannot tell apart
    is not kept apart. A chart in shades of one spectrum needs one plane, and three channels behind
    a lens without chromatic aberration need three for any scene. The planes are then turned so that
    the commonest spectra lie in the first of them: where a block of the image shows no others, the
    rest is left out.

    Parameters
    ----------
    spectra : ndarray (M, K)
        Scene spectra, W m^-2 sr^-1 nm^-1 per unit coefficient.
    weights : ndarray (C, L, K)
        As `spectral_weights` returns them.
    edges : ndarray (L, n_features)
        As `edge_responses` returns them.
    tolerance : float
        Largest error of an edge response, relative to the spectrum's own signal; the root mean
        square over spectra and channels is held to `RMS_SHARE` of it.
    common_first : ndarray (M,) of int
        The spectra, commonest first.
    """
    seen = np.einsum("clw,mw->mcl", weights, spectra)
    signal = seen.sum(axis=2)
    channel_scale = 1 / np.maximum(signal.max(axis=0), np.finfo(float).tiny)
    material_scale = 1 / np.maximum((signal * channel_scale).mean(axis=1), np.finfo(float).tiny)
    scaled = seen * material_scale[:, None, None] * channel_scale[:, None]
    features = np.einsum("mcl,lf->mcf", scaled, edges)
    # The left singular vectors of A are those of R', A' = Q R: a small matrix.
    triangle = np.linalg.qr(features.reshape(len(spectra), -1).T, mode="r")
    left, _, _ = np.linalg.svd(triangle.T, full_matrices=False)
    for planes in range(1, min(left.shape[1], MAX_PLANES) + 1):
        vectors = left[:, :planes]
        planes_seen = np.einsum("mj,mcl->jcl", vectors, scaled)
        fitted = np.einsum("mj,jcl->mcl", vectors, planes_seen)
        error = np.abs(np.einsum("mcl,lf->mcf", scaled - fitted, edges)).max(axis=2)
        relative = error / np.maximum(scaled.sum(axis=2), 1e-12)
        residual, rms = float(relative.max()), float(np.sqrt(np.mean(relative**2)))
        if residual <= tolerance and rms <= RMS_SHARE * tolerance:
            break
    turn = _commonest_first((vectors / material_scale[:, None])[common_first])
    coefficients = vectors / material_scale[:, None] @ turn
    size = np.linalg.norm(coefficients, axis=1, keepdims=True)
    # For a black material the decomposition leaves subnormal numbers.
    coefficients[np.abs(coefficients) < np.maximum(ROUNDING * size, np.finfo(float).tiny)] = 0.0
    return Basis(
        coefficients=coefficients,
        weights=np.einsum("jk,jcl->kcl", turn, planes_seen) / channel_scale[:, None],
        residual=residual,
        rms=rms,
        spectra=turn.T @ vectors.T @ (material_scale[:, None] * spectra),
        response=weights,
    )


def _projected(
    spectra: np.ndarray, shown: np.ndarray, basis: Basis, weights: np.ndarray, edges: np.ndarray
) -> np.ndarray:
    """Return coefficients (M, J) of spectra in the planes of a basis that is for mixtures (P, K).

    By least squares over edge responses, as the decomposition weighs them. For the mixtures
    themselves that gives what the decomposition gave.
    """
    seen = np.einsum("clw,mw->mcl", weights, spectra)
    of_planes = np.einsum("clw,jw->jcl", weights, basis.spectra)
    signal = np.einsum("clw,mw->mc", weights, shown).max(axis=0)
    scale = 1 / np.maximum(signal, np.finfo(float).tiny)[:, None]
    responses, of_planes = (
        np.einsum("xcl,lf->xcf", one * scale, edges).reshape(len(one), -1)
        for one in (seen, of_planes)
    )
    return np.linalg.lstsq(of_planes.T, responses.T, rcond=ROUNDING)[0].T


def _commonest_first(coefficients: np.ndarray) -> np.ndarray:
    """Return a rotation (J, J) by Gram-Schmidt: the first spectra then need the fewest planes."""
    directions: list[np.ndarray] = []
    for row in coefficients:
        rest = row - sum(
            (direction * (direction @ row) for direction in directions), np.zeros(len(row))
        )
        if np.linalg.norm(rest) > ROUNDING * np.linalg.norm(row):
            directions.append(rest / np.linalg.norm(rest))
        if len(directions) == len(row):
            break
    # A scene that no channel sees keeps one plane, of zeros.
    return np.stack(directions or [np.eye(coefficients.shape[1])[0]], axis=1)

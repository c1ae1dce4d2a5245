"""Point-spread function of a pupil, by the matrix Fourier transform."""

from __future__ import annotations

import numpy as np

from gpusim.lens.wavefront import Pupil

COPIES = 2  # periods to each side whose light folds in: the next ones hold 1e-2 of the nearest's


def intensity(
    pupil: Pupil, wavelength_nm: float, size: int, pitch_um: float
) -> tuple[np.ndarray, float]:
    """Return the PSF of one field and wavelength, and the energy outside its window.

    U = E_eta P E_xi with P = A exp(i k W) and the two Fourier kernels as matrices (Soummer et al.,
    Opt. Express 15, 15935, 2007), so that the image grid does not depend on the
    wavelength. Where pupil and PSF are symmetric in the tangential direction, the kernel is
    2 cos(k alpha eta) and only rows eta <= 0 are computed.

    Parameters
    ----------
    pupil : Pupil
    wavelength_nm : float
    size : int
        Samples across the window, even.
    pitch_um : float
        Spacing of the samples.

    Returns
    -------
    psf : ndarray, shape (size, size)
        Share of the light per sample; rows tangential (eta), columns radial (xi, pointing away from
        the axis); sample j at (j - size / 2) pitch from the chief ray's point. With a whole pupil,
        rows are x and columns y.
    outside : float
        Share of the light that falls outside the window: 1 - psf.sum(). The total is known from
        the pupil (Parseval): lambda^2 times the integral of A^2.
    """
    wavelength_um = wavelength_nm * 1e-3
    k = 2 * np.pi / wavelength_um
    at = (np.arange(size) - size // 2) * pitch_um
    lit = pupil.coverage.any(axis=0)
    phase = np.exp(1j * k * 1e3 * pupil.opd_mm[:, lit])
    field = np.ascontiguousarray(pupil.amplitude[:, lit] * phase)
    along = np.exp(1j * k * np.outer(pupil.beta[lit], at))
    if pupil.half:
        across = 2 * np.cos(k * np.outer(at[: size // 2 + 1], pupil.alpha))
        # Real times complex as one real product, then complex times complex.
        partial = (across @ field.view(float)).view(complex)
        upper = np.square(np.abs(partial @ along))
        whole = np.concatenate([upper, upper[size // 2 - 1 : 0 : -1]])
    else:
        whole = np.square(np.abs(np.exp(1j * k * np.outer(at, pupil.alpha)) @ field @ along))
    total = wavelength_um**2 * pupil.light_sr / pupil.cell**2
    period = [wavelength_um / (side[1] - side[0]) for side in (pupil.alpha, pupil.beta)]
    psf = whole * pitch_um**2 / total * undrooped(at, period, landed_um(pupil))
    return psf, 1.0 - float(psf.sum())


def undrooped(at_um: np.ndarray, period_um: tuple[float, float], landed_um: float) -> np.ndarray:
    """Return factors (n, n) of a PSF that undo what averaging the pupil's rim over its cells does.

    The rim throws light about where its rays land. A cell on it counts with its share, a mean over
    the cell, so that at a place x from there the light is multiplied by sinc^2(x / period); then
    the copies from beyond the period fold in. In the mean the rim's light falls as 1 / r^3
    (`gpusim.psf.halo`). As far as rays land, most of the light is not the rim's, and stays.

    Parameters
    ----------
    at_um : ndarray (n,)
        Places of the samples, along both sides.
    period_um : (float, float)
        After which the sampled pupil's image repeats, down the rows and along them.
    landed_um : float
        How far rays land from the chief ray.
    """
    x, y = at_um[:, None], at_um[None]
    down, along = period_um

    def tail(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        r2 = np.maximum(u * u + v * v, 1e-12)
        return 1 / (r2 * np.sqrt(r2))  # ten times as fast as a power

    copies = sum(
        tail(x + a * down, y + b * along) * np.sinc(x / down + a) ** 2 * np.sinc(y / along + b) ** 2
        for a in range(-COPIES, COPIES + 1)
        for b in range(-COPIES, COPIES + 1)
    )
    return np.where(np.maximum(np.abs(x), np.abs(y)) > landed_um, tail(x, y) / copies, 1.0)


def landed_um(pupil: Pupil) -> float:
    """Return how far from the chief ray the rays of a pupil land, along a side at most."""
    slopes = np.gradient(1e3 * pupil.opd_mm, pupil.alpha, pupil.beta)
    return float(np.max(np.abs(slopes), where=pupil.coverage > 0, initial=0.0))


def folded_share(pupil: Pupil, wavelength_nm: float, size: int, pitch_um: float) -> float:
    """Return the share of the light whose rays land so far out that a copy folds into the window.

    The sampled pupil repeats the PSF every lambda / d_alpha; a ray beyond that less half a window
    would reappear inside. Where a ray lands follows from W: -dW / d alpha.
    """
    period_a = wavelength_nm * 1e-3 / (pupil.alpha[1] - pupil.alpha[0])
    period_b = wavelength_nm * 1e-3 / (pupil.beta[1] - pupil.beta[0])
    half = size * pitch_um / 2
    x, y = np.gradient(1e3 * pupil.opd_mm, pupil.alpha, pupil.beta)
    folds = (np.abs(x) > period_a - half) | (np.abs(y) > period_b - half)
    return float((folds * pupil.light).sum() / pupil.light.sum())

"""Point-spread function of a pupil, by the matrix Fourier transform."""

from __future__ import annotations

import numpy as np

from gpusim.lens.samples import Samples
from gpusim.lens.wavefront import Pupil, line_pupil
from gpusim.psf.boundary_wave import rim_lost
from gpusim.psf.wave import wave_of

# The rim is followed on every fourth node of the pupil, and on no more than these: it is smooth.
RIM_STEP, RIM_NODES = 4, 128
# A pupil is sampled twice as finely while more than this share of its light folds into the window.
FOLDED, MOST_NODES = 1e-5, 2048


def intensity(
    pupil: Pupil, wavelength_nm: float, size: int, pitch_um: float
) -> tuple[np.ndarray, float]:
    """Return the PSF of one field and wavelength, and the energy outside its window.

    U = E_eta P E_xi with P = A exp(i k W) and the two Fourier kernels as matrices (Soummer et al.,
    Opt. Express 15, 15935, 2007), so that the image grid does not depend on the
    wavelength. Where pupil and PSF are symmetric in the sagittal direction, the kernel is
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
        Share of the light per sample; rows sagittal (eta), columns tangential (xi, along the radius
        and away from the axis); sample j at (j - size / 2) pitch from the chief ray's point. With a
        whole pupil, rows are x and columns y.
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
    psf = whole * pitch_um**2 / total
    step = max(RIM_STEP, len(pupil.beta) // RIM_NODES)
    psf += rim_lost(wave_of(pupil, step), wavelength_um, size, pitch_um, period)
    return psf, 1.0 - float(psf.sum())


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


def unfolded_pupil(
    samples: Samples, line: int, wavelength_nm: float, *, size: int, pitch_um: float, nodes: int
) -> Pupil:
    """Return a pupil that is sampled so finely that no light folds into a window.

    Parameters
    ----------
    samples : Samples
        Rays of a field.
    line, wavelength_nm : int, float
        Which of its wavelengths.
    size, pitch_um : int, float
        The window's.
    nodes : int
        Across the pupil, at least. `MOST_NODES` are the most: with these some light may fold still.
    """
    while True:
        pupil = line_pupil(samples, line, wavelength_nm, size * pitch_um, nodes)
        nodes = 2 * len(pupil.beta)
        if nodes > MOST_NODES or folded_share(pupil, wavelength_nm, size, pitch_um) < FOLDED:
            return pupil


def losses_of(
    samples: Samples, line: int, pupil: Pupil, wavelength_nm: float, *, size: int, pitch_um: float
) -> dict[str, float]:
    """Return how good the PSF of a field and wavelength is, by the names of a bank's variables.

    Parameters
    ----------
    samples : Samples
        Rays of the field.
    line : int
        Which of their wavelengths.
    pupil : Pupil
        What `unfolded_pupil` makes of them.
    wavelength_nm : float
    size, pitch_um : int, float
        The window's.
    """
    in_stop = samples.margin[-1, line] < 0
    return {
        "folded_energy": folded_share(pupil, wavelength_nm, size, pitch_um),
        "fit_residual_waves": pupil.fit_residual_mm / (wavelength_nm * 1e-6),
        "failed_rays": np.int32((~samples.ok[line] & in_stop).sum()),
    }

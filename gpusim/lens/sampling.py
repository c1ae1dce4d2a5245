"""The sampling that the PSFs of a lens need, from its rays: how fine, and how wide."""

from __future__ import annotations

import numpy as np

from gpusim.lens.bank import PITCH_UM, SIZE, WAVELENGTHS_NM
from gpusim.lens.system import System
from gpusim.lens.wavefront import sample_field

PITCHES_UM = (0.5, 0.45, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15, 0.1)
SIZES = (256, 384, 512)
# Share of the rays that the window should catch; caustics leave a few far out.
CAUGHT = 0.98


def fitting(system: System) -> dict[str, object]:
    """Return settings for ``cached_bank`` where a lens needs others than the default ones.

    The pitch is the widest of PITCHES_UM that samples the PSF of the steepest beam at the shortest
    wavelength, lambda / (2 * width of the pupil); the window the least of SIZES that catches the
    rays, or the largest.

    Raises
    ------
    UserError
        Where a field does not pass the lens.
    """
    wavelength_nm = WAVELENGTHS_NM[0]
    index = system.index(np.array([wavelength_nm]))
    widths, reaches = [], []
    for part in (0.0, 0.5, 0.75, 1.0):
        theta = np.radians(part * system.prescription.max_field_deg)
        samples = sample_field(system, index, theta)
        inside = samples.inside
        alpha, beta = samples.alpha[inside], samples.beta[inside]
        widths.append(max(2 * np.abs(alpha).max(), np.ptp(beta)))
        landing = np.hypot(samples.landing_x_mm[inside], samples.landing_y_mm[inside])
        reaches.append(1e3 * np.quantile(landing, CAUGHT))
    # The rays inside end up to a ray's spacing before the rim: 1 / 40 of the width.
    finest = 0.97 * wavelength_nm * 1e-3 / (2 * max(widths))
    pitch = next((p for p in PITCHES_UM if p <= finest), PITCHES_UM[-1])
    size = next((s for s in SIZES if s / 2 * pitch >= max(reaches)), SIZES[-1])
    settings = {}
    if pitch != PITCH_UM:
        settings["pitch_um"] = pitch
    if size != SIZE:
        settings["size"] = size
    return settings

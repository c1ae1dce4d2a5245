"""How wide a window the PSFs of a lens need, from where its rays land."""

from __future__ import annotations

import numpy as np

from gpusim.lens.bank import PITCH_UM, SIZE, WAVELENGTHS_NM, default_pitch_um
from gpusim.lens.system import System
from gpusim.lens.wavefront import sample_field

SIZES = (SIZE, SIZE * 3 // 2, SIZE * 2)
# Share of the rays that the window should catch; caustics leave a few far out.
CAUGHT = 0.98


def window(system: System) -> dict[str, float]:
    """Return settings for ``cached_bank`` where a lens needs a wider window than the default.

    ``size`` is the least of SIZES, with the lens's default pitch, that catches the rays of the
    shortest wavelength at the axis, half, three quarters and the whole of the field. Where the
    largest does not, ``pitch_um`` is the widest that still samples the PSF, in steps of 0.05 um.

    Raises
    ------
    UserError
        Where a field does not pass the lens.
    """
    index = system.index(np.array([WAVELENGTHS_NM[0]]))
    needed_um = width = 0.0
    for part in (0.0, 0.5, 0.75, 1.0):
        theta = np.radians(part * system.prescription.max_field_deg)
        samples = sample_field(system, index, theta)
        inside = samples.inside
        landing_mm = np.hypot(samples.landing_x_mm, samples.landing_y_mm)[inside]
        needed_um = max(needed_um, 2e3 * float(np.quantile(landing_mm, CAUGHT)))
        width = max(width, 2 * np.abs(samples.alpha[inside]).max(), np.ptp(samples.beta[inside]))
    pitch_um = default_pitch_um(system.prescription, WAVELENGTHS_NM)
    size = next((size for size in SIZES if size * pitch_um >= needed_um), SIZES[-1])
    if size * pitch_um >= needed_um:
        return {} if size == SIZE else {"size": size}
    # Nyquist: lambda / (2 width), less 5 % for the rim between the rays.
    widest_um = 0.05 * np.floor(0.95 * 1e-3 * WAVELENGTHS_NM[0] / (2 * width) / 0.05)
    return {"size": size, "pitch_um": round(float(np.clip(widest_um, pitch_um, PITCH_UM)), 2)}

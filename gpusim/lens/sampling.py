"""How wide a window the PSFs of a lens need, from where its rays land."""

from __future__ import annotations

import numpy as np

from gpusim.lens.bank import SIZE, WAVELENGTHS_NM, default_pitch_um
from gpusim.lens.system import System
from gpusim.lens.wavefront import sample_field

SIZES = (SIZE, SIZE * 3 // 2, SIZE * 2)
# Share of the rays that the window should catch; caustics leave a few far out.
CAUGHT = 0.98


def window(system: System) -> dict[str, int]:
    """Return the setting ``size`` for ``cached_bank`` where a lens needs more than the default.

    The least of SIZES, with the lens's default pitch, that catches the rays of the shortest
    wavelength at the axis, half, three quarters and the whole of the field, or the largest.

    Raises
    ------
    UserError
        Where a field does not pass the lens.
    """
    index = system.index(np.array([WAVELENGTHS_NM[0]]))
    needed_um = 0.0
    for part in (0.0, 0.5, 0.75, 1.0):
        theta = np.radians(part * system.prescription.max_field_deg)
        samples = sample_field(system, index, theta)
        landing_mm = np.hypot(samples.landing_x_mm, samples.landing_y_mm)[samples.inside]
        needed_um = max(needed_um, 2e3 * float(np.quantile(landing_mm, CAUGHT)))
    pitch_um = default_pitch_um(system.prescription, WAVELENGTHS_NM)
    size = next((size for size in SIZES if size * pitch_um >= needed_um), SIZES[-1])
    return {} if size == SIZE else {"size": size}

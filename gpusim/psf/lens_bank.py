"""The PSF bank of a lens that can be traced, whether it has an axis or not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.lens.prescription import Prescription
from gpusim.psf.compute import cached_bank
from gpusim.psf.compute_plane import cached_plane_bank
from gpusim.psf.field_bank import FieldBank


def lens_bank(
    lens: Prescription,
    progress: Callable[[int, int], None] | None = None,
    **sampling: np.ndarray,
) -> FieldBank:
    """Return the PSF bank of a lens, from the cache on disk where it is there.

    Parameters
    ----------
    lens : Prescription
        Where a surface is decentred or tilted, the bank spans both directions of the field.
    progress : callable, optional
        Called with the steps that are done and their number.
    sampling : ndarray
        ``field_deg`` and ``wavelengths_nm``, in place of the default ones.
    """
    cached = cached_bank if lens.is_centred else cached_plane_bank
    return cached(lens, progress=progress, **sampling)

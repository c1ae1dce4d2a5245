"""Where points of the ideal plane land: the inverse of the map that the fields of a bank give."""

from __future__ import annotations

import numpy as np

from gpusim.reference.fields import Grid, Heights

NEWTON_STEPS = 30
STEP_UM, FOUND_UM = 1e-3, 1e-7


def landed(fields: Heights | Grid, ideal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where ideal-plane points (P, 2) land, and the map's stretch of areas there.

    By Newton's steps on the map to the ideal plane. Where none lands, they end anywhere. The
    stretch is 0 beyond the image circle.
    """
    real = np.array(ideal, np.float64)
    for _ in range(NEWTON_STEPS):
        columns = [
            (fields.ideal(real + d) - fields.ideal(real - d)) / (2 * STEP_UM)
            for d in STEP_UM * np.eye(2)
        ]
        slopes = np.stack(columns, axis=2)
        lack = ideal - fields.ideal(real)
        if np.abs(lack).max() < FOUND_UM:
            break
        real += np.linalg.solve(slopes, lack[..., None])[..., 0]
    lit = np.hypot(*(real - fields.centre).T) <= fields.circle
    return real, lit / np.abs(np.linalg.det(slopes))

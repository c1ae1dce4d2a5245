"""Where points of the ideal plane land: the inverse of the map that the fields of a bank give."""

from __future__ import annotations

from threading import Lock
from typing import Any

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


class Landings:
    """Where a photograph's highlights land behind the map of a bank, found once for all its models.

    Probes run in threads: while one thread finds points, the others wait for them.
    """

    def __init__(self, fields: Heights | Grid) -> None:
        self.fields = fields
        self._lock = Lock()
        self._found: dict[bytes, tuple[Any, np.ndarray, np.ndarray]] = {}

    def of(
        self, highlights: Any, line_um: np.ndarray, shares_um: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return points of each square on the real plane (N, I, 2), with their areas (N, I), um^2.

        Parameters
        ----------
        highlights : gpusim.scene.highlights.Highlights
        line_um, shares_um : ndarray (n,)
            Nodes along a side of a square, from its middle, and the length that each stands for.
            The I = n * n points are all pairs of them.
        """
        key = line_um.tobytes()
        with self._lock:
            found = self._found.get(key)
            if found is None or found[0] is not highlights:
                inner = np.stack(np.meshgrid(line_um, line_um), axis=-1).reshape(-1, 2)
                ideal = highlights.centre_um[:, None] + inner
                real, stretch = landed(self.fields, ideal.reshape(-1, 2))
                areas = np.outer(shares_um, shares_um).ravel() * stretch.reshape(ideal.shape[:2])
                found = self._found[key] = highlights, real.reshape(ideal.shape), areas
        return found[1:]

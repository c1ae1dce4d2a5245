"""The wavefront in a pupil, both halves, as what lands far from the chief ray is found from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.lens.wavefront import Pupil

FEW_RAYS = 1e-6  # of the light: fewer are not looked for
# Across a pupil, at least: so many lay levels of the halo down evenly.
RAYS_ACROSS = 1536


@dataclass(frozen=True)
class Wave:
    """A vignetted pupil and its wavefront on a grid of direction cosines, both halves.

    Attributes
    ----------
    alpha, beta : ndarray, shapes (A,) and (B,)
        Evenly spaced.
    opd_um : ndarray, shape (A, B)
        W.
    reach : ndarray, shape (A, B)
        Less than 1 within the pupil, 1 at its rim.
    light : ndarray, shape (A, B)
        What each cell passes: its share within the rim, times `passed`.
    passed : ndarray, shape (A, B), or float
        Light that enters and passes there, over that about the chief ray; 1 where it is even.
    mirrored : bool
        Whether alpha and -alpha are alike: one half is then worked out for both.
    rays_per_node : int
        Rays for each node of the grid, each way, where they land beyond a core.
    """

    alpha: np.ndarray
    beta: np.ndarray
    opd_um: np.ndarray
    reach: np.ndarray
    light: np.ndarray
    passed: np.ndarray | float = 1.0
    mirrored: bool = False
    rays_per_node: int = 6

    @property
    def slope(self) -> list[np.ndarray]:
        """The gradient of W, um, along alpha and beta: rays land at its negative."""
        return np.gradient(self.opd_um, self.alpha, self.beta, edge_order=2)

    def lands_beyond(self, radius_um: float) -> bool:
        """Return whether rays land farther from the chief ray than a radius."""
        far = self.light * (np.hypot(*self.slope) > radius_um)
        return bool(far.sum() > FEW_RAYS * self.light.sum())


def wave_of(pupil: Pupil, step: int = 1) -> Wave:
    """Return the wave in a pupil, of every `step`-th node each way, both halves.

    The middles of as many cells are kept: they mirror one another where the halves do. An even
    step has no node in the middle, so that one more is taken there.
    """
    step |= pupil.half
    thin = slice(step // 2, None, step)
    alpha, beta = pupil.alpha[thin], pupil.beta[thin]

    def whole(values: np.ndarray) -> np.ndarray:
        kept = values[thin, thin]
        return np.concatenate([kept[::-1], kept]) if pupil.half else kept

    return Wave(
        alpha=np.concatenate([-alpha[::-1], alpha]) if pupil.half else alpha,
        beta=beta,
        opd_um=whole(1e3 * pupil.opd_mm),
        reach=whole(pupil.reach),
        light=whole(pupil.light),
        passed=whole((pupil.apodised * pupil.entering) ** 2),
        mirrored=pupil.half,
        rays_per_node=-(-RAYS_ACROSS // len(beta)),
    )

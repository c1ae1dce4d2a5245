"""Spectra of a scene as its planes are chosen for them: which come first, and which are mixed."""

from __future__ import annotations

import numpy as np

from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene

FEW_SPECTRA = 3  # of a photograph in colour, whose planes are for each by itself
SHOWN = 500  # samples of a spectral photograph that its planes are made for


def shown_mixtures(scene: Scene) -> np.ndarray | None:
    """Return coefficients (P, M) of samples of a spectral photograph; None of other scenes.

    The samples lie on a lattice; each spectrum adds the sample with the largest share of it. A
    scene of bands shows smooth spectra: far fewer planes keep these apart than the bands
    themselves.
    """
    if isinstance(scene.source, Chart) or len(scene.spectra) <= FEW_SPECTRA:
        return None
    planes = scene.source.planes.reshape(len(scene.spectra), -1)
    total = planes.sum(axis=0, dtype=np.float64)
    lit = np.flatnonzero(total > 0)
    if not len(lit):
        return None
    share = planes[:, lit] / total[lit]
    lattice = np.linspace(0, len(lit) - 1, min(SHOWN, len(lit))).astype(int)
    return planes[:, lit[np.union1d(lattice, share.argmax(axis=1))]].T.astype(np.float64)


def commonest_first(scene: Scene) -> np.ndarray:
    """Return the scene's spectra, those of most primitives first."""
    counts = np.zeros(len(scene.spectra))
    if isinstance(scene.source, Chart):
        np.add.at(counts, [shape.material for shape in scene.source.primitives], 1)
        counts[scene.source.background] = np.inf
    return np.argsort(-counts, kind="stable")

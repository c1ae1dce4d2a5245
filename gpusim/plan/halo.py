"""Which levels of a bank's halo a tolerance needs, and how well each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.plan.accuracy import LARGEST, SMALLEST, Accuracy
from gpusim.plan.stage import PlanStage
from gpusim.psf.field_bank import FieldBank
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene

# Signal of a white around a dark patch over the patch's own: what the halo brings there counts so
# much more. A level is left out where it brings less than this share of the tolerance even then.
CONTRAST = 20.0
LEFT_OUT = 0.1
# What a level may err by: share of the tolerance. Its light counts by the contrast that edges of
# charts have where it matters, between a patch and its neighbours of another brightness.
SHARE = 0.3
AROUND = 5.0
# Photographs are measured instead: their mean over what their darkest DARK hold, up to MOST_AROUND.
# Fivefold care took the phone camera's first level three times as long as the core, and its engine
# from an RMS of 9e-5 to 3e-5, of the 1e-3 that were asked for.
DARK = 0.05
MOST_AROUND = 10.0


@dataclass(frozen=True)
class HaloLevel:
    """One level of a bank's halo that is rendered.

    Attributes
    ----------
    number : int
        Place among the bank's levels.
    share : float
        Share of the light, at the field and wavelength where it is largest.
    accuracy : Accuracy
        Accuracy with which the level is rendered, relative to its own light.
    """

    number: int
    share: float
    accuracy: Accuracy


def surroundings(scene: Scene) -> float:
    """Return how much brighter than what is dark in a scene that is which lights it from afar."""
    if isinstance(scene.source, Chart):
        return AROUND
    brightness = scene.source.planes.max(axis=0)
    lit = brightness[brightness > 0]
    if not lit.size:
        return AROUND
    ratio = float(lit.mean(dtype=np.float64) / max(np.quantile(lit, DARK), 1e-30))
    return min(max(ratio, AROUND), MOST_AROUND)


def halo_levels(
    levels: tuple[FieldBank, ...], accuracy: Accuracy, around: float = AROUND
) -> tuple[HaloLevel, ...]:
    """Return which of a bank's levels a relative tolerance needs beside the core.

    ``around``: see `surroundings`.
    """
    found = []
    for number, level in enumerate(levels[1:], start=1):
        share = float(level.psf.sum(axis=(-2, -1), dtype=float).max())
        if CONTRAST * share < LEFT_OUT * accuracy.tolerance:
            continue
        allowed = SHARE * accuracy.tolerance / (around * share)
        own = Accuracy(min(max(allowed, SMALLEST), LARGEST), probes=0)
        found.append(HaloLevel(number, share, own))
    return tuple(found)


def describe_halo(levels: tuple[FieldBank, ...], halo: tuple[HaloLevel, ...]) -> PlanStage:
    """Describe the stage."""
    if len(levels) == 1:
        return PlanStage("halo", False, "the bank holds no light beyond its window")
    if not halo:
        return PlanStage(
            "halo", False, "less light lands beyond the window than the tolerance asks"
        )
    shares = ", ".join(f"{level.share:.2%}" for level in halo)
    last = levels[halo[-1].number]
    reach_um = last.psf.shape[-1] / 2 * last.pitch_um
    window_um = levels[0].psf.shape[-1] / 2 * levels[0].pitch_um
    return PlanStage(
        "halo",
        True,
        f"{shares} of the light beyond {window_um:g} um, to {reach_um / 1e3:.3g} mm, on coarse "
        "grids, once a scene",
    )

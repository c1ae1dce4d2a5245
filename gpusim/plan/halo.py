"""Which levels of a bank's halo a tolerance needs, and how well each."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

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
# charts have where it matters, between a patch and its neighbours of another brightness. Plans for
# levels foresee more than is found: with 0.3 and with 0.6 the certificates of photographs say the
# same (a desk before the phone: 2.70e-4 and 2.69e-4; a still life before the demonstration camera:
# 9.0e-4 and 9.2e-4), and levels of the phone take 73 and 37 s.
SHARE = 0.5
AROUND = 5.0
ROUNDING = 1e-9  # of the brightest: what a transform leaves where there is no light


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


def seen_shares(
    levels: tuple[FieldBank, ...], scene: Scene, half_um: tuple[float, float]
) -> np.ndarray:
    """Return how much of a scene's signal each level beside the core brings (K - 1,).

    For a photograph it is the root mean square over its samples: the light of a level there, by
    its strongest PSF, over that of all levels. Shadows beside a lamp may have nearly all of their
    light from the halo. For a chart it is the level's share of the light, AROUND times.

    Parameters
    ----------
    levels : tuple of FieldBank
    scene : Scene
    half_um : (float, float)
        Half the width and height that it covers.
    """
    shares = np.array([_strongest(level).sum() for level in levels])
    source = scene.source
    if len(levels) == 1 or isinstance(source, Chart) or not source.planes.max() > 0:
        return AROUND * shares[1:]
    brightness = np.maximum(source.planes.max(axis=0).astype(np.float64), 0.0)
    pitch_um = source.pitch_um(*half_um)
    grids = [max(1, math.ceil(level.pitch_um / pitch_um)) for level in levels[1:]]
    light = [
        _blurred(_binned(brightness, every), _kernel(level, every * pitch_um))
        for level, every in zip(levels, (grids[0], *grids), strict=True)
    ]
    rows, cols = (np.arange(count) * grids[0] for count in light[0].shape)
    on_first = [light[0]] + [
        one[np.ix_(rows // every, cols // every)]
        for one, every in zip(light[1:], grids, strict=True)
    ]
    total = sum(on_first)
    lit = total > ROUNDING * total.max()
    return np.array([np.sqrt(np.mean((one[lit] / total[lit]) ** 2)) for one in on_first[1:]])


def _strongest(level: FieldBank) -> np.ndarray:
    """Return the PSF (n, n) that holds most light."""
    n = level.psf.shape[-1]
    sums = level.psf.sum(axis=(-2, -1), dtype=np.float64)
    return level.psf.reshape(-1, n, n)[int(np.argmax(sums))].astype(np.float64)


def _binned(values: np.ndarray, every: int) -> np.ndarray:
    """Return the means of squares of so many samples; the last ones are filled up."""
    pads = [(0, -count % every) for count in values.shape]
    rows, cols = (count + pad for count, (_, pad) in zip(values.shape, pads, strict=True))
    filled = np.pad(values, pads, "edge")
    return filled.reshape(rows // every, every, cols // every, every).mean(axis=(1, 3))


def _kernel(level: FieldBank, pitch_um: float) -> np.ndarray:
    """Return a level's strongest PSF on a grid that is as fine as its own, or coarser."""
    psf = _strongest(level)
    n, half = len(psf), math.ceil(len(psf) / 2 * level.pitch_um / pitch_um)
    if pitch_um >= 2 * level.pitch_um:
        at = np.round((np.arange(n) - n // 2) * level.pitch_um / pitch_um).astype(int) + half
        found = np.zeros((2 * half + 1, 2 * half + 1))
        np.add.at(found, np.ix_(at, at), psf)
        return found
    at = (np.arange(-half, half + 1) * pitch_um) / level.pitch_um + n // 2
    found = map_coordinates(psf, np.meshgrid(at, at, indexing="ij"), order=1)
    return found * (psf.sum() / max(found.sum(), np.finfo(float).tiny))


def _blurred(values: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Return values convolved; beyond their border they stay."""
    # It brings scipy.stats along, a fifth of every start: for photographs' halos alone.
    from scipy.signal import fftconvolve

    around = np.pad(values, len(kernel) // 2, "edge")
    return np.maximum(fftconvolve(around, kernel, mode="valid"), 0.0)


def halo_levels(
    levels: tuple[FieldBank, ...], accuracy: Accuracy, seen: np.ndarray
) -> tuple[HaloLevel, ...]:
    """Return which of a bank's levels a relative tolerance needs beside the core.

    ``seen``: see `seen_shares`.
    """
    found = []
    for number, (level, of_signal) in enumerate(zip(levels[1:], seen, strict=True), start=1):
        share = float(_strongest(level).sum())
        if CONTRAST * share < LEFT_OUT * accuracy.tolerance:
            continue
        allowed = SHARE * accuracy.tolerance / of_signal
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

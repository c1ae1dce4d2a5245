"""PSFs of places on the sensor as its colours see them, to look at."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from gpusim.psf.bank import Bank

if TYPE_CHECKING:
    from gpusim.psf.field_bank import FieldBank
    from gpusim.scene.scene import Scene
    from gpusim.sensor.sensor import Sensor

HEIGHTS = 9  # from the axis to the sensor's corner
ACROSS = 5  # places each way of a lens without an axis
SIDE_PX = 12.0  # sensor pixels that are shown, as far as the PSFs reach
LEAST_SAMPLES = 24  # across
RGB = "RGB"


@dataclass(frozen=True, eq=False)
class LocalPsfs:
    """PSFs of some places.

    Attributes
    ----------
    places_um : ndarray (N, 2)
        Where the light lands, x and y from the axis. A lens with an axis has its places along x,
        as ``turned`` says: elsewhere at the same distance a PSF is the same, turned about the axis.
    turned : bool
    light : ndarray (N, k, k, 3) or (N, k, k)
        What red, green and blue photosites see, or all, per sample and with a sum of 1 at most;
        rows y, columns x.
    side_um : float
        Side of the square that is shown.
    """

    places_um: np.ndarray
    turned: bool
    light: np.ndarray
    side_um: float


def local_psfs(bank: FieldBank, sensor: Sensor, scene: Scene) -> LocalPsfs:
    """Return PSFs of the scene's white, colours where they land from the reference's chief ray."""
    lines = bank.wavelengths_nm
    qe = {
        name: np.interp(lines, scene.wavelengths_nm, curve * scene.white * scene.wavelengths_nm)
        for name, curve in sensor.by_colour(sensor.qe_at(scene.wavelengths_nm)).items()
    }
    # What a line of the bank stands for: the interval to its neighbours' middles.
    intervals = np.gradient(lines) if len(lines) > 1 else np.ones(1)
    weights = {name: one * intervals for name, one in qe.items()}
    shown = [weights[name] for name in RGB] if set(RGB) <= set(weights) else [*weights.values()]
    seen = np.stack(shown) if len(shown) == len(RGB) else np.sum(shown, axis=0)[None]
    seen = seen / np.maximum(seen.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    pitch, whole = bank.pitch_um, bank.psf.shape[-1]
    wanted = max(SIDE_PX * sensor.pixel_pitch_um, LEAST_SAMPLES * pitch)
    half = min(math.ceil(wanted / pitch / 2), whole // 2)
    if isinstance(bank, Bank):
        corner_um = math.hypot(sensor.rows, sensor.cols) / 2 * sensor.pixel_pitch_um
        height = bank.real_height_um[:, bank.reference]
        wanted_um = np.linspace(0, min(corner_um, height[-1]), HEIGHTS)
        fields = np.unique(np.abs(height[:, None] - wanted_um).argmin(axis=0))
        places = np.stack([height[fields], np.zeros(len(fields))], axis=1)
        psfs = bank.psf[fields]
        moved = bank.real_height_um[fields] - height[fields, None]
        moved = np.stack([moved, np.zeros_like(moved)], axis=-1)
    else:
        rows, cols = (
            np.unique(np.linspace(0, count - 1, ACROSS).round().astype(int))
            for count in bank.psf.shape[:2]
        )
        at = np.ix_(rows, cols)
        chief = np.stack([bank.chief_x_um[at], bank.chief_y_um[at]], axis=-1)
        chief = chief.reshape(-1, *chief.shape[2:])
        places = chief[:, bank.reference]
        psfs = bank.psf[at].reshape(len(places), *bank.psf.shape[2:])
        moved = chief - places[:, None]
    # What is shown, and what colours that land elsewhere bring in from around it.
    wide = min(half + math.ceil(float(np.abs(moved).max()) / pitch) + 1, whole // 2)
    around = slice(whole // 2 - wide, whole // 2 + wide)
    psfs = psfs[..., around, around]
    light = np.stack([_seen(*one, seen, pitch) for one in zip(psfs, moved, strict=True)])
    middle = slice(wide - half, wide + half)
    light = light[:, middle, middle]
    return LocalPsfs(
        places, isinstance(bank, Bank), light[..., 0] if len(seen) == 1 else light, 2 * half * pitch
    )


def _seen(psf: np.ndarray, moved_um: np.ndarray, seen: np.ndarray, pitch_um: float) -> np.ndarray:
    """Return what each colour (C) sees of PSFs (L, n, n), moved by x and y (L, 2): (n, n, C)."""
    shifted = np.stack(
        [
            ndimage.shift(one, (by[1] / pitch_um, by[0] / pitch_um), order=1)
            for one, by in zip(psf, moved_um, strict=True)
        ]
    )
    return np.einsum("cl,lyx->yxc", seen, shifted)

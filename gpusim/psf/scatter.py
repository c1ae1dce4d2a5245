"""What PSFs do to an even scene: they lie beside their chief rays and change with the field.

A point spreads one light, and an even scene shows another there; this is the way between the two.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import make_interp_spline

from gpusim.psf.halo import distances_um, fall

if TYPE_CHECKING:
    from gpusim.psf.bank import Bank

# Steps to the light whose spread is a ready-made bank's relative illumination: each is a hundred
# times nearer.
SCATTER_STEPS = 3
RAYS_SHARE = 0.02  # of the light: a level that holds more holds rays, not diffracted light alone


def spread_by(bank: Bank) -> np.ndarray:
    """Return the light (F, L) that points of the fields spread where its bank knows what is shown.

    See `gpusim.psf.bank.Bank.scatter`.
    """
    shown = light = bank.relative_illumination
    for _ in range(SCATTER_STEPS):
        light = shown + light - shown_by(bank, light)
    return light


def shown_by(bank: Bank, light: np.ndarray) -> np.ndarray:
    """Return what an even scene shows (F, L) where points of the fields spread a light (F, L).

    See `Bank.scatter`. With fewer than four fields nobody knows how PSFs change: the light itself.
    """
    height = bank.real_height_um[:, bank.reference]
    if len(height) < 4:
        return light
    radial, along, across = _moments(bank)
    radial += bank.real_height_um - height[:, None]
    return light - _divergence(height, light, radial, along, across)


def _moments(bank: Bank) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the first moment (F, L) of the PSFs along x, um, and the second along x and y, um^2.

    Second moments without the levels whose light is diffracted alone: over millimetres the
    illumination is no parabola, and there is little of it.
    """
    parts = [(bank.psf, bank.pitch_um, 1.0, True)]
    if bank.halo is not None:
        size = bank.psf.shape[-1]
        within = fall(distances_um(size, bank.pitch_um), size / 2 * bank.pitch_um)
        parts = [(bank.psf, bank.pitch_um, within, True)]
        for psf, pitch in zip(bank.halo, bank.halo_pitch_um, strict=True):
            rays = psf.sum(axis=(-2, -1), dtype=float).max() > RAYS_SHARE
            parts.append((psf, float(pitch), 1.0, rays))
    moments = np.zeros((3, *bank.psf.shape[:2]))
    for psf, pitch, weight, wide in parts:
        at = (np.arange(psf.shape[-1]) - psf.shape[-1] // 2) * pitch
        x = np.einsum("flyx,yx->flx", psf, np.broadcast_to(weight, psf.shape[2:]), dtype=float)
        moments[0] += x @ at
        if wide:
            y = np.einsum("flyx,yx->fly", psf, np.broadcast_to(weight, psf.shape[2:]), dtype=float)
            moments[1] += x @ at**2
            moments[2] += y @ at**2
    return moments[0], moments[1], moments[2]


def _divergence(
    height: np.ndarray, light: np.ndarray, radial: np.ndarray, along: np.ndarray, across: np.ndarray
) -> np.ndarray:
    """Return div(K c) - div div(K S) / 2 at heights (F,), of what is even about the axis.

    In polar coordinates, by splines over the heights, which are odd or even about the axis:
    div v = (r v)' / r, and (div T)_r = (r T_rr)' / r - T_tt / r.
    """
    both = np.concatenate([-height[:0:-1], height])

    def slope(values: np.ndarray, odd: bool) -> np.ndarray:
        mirrored = values[:0:-1] * (-1 if odd else 1)
        spline = make_interp_spline(both, np.concatenate([mirrored, values]), k=3)
        return spline.derivative()(height)

    def over_height(values: np.ndarray, limit: np.ndarray) -> np.ndarray:
        r = np.where(height > 0, height, 1.0)[:, None]
        return np.where(height[:, None] > 0, values / r, limit)

    flow = light * radial
    pressure, shear = light * along, light * (along - across)
    # (div K S)_r, odd about the axis.
    second = slope(pressure, odd=False) + over_height(shear, 0.0)
    vector = flow - second / 2
    vector[0] = 0.0
    rise = slope(vector, odd=True)
    return rise + over_height(vector, rise)

"""Light beyond a bank's widest level, as far as it can land where the bank's image is."""

from __future__ import annotations

import numpy as np

from gpusim.psf.field_bank import FieldBank
from gpusim.psf.halo import LAST_FALLS_FROM

TURNS = 360  # directions about a pixel: against twice as many, shares change by 1e-3 of themselves


def landing_share(bank: FieldBank, radius_um: np.ndarray) -> np.ndarray:
    """Return how much of the light beyond the widest level an even scene brings to image points.

    So far out a share b of a point's light falls as b D / (2 pi r^3) from the distance D on, where
    the last level begins to fall (`gpusim.psf.halo`: the boundary diffraction wave). An image
    circle that is lit evenly brings to a point from which its rim is l away

        b D / (2 pi) integral max(0, 1 / D - 1 / l) d theta,

    the integral over r of r / r^3; b itself were the circle without end.

    Parameters
    ----------
    bank : FieldBank
        One without a halo brings all of the share.
    radius_um : ndarray (P,)
        Distances from the image circle's centre, within the circle.

    Returns
    -------
    ndarray (P,)
        Shares of b: 0 where all of it lands beside the circle, 1 at most.
    """
    radius = np.asarray(radius_um, float)
    if bank.halo is None:
        return np.ones(radius.shape)
    last, circle = bank.levels[-1], bank.rectilinear_circle_um
    from_um = LAST_FALLS_FROM * last.psf.shape[-1] / 2 * last.pitch_um
    theta = (np.arange(TURNS) + 0.5) * 2 * np.pi / TURNS
    along, off = np.multiply.outer(radius, np.cos(theta)), np.multiply.outer(radius, np.sin(theta))
    to_rim = np.sqrt(np.maximum(circle**2 - off**2, 0.0)) - along
    return np.maximum(1 - from_um / np.maximum(to_rim, from_um), 0.0).mean(axis=-1)

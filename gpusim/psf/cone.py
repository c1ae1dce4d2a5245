"""In which directions light arrives at an image point: the chief ray, and the cone about it.

A direction is that in which the light travels, by its cosines along the image plane: (sin theta cos
phi, sin theta sin phi). From an even scene light arrives evenly over the vignetted pupil in
direction cosines (radiance theorem), times what an apodised stop passes. So the mean of any
response over the cone is the sum over its rays of share times response; the share is one of
projected solid angle, and sums to 1.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gpusim.errors import UserError

if TYPE_CHECKING:
    from gpusim.psf.bank import Bank

# Rays of a cone, each way: each stands for the light of one square of directions, at its centre of
# mass. The mean of a smooth response R errs by (w / CELLS)^2 / 24 (R_aa + R_bb), w the width of the
# cone: at f/2 by 1.5e-4 for cos(theta)^4, over the whole cone alike.
CELLS = 24


class FieldRays(NamedTuple):
    """Rays of one field, in the frame of its PSFs: x is their columns.

    Attributes
    ----------
    place_um : ndarray (2,)
        x, y where the chief ray of the reference wavelength lands, from the middle of the sensor;
        of a lens with an axis, at azimuth 0.
    chief : ndarray (L, 2)
        Direction cosines of the chief ray.
    cone : ndarray (L, R, 3)
        Direction cosines and share of each ray.
    """

    place_um: np.ndarray
    chief: np.ndarray
    cone: np.ndarray


def cone_of(x: np.ndarray, y: np.ndarray, light: np.ndarray, mirrored: bool) -> np.ndarray:
    """Return the rays of a cone.

    Parameters
    ----------
    x, y : ndarray (X,), (Y,)
        Direction cosines, evenly spaced.
    light : ndarray (X, Y)
        What passes in each of these directions; somewhere more than 0.
    mirrored : bool
        Whether as much passes at -x, which is not listed.

    Returns
    -------
    ndarray of float32 (CELLS^2, 3)
        x, y and share of each ray; where no light passes, the share is 0.
    """
    if mirrored:
        x, light = np.concatenate([-x[::-1], x]), np.concatenate([light[::-1], light])
    edges, cells = [], []
    for at, axis in ((x, 1), (y, 0)):
        lit = at[(light > 0).any(axis=axis)]
        half = (at[1] - at[0]) / 2
        edges.append(np.linspace(lit[0] - half, lit[-1] + half, CELLS + 1))
        cells.append(np.clip(np.searchsorted(edges[-1], at) - 1, 0, CELLS - 1))
    cell = (cells[0][:, None] * CELLS + cells[1]).ravel()
    share, along_x, along_y = (
        np.bincount(cell, (light * one).ravel(), CELLS**2) for one in (1.0, x[:, None], y)
    )
    middles = [(one[1:] + one[:-1]) / 2 for one in edges]
    empty = share == 0
    filled = np.where(empty, 1.0, share)
    rays = [
        np.where(empty, np.repeat(middles[0], CELLS), along_x / filled),
        np.where(empty, np.tile(middles[1], CELLS), along_y / filled),
        share / share.sum(),
    ]
    return np.stack(rays, axis=-1).astype(np.float32)


def with_exit_pupil(bank: Bank, distance_mm: float) -> Bank:
    """Return a ready-made bank with the rays that its exit pupil gives.

    The chief ray comes from the pupil's middle; the cone is a disc of directions about it, as large
    as the projected solid angle says.

    Parameters
    ----------
    bank : Bank
    distance_mm : float
        From the exit pupil to the image plane; infinite where the lens is telecentric.
    """
    tangent = 1e-3 * bank.real_height_um / distance_mm
    sine = tangent / np.hypot(1, tangent)
    radius = np.sqrt(bank.projected_solid_angle_sr * bank.relative_illumination / np.pi)
    at = (np.arange(8 * CELLS) + 0.5) / (4 * CELLS) - 1
    disc = cone_of(at, at, (np.hypot(at, at[:, None]) < 1).astype(float), False)
    cone = np.empty((*sine.shape, *disc.shape), np.float32)
    cone[...] = disc
    cone[..., :2] *= radius[..., None, None]
    cone[..., 0] += sine[..., None]
    return replace(bank, chief=np.stack([sine, np.zeros_like(sine)], axis=-1), cone=cone)


def no_rays(provenance: dict[str, str]) -> UserError:
    """Return the error of a lens of which nobody said at which angles its light arrives."""
    return UserError(
        "the sensor's quantum efficiency goes with the angle at which light arrives, and the file "
        "of this lens does not say it",
        field="exit_pupil_mm",
        value=f"none for {provenance['title']}",
        allowed="the distance from the exit pupil to the image plane in the lens's file, a lens "
        "given by its prescription, or a sensor without eqe_map",
    )

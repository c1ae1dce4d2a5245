"""Where light comes to a focus: over the field, over the pupil, over wavelengths."""

from __future__ import annotations

import numpy as np

from gpusim.lens.analysis.fields import Field, passes, rays_at
from gpusim.lens.samples import Samples
from gpusim.lens.system import System

# Close rays meet the stop this part of its radius beside the chief ray: of spherical aberration and
# coma they see its square, 1e-6. Rays are aimed to 1e-9, which is 1e-6 of it.
CLOSE = 1e-3


def field_focus(system: System, wavelengths_nm: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return where close rays about the chief ray meet, along the axis from the image plane.

    The same as Coddington's equations along the chief ray (Welford, Aberrations of Optical Systems,
    1986, sec. 9.4), for surfaces of any form and place.

    Parameters
    ----------
    system : System
    wavelengths_nm : ndarray, shape (L,)
    theta : ndarray, shape (F,)
        Field angles along y, rad.

    Returns
    -------
    ndarray, shape (F, L, 2)
        Tangential and sagittal focus, mm, positive behind the image plane.
    """
    return np.array([_close_focus(system, wavelengths_nm, Field("", angle)) for angle in theta])


def _close_focus(system: System, wavelengths_nm: np.ndarray, field: Field) -> np.ndarray:
    samples = rays_at(
        system,
        wavelengths_nm,
        field,
        np.array([0.0, 0.0, CLOSE, -CLOSE]),
        np.array([CLOSE, -CLOSE, 0.0, 0.0]),
    )
    slope_x, slope_y = _slopes(samples)
    tangential = np.diff(samples.landing_y_mm[:, :2]) / np.diff(slope_y[:, :2])
    sagittal = np.diff(samples.landing_x_mm[:, 2:]) / np.diff(slope_x[:, 2:])
    return -np.concatenate([tangential, sagittal], axis=1)


def _slopes(samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Return dx/dz and dy/dz of the rays."""
    gamma = np.sqrt(1 - samples.alpha**2 - samples.beta**2)
    return samples.alpha / gamma, samples.beta / gamma


def longitudinal_aberration(
    system: System, wavelengths_nm: np.ndarray, zones: np.ndarray
) -> np.ndarray:
    """Return where rays of the axial beam cross the axis, from the image plane.

    Parameters
    ----------
    system : System
        With an axis.
    wavelengths_nm : ndarray, shape (L,)
    zones : ndarray, shape (Z,)
        Heights at the stop relative to its radius, greater than 0.

    Returns
    -------
    ndarray, shape (L, Z)
        In mm, positive behind the image plane; NaN where a ray does not pass.
    """
    samples = rays_at(system, wavelengths_nm, Field("axis", 0.0), np.zeros_like(zones), zones)
    crossing = -samples.landing_y_mm / _slopes(samples)[1]
    return np.where(passes(samples), crossing, np.nan)

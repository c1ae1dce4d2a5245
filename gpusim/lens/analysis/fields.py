"""Which fields and wavelengths the analyses of a lens take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.lens.samples import Samples, sample_rays
from gpusim.lens.system import System, transmission

# Light from 400 to 700 nm: 50 nm are enough for a curve of a lens that is corrected for colour.
WHITE_NM = np.arange(400.0, 701.0, 50.0)
WHITE_REFERENCE = 3  # 550 nm
# Lines that figures show, evenly spread, where a lens has more design wavelengths.
MOST_LINES = 5


@dataclass(frozen=True)
class Field:
    """A direction of the object: angle from the axis and azimuth from y towards x, rad."""

    name: str
    theta: float
    azimuth: float = 0.0

    @property
    def degrees(self) -> float:
        """Angle from the axis, deg."""
        return float(np.degrees(self.theta))


def main_fields(system: System) -> list[Field]:
    """Return axis, half and full field; of a lens without an axis, full field on four sides."""
    edge = np.radians(system.prescription.max_field_deg)
    axis = Field("axis", 0.0)
    if edge == 0:
        return [axis]
    if not system.geometry.moved.any():
        return [axis, Field("half field", edge / 2), Field("full field", edge)]
    return [
        axis,
        Field("up", edge),
        Field("down", -edge),
        Field("right", edge, np.pi / 2),
        Field("left", -edge, np.pi / 2),
    ]


def angles_across(system: System, count: int) -> np.ndarray:
    """Return angles (rad) across the field along y, from the axis on where the lens has one."""
    edge = np.radians(system.prescription.max_field_deg)
    return np.linspace(-edge if system.geometry.moved.any() else 0.0, edge, count)


def design_lines(system: System) -> tuple[np.ndarray, int]:
    """Return the design wavelengths (nm), rising, and the number of the primary one."""
    lens = system.prescription
    lines = np.unique(lens.design_wavelengths_nm)
    if len(lines) > MOST_LINES:
        lines = lines[np.linspace(0, len(lines) - 1, MOST_LINES).round().astype(int)]
    return lines, int(np.abs(lines - lens.reference_nm).argmin())


def white_light(system: System) -> np.ndarray:
    """Return the light of each of ``WHITE_NM`` behind the lens, of equal energy per nm."""
    weights = np.full(len(WHITE_NM), 50.0)
    weights[[0, -1]] = 25.0  # the trapezoidal rule
    return weights * transmission(system.prescription, WHITE_NM)


def rays_at(
    system: System, wavelengths_nm: np.ndarray, field: Field, stop_x: np.ndarray, stop_y: np.ndarray
) -> Samples:
    """Trace rays through points of the stop, each on its own side of the meridional plane.

    Parameters
    ----------
    system : System
    wavelengths_nm : ndarray, shape (L,)
    field : Field
    stop_x, stop_y : ndarray, shape (R,)
        Relative to the stop's radius.
    """
    radius = system.stop_radius_mm
    index = system.index(wavelengths_nm)
    return sample_rays(
        system,
        index,
        field.theta,
        radius * stop_x,
        radius * stop_y,
        azimuth=field.azimuth,
        whole=True,
    )


def passes(samples: Samples) -> np.ndarray:
    """Return which rays pass every aperture, shape (L, R); the stop's own rim counts as inside."""
    clear = (samples.margin[:-1] < 1e-9).all(axis=0) & (samples.margin[-1] < 1e-9)
    return samples.ok & clear

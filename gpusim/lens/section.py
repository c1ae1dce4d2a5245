"""The meridional section of a lens with the rays of a field: what a layout drawing shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.lens.aim import AIM_TOLERANCE, aim
from gpusim.lens.geometry import Geometry
from gpusim.lens.samples import field_launch
from gpusim.lens.system import System
from gpusim.lens.trace import trace

FRAUNHOFER_F_D_C_NM = (486.1327, 587.5618, 656.2725)
# Points on the section of a surface: a curve of 60 mm drawn 12 cm wide has steps of 1 mm.
_ACROSS = 121
# Points of the stop among which the rim rays of a beam are sought: to 1 % of its radius.
_FAN = 201


@dataclass(frozen=True)
class Element:
    """The section of the glass between two surfaces.

    Attributes
    ----------
    outline : ndarray, shape (P, 2)
        (z, y) of a closed polygon, mm.
    abbe : float
        Abbe number, from the F, d and C lines.
    """

    outline: np.ndarray
    abbe: float


def section(geometry: Geometry, surface: int, height_mm: np.ndarray) -> np.ndarray:
    """Return the meridional section of a surface: (z, y) in mm, shape (H, 2).

    Parameters
    ----------
    geometry : Geometry
    surface : int
        From 0.
    height_mm : ndarray, shape (H,)
        Heights from the surface's own vertex, along its own y axis.
    """
    c, conic = geometry.curvature[surface], geometry.conic[surface]
    r2 = height_mm * height_mm
    sag = c * r2 / (1 + np.sqrt(np.maximum(1 - (1 + conic) * c * c * r2, 0)))
    powers = r2[:, None] ** np.arange(1, geometry.asphere.shape[1] + 1)
    sag = sag + powers @ geometry.asphere[surface]
    own = np.stack([np.zeros_like(sag), height_mm, sag])
    _, y, z = geometry.rotation[surface] @ own
    return np.column_stack([geometry.vertex_z[surface] + z, geometry.decentre[surface, 1] + y])


def elements(system: System) -> list[Element]:
    """Return the glass of a lens: each surface to its own clear aperture, joined by a cylinder."""
    prescription, geometry = system.prescription, system.geometry
    blue, yellow, red = system.index(np.array(FRAUNHOFER_F_D_C_NM)).T
    found = []
    for front, surface in enumerate(prescription.surfaces[:-1]):
        if surface.glass is None:
            continue
        sides = []
        edge = max(system.semi_diameter_mm[front : front + 2])
        for number in (front, front + 1):
            clear = system.semi_diameter_mm[number]
            side = section(geometry, number, np.linspace(-clear, clear, _ACROSS))
            # Beyond the clear aperture a flat ring, up to the wider surface's height.
            across = (edge - clear) * geometry.rotation[number][[2, 1], 1]
            sides.append(np.concatenate([[side[0] - across], side, [side[-1] + across]]))
        outline = np.concatenate([sides[0], sides[1][::-1]])
        behind = front + 1
        spread = max(blue[behind] - red[behind], 1e-6)  # a constant index does not disperse
        found.append(Element(outline=outline, abbe=float((yellow[behind] - 1) / spread)))
    return found


def beam(system: System, theta: float, rays: int, lead_mm: float) -> np.ndarray:
    """Return the paths of meridional rays of a field that pass every aperture.

    Parameters
    ----------
    system : System
    theta : float
        Field angle, rad.
    rays : int
        How many, evenly over the part of the stop that the field fills, both rims included.
    lead_mm : float
        How far before the lens the beam starts, on a plane across it.

    Returns
    -------
    ndarray, shape (S + 2, rays, 2)
        (z, y) at the start, at each surface and in the image plane, mm. No rays where the field
        is vignetted whole.
    """
    geometry, radius = system.geometry, system.stop_radius_mm
    index = system.index(np.array([system.prescription.reference_nm]))
    launch = field_launch(system, index, theta)

    def traced(stop_y):
        px, py, found = aim(
            geometry,
            index,
            launch,
            np.zeros_like(stop_y),
            stop_y,
            tolerance_mm=AIM_TOLERANCE * radius,
        )
        result = trace(geometry, index, launch, px, py)
        height = np.hypot(result.own_x, result.own_y)[:, 0]
        clear = (height < system.semi_diameter_mm[:, None]).all(axis=0)
        return result, (found & result.ok)[0] & clear

    fan = radius * np.linspace(-0.999, 0.999, _FAN)
    _, passes = traced(fan)
    if not passes.any():
        return np.empty((len(geometry.curvature) + 2, 0, 2))
    result, _ = traced(np.linspace(fan[passes][0], fan[passes][-1], rays))
    y, z = result.y[:, 0], result.z[:, 0]
    # Back from the first surface to one plane across the beam, each ray as it came.
    first, chief = np.stack([z[0], y[0]]), launch.direction[[2, 1], 0]
    towards = np.broadcast_to(chief[:, None], first.shape)
    if launch.source is not None:
        way = first - launch.source[[2, 1], None]
        far = np.sqrt((way * way).sum(0))
        towards, lead_mm = way / far, min(lead_mm, 0.5 * float(far.min()))
    along = chief @ first
    back = (along - along.min() + lead_mm) / (chief @ towards)
    begin = first - back * towards
    slope = result.direction[1, 0] / result.direction[2, 0]
    end_y = y[-1] + (system.image_z_mm - z[-1]) * slope
    end = np.stack([np.full(rays, system.image_z_mm), end_y])
    middle = np.stack([z, y], axis=-1)
    return np.concatenate([begin.T[None], middle, end.T[None]])

"""What one image point sees through a lens: the light it takes, by direction and wavelength.

G of `gpusim.reference.lens_truth`, on two grids of X = f w (object directions, as lengths): a fine
core, on which the pixel's aperture is folded in by its transform, and around it cells of some
micrometres over one period of the sampled pupil, which holds every ray. What diffraction throws
farther is a stated share (`View.beyond`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.lens.system import System, first_order
from gpusim.lens.throughput import goes_with_the_ray
from gpusim.reference.aperture import aperture_of, core_of, wide_of
from gpusim.reference.backward import chief_back
from gpusim.reference.bundle import Frame, Rays, frame_of, rays_of

REFERENCE_NM = 550.0  # whose chief ray names the frame: any would do
# Half the width of the fine core: at least, and in wavelengths over the aperture: 16 lambda N, or
# 13 Airy radii.
CORE_UM, CORE_WAVES = 28.0, 16.0
CELLS = 7  # coarse cells across half the core
# The sampled pupil's period holds every ray and this share more.
SPARE = 1.25
# Nodes across the pupil, at least: of a round pupil the light beyond the period is 0.45 / nodes
# (2 lambda N / (pi^2 R) beyond a radius R; Born & Wolf, sec. 8.5.2).
NODES = 768


@dataclass(frozen=True)
class View:
    """What one image point sees at each wavelength.

    Attributes
    ----------
    frame : Frame
    wavelengths_nm : ndarray (L,)
    solid_angle_sr : ndarray (L,)
        Solid angle of the light that arrives at this very point, as direction cosines.
    core : ndarray (L, n, n)
        Share of the light per sample at places `at_um`; rows X1, columns X2.
    at_um : ndarray (n,)
    wide : ndarray (L, m, m)
        Share of the light in cells between `edges_um`, 0 where the core lies.
    edges_um : ndarray (m + 1,)
    beyond : ndarray (L,)
        Share of the light outside both.
    residual_waves : float
        Worst misfit of the wavefronts.
    """

    frame: Frame
    wavelengths_nm: np.ndarray
    solid_angle_sr: np.ndarray
    core: np.ndarray
    at_um: np.ndarray
    wide: np.ndarray
    edges_um: np.ndarray
    beyond: np.ndarray
    residual_waves: float


@dataclass(frozen=True)
class _Grids:
    """Where a view is sampled.

    Attributes
    ----------
    at_um : ndarray (n,)
        Samples of the core, `pitch_um` apart.
    edges_um : ndarray (m + 1,)
        Edges of the cells around it, to `half_um` each way.
    hole : slice
        The cells that the core covers.
    """

    at_um: np.ndarray
    pitch_um: float
    edges_um: np.ndarray
    half_um: float
    hole: slice


def _bundles(
    system: System, image: np.ndarray, wavelengths_nm: np.ndarray
) -> tuple[Frame, list[Rays]]:
    """Return the frame of an image point (2,), mm, and its rays at each wavelength."""
    focal = first_order(system.prescription, REFERENCE_NM).efl_mm
    frame = frame_of(system, system.index(np.array([REFERENCE_NM])), image, focal)
    indices = system.index(wavelengths_nm)
    chiefs = chief_back(system, indices, image)
    lines = [
        (system, indices[:, [line]], image, chiefs[:, [line]], frame)
        for line in range(len(wavelengths_nm))
    ]
    return frame, [rays_of(*line) for line in lines]


def _reach(rays: Rays) -> float:
    """Return how far from the middle rays land, um, along one axis."""
    return float(np.abs(rays.landing_um[:, rays.inside]).max())


def _grids(
    bundles: Sequence[Rays],
    wavelengths_nm: np.ndarray,
    core_um: float | None,
    *,
    nodes: int,
    finer: float,
) -> _Grids:
    """Return the grids that hold the rays of all wavelengths; the rest is as for `view`."""
    extent = max(float(np.ptp(rays.p, axis=1).max()) for rays in bundles)
    shortest = float(np.min(wavelengths_nm)) * 1e-3
    if core_um is None:
        core_um = max(CORE_UM, CORE_WAVES * float(np.max(wavelengths_nm)) * 1e-3 / extent)
    reach = max(_reach(rays) for rays in bundles)
    half = max(SPARE * reach, 2 * core_um, nodes * shortest / (2 * extent))
    cell = core_um / CELLS
    while half / cell > 160:  # cells grow with the window
        cell *= 2
    inner = max(1, round(core_um / cell))
    core_um = inner * cell
    cells = int(np.ceil(half / cell))
    # |F|^2 has no frequency beyond extent / lambda: samples at twice that, and a tenth more.
    count = int(np.ceil(2 * core_um * 2 * 1.1 * finer * extent / shortest / 2)) * 2
    pitch = 2 * core_um / count
    return _Grids(
        at_um=pitch * (np.arange(count) + 0.5 - count / 2),
        pitch_um=pitch,
        edges_um=cell * np.arange(-cells, cells + 1),
        half_um=cells * cell,
        hole=slice(cells - inner, cells + inner),
    )


def view(
    system: System,
    point_um: tuple[float, float],
    wavelengths_nm: np.ndarray,
    *,
    core_um: float | None = None,
    nodes: int = NODES,
    finer: float = 1.0,
) -> View:
    """Return what an image point sees.

    Parameters
    ----------
    system : System
    point_um : (float, float)
        x right, y down from the axis.
    wavelengths_nm : ndarray (L,)
    core_um : float, optional
        Half the width of the core: by default `CORE_UM` or `CORE_WAVES`, whichever is more.
    nodes : int
        Least nodes across the pupil.
    finer : float
        Divides the pitch of the core.

    Raises
    ------
    ValueError
        Where no light arrives, or the object is not at infinity: this judge names what it sees by
        directions. Where losses go with the ray: it knows those on the axis alone.
    """
    if np.isfinite(system.geometry.object_z):
        raise ValueError("the object is not at infinity")
    if goes_with_the_ray(system.prescription):
        raise ValueError("losses go with the ray")
    frame, bundles = _bundles(system, np.asarray(point_um, float) * 1e-3, wavelengths_nm)
    grids = _grids(bundles, wavelengths_nm, core_um, nodes=nodes, finer=finer)
    at, edges, hole = grids.at_um, grids.edges_um, grids.hole
    cores, wides, solid, residual = [], [], [], []
    apodised = system.prescription.gaussian_apodisation or 0.0
    for rays, wavelength in zip(bundles, wavelengths_nm, strict=True):
        aperture = aperture_of(rays, wavelength, grids.half_um, apodised)
        core = core_of(aperture, wavelength, at, at) * grids.pitch_um**2
        wide = wide_of(aperture, edges)
        wide = wide * _undrooped(edges, 1.1 * _reach(rays))
        wide[hole, hole] = 0.0
        cores.append(core)
        wides.append(wide)
        solid.append(aperture.solid_angle_sr)
        residual.append(aperture.residual_waves)
    core, wide = np.stack(cores), np.stack(wides)
    return View(
        frame,
        np.asarray(wavelengths_nm, float),
        np.array(solid),
        core,
        at,
        wide,
        edges,
        1 - core.sum(axis=(1, 2)) - wide.sum(axis=(1, 2)),
        max(residual),
    )


def _undrooped(edges: np.ndarray, landed_um: float) -> np.ndarray:
    """Return factors (m, m) that undo what averaging the pupil's rim over its cells does.

    That multiplies the light which the rim diffracts by sinc^2 of the place over the period, and
    then the copies from beyond the period fold in. Far out it falls as 1 / r^3 in the mean; where
    rays land, up to `landed_um`, most of the light is not the rim's.
    """
    period = edges[-1] - edges[0]
    at = (edges[1:] + edges[:-1]) / 2
    x, y = np.meshgrid(at, at, indexing="ij")

    def tail(u, v):
        return (u * u + v * v + edges[-1] ** 2 * 1e-12) ** -1.5

    copies = sum(
        tail(x + a * period, y + b * period)
        * np.sinc(x / period + a) ** 2
        * np.sinc(y / period + b) ** 2
        for a in range(-2, 3)
        for b in range(-2, 3)
    )
    return np.where(np.maximum(np.abs(x), np.abs(y)) > landed_um, tail(x, y) / copies, 1.0)

"""Rays on the device: aiming at the stop and tracing, stages ``shaders/lens/aim`` and ``trace``.

Rays go in f32, their optical path in double float: see the head of ``trace.wgsl``. The float64
tracer in ``trace.py`` is the reference; the chief rays come from it, so that what the OPD is
measured against is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording, double_float
from gpusim.lens.launch import Launch
from gpusim.lens.samples import field_launch, no_chief_ray
from gpusim.lens.system import System
from gpusim.lens.trace import trace

GROUP = 64  # invocations of a workgroup of shaders/lens/trace
ACROSS = 32768  # workgroups in a row of a dispatch, of 65535 that adapters allow

_SURFACE = np.dtype(
    [("curvature", "f4", 2), ("bulge", "f4", 2), ("gap", "f4", 2), ("semi", "f4"), ("terms", "u4")]
)
_PAIR = np.dtype(
    [
        ("sine", "f4", 2),
        ("cosine", "f4", 2),
        ("start_y", "f4", 2),
        ("start_z", "f4", 2),
        ("image_y", "f4", 2),
        ("image_z", "f4", 2),
        ("chief_path", "f4", 2),
        ("first_index", "u4"),
        ("waves_per_mm", "f4"),
        ("vergence", "f4", 2),
        ("unused", "f4", 2),
        ("aim", "f4", 4),
    ]
)


def split(values: np.ndarray) -> np.ndarray:
    """Return float64 values as high and low f32 parts, along a new last axis."""
    values = np.asarray(values, dtype=float)
    high = values.astype(np.float32)
    return np.stack([high, (values - high).astype(np.float32)], axis=-1)


@dataclass(frozen=True)
class Traced:
    """What the device knows of R rays.

    Attributes
    ----------
    opd_waves, reach : ndarray, shape (R,)
        W, and the largest (height / clear semi-diameter)^2: below 1 inside every aperture, 0 where
        the ray failed.
    landing_mm : ndarray, shape (R, 2)
        From the chief ray's point.
    cosines : ndarray, shape (R, 2)
        alpha and beta.
    failed_at : ndarray of int, shape (R,)
        Number of the surface that the ray missed or could not pass; 0 where it arrived.
    """

    opd_waves: np.ndarray
    reach: np.ndarray
    landing_mm: np.ndarray
    cosines: np.ndarray
    failed_at: np.ndarray


class Beams:
    """The beams of a lens at F fields and L wavelengths, ready to be traced on a device.

    Pair ``field * L + wavelength`` is one beam.

    Parameters
    ----------
    device : Device
    system : System
    wavelengths_nm : ndarray, shape (L,)
    angles : ndarray, shape (F,)
        Field angles, rad.

    Attributes
    ----------
    chief_y_mm, chief_beta : ndarray, shape (F, L)
        Where the chief rays land, and their direction cosine there.
    launches : list of Launch
        Launch planes of the fields, on their chief rays.

    Raises
    ------
    UserError
        A chief ray does not pass the lens.
    ValueError
        An element is decentred or tilted: shaders/lens knows surfaces of revolution on one axis.
    """

    def __init__(
        self, device: Device, system: System, wavelengths_nm: np.ndarray, angles: np.ndarray
    ) -> None:
        self.device = device
        self.system = system
        self.wavelengths_nm = wavelengths_nm
        self.angles = angles
        geometry, index = system.geometry, system.index(wavelengths_nm)
        if geometry.moved.any():
            raise ValueError("the device traces lenses whose elements lie on one axis")
        count = len(geometry.curvature)
        used = np.flatnonzero(geometry.asphere.any(axis=0))
        self.terms = 1 + int(used[-1]) if used.size else 1
        surfaces = np.zeros(count, _SURFACE)
        surfaces["curvature"] = split(geometry.curvature)
        surfaces["bulge"] = split(1 + geometry.conic)
        surfaces["gap"] = split(np.diff(geometry.vertex_z, prepend=0.0))
        surfaces["semi"] = system.semi_diameter_mm**-2.0
        surfaces["terms"] = np.where(geometry.asphere.any(axis=1), self.terms, 0)
        # Powers of a power of two are exact; of about the lens's radius they keep a30 within f32.
        sizes = np.append(system.semi_diameter_mm, system.stop_radius_mm)
        unit_mm = 2.0 ** np.ceil(np.log2(sizes[np.isfinite(sizes)].max()))
        self.per_unit2 = unit_mm**-2.0
        powers = 2.0 * np.arange(1, self.terms + 1)
        aspheres = geometry.asphere[:, : self.terms] * unit_mm**powers
        pairs = np.zeros((len(angles), len(wavelengths_nm)), _PAIR)
        # Sine and cosine of the chief rays at their launch, and 1 / distance from the object.
        self._launch = np.zeros((3, *pairs.shape))
        self.chief_y_mm, self.chief_beta = np.empty((2, *pairs.shape))
        self.launches: list[Launch] = []
        for field, theta in enumerate(angles):
            before = self.launches[-1] if self.launches else None
            launch = field_launch(system, index, float(theta), start=before)
            self.launches.append(launch)
            chief = self._chief(pairs[field], self._launch[:, field], index, launch)
            self.chief_y_mm[field], self.chief_beta[field] = chief
        pairs["first_index"] = np.arange(len(wavelengths_nm)) * (count + 1)
        pairs["waves_per_mm"] = 1e6 / wavelengths_nm
        # Nothing is on the device before all that can fail has passed.
        self._surfaces = device.resident("surfaces", surfaces.view(np.float32))
        self._aspheres = device.resident("aspheres", split(aspheres))
        self._indices = device.resident("indices", split(index.T))
        self._pairs = device.resident("pairs", pairs.view(np.float32))
        self.count = pairs.size

    def _chief(
        self, pairs: np.ndarray, launched: np.ndarray, index: np.ndarray, launch: Launch
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fill in what the chief rays of one field give, in float64; return height and beta."""
        system, geometry = self.system, self.system.geometry
        # Beside the chief ray, one ray each in x and y: their stop points give the aim's start.
        step = 1e-3 * system.stop_radius_mm
        px, py = (np.tile(line, (index.shape[1], 1)) for line in step * np.eye(3)[1:])
        rays = trace(geometry, index, launch, px, py)
        _, beta, gamma = rays.direction[:, :, 0]
        if not (rays.ok.all() and (gamma > 0).all()):
            raise no_chief_ray(system, launch.theta)
        at_x, at_y = rays.x[geometry.stop], rays.y[geometry.stop]
        slopes = np.array([at_x[:, 1:] - at_x[:, :1], at_y[:, 1:] - at_y[:, :1]]) / step
        inverse = np.linalg.inv(np.moveaxis(slopes, 0, 1))
        to_image = (system.image_z_mm - rays.point[2, :, 0]) / gamma
        height = rays.point[1, :, 0] + to_image * beta
        _, sine, cosine = launch.direction
        launched[:2] = sine, cosine
        pairs["sine"], pairs["cosine"] = split(sine), split(cosine)
        if launch.source is not None:
            way = launch.base - launch.source[:, None]
            launched[2] = (way * way).sum(0) ** -0.5
            pairs["vergence"] = split(launched[2])
        pairs["start_y"], pairs["start_z"] = split(launch.base[1]), split(launch.base[2])
        pairs["image_y"] = split(height)
        pairs["image_z"] = split(system.image_z_mm - geometry.vertex_z[-1])
        pairs["chief_path"] = split(rays.path[:, 0] + to_image)
        pairs["aim"] = inverse.transpose(0, 2, 1).reshape(-1, 4)
        return height, beta

    def etendue(self, field: int, line: int, px_mm: np.ndarray, py_mm: np.ndarray) -> np.ndarray:
        """Return the light of a point of the scene per area of the launch plane there.

        1 from infinity. From a near point, direction cosines along the object plane: the cosine to
        the axis times the solid angle, z s / r^3, s the distance to the plane and r to the place.
        """
        sine, cosine, vergence = self._launch[:, field, line]
        if vergence == 0:
            return np.ones_like(px_mm)
        far2 = 1 + vergence**2 * (px_mm**2 + py_mm**2)  # (r / s)^2
        return vergence**2 * (cosine - vergence * py_mm * sine) / far2**2

    def aim(self, wanted_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Aim rays of every beam at points of the stop.

        Parameters
        ----------
        wanted_mm : ndarray, shape (R, 2)

        Returns
        -------
        p_mm : ndarray, shape (P, R, 2)
            On the launch plane.
        miss : ndarray, shape (P, R)
            Miss, in units of the stop's radius; -1 where no such ray was found.
        """
        rec = Recording(self.device)
        rays = len(wanted_mm)
        wanted = rec.buffer("wanted", (rays, 2), "f4")
        aimed = rec.buffer("aimed", (self.count, rays, 4), "f4")
        rec.upload(wanted, wanted_mm.astype(np.float32))
        kernel = Kernel("lens/aim")
        params = {
            "terms": self.terms,
            "per_unit2": self.per_unit2,
            "stop": self.system.geometry.stop + 1,
            "rays": rays,
            "radius": self.system.stop_radius_mm,
        }
        groups = (-(-rays // GROUP), self.count, 1)
        kernel.record(rec, groups, params, wanted=wanted, aimed=aimed, **self._lens())
        rec.download(aimed)
        found = rec.run()["aimed"]
        return found[..., :2], found[..., 2]

    def _lens(self) -> dict[str, Array]:
        return {
            "surfaces": self._surfaces,
            "aspheres": self._aspheres,
            "indices": self._indices,
            "pairs": self._pairs,
        }

    def record_trace(self, rec: Recording, rays: Array, opd: Array, directions: Array) -> None:
        """Record the trace of R rays.

        Parameters
        ----------
        rec : Recording
        rays : Array (R, 4), f32
            As `starts` makes them.
        opd, directions : Array (R, 4), f32
            See shaders/lens/trace.
        """
        geometry = self.system.geometry
        count = rays.shape[0]
        groups = -(-count // GROUP)
        params = {
            "zero": 0,
            "terms": self.terms,
            "per_unit2": self.per_unit2,
            "surfaces": len(geometry.curvature),
            "stop": geometry.stop + 1,
            "rays": count,
            "across": ACROSS,
            "inverse_stop2": self.system.stop_radius_mm**-2.0,
        }
        Kernel("lens/trace", **double_float(self.device)).record(
            rec,
            (min(groups, ACROSS), -(-groups // ACROSS), 1),
            params,
            rays=rays,
            opd=opd,
            directions=directions,
            **self._lens(),
        )

    def trace(self, p_mm: np.ndarray, pair: np.ndarray) -> Traced:
        """Trace rays.

        Parameters
        ----------
        p_mm : ndarray, shape (R, 2)
            On the launch plane.
        pair : ndarray of int, shape (R,)
            Each ray's beam.
        """
        rec = Recording(self.device)
        rays, opd, directions = (
            rec.buffer(name, (len(pair), 4), "f4") for name in ("rays", "opd", "directions")
        )
        rec.upload(rays, starts(p_mm, pair, np.arange(len(pair))))
        self.record_trace(rec, rays, opd, directions)
        rec.download(opd)
        rec.download(directions)
        found = rec.run()
        return Traced(
            opd_waves=found["opd"][:, 0],
            reach=found["opd"][:, 1],
            landing_mm=found["opd"][:, 2:],
            cosines=found["directions"][:, :2],
            failed_at=found["directions"][:, 2].astype(int),
        )

    def release(self) -> None:
        """Give the device memory back."""
        for one in self._lens().values():
            one.destroy()


def starts(p_mm: np.ndarray, pair: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Return rays as shaders/lens/trace reads them.

    Parameters
    ----------
    p_mm : ndarray, shape (R, 2)
        On the launch plane.
    pair, to : ndarray of int, shape (R,)
        Each ray's beam, and where its result goes.

    Returns
    -------
    ndarray of float32, shape (R, 4)
    """
    rays = np.empty((len(pair), 4), np.float32)
    rays[:, :2] = p_mm
    numbers = rays.view(np.uint32)
    numbers[:, 2], numbers[:, 3] = pair, to
    return rays

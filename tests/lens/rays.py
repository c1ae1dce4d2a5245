"""Rays for the stages that trace them: what the device gets, and what float64 makes of the same."""

from dataclasses import dataclass
from math import comb

import numpy as np
from harness.stage import MARGIN
from lens.made import fisheye, lens, model

from gpusim.formats.lens_file import load_prescription
from gpusim.gpu import Device
from gpusim.lens.samples import field_launch
from gpusim.lens.system import System, build
from gpusim.lens.trace import trace
from gpusim.lens.tracer import Beams

LINES = np.array([450.0, 650.0])


def double_gauss() -> System:
    return build(load_prescription("double-gauss").scaled(8.3).stopped(2.8).limited(14.3))


def phone_lens() -> System:
    """Return a small lens of strong aspheres, up to a30, and conics of every kind."""
    rows = [
        {"radius": np.inf, "thickness": 0.1},
        {
            "radius": 1.6,
            "conic": -0.6,
            "asphere": {"a4": 0.02, "a6": -0.01, "a8": 0.008, "a30": 3e-4},
            "thickness": 0.7,
            **model(1.54),
        },
        {"radius": 9.0, "conic": 4.0, "asphere": {"a2": 0.01, "a4": -0.03}, "thickness": 0.5},
        {"radius": -12.0, "conic": -2.0, "thickness": 0.4, **model(1.64)},
        {"radius": np.inf, "asphere": {"a4": 0.05, "a10": -0.004}, "thickness": 0.5},
        {"radius": 3.0, "conic": -1.0, "thickness": 0.6, **model(1.54)},
        {"curvature": 0.2, "asphere": {"a4": -0.02, "a6": 0.004}},
    ]
    return build(lens(rows, f_number=2.4, max_field_deg=20.0, focus="best"))


def oval(**last: object) -> System:
    """Return a lens without spherical aberration at f/1.25: plane, then Descartes's hyperboloid.

    Its glass does not disperse: on the axis W is nothing but what is lost to rounding.
    """
    rows = [
        {"radius": np.inf, "thickness": 20.0, "glass": "constant", "nd": 1.5},
        {"radius": -25.0, "conic": -2.25} | last,
    ]
    return build(lens(rows, f_number=1.25, max_field_deg=1.0))


def polynomial_oval() -> System:
    """Return the same lens up to f/2.5, its hyperboloid as a polynomial of fifteen terms.

    c r^2 / (1 + sqrt(1 - q r^2)), q = (1 + conic) c^2, is c sum of C_m (q / 4)^m r^(2 m + 2) / 2,
    with Catalan's numbers C_m.
    """
    c, q = -1 / 25, (1 - 2.25) / 25**2
    terms = {f"a{2 * m + 2}": c / 2 * comb(2 * m, m) / (m + 1) * (q / 4) ** m for m in range(15)}
    whole = oval(radius=np.inf, conic=0.0, asphere=terms)
    return build(whole.prescription.model_copy(update={"f_number": 2.5}))


def two_ovals() -> System:
    """Return two of Descartes's hyperboloids, glass between: a point at 30 mm, imaged at 20 mm.

    By a magnification of -2/3, and without spherical aberration, as each sends a beam of parallel
    rays to its focus.
    """
    rows = [
        {"radius": 15.0, "conic": -2.25, "thickness": 8.0, "glass": "constant", "nd": 1.5},
        {"radius": -10.0, "conic": -2.25},
    ]
    return build(lens(rows, object_na=0.25, object_distance_mm=30.0, max_field_deg=1.0))


def near(make, distance_m: float) -> System:
    """Return a lens with an object plane so near."""
    return build(make().prescription.looking(distance_m))


LENSES = {
    "two ovals": (two_ovals, (0.0, 1.0)),
    "near double gauss": (lambda: near(double_gauss, 0.05), (0.0, 14.0)),
    "near phone": (lambda: near(phone_lens, 0.6), (0.0, 20.0)),
    "oval": (oval, (0.0, 1.0)),
    "polynomial oval": (polynomial_oval, (0.0, 1.0)),
    "double gauss": (double_gauss, (0.0, 14.0)),
    "phone": (phone_lens, (0.0, 20.0)),
    "fisheye": (lambda: build(fisheye()), (30.0, 90.0, 105.0)),
}


@dataclass(frozen=True)
class Exact:
    """What `gpusim.lens.tracer.Traced` holds, in float64; zeros where a ray failed."""

    opd_waves: np.ndarray
    reach: np.ndarray
    landing_mm: np.ndarray
    cosines: np.ndarray
    failed_at: np.ndarray


def exact(system: System, lines: np.ndarray, theta: float, p_mm: np.ndarray) -> Exact:
    """Trace the same rays in every wavelength of one field, each array (L, R, ...)."""
    index = system.index(lines)
    launch = field_launch(system, index, theta)
    px, py = (np.tile(np.append(0.0, one), (len(lines), 1)) for one in p_mm.astype(float).T)
    rays = trace(system.geometry, index, launch, px, py)
    count = len(system.geometry.curvature)
    failed_at = np.zeros(px.shape, int)
    for through in range(count, 0, -1):
        part = trace(system.geometry, index, launch, px, py, through=through)
        failed_at[~part.ok] = through
    alpha, beta, gamma = rays.direction
    failed_at[(failed_at == 0) & (gamma <= 0)] = count
    ok = failed_at == 0
    to_image = (system.image_z_mm - rays.point[2]) / np.where(ok, gamma, 1)
    x, y = rays.point[0] + to_image * alpha, rays.point[1] + to_image * beta
    y = y - y[:, :1]
    path = rays.path + to_image - alpha * x - beta * y
    height2 = rays.x**2 + rays.y**2
    reach = (height2 / system.semi_diameter_mm[:, None, None] ** 2).max(axis=0)
    reach = np.maximum(reach, height2[system.geometry.stop] / system.stop_radius_mm**2)

    def only(values: np.ndarray) -> np.ndarray:
        return np.where(ok, values, 0)[..., 1:]

    return Exact(
        opd_waves=only((path - path[:, :1]) / (1e-6 * lines[:, None])),
        reach=only(reach),
        landing_mm=np.stack([only(x), only(y)], axis=-1),
        cosines=np.stack([only(alpha), only(beta)], axis=-1),
        failed_at=failed_at[:, 1:],
    )


def bound(device: Device, beams: Beams) -> dict[str, np.ndarray]:
    """Return what the lens is on the device: the buffers that aim and trace share.

    Pairs are filled up with zeros so that the margin of `run_stage` ends with a whole one.
    """
    buffers = {name: device.read(one) for name, one in beams._lens().items()}
    pairs = buffers["pairs"].ravel()
    return buffers | {"pairs": np.pad(pairs, (0, -(pairs.size + MARGIN) % 24))}

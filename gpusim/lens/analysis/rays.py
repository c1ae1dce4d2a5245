"""Ray fans, spot diagrams, the wavefront over the stop, and the angles at which light arrives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gpusim.lens.analysis.fields import Field, passes, rays_at
from gpusim.lens.samples import Samples
from gpusim.lens.system import System

Way = Literal["x", "y"]
FAN_POINTS = 81  # odd: the middle one is the chief ray
SPOT_RINGS = 12  # hexapolar: 469 rays
MAP_POINTS = 65  # across the stop
_EDGE_POINTS = 201


@dataclass(frozen=True)
class Fan:
    """Aberrations along one diameter of the stop; NaN where a ray does not pass.

    Attributes
    ----------
    stop : ndarray, shape (P,)
        Where the rays meet the stop, relative to its radius.
    x_um, y_um : ndarray, shape (L, P)
        Where they land, from the chief ray of the primary wavelength.
    opd_waves : ndarray, shape (L, P)
        In waves of their own, 0 at the chief ray of each wavelength.
    alpha, beta : ndarray, shape (L, P)
        Direction cosines at the image.
    """

    stop: np.ndarray
    x_um: np.ndarray
    y_um: np.ndarray
    opd_waves: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray


def ray_fan(
    system: System, wavelengths_nm: np.ndarray, primary: int, field: Field, way: Way
) -> Fan:
    """Return the aberrations along the diameter x or y of the stop."""
    stop = np.linspace(-1, 1, FAN_POINTS)
    nothing = np.zeros_like(stop)
    points = (stop, nothing) if way == "x" else (nothing, stop)
    samples = rays_at(system, wavelengths_nm, field, *points)
    blocked = np.where(passes(samples), 0.0, np.nan)
    away_x, away_y = _from_primary(samples, primary)
    return Fan(
        stop=stop,
        x_um=1e3 * (samples.landing_x_mm + away_x) + blocked,
        y_um=1e3 * (samples.landing_y_mm + away_y) + blocked,
        opd_waves=_opd_waves(samples, wavelengths_nm, primary) + blocked,
        alpha=samples.alpha + blocked,
        beta=samples.beta + blocked,
    )


def _from_primary(samples: Samples, primary: int) -> tuple[np.ndarray, np.ndarray]:
    """Return how far each wavelength's chief ray lands from the primary's, mm, (L, 1) each."""
    x, y = samples.chief_x_mm[:, None], samples.chief_y_mm[:, None]
    return x - x[primary], y - y[primary]


def _opd_waves(samples: Samples, wavelengths_nm: np.ndarray, primary: int) -> np.ndarray:
    """Return the OPD about the image point of the primary wavelength, shape (L, R).

    Another reference point tilts W: with W - alpha dx - beta dy, -dW/d alpha moves by dx.
    """
    away_x, away_y = _from_primary(samples, primary)
    chief = samples.chief_direction[:, None]
    tilt = away_x * (samples.alpha - chief[..., 0]) + away_y * (samples.beta - chief[..., 1])
    return (tilt - samples.opd_mm) / (1e-6 * np.asarray(wavelengths_nm)[:, None])


@dataclass(frozen=True)
class Spot:
    """Where the rays of one field land.

    Attributes
    ----------
    x_um, y_um : ndarray, shape (L, R)
        From the chief ray of the primary wavelength; NaN where a ray does not pass.
    centroid_um : ndarray, shape (2,)
        Mean of all wavelengths' rays, by the share of the stop that each stands for.
    rms_um, geometric_um : float
        Root mean square and largest distance from the centroid.
    """

    x_um: np.ndarray
    y_um: np.ndarray
    centroid_um: np.ndarray
    rms_um: float
    geometric_um: float


def hexapolar(rings: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points of a unit disc, one in the middle and 6 k on ring k, and their shares of it.

    A point stands for the area nearest to its ring: those of the rim for half as much as others.
    """
    numbers = np.concatenate([[0], *(np.full(6 * k, k) for k in range(1, rings + 1))])
    angle = np.concatenate(
        [[0.0], *(np.arange(6 * k) * np.pi / (3 * k) for k in range(1, rings + 1))]
    )
    edges = np.clip((np.arange(rings + 2) - 0.5) / rings, 0, 1)
    area = np.diff(edges**2) / np.maximum(6 * np.arange(rings + 1), 1)
    radius = numbers / rings
    return radius * np.cos(angle), radius * np.sin(angle), area[numbers]


def spot_diagram(system: System, wavelengths_nm: np.ndarray, primary: int, field: Field) -> Spot:
    """Return where rays land that fill the stop evenly; each wavelength weighs the same."""
    *points, area = hexapolar(SPOT_RINGS)
    samples = rays_at(system, wavelengths_nm, field, *points)
    blocked = np.where(passes(samples), 0.0, np.nan)
    away_x, away_y = _from_primary(samples, primary)
    x = 1e3 * (samples.landing_x_mm + away_x) + blocked
    y = 1e3 * (samples.landing_y_mm + away_y) + blocked
    share = np.where(np.isfinite(x), area, 0.0)
    share /= share.sum()
    centroid = np.array([np.nansum(share * x), np.nansum(share * y)])
    distance = np.hypot(x - centroid[0], y - centroid[1])
    return Spot(
        x_um=x,
        y_um=y,
        centroid_um=centroid,
        rms_um=float(np.sqrt(np.nansum(share * distance**2))),
        geometric_um=float(np.nanmax(distance)),
    )


def airy_radius_um(system: System, wavelength_nm: float) -> float:
    """Return the radius of the first dark ring on the axis: 0.61 lambda / NA (Born & Wolf 8.5)."""
    rim = rays_at(
        system, np.array([wavelength_nm]), Field("axis", 0.0), np.array([1.0]), np.array([0.0])
    )
    sine = np.hypot(
        rim.alpha[0, 0] - rim.chief_direction[0, 0], rim.beta[0, 0] - rim.chief_direction[0, 1]
    )
    return 0.61e-3 * wavelength_nm / float(sine)


@dataclass(frozen=True)
class Wavefront:
    """OPD over the stop at one wavelength.

    Attributes
    ----------
    stop : ndarray, shape (P,)
        Positions of columns (x) and rows (y), relative to the stop's radius.
    opd_waves : ndarray, shape (P, P)
        Rows y, columns x; NaN where no light passes.
    """

    stop: np.ndarray
    opd_waves: np.ndarray

    @property
    def rms_waves(self) -> float:
        """Standard deviation over the light that passes."""
        return float(np.nanstd(self.opd_waves))

    @property
    def peak_to_valley_waves(self) -> float:
        """Largest difference of two OPDs."""
        return float(np.nanmax(self.opd_waves) - np.nanmin(self.opd_waves))


def wavefront_map(system: System, wavelength_nm: float, field: Field) -> Wavefront:
    """Return the OPD over the stop."""
    stop = np.linspace(-1, 1, MAP_POINTS)
    x, y = np.meshgrid(stop, stop)
    inside = np.hypot(x, y) <= 1
    lines = np.array([wavelength_nm])
    samples = rays_at(system, lines, field, x[inside], y[inside])
    opd = np.full(x.shape, np.nan)
    opd[inside] = np.where(passes(samples), _opd_waves(samples, lines, 0), np.nan)[0]
    return Wavefront(stop, opd)


@dataclass(frozen=True)
class Arrival:
    """How light arrives at the image of one field, at one wavelength.

    Angles are from the image's normal, in degrees, in the y-z plane but for the sagittal ones,
    which are in the plane across it; positive where light travels towards larger y (or x).

    Attributes
    ----------
    x_mm, y_mm : float
        Where the chief ray lands.
    chief_deg : float
        Its whole angle from the normal.
    upper_deg, lower_deg : float
        Angles of the outermost rays along y that pass: the greater and the smaller one.
    sagittal_deg : tuple of float
        Angles of the outermost rays along x that pass.

    Angles of rims are NaN where no light passes on that diameter of the stop.
    """

    x_mm: float
    y_mm: float
    chief_deg: float
    upper_deg: float
    lower_deg: float
    sagittal_deg: tuple[float, float]

    @property
    def f_numbers(self) -> tuple[float, float]:
        """Working f-numbers along y and along x: 1 over the difference of the rims' sines."""
        return tuple(
            1 / abs(np.sin(np.radians(a)) - np.sin(np.radians(b)))
            for a, b in ((self.upper_deg, self.lower_deg), self.sagittal_deg)
        )


def arrival(system: System, wavelength_nm: float, field: Field) -> Arrival:
    """Return chief-ray and marginal-ray angles at the image."""
    lines = np.array([wavelength_nm])
    lower, upper = _rim_angles(system, lines, field, "y")
    left, right = _rim_angles(system, lines, field, "x")
    middle = np.zeros(1)
    samples = rays_at(system, lines, field, middle, middle)
    a, b = samples.chief_direction[0]
    sign = -1.0 if b < 0 else 1.0
    return Arrival(
        x_mm=float(samples.chief_x_mm[0]),
        y_mm=float(samples.chief_y_mm[0]),
        chief_deg=sign * float(np.degrees(np.arcsin(np.hypot(a, b)))),
        upper_deg=upper,
        lower_deg=lower,
        sagittal_deg=(right, left),
    )


def _rim_angles(system: System, lines: np.ndarray, field: Field, way: Way) -> tuple[float, float]:
    """Return the angles (deg) of the outermost rays that pass along a diameter of the stop.

    The smaller first; NaN where none passes. Rims are looked for twice, to 1e-4 of the radius.
    """

    def traced(stop: np.ndarray) -> Samples:
        nothing = np.zeros_like(stop)
        return rays_at(system, lines, field, *((nothing, stop) if way == "y" else (stop, nothing)))

    def lit(stop: np.ndarray) -> np.ndarray:
        return passes(traced(stop))[0]

    stop = np.linspace(-1, 1, _EDGE_POINTS)
    found = np.flatnonzero(lit(stop))
    if not found.size:
        return np.nan, np.nan
    ends = []
    for at, side in ((found[0], -1), (found[-1], 1)):
        beyond = np.clip(at + side, 0, _EDGE_POINTS - 1)
        between = np.linspace(stop[at], stop[beyond], _EDGE_POINTS // 2)
        ends.append(between[np.flatnonzero(lit(between))[-1]])
    rims = traced(np.array(ends))
    gamma = np.sqrt(1 - rims.alpha[0] ** 2 - rims.beta[0] ** 2)
    angles = np.degrees(np.arctan2((rims.beta if way == "y" else rims.alpha)[0], gamma))
    return float(angles.min()), float(angles.max())

"""Frequency and amplitude of a sinusoidal pattern: the law of a wave fitted to the pixels.

    v(x, y) = plane(x, y) + a cos(2 pi (f_x x + f_y y)) + b sin(2 pi (f_x x + f_y y))

by least squares over all pixels of a region, each at its own place, so that frequencies between
those of a Fourier transform are found, and a filter array's photosites need no demosaicing. The
transform of the region under a Hann window gives the start. What is fitted is the pattern as
sampled: a pixel's own aperture is part of the amplitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gpusim.errors import UserError
from gpusim.metrics.figure import Figure
from gpusim.metrics.picture import Plane
from gpusim.metrics.regions import filled

SMALLEST_PX = 16  # sides of a region
LEAST_WAVES = 2.0  # in a region: fewer cannot be told from its shading
LEAST_SIGMAS = 5.0  # of the amplitude in its uncertainty


@dataclass(frozen=True, eq=False)
class Sinusoid:
    """A wave in a region.

    Attributes
    ----------
    region : (x, y, width, height)
    frequency_cy_px : Figure
        Along the normal of its crests, with the standard uncertainty.
    frequency_x, frequency_y : Figure
        Cycles/px along rows and columns; f_x is not negative.
    amplitude : Figure
        Half the swing, in the unit of the picture.
    mean : float
        Mean of the plane below it, in the region's middle.
    modulation : Figure
        Amplitude over mean.
    phase_deg : float
        At the region's middle, of the cosine.
    noise : float
        Standard deviation of what the law leaves.
    harmonic : float or None
        Amplitude at twice the frequency, over that of the wave; None where samples are too far
        apart for it.
    spectrum_cy_px, spectrum : ndarray (F,)
        Amplitude along the wave's normal under a Hann window, at frequencies up to 0.5.
    places, values : ndarray (N,)
        Pixels: their phase in waves, and their value less the plane.
    """

    region: tuple[int, int, int, int]
    frequency_cy_px: Figure
    frequency_x: Figure
    frequency_y: Figure
    amplitude: Figure
    mean: float
    modulation: Figure
    phase_deg: float
    noise: float
    harmonic: float | None
    spectrum_cy_px: np.ndarray
    spectrum: np.ndarray
    places: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class Bend:
    """A picture's distortion, r_u = r_d (1 + k_1 r_d^2 + k_2 r_d^4 + ...), as marks tell it.

    Attributes
    ----------
    coefficients : tuple of float
        k_1, k_2 ...
    centre_px : (float, float)
    corner_px : float
        Unit of the radii.
    """

    coefficients: tuple[float, ...]
    centre_px: tuple[float, float]
    corner_px: float

    def undistorted(self, wave: Sinusoid) -> float:
        """Return the frequency that a wave has in the undistorted picture, cycles/px.

        Its phase is that of the same point of the chart: f_u = J^T f_d with J = d x_d / d x_u in
        the region's middle, which is d r_d / d r_u along the radius and r_d / r_u across it.
        """
        left, top, width, height = wave.region
        x, y = left + width / 2 - self.centre_px[0], top + height / 2 - self.centre_px[1]
        away = np.hypot(x, y)
        out_x, out_y = (x / away, y / away) if away else (1.0, 0.0)
        powers = 2 * np.arange(1, len(self.coefficients) + 1)
        terms = np.array(self.coefficients) * (away / self.corner_px) ** powers
        f_x, f_y = wave.frequency_x.value, wave.frequency_y.value
        along = (f_x * out_x + f_y * out_y) / (1 + (powers + 1) @ terms)
        across = (f_y * out_x - f_x * out_y) / (1 + terms.sum())
        return float(np.hypot(along, across))


def measure_sinusoid(plane: Plane, region: tuple[int, int, int, int]) -> Sinusoid:
    """Measure the strongest wave in a region.

    Parameters
    ----------
    plane : Plane
    region : (x, y, width, height)
        Pixels.

    Raises
    ------
    UserError
        The region leaves the picture, is too small, clipped, or holds no wave.
    """
    width, height = region[2:]
    x, y, value = _pixels(plane, region)
    start = _start(plane, region)
    fit = _fit(x, y, value, start)
    f, spread, beside, noise = fit
    level, slope_x, slope_y, a, b = beside
    size = float(np.hypot(a, b))
    frequency = float(np.hypot(*f))
    u_size, u_f = spread[0], spread[1:]
    if size < LEAST_SIGMAS * u_size or frequency * max(width, height) < LEAST_WAVES:
        raise UserError(
            "There is no wave in the region.",
            field="roi",
            value=f"amplitude {size:.3g} with an uncertainty of {u_size:.3g}",
            allowed=f"a sinusoid of {LEAST_WAVES:g} waves or more",
        )
    if f[0] < 0:
        f, b = -f, -b
    at = x * f[0] + y * f[1]
    rest = value - level - slope_x * x - slope_y * y
    u_along = float(np.hypot(*(f * u_f)) / frequency)
    spectrum_f, spectrum = _spectrum(x, y, rest, f / frequency, (width, height))
    harmonic = None
    step = 1 if plane.sites is None else 2  # px between the photosites of a colour, or less
    if 2 * np.abs(f).max() < 0.5 / step:
        second = _design(x, y, 2 * f)[:, 3:]
        left_over = rest - a * np.cos(2 * np.pi * at) - b * np.sin(2 * np.pi * at)
        harmonic = float(np.hypot(*np.linalg.lstsq(second, left_over, rcond=None)[0]) / size)
    return Sinusoid(
        region,
        Figure(frequency, u_along),
        Figure(float(f[0]), float(u_f[0])),
        Figure(float(f[1]), float(u_f[1])),
        Figure(size, float(u_size)),
        float(level),
        Figure(size / level, float(u_size / abs(level))),
        float(np.degrees(np.arctan2(-b, a))),
        noise,
        harmonic,
        spectrum_f,
        spectrum,
        at,
        rest,
    )


def _pixels(
    plane: Plane, region: tuple[int, int, int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x and y from a region's middle (N,), and values (N,), of its own pixels."""
    left, top, width, height = region
    tall, wide = plane.values.shape
    if not (0 <= left < left + width <= wide and 0 <= top < top + height <= tall):
        allowed = f"x,y,width,height within {wide} x {tall}"
        raise UserError(
            "The region leaves the picture.", field="roi", value=region, allowed=allowed
        )
    if min(width, height) < SMALLEST_PX:
        allowed = f"{SMALLEST_PX} x {SMALLEST_PX} pixels or more"
        raise UserError("The region is too small.", field="roi", value=region, allowed=allowed)
    rows, cols = np.mgrid[top : top + height, left : left + width]
    own = np.ones(rows.shape, bool)
    if plane.sites is not None:
        own = plane.sites[rows % plane.sites.shape[0], cols % plane.sites.shape[1]]
    value = plane.values[rows[own], cols[own]].astype(np.float64)
    if np.mean((value <= plane.clip[0]) | (value >= plane.clip[1])) > 0:
        raise UserError(
            "The region is clipped.", field="roi", value=region, allowed="no black or full pixels"
        )
    x, y = cols[own] + 0.5 - left - width / 2, rows[own] + 0.5 - top - height / 2
    return x, y, value


def _start(plane: Plane, region: tuple[int, int, int, int]) -> np.ndarray:
    """Return the strongest frequency (2,) of the region's transform, x and y."""
    left, top, width, height = region
    values = filled(plane)[top : top + height, left : left + width]
    window = np.outer(np.hanning(height), np.hanning(width))
    shape = 4 * height, 4 * width
    power = np.abs(np.fft.rfft2((values - values.mean()) * window, shape))
    f_y, f_x = np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1]), indexing="ij")
    # Shading lies below two waves in the region.
    power[np.hypot(f_x * width, f_y * height) < LEAST_WAVES] = 0
    at = np.unravel_index(np.argmax(power), power.shape)
    return np.array([f_x[at], f_y[at]])


def _design(x: np.ndarray, y: np.ndarray, f: np.ndarray) -> np.ndarray:
    turn = 2 * np.pi * (f[0] * x + f[1] * y)
    return np.stack([np.ones_like(x), x, y, np.cos(turn), np.sin(turn)], 1)


def _fit(
    x: np.ndarray, y: np.ndarray, value: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return the frequency, uncertainties of amplitude, f_x and f_y, the linear part, the noise."""

    def rest(f: np.ndarray) -> np.ndarray:
        # What is linear is solved for at each frequency (Golub and Pereyra 1973).
        design = _design(x, y, f)
        return value - design @ np.linalg.lstsq(design, value, rcond=None)[0]

    found = least_squares(rest, start, x_scale=0.01, xtol=1e-13, ftol=1e-13, gtol=1e-13)
    f = found.x
    design = _design(x, y, f)
    beside, *_ = np.linalg.lstsq(design, value, rcond=None)
    a, b = beside[3:]
    across = 2 * np.pi * (b * design[:, 3] - a * design[:, 4])
    whole = np.column_stack([design, across * x, across * y])
    noise = float(np.sqrt(np.sum(found.fun**2) / max(len(value) - whole.shape[1], 1)))
    covariance = np.linalg.pinv(whole.T @ whole) * noise**2
    size = np.hypot(a, b)
    u_size = np.sqrt(np.array([a, b]) @ covariance[3:5, 3:5] @ np.array([a, b])) / size
    return f, np.array([u_size, *np.sqrt(np.diag(covariance)[5:])]), beside, noise


def _spectrum(
    x: np.ndarray, y: np.ndarray, rest: np.ndarray, normal: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return amplitudes along a normal, of waves as they are, by the transform of the pixels."""
    weight = np.cos(np.pi * x / size[0]) ** 2 * np.cos(np.pi * y / size[1]) ** 2
    f = np.linspace(0, 0.5, 201)
    along = x * normal[0] + y * normal[1]
    wave = np.exp(-2j * np.pi * f[:, None] * along)
    return f, 2 * np.abs(wave @ (weight * rest)) / weight.sum()

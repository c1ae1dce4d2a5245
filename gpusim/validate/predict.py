"""Line spreads of a lens and a band, from a tracer's rays alone: no bank, no plan, no shader.

Along the normal n of an edge, with direction cosines (u, v) along n and along the edge, the line
spread of one wavelength is

    LSF(d) = integral | integral P(u, v) exp(2 pi i u d / lambda) du |^2 dv,
    OTF(f) = integral P(u + lambda f, v) conj(P(u, v)) du dv

(Goodman 2005, eq. 6-28, in one direction), P = sqrt(E) exp(2 pi i W / lambda) inside all apertures,
else 0, with E the light that enters by direction cosines: the area dA of the beam from a far point
that goes into du dv. Rays alone, without diffraction, give OTF(f) = integral E exp(2 pi i f dW/du).
A band is the sum over wavelengths about their own chief rays, weighted by photons, efficiency,
glass surfaces and the pupil's solid angle; the pixel's square aperture is two sincs.

PSFs h and light K go with the place s of a source point. An edge at s = 0 over its flat field is
(integral over s > 0 of K(s) h(x - s; s) ds) / (integral over all s of the same), whose derivative
is, to first order in both slopes,

    h(x; 0) (1 - (x - centroid) d ln K / ds) + integral to x of dh/ds dx:

where PSFs widen outwards, edges lie farther inwards by half of the slope of their variance.

K is what enters about a field, per area of its image: A sin(theta) d theta / (h dh), A the integral
of E du dv. An even scene shows, at the height h, to second order,

    K - div (K c) + div div (K S) / 2,

c and S the mean and the second moments of where the rays of a field land about its chief ray.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline

from gpusim.validate.pupils import ROWS, SAMPLES, Pupils
from gpusim.validate.tracers import Tracer

STEP_CY_UM = 1 / 1600  # of transfer functions: line spreads repeat after 1600 um
CUTOFF_CY_UM = 1.3  # 2 sin(theta') / lambda at f/2 and 400 nm
CONE_STEP = 5  # of the samples of a cone, over which an efficiency is averaged: 1e-5 of it
FIELDS = 13  # at which pupils are traced: 21 move no edge 5 or 9 by 1e-4 px
CHIEF_FIELDS = 25  # of a spline of chief-ray heights over the field: 1e-7 mm


@dataclass(frozen=True, eq=False)
class Band:
    """A spectral band: photons times efficiency at wavelengths (K,), for nodes that are traced."""

    name: str
    wavelengths_nm: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True, eq=False)
class LineSpread:
    """A line spread about a place.

    Attributes
    ----------
    frequency_cy_um : ndarray (F,)
    otf : ndarray (F,) of complex
        1 at 0; the phase belongs to distances from the place.
    light : float
        Light of a point, relative: solid angle, surfaces, photons and efficiency.
    """

    frequency_cy_um: np.ndarray
    otf: np.ndarray
    light: float

    def at(self, distance_um: np.ndarray) -> np.ndarray:
        """Return the line spread (D,), per um."""
        count = 2 * next_fast_len(2 * self.otf.size)
        values = irfft(self.otf, count) * count * self.frequency_cy_um[1]
        period_um = 1 / self.frequency_cy_um[1]
        whole = CubicSpline(
            np.arange(count + 1) * period_um / count,
            np.append(values, values[0]),
            bc_type="periodic",
        )
        return whole(distance_um)

    def through(self, width_um: float, slope: float) -> LineSpread:
        """Return it as a square aperture of a side sees it, an edge of dx/dy = slope before it."""
        cos = 1 / np.hypot(1, slope)
        f = self.frequency_cy_um * width_um
        aperture = np.sinc(f * cos) * np.sinc(f * cos * slope)
        return replace(self, otf=self.otf * aperture)


class Predictor:
    """What a tracer says of edges in front of a lens.

    Parameters
    ----------
    tracer : Tracer
    widest_rad : float
        Field to which rays are followed.
    nodes_nm : ndarray (L,)
        Wavelengths that are traced; between them a cubic spline about each one's own chief ray.
    passed : ndarray (L,)
        Share of the light that the surfaces pass there.
    pupils, chiefs : int
        Fields at which pupils and chief rays are traced.
    diffracts : bool
        Whether light is a wave; else line spreads are those of the rays.
    """

    def __init__(
        self,
        tracer: Tracer,
        widest_rad: float,
        nodes_nm: np.ndarray,
        passed: np.ndarray,
        *,
        pupils: int = FIELDS,
        chiefs: int = CHIEF_FIELDS,
        diffracts: bool = True,
    ) -> None:
        self.tracer, self.nodes_nm, self.widest_rad = tracer, nodes_nm, widest_rad
        fields = np.linspace(0, widest_rad, chiefs)
        heights = np.stack([tracer.chief_mm(fields, float(nm)) for nm in nodes_nm])
        over_field = make_interp_spline(fields, heights.T, k=5)
        self._knots, self._heights = over_field.t, CubicSpline(nodes_nm, over_field.c.T)
        at = np.linspace(0, widest_rad, pupils)
        self._pupils = [Pupils(tracer, at, float(nm)) for nm in nodes_nm]
        self.diffracts = diffracts
        self._passed = passed
        sent = np.array([[one.sent(field) for field in fields] for one in self._pupils])
        heights_mm = over_field(fields)  # (F, L)
        slope = over_field.derivative()(fields)
        on_axis = fields[:, None] == 0
        sine = np.where(on_axis, 1.0, np.sin(fields)[:, None])
        entered, *moments = np.moveaxis(sent, -1, 0).swapaxes(1, 2)  # each (F, L)
        light = entered / (slope * np.where(on_axis, slope, heights_mm / sine))
        self._light = CubicSpline(fields, light * passed)
        self._shown = [
            _shown_at(*(1e3 * heights_mm[:, line], light[:, line]), *(m[:, line] for m in moments))
            for line in range(len(nodes_nm))
        ]
        self.found: dict[tuple[float, ...], np.ndarray] = {}

    def chief_um(self, field_rad: np.ndarray, wavelengths_nm: np.ndarray) -> np.ndarray:
        """Return chief-ray heights (K, F), um."""
        coefficients = self._heights(wavelengths_nm).T  # over wavelengths smooth as the heights
        return 1e3 * BSpline(self._knots, coefficients, 5)(field_rad).T

    def field_rad(self, radius_um: np.ndarray, wavelength_nm: float) -> np.ndarray:
        """Return the fields, rad, whose chief rays land at distances from the axis."""
        fields = np.linspace(0, self.widest_rad, 80 * CHIEF_FIELDS)
        heights = self.chief_um(fields, np.array([wavelength_nm]))[0]
        return CubicSpline(heights, fields)(radius_um)

    def light(self, field_rad: np.ndarray, wavelengths_nm: np.ndarray) -> np.ndarray:
        """Return the light (K, F) that fields send per photon, sr: what surfaces pass of it."""
        return CubicSpline(self.nodes_nm, self._light(field_rad), axis=-1)(wavelengths_nm).T

    def shown(self, radius_um: np.ndarray, wavelengths_nm: np.ndarray) -> np.ndarray:
        """Return the light (K, R) per photon of an even scene at distances from the axis, sr."""
        found = [one(radius_um) * p for one, p in zip(self._shown, self._passed, strict=True)]
        return CubicSpline(self.nodes_nm, found)(wavelengths_nm)

    def flat_field(self, radius_um: np.ndarray, band: Band) -> np.ndarray:
        """Return the light of an even scene at distances from the axis, over that on it."""
        heights = np.linspace(0, np.max(radius_um), 4 * CHIEF_FIELDS)
        light = band.weight @ self.shown(heights, band.wavelengths_nm)
        return CubicSpline(heights, light / light[0])(radius_um)

    def ideal_um(self, place_um: np.ndarray, band: Band) -> np.ndarray:
        """Return the point (2,) of the ideal image plane whose image by a band is at a place.

        The band's mean chief ray, by the secant rule on the field.
        """
        radius = float(np.hypot(*place_um))
        if radius == 0:
            return np.zeros(2)
        field = np.arctan(1e-3 * radius / self.tracer.efl_mm)
        for _ in range(20):
            field *= radius / self.mean_um(field, band)
        return place_um / radius * 1e3 * self.tracer.efl_mm * np.tan(field)

    def mean_um(self, field_rad: float, band: Band) -> float:
        """Return the height of a band's mean chief ray."""
        heights = self.chief_um(np.array([field_rad]), band.wavelengths_nm)[:, 0]
        return float(np.average(heights, weights=band.weight))

    def image_um(self, ideal_um: np.ndarray, band: Band) -> np.ndarray:
        """Return where a point of the ideal image plane is imaged by a band's mean chief ray."""
        radius = float(np.hypot(*ideal_um))
        if radius == 0:
            return np.zeros(2)
        field = float(np.arctan(1e-3 * radius / self.tracer.efl_mm))
        return ideal_um / radius * self.mean_um(field, band)

    def cone(self, field_rad: float, line: int) -> np.ndarray:
        """Return rays (R, 3) that arrive from a field at a node: share, and direction cosines.

        The cosines are those along the radius, outwards, and across it.
        """
        pupils = self._pupils[line]
        share, _, _, step = pupils.seen(field_rad, np.array([0.0, 1.0]))
        radial = (np.arange(SAMPLES) + 0.5) * step - pupils.reach + pupils.chief_beta(field_rad)
        across = ((np.arange(ROWS) + 0.5) * 2 / ROWS - 1)[:, None] * pupils.reach
        rays = np.stack(np.broadcast_arrays(share, radial, across), -1)[:, ::CONE_STEP]
        clear = rays[rays[..., 0] > 0]
        clear[:, 0] /= clear[:, 0].sum()
        return clear

    def line_spread(
        self, ideal_um: np.ndarray, normal: np.ndarray, origin_um: np.ndarray, band: Band
    ) -> LineSpread:
        """Return the line spread of an edge through a point of the ideal image plane.

        Parameters
        ----------
        ideal_um : ndarray (2,)
        normal : ndarray (2,)
            Unit normal of the edge's image: distances grow along it.
        origin_um : ndarray (2,)
            Point of the image plane from which distances count.
        band : Band
        """
        radius = float(np.hypot(*ideal_um))
        radial = np.array([0.0, 1.0]) if radius == 0 else ideal_um / radius
        field = float(np.arctan(1e-3 * radius / self.tracer.efl_mm))
        # The rays' y lies along the radius, their x across it; the pupil is even in x.
        own = np.array([abs(normal @ [radial[1], -radial[0]]), normal @ radial])
        frequency = np.arange(0, CUTOFF_CY_UM, STEP_CY_UM)
        lines = range(len(self.nodes_nm))
        otf = np.array([self._transfer(field, own, line, frequency) for line in lines])
        about = CubicSpline(self.nodes_nm, otf)(band.wavelengths_nm)
        light = self.light(np.array([field]), band.wavelengths_nm)[:, 0]
        chief = self.chief_um(np.array([field]), band.wavelengths_nm)
        away = (chief * radial - origin_um) @ normal  # (K,)
        about = about * np.exp(-2j * np.pi * np.outer(away, frequency))
        total = (band.weight * light) @ about
        return LineSpread(frequency, total / total[0], float(total[0].real))

    def point_spread(
        self, field_rad: float, node_nm: float, pitch_um: float, samples: int
    ) -> np.ndarray:
        """Return the PSF (n, n) at a node about the chief ray, which lands on [n / 2, n / 2].

        Share of the light of the window per sample; rows lie across the radius, columns along it,
        outwards.
        """
        line = int(np.flatnonzero(self.nodes_nm == node_nm)[0])
        at = (np.arange(samples) - samples / 2) * pitch_um
        values = self._pupils[line].point_spread(field_rad, at)
        return values / values.sum()

    def spot_um(self, field_rad: float, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (L,) and standard deviation (L,) of the rays along a normal, at the nodes.

        About the chief ray's point; ``normal`` is (across the radius, along it).
        """
        found = [pupils.spot_um(field_rad, normal) for pupils in self._pupils]
        mean, deviation = np.array(found).T
        return mean, deviation

    def _transfer(
        self, field: float, normal: np.ndarray, line: int, frequency: np.ndarray
    ) -> np.ndarray:
        """Return the transfer function about the chief ray."""
        key = round(field, 9), line, *np.round(normal, 9)
        if key not in self.found:  # bands share what is traced
            pupils = self._pupils[line]
            transfer = pupils.transfer if self.diffracts else pupils.ray_transfer
            self.found[key] = transfer(field, normal, frequency)
        return self.found[key]


def _shown_at(
    height_um: np.ndarray,
    light: np.ndarray,
    mean: np.ndarray,
    along: np.ndarray,
    across: np.ndarray,
) -> BSpline:
    """Return what an even scene shows, over the height: see the head.

    In polar coordinates (div K S)_r = (K S_rr)' + K (S_rr - S_tt) / r and div v = v' + v / r; what
    is even about the axis continues as itself, and the radial part of a vector as its negative.
    """
    both = np.concatenate([-height_um[:0:-1], height_um])

    def spline(values: np.ndarray, sign: float) -> BSpline:
        return make_interp_spline(both, np.concatenate([sign * values[:0:-1], values]), k=5)

    r = np.where(height_um > 0, height_um, 1.0)
    tensor = spline(light * along, 1).derivative()(height_um) + light * (along - across) / r
    vector = np.where(height_um > 0, light * mean - tensor / 2, 0.0)
    rise = spline(vector, -1).derivative()(height_um)
    return spline(light - rise - np.where(height_um > 0, vector / r, rise), 1)

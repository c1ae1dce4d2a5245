"""The pupils of one wavelength over the field, from a tracer's rays, and what they make of light.

Equations: `gpusim.validate.predict`.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev
from scipy.fft import fft, ifft, next_fast_len
from scipy.interpolate import CubicSpline

from gpusim.validate.tracers import Tracer

DEGREE = 14  # of polynomials in the direction cosines: 1e-4 waves, as gpusim.lens.wavefront has it
ROWS = 96  # across the edge's direction: 192 move no edge 5 or 9 by 4e-4 px
SAMPLES = 640  # of the pupil along n: one period of the line spread is over 800 um
WIDER = 1.1  # rays so far beyond the widest pupil still count for the polynomials


class Pupils:
    """Pupils of one wavelength over the field.

    Path, places where rays enter and margins are polynomials in the direction cosines about the
    chief ray's, even in alpha (but for the place along x, which is odd), whose coefficients are
    cubic splines over the field.
    """

    def __init__(self, tracer: Tracer, fields: np.ndarray, wavelength_nm: float) -> None:
        bundles = [tracer.rays(float(field), wavelength_nm) for field in fields]
        self.wave_um = 1e-3 * wavelength_nm
        inside = [(one.margin < 0).all(axis=0) for one in bundles]
        apart = [np.hypot(one.alpha, one.beta - one.chief_beta) for one in bundles]
        self.reach = 1.02 * max(r[own].max() for r, own in zip(apart, inside, strict=True))
        i, j = (a.ravel() for a in np.indices((DEGREE + 1, DEGREE + 1)))
        self.used = (i + j <= DEGREE) & (i % 2 == 0)
        # Apertures that stop light at some field.
        close = np.any(
            [
                one.margin[:, own].max(axis=1) > -0.1
                for one, own in zip(bundles, inside, strict=True)
            ],
            axis=0,
        )
        fits, rest = [], []
        for one, own, away in zip(bundles, inside, apart, strict=True):
            near = away < WIDER * self.reach
            across, *even = one.entered_mm[0], one.wave_mm, one.entered_mm[1], *one.margin[close]
            design = self._powers(one.alpha[near], one.beta[near] - one.chief_beta)
            fit = np.linalg.lstsq(design, np.array(even)[:, near].T, rcond=None)[0]
            odd = design * one.alpha[near][:, None]
            fits.append(np.column_stack([fit, np.linalg.lstsq(odd, across[near], rcond=None)[0]]))
            rest.append((design @ fits[-1][:, 0] - one.wave_mm[near])[own[near]])
        self.fits = CubicSpline(fields, fits)
        self.chief_beta = CubicSpline(fields, [one.chief_beta for one in bundles])
        self.residual_waves = float(np.std(np.concatenate(rest))) * 1e3 / self.wave_um

    def _powers(self, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
        scale = WIDER * self.reach
        return chebyshev.chebvander2d(alpha / scale, beta / scale, [DEGREE, DEGREE])[..., self.used]

    def sent(self, field: float) -> tuple[float, float, float, float]:
        """Return what a field sends through, mm^2, and moments of where its rays land.

        Their mean along the radius, um, and second moments along it and across, um^2.
        """
        share, light, path_mm, step = self.seen(field, np.array([0.0, 1.0]))
        weight, row = share * light, 2 * self.reach / ROWS
        across, along = (-1e3 * one for one in np.gradient(path_mm, row, step))
        total = weight.sum()
        means = ((weight * one).sum() / total for one in (along, along**2, across**2))
        return float(total * step * row), *map(float, means)

    def seen(
        self, field: float, normal: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Return what of cells (V, U) is clear, the light in it, path, mm, and a cell's width."""
        reach = self.reach
        step = 2 * reach / SAMPLES
        u = (np.arange(SAMPLES) + 0.5) * step - reach
        v = ((np.arange(ROWS) + 0.5) * 2 / ROWS - 1)[:, None] * reach
        # Along u polynomials of degree 14 are known from their values at 15 nodes.
        node = reach * np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
        powers = self._powers(node * normal[0] - v * normal[1], node * normal[1] + v * normal[0])
        at_nodes = np.einsum("vnp,pk->vkn", powers, self.fits(field), optimize=True)
        from_nodes = np.linalg.inv(chebyshev.chebvander(node / reach, DEGREE))
        found = at_nodes @ (chebyshev.chebvander(u / reach, DEGREE) @ from_nodes).T  # (V, k, U)
        share = (np.hypot(u, v) <= reach) * _covered(found[:, 2:-1])
        entered = found[:, 1], found[:, -1] * (u * normal[0] - v * normal[1])
        (y_v, y_u), (x_v, x_u) = (np.gradient(one, 2 * reach / ROWS, step) for one in entered)
        return share, np.abs(x_u * y_v - x_v * y_u), found[:, 0], step

    def transfer(self, field: float, normal: np.ndarray, frequency: np.ndarray) -> np.ndarray:
        """Return the transfer function (F,) along a normal."""
        share, light, path_mm, step = self.seen(field, normal)
        pupil = share * np.sqrt(light) * np.exp(2j * np.pi * path_mm * 1e3 / self.wave_um)
        length = next_fast_len(2 * SAMPLES)
        power = (np.abs(fft(pupil, length, axis=1)) ** 2).sum(axis=0)
        lags = ifft(power)[:SAMPLES]  # sum of P(u + lag) conj(P(u))
        # Between lags the autocorrelation is smooth: a cubic spline through it.
        # Without a lag a cell that the rim cuts passes its share, not the square of it.
        lags[0] = (share * light).sum()
        own = CubicSpline(np.arange(SAMPLES) * step / self.wave_um, lags / lags[0].real)
        reached = frequency <= (SAMPLES - 1) * step / self.wave_um
        otf = np.zeros(frequency.size, complex)
        otf[reached] = own(frequency[reached])
        return otf

    def point_spread(self, field: float, at_um: np.ndarray) -> np.ndarray:
        """Return the PSF (across, along the radius) at distances from the chief ray."""
        share, light, path_mm, step = self.seen(field, np.array([0.0, 1.0]))
        pupil = share * np.sqrt(light) * np.exp(2j * np.pi * path_mm * 1e3 / self.wave_um)  # (V, U)
        u = (np.arange(SAMPLES) + 0.5) * step - self.reach
        v = ((np.arange(ROWS) + 0.5) * 2 / ROWS - 1) * self.reach
        along = np.exp(2j * np.pi * np.outer(u, at_um) / self.wave_um)
        across = np.exp(2j * np.pi * np.outer(at_um, v) / self.wave_um)
        return np.abs(across @ pupil @ along) ** 2

    def spot_um(self, field: float, normal: np.ndarray) -> tuple[float, float]:
        """Return mean and standard deviation of where rays land along a normal."""
        share, light, path_mm, step = self.seen(field, normal)
        weight, away_um = share * light, -1e3 * np.gradient(path_mm, step, axis=1)
        mean = float((weight * away_um).sum() / weight.sum())
        return mean, float(np.sqrt((weight * (away_um - mean) ** 2).sum() / weight.sum()))

    def ray_transfer(self, field: float, normal: np.ndarray, frequency: np.ndarray) -> np.ndarray:
        """Return the same of the rays alone."""
        share, light, path_mm, step = self.seen(field, normal)
        seen = share > 0
        away_um = (1e3 * np.gradient(path_mm, step, axis=1))[seen]
        weight = (share * light)[seen]
        # In bins of a fiftieth of a um: at 0.3 cy/um a bin's width counts for 6e-5.
        low = away_um.min()
        bins = np.bincount(np.rint((away_um - low) * 50).astype(int), weight / weight.sum())
        at = low + np.arange(bins.size) / 50
        return np.exp(2j * np.pi * np.outer(frequency, at)) @ bins


def _covered(margin: np.ndarray) -> np.ndarray:
    """Return the share (V, U) of each cell inside all apertures, from margins (V, k, U)."""
    if margin.shape[1] == 0:
        return np.ones((margin.shape[0], margin.shape[2]))
    worst = margin.max(axis=1)
    slope = np.abs(np.gradient(worst, axis=1)) + 1e-12
    return np.clip(0.5 - worst / slope, 0, 1)

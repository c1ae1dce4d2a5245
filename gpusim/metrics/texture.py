"""Texture MTF from dead leaves: what is left of fine detail of low contrast in a picture.

The power spectrum of a region is divided by that of the target, which is known. Leaves lie one over
another. Take the front leaf of all that cover either of two points d apart: it covers both points,
and gives both the same grey, with the probability

    gamma(d) / (2 gamma(0) - gamma(d))

where gamma(d) is the mean area that a leaf shares with itself moved by d (Lee, Mumford and Huang
2001); else their greys are independent. So that is the covariance over the variance. Its transform,
seen through the same window, is the target's spectrum. Noise is taken off: by a second picture of
the same scene, whose noise is independent, or by the spectrum of an even patch (McElvain et al.
2010).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft

from gpusim.errors import UserError
from gpusim.metrics.picture import Plane

Box = tuple[int, int, int, int]  # x, y, width, height

TILE, LEAST_TILE = 256, 64  # samples along a side of what is transformed
FINE = 4  # samples of the covariance in one of the picture's: its spectrum falls as f^-3
RADII = 512  # at which areas are averaged
LOW = (3.0, 0.15)  # where the MTF is taken to 1: from so many bins to so many cycles/sample
SEEN = 4.0  # uncertainties above which power at low frequencies is texture and not noise
BINS = 64  # up to Nyquist's frequency, at least two frequencies of the transform wide


@dataclass(frozen=True, eq=False)
class Texture:
    """Texture MTF of one channel.

    Attributes
    ----------
    channel : str
    box : (int, int, int, int)
    frequency : ndarray (B,)
        Cycles per pixel.
    mtf : ndarray (B,)
        1 at low frequencies.
    u : ndarray (B,)
        Standard uncertainties: from how tiles of the region differ, of what is taken to 1, and of
        what samples fold.
    target : ndarray (B,)
        Power of the target over its variance, pixels^2.
    power : ndarray (B,)
        Power of the picture without its noise, the picture's unit squared times pixels^2.
    noise : str
        How noise was taken off.
    clipped : bool
        Some pixels are black or saturated.
    """

    channel: str
    box: Box
    frequency: np.ndarray
    mtf: np.ndarray
    u: np.ndarray
    target: np.ndarray
    power: np.ndarray
    noise: str
    clipped: bool

    @property
    def mtf50(self) -> float | None:
        """Return the frequency at which it first falls to 1/2; None where it does not."""
        below = np.flatnonzero(self.mtf < 0.5)
        if not len(below) or below[0] == 0:
            return None
        two = slice(below[0] - 1, below[0] + 1)
        return float(np.interp(0.5, self.mtf[two][::-1], self.frequency[two][::-1]))


def covariance(distance_px: np.ndarray, radii_px: tuple[float, float]) -> np.ndarray:
    """Return the covariance of dead leaves over their variance.

    Parameters
    ----------
    distance_px : ndarray
    radii_px : (float, float)
        Between them the radii have a density of r^-3.
    """
    low, high = radii_px
    radius = np.geomspace(low, high, RADII)
    at = 2 * high * np.linspace(0, 1, 4096) ** 2  # finer where it is steep
    half = at[:, None] / 2
    inside = half < radius
    share = np.where(inside, half / radius, 1.0)
    # Two discs a distance apart have this area in common, as a share of a disc's.
    common = (2 / np.pi) * (np.arccos(share) - share * np.sqrt(1 - share**2))
    # A density of r^-3 weights areas as r^-1: evenly in log(r).
    gamma = np.trapezoid(common, np.log(radius), axis=1) / math.log(high / low)
    return np.interp(distance_px, at, gamma / (2 - gamma), right=0.0)


def target_power(tile: int, radii_px: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the power (T, T) of the target over its variance, as a tile sees it.

    First that of each frequency alone, then with those that samples fold onto it.

    Parameters
    ----------
    tile : int
        Samples along a side.
    radii_px : (float, float)
        In samples.
    """
    size = FINE * tile
    window = _hann(size)
    # The window moved over itself, in samples of the picture.
    moved = scipy.fft.irfft(np.abs(scipy.fft.rfft(window, 2 * size)) ** 2, 2 * size)
    moved /= window @ window
    away = np.minimum(np.arange(2 * size), 2 * size - np.arange(2 * size)) / FINE
    seen = covariance(np.hypot(away, away[:, None]), radii_px) * moved * moved[:, None]
    # Every second frequency is one of the tile's.
    power = np.maximum(scipy.fft.fft2(seen).real[::2, ::2], 0.0) / FINE**2
    kept = scipy.fft.fftfreq(tile, 1 / tile).astype(int)
    folded = power.reshape(FINE, tile, FINE, tile).sum(axis=(0, 2))
    return power[np.ix_(kept, kept)], folded


def measure_texture(
    plane: Plane,
    channel: str,
    box: Box,
    radii_px: tuple[float, float],
    *,
    second: Plane | None = None,
    even: Box | None = None,
) -> Texture:
    """Measure the texture MTF of a region of dead leaves.

    Parameters
    ----------
    plane : Plane
    channel : str
    box : (int, int, int, int)
        x, y, width and height of the region, pixels.
    radii_px : (float, float)
        Radii of the smallest and the largest leaf in the picture, pixels.
    second : Plane, optional
        The same scene once more, with other noise.
    even : (int, int, int, int), optional
        A patch without texture, about as bright: its spectrum is noise.

    Raises
    ------
    UserError
        A region leaves the picture or is too small, radii do not rise, or there is no texture.
    """
    if not 0 < radii_px[0] < radii_px[1] < math.inf:
        raise UserError(
            "The radii of the leaves do not rise.",
            field="--leaves",
            value=",".join(f"{one:g}" for one in radii_px),
            allowed="two radii in pixels above 0, the smaller one first",
        )
    values, step = _samples(plane, box, "--roi")
    tile = _tile(values.shape, box, "--roi")
    bins, frequency = _bins(tile)
    found, noise = _without_noise(plane, box, values, tile, second=second, even=even)
    whole = target_power(tile, (radii_px[0] / step, radii_px[1] / step))
    target, folded = (_averaged(one, bins) for one in whole)
    power = found.mean(axis=0)
    ratio = power / target
    low = (frequency * tile >= LOW[0]) & (frequency <= LOW[1])
    # As many independent tiles as lie side by side.
    count = max(values.size / tile**2, 1.0)
    spread = found.std(axis=0, ddof=1) if len(found) > 1 else power
    u = np.maximum(spread / math.sqrt(count) / target, np.finfo(float).tiny)
    if ratio[low].sum() < SEEN * np.linalg.norm(u[low]):
        raise UserError(
            "The region has no texture.",
            field="--roi",
            value=",".join(map(str, box)),
            allowed="a region of dead leaves, larger than its noise",
        )
    mtf, u = _scaled(ratio, u, frequency, low & (ratio > 0), folded / target)
    x, y, width, height = box
    seen = plane.values[y : y + height, x : x + width]
    clipped = bool(np.any(seen <= plane.clip[0]) or np.any(seen >= plane.clip[1]))
    return Texture(
        channel,
        box,
        frequency / step,
        mtf,
        u,
        target * step**2,
        power * step**2,
        noise,
        clipped,
    )


def _scaled(
    ratio: np.ndarray, u: np.ndarray, frequency: np.ndarray, low: np.ndarray, folds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the MTF, 1 at low frequencies, and its uncertainties.

    Parameters
    ----------
    ratio, u : ndarray (B,)
        Power over the target's, and its standard uncertainty.
    frequency : ndarray (B,)
    low : ndarray of bool (B,)
        The frequencies that say what is 1.
    folds : ndarray (B,)
        How many times its own power samples fold onto a frequency of the target.
    """
    # ln(MTF^2) = a + b f^2, of a Gaussian exactly, and of others nearly, while f is low.
    weights = ratio[low] / u[low]
    logs = np.log(ratio[low])
    (_, start), errors = np.polyfit(frequency[low] ** 2, logs, 1, w=weights, cov="unscaled")

    def amplitude(of: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum(of, 0.0) / math.exp(start))

    most = amplitude(ratio)
    # Samples fold higher frequencies onto these. Their MTF lies between none and that of these.
    least = most / np.sqrt(folds)
    mtf = (most + least) / 2
    u = np.sqrt(
        ((amplitude(ratio + u) - amplitude(ratio - u)) / 2) ** 2
        + (mtf * math.sqrt(errors[1, 1]) / 2) ** 2
        + ((most - least) / 2) ** 2 / 3  # anywhere between both
    )
    return mtf, u


def _without_noise(
    plane: Plane,
    box: Box,
    values: np.ndarray,
    tile: int,
    *,
    second: Plane | None,
    even: Box | None,
) -> tuple[np.ndarray, str]:
    """Return the power of each tile by rings (N, B), and how noise was taken off."""
    own = _tiles(values, tile)
    bins, frequency = _bins(tile)
    if second is not None:
        other = _tiles(_samples(second, box, "--roi")[0], tile)
        crossed = (own * other.conj()).real
        return np.stack([_averaged(one, bins) for one in crossed]), "by the second picture"
    found = np.stack([_averaged(one, bins) for one in np.abs(own) ** 2])
    if even is None:
        return found, "not taken off"
    patch = _samples(plane, even, "--noise")[0]
    small = _tile(patch.shape, even, "--noise")
    own_bins, at = _bins(small)
    grain = [_averaged(np.abs(one) ** 2, own_bins) for one in _tiles(patch, small)]
    return found - np.interp(frequency, at, np.mean(grain, axis=0)), "by an even patch"


def _samples(plane: Plane, box: Box, field: str) -> tuple[np.ndarray, int]:
    """Return the samples of a region, of a filter array one of each period, and their distance."""
    x, y, width, height = box
    rows, cols = plane.values.shape
    if min(x, y) < 0 or min(width, height) < 1 or x + width > cols or y + height > rows:
        raise UserError(
            "The region leaves the picture.",
            field=field,
            value=",".join(map(str, box)),
            allowed=f"x, y, width and height within {cols} x {rows} pixels",
        )
    part = np.asarray(plane.values[y : y + height, x : x + width], np.float64)
    if plane.sites is None:
        return part, 1
    down, across = plane.sites.shape
    if down != across:
        raise UserError(
            "The filter array repeats after other numbers of rows than of columns.",
            field="PICTURE",
            value=f"{down} x {across}",
            allowed="a developed picture of it",
        )
    row, col = np.argwhere(plane.sites)[0]
    return part[(row - y) % down :: down, (col - x) % across :: across], int(down)


def _tile(shape: tuple[int, int], box: Box, field: str) -> int:
    """Return the side of the tiles of a region, two of which lie side by side if it can be."""
    side = min(shape)
    if side < LEAST_TILE:
        raise UserError(
            "The region is too small for a spectrum.",
            field=field,
            value=",".join(map(str, box)),
            allowed=f"{LEAST_TILE} x {LEAST_TILE} photosites of a colour, or more",
        )
    return min(TILE, max(LEAST_TILE, 1 << int(math.log2(side / 2))))


def _hann(size: int) -> np.ndarray:
    return np.sin(np.pi * (np.arange(size) + 0.5) / size) ** 2


def _tiles(values: np.ndarray, tile: int) -> np.ndarray:
    """Return spectra (N, T, T) of tiles that overlap by half (Welch 1967): power by area."""
    window = _hann(tile)
    window = window * window[:, None]
    window /= math.sqrt(np.sum(window**2))
    # Without its mean: a tile's own would take power of low frequencies with it.
    values = values - values.mean()
    starts = [range(0, size - tile + 1, tile // 2) for size in values.shape]
    return np.stack(
        [
            scipy.fft.fft2(window * values[row : row + tile, col : col + tile])
            for row in starts[0]
            for col in starts[1]
        ]
    )


def _bins(tile: int) -> tuple[np.ndarray, np.ndarray]:
    """Return each frequency's ring (T, T), and the rings' middle frequencies, cycles/sample."""
    line = scipy.fft.fftfreq(tile)
    count = min(BINS, tile // 4)
    away = np.hypot(line, line[:, None])
    rings = np.floor(away * 2 * count).astype(int)
    rings[0, 0] = count  # the mean is no texture
    at = np.bincount(rings.ravel(), away.ravel())[:count] / np.bincount(rings.ravel())[:count]
    return rings, at


def _averaged(power: np.ndarray, rings: np.ndarray) -> np.ndarray:
    count = min(BINS, len(power) // 4)
    return (np.bincount(rings.ravel(), power.ravel()) / np.bincount(rings.ravel()))[:count]

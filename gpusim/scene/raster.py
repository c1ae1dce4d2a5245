"""Photographs as scenes: coefficient planes, placed on the sensor and made continuous."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from gpusim.parallel import each
from gpusim.scene.highlights import Highlights, Split, split_outliers

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Weights of a cubic spline's coefficients in its samples: in its values, those of the cubic
# B-spline at whole numbers; in its integrals with B-splines of its own, those of the one of degree
# 7, their convolution (Unser 1999, eq. 14).
VALUES = np.array([1, 4, 1]) / 6
INTEGRALS = np.array([1, 120, 1191, 2416, 1191, 120, 1]) / 5040
# Integrating samples as cells of their own width multiplies a wave of f cycles per sample by
# sinc(f). With s = 2 - 2 cos(2 pi f), second differences negated, these are the first terms of
# 1 / sinc(f) = 1 + s / 24 + 3 s^2 / 640 + ...: what is left is 1e-6 at f = 1/8, 1e-3 at 1/4.
SHARPEN = (1 / 24, 3 / 640, 5 / 7168, 35 / 294912)
MOST_MOVED = 1 / 4  # of a sample, over each of its sides
# Steps of the non-negative fit. Measured on the HDR still life of the OpenEXR sample images, rms
# misfit at the samples over their rms: 5.4 % before, 4.27 % after 5 steps, 4.25 % after 50.
FIT_STEPS = 5
FLOOR = 0.01  # of the sample: what a step multiplies must not be zero
# Rows that are worked on at once, in float64, and what is left of a sample beyond the rows around
# them.
BAND_ROWS, REST = 256, 4e-12
POLES = 0.268, 0.535  # the filters' largest, of VALUES and of INTEGRALS
# Rows that go through all steps together: what a step writes and the next reads stays in the
# cache. Measured on lines of 4056 samples, ns a sample: 29, 22, 20, 24 with 16, 64, 128, 256 rows.
STRIP_ROWS = 128
TINY = 1e-200  # far below the smallest sample that is not 0, 1.4e-45, and its share of a sum
ROUNDING = 1e-9  # of a sample: what counts as equal in sizes


@dataclass(frozen=True, eq=False)
class PlacedRaster:
    """A raster on the image plane.

    Attributes
    ----------
    planes : ndarray (M, rows, cols), float32
        Coefficients of the scene's spectra, none negative.
    pitch_um : float
        Distance between samples.
    x0_um, y0_um : float
        Outer corner of sample [0, 0], whose centre is half a pitch to the right and below; origin
        on the axis.
    note : str
        How it was placed, for the report.
    integrals : bool
        Whether the samples are the radiance's integrals with B-splines (`INTEGRALS`), not its
        values.
    highlights : Highlights
        Light that is not in the planes.
    waves : bool
        Whether the samples are of smooth waves: see `Raster`.
    """

    planes: np.ndarray
    pitch_um: float
    x0_um: float
    y0_um: float
    note: str
    integrals: bool = False
    highlights: Highlights = field(
        default_factory=lambda: Highlights(np.zeros((0, 2)), 0.0, np.zeros((0, 0)))
    )
    waves: bool = False

    def spline_coefficients(self) -> np.ndarray:
        """Return the cubic B-spline coefficients that define the continuous radiance.

        None is negative, so nowhere is the radiance. Where the linear solution gives that, the
        spline has the samples (mirrored at the first and last, scipy's mode "mirror").
        Beside highlights it would ring below zero: there the coefficients are the non-negative ones
        whose spline explains the samples best (Richardson 1972, Lucy 1974), the light of a
        highlight kept in sum. Waves have the linear solution everywhere: see `Raster`.

        Returns
        -------
        ndarray (M, rows, cols), float32
        """
        result = np.empty(self.planes.shape, np.float32)
        count, rows, cols = result.shape

        def band(place: tuple[int, int]) -> None:
            number, first = place
            wanted = range(first, min(first + BAND_ROWS, rows))
            result[number, first : wanted.stop] = self._fitted(number, wanted, range(cols))

        each(band, [(n, first) for n in range(count) for first in range(0, rows, BAND_ROWS)])
        return result

    def spline_in(self, rows: range, cols: range) -> np.ndarray:
        """Return the coefficients of `spline_coefficients` (M, rows, cols) in a window, float64."""
        return np.stack([self._fitted(number, rows, cols) for number in range(len(self.planes))])

    def _fitted(self, number: int, rows: range, cols: range) -> np.ndarray:
        """Return the coefficients of one plane in a window, from what reaches into it."""
        margin = _reach(INTEGRALS if self.integrals else VALUES) + _faded(self.integrals)
        (top, bottom), (left, right) = (
            (max(part.start - margin, 0), part.stop + margin) for part in (rows, cols)
        )
        samples = self.planes[number, top:bottom, left:right].astype(np.float64)
        wanted = range(rows.start - top, rows.stop - top)
        inner = slice(cols.start - left, cols.stop - left)
        if self.waves:
            return _linear(samples, self.integrals)[wanted.start : wanted.stop, inner]
        return _fitted(samples, self.integrals, wanted)[:, inner]

    def values(self, coefficients: np.ndarray) -> np.ndarray:
        """Return the spline's values at its samples, float32; its planes where they are its values.

        Parameters
        ----------
        coefficients : ndarray (M, rows, cols)
            As `spline_coefficients` returned them.
        """
        from scipy.ndimage import correlate1d

        found = coefficients.astype(np.float64)
        for axis in (1, 2):
            found = correlate1d(found, VALUES, axis=axis, mode="mirror")
        # They differ by the coefficients' rounding, unless a highlight kept the spline from them.
        same = np.isclose(found, self.planes, rtol=1e-5, atol=0)
        return np.where(same, self.planes, found).astype(np.float32)


def _reach(weights: np.ndarray) -> int:
    """Return how far the steps of the non-negative fit reach, samples."""
    return 2 * FIT_STEPS * (len(weights) // 2)


def _faded(integrals: bool) -> int:
    """Return how many samples off REST of a sample is left in the coefficients."""
    return math.ceil(math.log(REST) / math.log(POLES[integrals]))


def _linear(samples: np.ndarray, integrals: bool) -> np.ndarray:
    """Return the spline coefficients of one plane that give its samples, in float64."""
    from scipy.ndimage import spline_filter

    return _undone(samples) if integrals else spline_filter(samples, order=3, mode="mirror")


def _fitted(samples: np.ndarray, integrals: bool, wanted: range) -> np.ndarray:
    """Return the wanted rows of the non-negative spline coefficients of one plane, in float64."""
    weights = INTEGRALS if integrals else VALUES
    linear = _linear(samples, integrals)
    least = FLOOR * samples
    wrong = (linear < least).any(axis=1)
    fit = np.maximum(linear, least, out=linear)
    if not wrong.any():
        return fit[wanted.start : wanted.stop]
    # Mirrored once, as far as the steps reach: they need no borders then.
    reach = _reach(weights)
    start, samples = (np.pad(part, reach, "reflect") for part in (fit, samples))
    spare = np.empty((3, STRIP_ROWS + 2 * reach, start.shape[1]))
    for first in wanted[::STRIP_ROWS]:
        last = min(first + STRIP_ROWS, wanted.stop)
        # Where the linear solution stands, its samples are met, and the steps change nothing.
        if wrong[max(first - reach, 0) : last + reach].any():
            strip = slice(first, last + 2 * reach)
            fit[first:last] = _stepped(start[strip].copy(), samples[strip], weights, spare)
    return fit[wanted.start : wanted.stop]


def _stepped(
    fit: np.ndarray, samples: np.ndarray, weights: np.ndarray, spare: np.ndarray
) -> np.ndarray:
    """Return what the steps of the non-negative fit make of all but the outer samples.

    Parameters
    ----------
    fit, samples : ndarray (rows, cols)
        The first is overwritten.
    weights : ndarray
        Weights of coefficients in samples, VALUES or INTEGRALS.
    spare : ndarray (3, at least rows, cols)
        To work in.

    Returns
    -------
    ndarray (rows - 2 reach, cols - 2 reach)
    """
    half = len(weights) // 2
    inner = np.s_[half:-half, half:-half]

    def at_samples(coefficients: np.ndarray, place: np.ndarray) -> np.ndarray:
        rows = _summed(coefficients, weights, spare[0])
        return _summed(rows.T, weights, place.T).T

    for _ in range(FIT_STEPS):
        ratio = at_samples(fit, spare[1])
        # A sum is 0 only where the samples are.
        np.divide(samples[inner], np.maximum(ratio, TINY, out=ratio), out=ratio)
        fit, samples = fit[inner][inner], samples[inner][inner]
        fit *= at_samples(ratio, spare[2])  # one is too large by what the other is too small by
    return fit


def _summed(values: np.ndarray, weights: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return weighted sums of lines and their neighbours, those that have all of them, in `place`.

    As if the outermost weight were 1.
    """
    half = len(weights) // 2
    count = len(values) - 2 * half
    total = place[:count, : values.shape[1]]
    np.multiply(values[half : half + count], weights[half] / weights[half + 1], out=total)
    for k in range(1, half + 1):
        total += values[half - k : half - k + count]
        total += values[half + k : half + k + count]
        if k < half:
            total *= weights[half + k] / weights[half + k + 1]
    return total


@dataclass(frozen=True, eq=False)
class Raster:
    """Coefficient planes (M, rows, cols), float32, of a scene's spectra; none negative.

    ``whole``: bright outliers are samples like others; for what blurs them far beyond a sample.
    ``waves``: the spline through them may have negative coefficients, and samples be negative by
    what a spline has less of a wave than its samples: a non-negative fit took up to 7 % of one of
    4 samples a period from it.
    ``half_um``: half the width and height that it covers, whatever the sensor's; ``half_efl``: the
    same in focal lengths, before a lens is known.
    """

    planes: np.ndarray
    whole: bool = False
    half_um: tuple[float, float] | None = None
    half_efl: tuple[float, float] | None = None
    waves: bool = False

    @functools.cached_property
    def split(self) -> Split:
        """The planes without their bright outliers, and these."""
        if self.whole:
            none = np.zeros(0, int)
            return Split(self.planes, none, none, np.zeros((0, len(self.planes))), math.inf)
        return split_outliers(self.planes)

    def pitch_um(self, half_width_um: float, half_height_um: float) -> float:
        """Return the distance between samples where the raster covers the sensor."""
        _, rows, cols = self.planes.shape
        width_um, height_um = self.half_um or (half_width_um, half_height_um)
        return 2 * max(width_um / cols, height_um / rows)

    def placed(
        self, half_width_um: float, half_height_um: float, min_pitch_um: float
    ) -> PlacedRaster:
        """Return the raster scaled to cover the sensor, centred, no finer than `min_pitch_um`.

        Parameters
        ----------
        half_width_um, half_height_um : float
            Half the size of the sensor's rectangle. What overhangs it in one direction is kept.
        min_pitch_um : float
            A finer raster is resampled to this pitch or slightly above, as the spline of that pitch
            that is nearest to it (least squares, Unser 1999, eq. 24): it passes 0.9998 at half the
            new Nyquist frequency, 0.5 at it, and 0.02 of what lies at 1.5 times it. At most the
            sensor's width.
        """
        _, rows, cols = self.planes.shape
        pitch = self.pitch_um(half_width_um, half_height_um)
        width, height = cols * pitch, rows * pitch
        split, planes = self.split, self.split.planes
        centre = (np.stack([split.cols, split.rows], axis=1) + 0.5) * pitch
        highlights = Highlights(centre - (width / 2, height / 2), pitch, split.excess)
        note = f"{cols} x {rows} samples at {pitch:.4g} um"
        if pitch < min_pitch_um * (1 - ROUNDING):
            # One pitch in both directions, that of a whole number of samples across. Down, the
            # outer rows may hang over the raster's border, which is continued.
            new_cols = max(1, int(width / min_pitch_um))
            pitch = width / new_cols
            new_rows = math.ceil(height / pitch - ROUNDING)
            height = new_rows * pitch
            planes = _reduced(planes, (new_rows, new_cols), pitch * cols / width)
            note += f", low-passed to {new_cols} x {new_rows} at {pitch:.4g} um"
        if len(highlights):
            note += f"; {len(highlights)} samples brighter than {split.limit:.4g} held as squares"
        return PlacedRaster(
            planes,
            pitch,
            -width / 2,
            -height / 2,
            note,
            integrals=planes is not split.planes,
            highlights=highlights,
            waves=self.waves,
        )


def _undone(samples: np.ndarray) -> np.ndarray:
    """Return the coefficients (rows, cols) whose INTEGRALS are the samples, mirrored beyond."""
    from scipy.fft import dct, idct, next_fast_len

    # Mirrored a second time beyond what reaches the samples, where transforms are fast: those of
    # 1500 and 4056 samples take 7 and 9 times as long as those of 1501 and 4097.
    sizes = [next_fast_len(size - 1 + _faded(True), real=True) + 1 for size in samples.shape]
    more = [(0, size - given) for size, given in zip(sizes, samples.shape, strict=True)]
    result = np.pad(samples, more, "reflect")
    for axis, size in enumerate(sizes):
        # Mirrored about the first and last, a line's spectrum is its cosine transform.
        turn = np.pi * np.arange(size) / (size - 1)
        gain = INTEGRALS[3] + 2 * np.cos(np.outer(turn, (1, 2, 3))) @ INTEGRALS[4:]
        spectrum = dct(result, 1, axis=axis)
        spectrum /= np.expand_dims(gain, 1 - axis)
        result = idct(spectrum, 1, axis=axis, overwrite_x=True)
    rows, cols = samples.shape
    return result[:rows, :cols]


def _reduced(planes: np.ndarray, shape: tuple[int, int], step: float) -> np.ndarray:
    """Return planes resampled about their centre to `shape`, new samples `step` old ones apart."""
    down = _spline_weights(planes.shape[1], shape[0], step)
    across = _spline_weights(planes.shape[2], shape[1], step)
    sharp = (_sharpened(plane) for plane in planes)
    return np.stack([(across @ (down @ plane).T).T for plane in sharp]).astype(np.float32)


def _sharpened(plane: np.ndarray) -> np.ndarray:
    """Return a plane whose cells, taken as even, blur to the samples: see `SHARPEN`.

    Light moves between neighbours, but never more than MOST_MOVED of the darker one: none is lost,
    and nothing becomes negative beside a highlight.
    """
    result = plane.astype(np.float64)
    for axis in (0, 1):
        along = np.moveaxis(result, axis, 0)
        # Over the side between samples i and i + 1, towards i + 1: odd differences about it.
        moved = sum(
            factor * (-1) ** k * np.diff(np.pad(along, ((k, k), (0, 0)), "edge"), 2 * k + 1, axis=0)
            for k, factor in enumerate(SHARPEN)
        )
        most = MOST_MOVED * np.minimum(along[:-1], along[1:])
        moved = np.clip(moved, -most, most)
        along[:-1] -= moved
        along[1:] += moved
    return result


def _spline_weights(old: int, new: int, step: float) -> csr_array:
    """Return a sparse matrix (new, old): integrals of a cubic B-spline over each old sample's cell.

    The border cells reach to infinity, so that each row sums to 1.
    """
    from scipy.interpolate import BSpline
    from scipy.sparse import csr_array

    whole = BSpline.basis_element([-2, -1, 0, 1, 2]).antiderivative()
    centres = old / 2 + step * (np.arange(new) + 0.5 - new / 2)
    first = np.floor(centres - 2 * step).astype(int)
    taps = np.arange(int(4 * step) + 3)
    cells = first[:, None] + taps
    lower = (cells - centres[:, None]) / step
    below, above = (whole(np.clip(edge, -2, 2)) for edge in (lower, lower + 1 / step))
    rows = np.broadcast_to(np.arange(new)[:, None], cells.shape)
    cells = np.clip(cells, 0, old - 1)  # duplicates add up
    return csr_array(((above - below).ravel(), (rows.ravel(), cells.ravel())), shape=(new, old))

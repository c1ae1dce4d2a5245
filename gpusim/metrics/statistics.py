"""Mean, temporal and spatial variance of repeated frames, one frame at a time.

The sites of a colour filter array are kept apart, each as the image of its own photosites: what
differs between the colours is neither noise nor non-uniformity.

Row, column and pixel parts of a variance are those of an analysis of variance of the two crossed
random factors row and column (H. Scheffe, The Analysis of Variance, 1959, chapter 7): without
bias, and each mean square with a chi-square law of its own, which gives the uncertainties. EMVA
Standard 1288, release 4.0 Linear, splits the spatial variance into the same parts from the
variances of the row and column means; the two differ by terms of 1/rows and 1/cols.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

GAUSSIAN_KURTOSIS = 3.0


@dataclass(frozen=True)
class Parts:
    """A variance by its parts, and the squared standard uncertainty of each.

    Attributes
    ----------
    total, pixel, row, column : float
        Variances, DN^2; the total is the sum of the others. A part may come out negative where
        there is none.
    total_u2, pixel_u2, row_u2, column_u2 : float
        Variances of these variances, DN^4.
    """

    total: float
    pixel: float
    row: float
    column: float
    total_u2: float
    pixel_u2: float
    row_u2: float
    column_u2: float

    def scaled(self, factor: float) -> Parts:
        """Return the parts of a signal whose variance is `factor` times as large."""
        return self._map(lambda name, value: value * factor ** (2 if name.endswith("_u2") else 1))

    def minus(self, other: Parts) -> Parts:
        """Return the difference of two independent variances, part by part."""
        return self._map(
            lambda name, value: (
                value + getattr(other, name)
                if name.endswith("_u2")
                else value - getattr(other, name)
            )
        )

    def _map(self, function) -> Parts:
        return Parts(
            **{one.name: function(one.name, getattr(self, one.name)) for one in fields(self)}
        )


def split(image: np.ndarray) -> Parts:
    """Split the variance of an image into row, column and pixel parts.

    Parameters
    ----------
    image : ndarray, shape (rows, cols)
        At least two of each.

    Returns
    -------
    Parts
        In the square of the image's unit. The uncertainty of the pixel part counts with the
        kurtosis that the image has; those of the row and column means are nearly normal.
    """
    rows, cols = image.shape
    mean = image.mean()
    of_rows, of_cols = image.mean(axis=1) - mean, image.mean(axis=0) - mean
    rest = image - mean
    rest -= of_rows[:, None]
    rest -= of_cols
    rest *= rest
    freedom = (rows - 1) * (cols - 1)
    square = float(rest.sum()) / freedom
    about = float(rest.mean())  # less than `square`: rows and columns have taken their part
    kurtosis = float(np.vdot(rest, rest)) / rest.size / about**2 if about else GAUSSIAN_KURTOSIS
    row_square = cols * float(of_rows @ of_rows) / (rows - 1)
    col_square = rows * float(of_cols @ of_cols) / (cols - 1)
    square_u2 = square**2 * max(kurtosis - 1, 0.0) / freedom
    row_square_u2 = 2 * row_square**2 / (rows - 1)
    col_square_u2 = 2 * col_square**2 / (cols - 1)
    share = 1 - 1 / rows - 1 / cols
    return Parts(
        total=row_square / cols + col_square / rows + share * square,
        pixel=square,
        row=(row_square - square) / cols,
        column=(col_square - square) / rows,
        total_u2=row_square_u2 / cols**2 + col_square_u2 / rows**2 + share**2 * square_u2,
        pixel_u2=square_u2,
        row_u2=(row_square_u2 + square_u2) / cols**2,
        column_u2=(col_square_u2 + square_u2) / rows**2,
    )


def pooled(parts: Sequence[Parts]) -> Parts:
    """Return the mean of variances: of the photosites of a channel, or of pairs of frames.

    The pixels of two sites are independent of each other; their rows and columns may be the same
    ones, and count as if they were.
    """
    count = len(parts)
    means = {name: float(np.mean([getattr(one, name) for one in parts])) for name in _VALUES}
    for name in _VALUES:
        of_all = [getattr(one, f"{name}_u2") for one in parts]
        means[f"{name}_u2"] = float(np.mean(np.sqrt(of_all)) ** 2)
    means["pixel_u2"] = sum(one.pixel_u2 for one in parts) / count**2
    shared = means["row_u2"] + means["column_u2"]
    means["total_u2"] = min(means["total_u2"], means["pixel_u2"] + shared)
    return Parts(**means)


_VALUES = ("total", "pixel", "row", "column")


@dataclass(frozen=True)
class SiteStatistics:
    """The photosites of one site of the filter pattern under one light.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of such photosites.
    frames : int
    mean : float
        Over pixels and frames, DN.
    temporal : Parts
        Noise of one frame, from differences of pairs of frames, in which the fixed pattern cancels.
    average : ndarray (rows, cols), float64, or None
        Average of all frames, DN. That of a pair is not kept, because it has too much noise in it.
    zero_share : float
        Share of the pixels that are 0 DN.
    covariance, covariance_u2 : float or None
        Covariance of the pixels' mean and their temporal variance, DN^3, and its squared standard
        uncertainty; only with more than two frames.
    """

    shape: tuple[int, int]
    frames: int
    mean: float
    temporal: Parts
    average: np.ndarray | None
    zero_share: float
    covariance: float | None
    covariance_u2: float | None

    @property
    def spatial(self) -> Parts:
        """Variance of the fixed pattern: of the average less what the temporal noise left in it.

        EMVA Standard 1288, release 3.1, section 8.1: s_y^2 = s_y.measured^2 - sigma_y.stack^2 / L.
        """
        return split(self.average).minus(self.temporal.scaled(1 / self.frames))


@dataclass(frozen=True)
class Level:
    """What one light and exposure time gave.

    Attributes
    ----------
    exposure_s : float
    photons : float
        Mean number per pixel during the exposure; 0 in the dark.
    wavelength_nm : float or None
        Wavelength of the light; None in the dark, or where it is not known.
    sites : tuple of SiteStatistics
        One for each site of the filter pattern, row by row.
    """

    exposure_s: float
    photons: float
    wavelength_nm: float | None
    sites: tuple[SiteStatistics, ...]

    def mean_and_variance(self, sites: Sequence[int]) -> tuple[float, float, float, float]:
        """Return mean and temporal variance over some sites, each with its squared uncertainty.

        DN, DN^2; DN^2, DN^4.
        """
        taken = [self.sites[number] for number in sites]
        temporal = pooled([site.temporal for site in taken])
        (rows, cols), frames = taken[0].shape, taken[0].frames
        # Sites may lie in the same rows and columns, whose noise they then share.
        mean_u2 = (
            max(temporal.pixel, 0.0) / (rows * cols * len(taken))
            + max(temporal.row, 0.0) / rows
            + max(temporal.column, 0.0) / cols
        ) / frames
        return (
            float(np.mean([site.mean for site in taken])),
            mean_u2,
            temporal.total,
            temporal.total_u2,
        )


class Accumulator:
    """Takes the frames of one light one by one; holds a sum and the last frame alone.

    Parameters
    ----------
    period : (int, int)
        Rows and columns of the filter pattern; frames begin on a whole one.
    """

    def __init__(self, period: tuple[int, int]) -> None:
        self.period = period
        self.frames = 0
        self._sum: np.ndarray | None = None
        self._square: np.ndarray | None = None
        self._last: np.ndarray | None = None
        self._temporal: list[list[Parts]] = [[] for _ in range(period[0] * period[1])]
        self._zeros = np.zeros(period[0] * period[1])

    def add(self, frame: np.ndarray) -> None:
        """Add a frame: (rows, cols), digital numbers."""
        values = frame.astype(np.float64)
        if self._sum is None:
            self._sum, self._square = np.zeros_like(values), np.zeros_like(values)
        self._sum += values
        self._square += values**2
        self.frames += 1
        self._zeros += [np.mean(one == 0) for one in self._sites(frame)]
        if self.frames % 2:
            self._last = values
        else:  # disjoint pairs, so that their variances are independent
            for found, one in zip(self._temporal, self._sites(values - self._last), strict=True):
                found.append(split(one).scaled(1 / 2))
            self._last = None

    def _sites(self, frame: np.ndarray) -> list[np.ndarray]:
        py, px = self.period
        return [frame[row::py, col::px] for row in range(py) for col in range(px)]

    def sites(self) -> tuple[SiteStatistics, ...]:
        """Return what was found, site by site, row by row; of two frames or more."""
        found = []
        each = self._temporal, self._sites(self._sum), self._sites(self._square), self._zeros
        for pairs, image, squares, zeros in zip(*each, strict=True):
            average = image / self.frames
            temporal = _mean_of_pairs(pairs)
            several, covariance, covariance_u2 = self.frames > 2, None, None
            if several:
                variance = (squares - image * average) / (self.frames - 1)
                products = (average - average.mean()) * (variance - variance.mean())
                covariance = float(products.mean())
                covariance_u2 = float(products.var() / products.size)
            found.append(
                SiteStatistics(
                    shape=average.shape,
                    frames=self.frames,
                    mean=float(average.mean()),
                    temporal=temporal,
                    average=average if several else None,
                    zero_share=zeros / self.frames,
                    covariance=covariance,
                    covariance_u2=covariance_u2,
                )
            )
        return tuple(found)


def _mean_of_pairs(pairs: Sequence[Parts]) -> Parts:
    """Return the mean of the variances of independent pairs."""
    count = len(pairs)
    return Parts(
        **{
            one.name: sum(getattr(pair, one.name) for pair in pairs)
            / (count**2 if one.name.endswith("_u2") else count)
            for one in fields(Parts)
        }
    )

"""All colours at every photosite, of any filter array."""

from __future__ import annotations

import numpy as np


def planes(signal: np.ndarray, pattern: tuple[str, ...], colours: str) -> np.ndarray:
    """Return a plane for each colour: its photosites, interpolated.

    Each pixel is the mean of the photosites around it, by a tent as wide as the filter pattern on
    either side; a photosite keeps its own colour's value. For a 2 x 2 pattern that is bilinear
    interpolation.

    Parameters
    ----------
    signal : ndarray (rows, cols)
    pattern : tuple of str
        Rows of letters, from the first pixel.
    colours : str
        The letters that are wanted.

    Returns
    -------
    ndarray (colours, rows, cols), float32
    """
    sites = sites_of(pattern, signal.shape)
    reach = max(len(pattern), len(pattern[0]))
    found = np.empty((len(colours), *signal.shape), np.float32)
    for plane, colour in zip(found, colours, strict=True):
        own = sites == colour
        plane[:] = np.where(own, signal, spread(signal, own, reach))
    return found


def spread(signal: np.ndarray, own: np.ndarray, reach: int) -> np.ndarray:
    """Return at each pixel the mean of some pixels by a tent that is 0 from `reach` off on."""
    from scipy.ndimage import convolve1d

    tent = reach - np.abs(np.arange(1 - reach, reach)).astype(np.float32)
    sums = []
    for part in (np.where(own, signal, 0).astype(np.float32), own.astype(np.float32)):
        for axis in (0, 1):
            part = convolve1d(part, tent, axis=axis, mode="constant")
        sums.append(part)
    return sums[0] / np.maximum(sums[1], np.float32(1e-6))


def sites_of(pattern: tuple[str, ...], shape: tuple[int, int]) -> np.ndarray:
    """Return the letter of each photosite: (rows, cols)."""
    sites = np.array([list(row) for row in pattern])
    rows, cols = (np.arange(n) % period for n, period in zip(shape, sites.shape, strict=True))
    return sites[np.ix_(rows, cols)]

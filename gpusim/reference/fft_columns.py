"""Column transforms, products with the node kernels and sums, by the definitions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def fft_columns(
    spectra: np.ndarray,
    kernels: Sequence[np.ndarray],
    *,
    first_s: float,
    step_s: float,
    sites: Sequence[tuple[int, int, int]],
    stride: int,
) -> np.ndarray:
    """Sum the four nodes' and all planes' products, and invert in y at the photosites.

    Parameters
    ----------
    spectra : ndarray (J, B, T), complex
        Row spectra as `gpusim.reference.fft_rows.fft_rows` returns them.
    kernels : four ndarrays (T/2+1, J, C, T), complex
        Channel kernels [kx, plane, channel, ky] of the nodes (left, upper), (right, upper), (left,
        lower), (right, lower).
    first_s, step_s : float
        Position between the upper node (0) and the lower node (1): of row 0, and per row.
    sites : sequence of (channel, o_x, o_y)
        Colour channel of each CFA site and its offset in samples.
    stride : int
        Samples D from a photosite to the next of the same site.

    Returns
    -------
    ndarray (S, T/2+1, T/D), complex128
    """
    spectra = np.asarray(spectra, np.complex128)
    _, block, length = spectra.shape
    half = length // 2 + 1
    mirrored = np.roll(spectra[:, :, ::-1], 1, axis=2)  # index (T - k) mod T
    sides = (
        ((spectra + mirrored.conj()) / 2)[:, :, :half],
        ((spectra - mirrored.conj()) / 2j)[:, :, :half],
    )
    y = np.arange(block)
    s = first_s + step_s * y
    frequencies = np.arange(length)
    forward = np.exp(-2j * np.pi * np.outer(frequencies, y) / length)
    total = 0.0
    for weight, pair in ((1.0 - s, kernels[:2]), (s, kernels[2:])):
        for side, kernel in zip(sides, pair, strict=True):
            transformed = np.einsum("ky,jyx->xjk", forward * weight, side)
            total = total + np.einsum(
                "xjk,xjck->cxk", transformed, np.asarray(kernel, np.complex128)
            )
    m = np.arange(length // stride)
    kx = np.arange(half)[:, None]
    planes = []
    for channel, o_x, o_y in sites:
        inverse = np.exp(2j * np.pi * np.outer(frequencies, stride * m + o_y) / length)
        planes.append((total[channel] * np.exp(2j * np.pi * kx * o_x / length)) @ inverse)
    return np.stack(planes)

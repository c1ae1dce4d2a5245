"""Forward transform of the rows of a source block weighted with maps, by the definition."""

from __future__ import annotations

import numpy as np


def modes(
    planes: np.ndarray,
    maps: np.ndarray,
    first: tuple[float, float],
    step: tuple[float, float],
    length: int,
) -> np.ndarray:
    """Transform every row of a block, times each map; two real lines make a complex one.

    Parameters
    ----------
    planes : ndarray (J, BY, BX)
        Coefficient planes of one source block.
    maps : ndarray (R, ny, nx)
        Weights of the modes at nodes, bilinear between them.
    first, step : (float, float)
        Position among the nodes in x and in y: of the block's first sample, and per sample.
    length : int
        Transform length T; the rows are padded with zeros.

    Returns
    -------
    ndarray (ceil(J R / 2), BY, T), complex128
        Lines in the order plane 0 map 0, plane 0 map 1, ...; each the transform of an even line
        plus i times that of the next, if there is one.
    """
    planes, maps = np.asarray(planes, np.float64), np.asarray(maps, np.float64)
    hats = []
    for count, f, h, nodes in zip(planes.shape[:0:-1], first, step, maps.shape[:0:-1], strict=True):
        position = f + h * np.arange(count)
        hats.append(np.maximum(0, 1 - np.abs(position[:, None] - np.arange(nodes))))
    weights = np.einsum("yv,rvu,xu->ryx", hats[1], maps, hats[0])
    lines = (planes[:, None] * weights).reshape(-1, *planes.shape[1:])
    if len(lines) % 2:
        lines = np.append(lines, np.zeros_like(lines[:1]), axis=0)
    basis = np.exp(-2j * np.pi * np.outer(np.arange(planes.shape[2]), np.arange(length)) / length)
    return (lines[::2] + 1j * lines[1::2]) @ basis

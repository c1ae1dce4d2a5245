"""Error models: what each knob of the optics costs in an edge response."""

from __future__ import annotations

from itertools import product

import numpy as np

from gpusim.optics.kernels import (
    BAND_EDGE,
    FieldKernels,
    core_window,
    distances_um,
    sampled_kernels,
)
from gpusim.sensor.aperture import transfer_along
from gpusim.sensor.sensor import Sensor

# What least-squares nodes gain over interpolation between samples: see
# gpusim.optics.kernels.node_kernels.
NODE_GAIN = 2.45
SMALLEST_CELL = 16  # sim samples: twice as far apart as nodes must be (gpusim.plan.layout)


def edge_integral(frequency: np.ndarray, spectrum: np.ndarray) -> float:
    """Bound an edge response by its transfer function: 2 int |H(f)| / (2 pi f) df."""
    return float(2 * np.trapezoid(np.abs(spectrum) / (2 * np.pi * frequency), frequency))


def cut_error(
    images: np.ndarray, bank_pitch_um: float, coarse_pitch_um: float, sensor: Sensor, cut_um: float
) -> float:
    """Predict the error of an edge response when the PSF's tail beyond a cut goes to a coarse grid.

    What the coarse grid loses of the tail: its spectrum along both axes from the end of the coarse
    band on, through the pixel aperture, for the first plane of the fields given.
    """
    n = images.shape[-1]
    tail = 1 - core_window(distances_um(n, bank_pitch_um), cut_um)
    frequency = np.fft.rfftfreq(n, bank_pitch_um)
    lost = frequency > BAND_EDGE * 0.5 / coarse_pitch_um
    worst = 0.0
    for image in images[:, 0].reshape(-1, n, n):
        for axis in (0, 1):
            aperture = transfer_along(sensor.response_um, frequency, axis)
            spectrum = np.fft.rfft(np.fft.ifftshift((image * tail).sum(axis=axis))) * aperture
            worst = max(worst, edge_integral(frequency[lost], spectrum[lost]) / abs(image.sum()))
    return worst


def node_error(
    kernels: FieldKernels,
    pitch_um: float,
    reach_um: float,
    half_um: tuple[float, float],
    spacing_um: float,
    edges: bool = True,
) -> float:
    """Predict the error of an edge response that bilinear interpolation between PSF nodes causes.

    Where a scene has no edges, that of the kernels' sums: of the response far from an edge.

    Compares the kernel at the middle of a cell with the mean of its four corners, on the axis, at
    half field and in the corner of the sensor (in each of the quadrants that differ), as far as
    `reach_um`; the root of the mean square over these, relative to what the kernel holds, in the
    worst of the channels. How the quantum efficiency goes with the place is in the kernels.
    """
    half_size = int(np.ceil(reach_um / pitch_um))
    squares: list[list[float]] = [[] for _ in range(kernels.splines.shape[2])]
    for fraction, signs in product((0.0, 0.5, 1.0), kernels.places.quadrants):
        x, y = (
            sign * max(fraction * half - spacing_um / 2, 0.0)
            for sign, half in zip(signs, half_um, strict=True)
        )
        shifts = (-spacing_um / 2, spacing_um / 2)
        corners = [
            sampled_kernels(kernels, x + dx, y + dy, pitch_um, half_size, 1)[0]
            for dx in shifts
            for dy in shifts
        ]
        middles = sampled_kernels(kernels, x, y, pitch_um, half_size, 1)[0]
        for of_channel, kernel, mean in zip(squares, middles, sum(corners) / 4, strict=True):
            for axis in (0, 1):
                # A halo's level may hold nothing so near to the chief ray.
                response = np.cumsum((mean - kernel).sum(axis=axis)) / (kernel.sum() or 1.0)
                of_channel.append(np.abs(response if edges else response[-1]).max() ** 2)
    return max(float(np.sqrt(np.mean(one))) for one in squares) / NODE_GAIN


def cells_within(
    kernels: FieldKernels,
    pitch_um: float,
    reach_um: float,
    half_um: tuple[float, float],
    allowed: float,
    beyond_um: float,
    edges: bool = True,
) -> tuple[tuple[int, int], float]:
    """Return the fewest cells between PSF nodes that keep an error, and the error they leave.

    The cells cover the sensor and what its pixels see `beyond_um` around it. Where that is more
    than the sensor itself, they are no larger than half of it, so that a node lies where it is.
    """
    # Linear interpolation's error goes with the spacing squared.
    trial_um = half_um[1] / 4
    trial = node_error(kernels, pitch_um, reach_um, half_um, trial_um, edges)
    spacing_um = trial_um * np.sqrt(allowed / max(trial, 1e-12))
    if beyond_um > half_um[1]:
        spacing_um = min(spacing_um, max(half_um[1], SMALLEST_CELL * pitch_um))
    sides = [2 * (half + beyond_um) for half in half_um]
    cells = tuple(max(int(np.ceil(side / spacing_um)), 1) for side in sides)
    widest = max(side / count for side, count in zip(sides, cells, strict=True))
    return cells, trial * (widest / trial_um) ** 2

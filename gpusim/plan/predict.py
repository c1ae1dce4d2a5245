"""Error models: what each knob of the optics costs in an edge response."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from scipy.ndimage import uniform_filter1d

from gpusim.optics.kernels import (
    BAND_EDGE,
    FieldKernels,
    core_window,
    distances_um,
    sharpened,
)
from gpusim.optics.sampling import node_kernels, sampled_kernels
from gpusim.psf.places import Blends
from gpusim.sensor.aperture import transfer_along
from gpusim.sensor.sensor import Sensor

# Places along the sides of a quarter of a cell at which nodes are compared with what is there, and
# their weights: of the Gauss-Legendre rule with three places, exact where kernels are parabolas.
PLACES = {0.5 - math.sqrt(0.15): 5 / 9, 0.5: 4 / 9}
POWERS = 2.0, 4.0  # of the spacing, between which errors go
LOOKS = 1  # at the spacing that the power leads to
SAME = 0.05  # of the logarithm of two spacings: too near to each other to tell a power
EVEN = 128  # places over the sensor at which even scenes are looked at
AROUND = np.moveaxis(np.indices((3, 3)), 0, -1) - 1  # steps (3, 3, 2) to a place and those about it
PLASTIC = 1.3247179572447460  # the real root of x^3 = x + 1
# Sim samples around the kernels: room for the pixel's aperture, half a sample to its centre, and
# the ringing of the band's end.
GUARD = 8
SMALLEST_CELL = 16  # sim samples: twice as far apart as nodes must be (gpusim.plan.blocks)


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
    *,
    edge: Edge | None = None,
) -> float:
    """Predict the error of an edge response that bilinear interpolation between PSF nodes causes.

    Compares what the nodes around a cell make of its `PLACES` with the kernels there, on the axis,
    at half field and in the corner of the sensor (in each of the quadrants that differ), as far as
    `reach_um`; the root of the mean square over these, in the worst of the channels. How the
    quantum efficiency goes with the place is in the kernels.

    Parameters
    ----------
    edge : Edge, optional
        The error is that of pixels beside it, relative to their own light. Without, it is the
        largest of the response, relative to what the kernel holds: for a tail, which is little of
        the light around it.
    """
    half_size = int(np.ceil(reach_um / pitch_um))
    squares: list[list[float]] = [[] for _ in range(kernels.splines.shape[2])]
    for fraction, signs in product((0.0, 0.5, 1.0), kernels.places.quadrants):
        first = [
            sign * max(fraction * half - spacing_um / 2, 0.0) - spacing_um / 2
            for sign, half in zip(signs, half_um, strict=True)
        ]

        @cache
        def at(u: float, v: float, first: list[float] = first) -> np.ndarray:
            x, y = first[0] + u * spacing_um, first[1] + v * spacing_um
            found = sampled_kernels(kernels, x, y, pitch_um, half_size, planes=1)[0]
            return sharpened(found) if kernels.ringing else found

        corners = [
            node_kernels(lambda dx, dy, i=i, j=j: at(i + dx, j + dy))
            for j in (0, 1)
            for i in (0, 1)
        ]
        for (u, of_u), (v, of_v) in product(PLACES.items(), repeat=2):
            shares = (1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v
            made = sum(share * one for share, one in zip(shares, corners, strict=True))
            for of_channel, kernel, mean in zip(squares, at(u, v), made, strict=True):
                for axis in (0, 1):
                    # A halo's level may hold nothing so near to the chief ray.
                    light = kernel.sum() or 1.0
                    off = np.cumsum((mean - kernel).sum(axis=axis)) / light
                    whole = np.cumsum(kernel.sum(axis=axis)) / light
                    square = np.abs(off).max() ** 2 if edge is None else edge.square(off, whole)
                    of_channel.append(of_u * of_v * square)
    places = 2 * 3 * len(kernels.places.quadrants)  # of which each has weights of 1 in all
    return max(float(np.sqrt(np.sum(one) / places)) for one in squares)


@dataclass(frozen=True)
class Edge:
    """A straight edge, whose pixels an error is relative to.

    Attributes
    ----------
    contrast : float
        Bright over dark.
    pixel : int
        Side of a pixel, sim samples.
    """

    contrast: float
    pixel: int

    def square(self, off: np.ndarray, whole: np.ndarray) -> float:
        """Return the mean square within a pixel of the edge, of the worse of both ways round.

        Parameters
        ----------
        off, whole : ndarray (n,)
            Error of the edge's response, and the response, from 0 to 1.
        """
        error, light = (uniform_filter1d(one, self.pixel, mode="nearest") for one in (off, whole))
        middle = int(np.abs(light - 0.5).argmin())
        near = slice(max(middle - self.pixel, 0), middle + self.pixel + 1)
        step = 1 - 1 / self.contrast
        seen = (1 / self.contrast + step * one[near] for one in (light, 1 - light))
        # A kernel that rings may undershoot the dark side; what is there is no less than that.
        least = 0.5 / self.contrast
        return max(
            float(np.mean((step * error[near] / np.maximum(one, least)) ** 2)) for one in seen
        )


def even_error(
    kernels: FieldKernels,
    half_um: tuple[float, float],
    sides_um: tuple[float, float],
    cells: tuple[int, int],
) -> float:
    """Return the error of an even scene that interpolation between PSF nodes causes: the RMS.

    What kernels H(t; s) of sources s bring to a point of an even scene follows from their moments
    over t, m0, m1 and m2:

        integral H(x - s; s) ds = m0 - div m1 + div div m2 / 2.

    The engine has these as its nodes have them (`gpusim.optics.sampling.node_kernels`), and
    straight lines between: m0 errs with the square of the cells, the slope of m1 with the cells
    themselves, and m2 is not curved within a cell. For kernels wider than a cell m0 alone is
    compared: moments say little of these. At EVEN places over the sensor.

    Parameters
    ----------
    kernels : FieldKernels
        Kernels of the first plane.
    half_um : (float, float)
        Half the sensor's sides.
    sides_um, cells : (float, float), (int, int)
        What the cells cover, and how many they are.
    """
    of_fields = _moments(kernels)
    step = np.array(sides_um) / cells
    if kernels.splines.shape[-1] * kernels.pitch_um > step.min():
        of_fields[:, 1:] = 0.0
    first = -np.array(sides_um) / 2

    def at(points_um: np.ndarray) -> np.ndarray:
        """Return moments (..., 6, C) at points (..., 2)."""
        blends = kernels.places.blends(*points_um.reshape(-1, 2).T)
        return _turned(of_fields, blends).reshape(*points_um.shape[:-1], 6, -1)

    # Additive recurrence with powers of the plastic number (Roberts 2018): spread evenly, and in
    # step with no number of cells.
    places = (np.arange(1, EVEN + 1)[:, None] / PLASTIC ** np.array([1, 2])) % 1.0
    places = (2 * places - 1) * half_um
    true = _shown(at(places[:, None, None] + AROUND * step / 8), step / 8)
    low = np.floor((places - first) / step)
    # Two nodes both ways, and those around them.
    nodes = at(first + step * (low[:, None, None] + np.moveaxis(np.indices((4, 4)), 0, -1) - 1))
    nodes = node_kernels(lambda dx, dy: nodes[:, 1 + dx : 3 + dx, 1 + dy : 3 + dy])
    within = ((places - first) / step - low)[:, None, None] + AROUND / 8
    x, y = np.moveaxis(within, -1, 0)[..., None, None]
    # The plane through the cell's corners goes on beyond it: slopes are those at the place.
    corners = nodes[:, None, None]
    rows = [(1 - x) * corners[..., 0, j, :, :] + x * corners[..., 1, j, :, :] for j in (0, 1)]
    made = _shown((1 - y) * rows[0] + y * rows[1], step / 8)
    # A halo's level may hold nothing at a place.
    squares = np.square((made - true) / np.where(true != 0, true, np.inf))
    return float(np.sqrt(squares.mean(axis=0).max()))


def _shown(around: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Return the light (P, C) of an even scene from moments (P, 3, 3, 6, C), x first, so far apart.

    The differences are those of the middle.
    """
    middle = around[:, 1, 1]
    shown = middle[:, 0]
    sides = (around[:, 2, 1], around[:, 0, 1]), (around[:, 1, 2], around[:, 1, 0])
    for axis, (more, less) in enumerate(sides):
        shown = shown - (more - less)[:, 1 + axis] / (2 * way[axis])
        shown = shown + (more - 2 * middle + less)[:, 3 + axis] / (2 * way[axis] ** 2)
    mixed = around[:, 2, 2] - around[:, 2, 0] - around[:, 0, 2] + around[:, 0, 0]
    return shown + mixed[:, 5] / (4 * way[0] * way[1])


def _moments(kernels: FieldKernels) -> np.ndarray:
    """Return moments (F, 6, C) of the first plane's kernels, in the frame of their PSFs.

    The six are those of 1, x, y, x^2, y^2 and x y, um from the chief ray.
    """
    images = kernels.splines[:, 0]
    n = images.shape[-1]
    at = (np.arange(n) - n // 2) * kernels.pitch_um
    squared = at**2
    if kernels.ringing:
        # What rings has no moments, but a spectrum: that of the PSFs, wherever the band is whole.
        # Its slope and curvature are those between 0 and the first frequency.
        turn = 2 * np.pi / (n * kernels.pitch_um)
        at, squared = np.sin(turn * at) / turn, 2 * (1 - np.cos(turn * at)) / turn**2
    along_x, along_y = images.sum(axis=-2, dtype=float), images.sum(axis=-1, dtype=float)
    mixed = np.einsum("fcyx,y,x->fc", images, at, at, optimize=True)
    parts = [along_x.sum(axis=-1), along_x @ at, along_y @ at, along_x @ squared, along_y @ squared]
    return np.stack([*parts, mixed], axis=1)


def _turned(of_fields: np.ndarray, blends: Blends) -> np.ndarray:
    """Return moments (P, 6, C) at points, along the sensor's x and y."""
    moments = np.einsum("pk,pkmc->mpc", blends.weights, of_fields[blends.fields], optimize=True)
    one, x, y, xx, yy, xy = moments
    c, s = blends.cos[:, None], blends.sin[:, None]
    turned = [
        one,
        c * x - s * y,
        s * x + c * y,
        c * c * xx + s * s * yy - 2 * c * s * xy,
        s * s * xx + c * c * yy + 2 * c * s * xy,
        c * s * (xx - yy) + (c * c - s * s) * xy,
    ]
    return np.stack(turned, axis=1)


def cells_within(
    kernels: FieldKernels,
    pitch_um: float,
    reach_um: float,
    half_um: tuple[float, float],
    allowed: float,
    *,
    beyond_um: float,
    edge: Edge | bool | None = None,
) -> tuple[tuple[int, int], float]:
    """Return the fewest cells between PSF nodes that keep an error, and the error they leave.

    The cells cover the sensor and what its pixels see `beyond_um` around it. Where that is more
    than the sensor itself, they are no larger than half of it, so that a node lies where it is.
    ``edge``: see `node_error`; False: the scene has no edges, and the error is that of an even
    scene.
    """
    sides = tuple(2 * (half + beyond_um) for half in half_um)
    least_um = SMALLEST_CELL * pitch_um
    most_um = max(half_um[1], least_um) if beyond_um > half_um[1] else max(sides)
    if edge is False:
        return _even_cells(kernels, half_um, sides, allowed, most_um=most_um, least_um=least_um)
    # Errors go with a power of the spacing: about 2 where PSFs change slowly, 4 at best.
    spacing_um = known_um = half_um[1] / 4
    error = node_error(kernels, pitch_um, reach_um, half_um, known_um, edge=edge)
    power = POWERS[0]
    for _ in range(LOOKS):
        spacing_um = known_um * (allowed / max(error, 1e-12)) ** (1 / power)
        spacing_um = float(np.clip(spacing_um, least_um, most_um))
        found = node_error(kernels, pitch_um, reach_um, half_um, spacing_um, edge=edge)
        if min(found, error) > 0 and abs(np.log(spacing_um / known_um)) > SAME:
            power = np.log(found / error) / np.log(spacing_um / known_um)
            power = float(np.clip(power, *POWERS))
        known_um, error = spacing_um, found
    spacing_um = known_um * (allowed / max(error, 1e-12)) ** (1 / power)
    spacing_um = min(spacing_um, most_um)
    # An even number, so that a node lies on the axis, about which PSFs turn.
    cells = tuple(_even(side / spacing_um) for side in sides)
    widest = max(side / count for side, count in zip(sides, cells, strict=True))
    return cells, error * (widest / known_um) ** power


def _even(count: float) -> int:
    return 1 if count <= 1 else 2 * math.ceil(count / 2)


def _even_cells(
    kernels: FieldKernels,
    half_um: tuple[float, float],
    sides: tuple[float, float],
    allowed: float,
    *,
    most_um: float,
    least_um: float,
) -> tuple[tuple[int, int], float]:
    """Return the fewest cells that keep the error of an even scene, and that."""
    spacing_um = most_um
    while True:
        cells = tuple(max(int(np.ceil(side / spacing_um)), 1) for side in sides)
        error = even_error(kernels, half_um, sides, cells)
        if error <= allowed or spacing_um <= least_um / 2:
            return cells, error
        # No more than a quarter of what it was, for wide cells do not tell how sums curve.
        spacing_um = max(spacing_um * np.clip(np.sqrt(allowed / error), 0.25, 0.9), least_um / 2)

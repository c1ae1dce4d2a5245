"""The boundary diffraction wave: the light that a pupil's rim throws.

The pupil's rim diffracts: each element of it, of length dl with the normal n, throws light both
ways along n. To first order in the shear of the pupil against itself the OTF is (Goodman,
Introduction to Fourier Optics, sec. 6.3, for small frequencies nu)

    H(nu) = 1/S integral exp(-2 pi i nu x(p)) dp - lambda/(2 S) contour |nu n| exp(-2 pi i nu x) dl,

p the direction cosines, S the pupil's area, x(p) = -grad W where the ray of p lands. The first term
is the spot diagram. The transform of the second, -|nu n| -> 1/(2 pi^2 t^2) along n, is

    lambda / (4 pi^2 S t^2) dl dt    at the distance t from x, on both sides:

the boundary diffraction wave (Rubinowicz 1917; Born and Wolf, sec. 8.9) without its fringes, which
go as fast as lambda N. A round pupil at f-number N so has 2 lambda N / (pi^2 r) of its light
beyond r. The share of H that is left out goes with the shear cubed: it changes the core.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from gpusim.psf.wave import Wave

# Diffracted light is summed up in polar bins, so many around and of this width in ln r: against
# twice as many each way the levels change by 1e-3 of their light.
AROUND = 256
LOG_STEP = 0.04
ELEMENTS = 64  # rim elements whose light is binned at once
# Rim elements turn by at most so much, and a corner is where the rim turns by more than CORNER from
# one node of the pupil's grid to the next: no light is thrown into the angle between its sides.
TURN = 2 * np.pi / 512
CORNER = np.radians(20)
# What sampling the rim loses is worked out from this part of the window's radius on, in bins of
# this width in ln r: nearer it is less than 1e-3 of the rim's light.
LOST_FROM, LOST_LOG_STEP = 16.0, 0.1


def rim_lost(
    wave: Wave, wavelength_um: float, size: int, pitch_um: float, period_um: tuple[float, float]
) -> np.ndarray:
    """Return what a window lacks because the pupil was sampled in cells: (size, size), shares.

    A cell on the rim counts with its share inside, a mean over the cell. At a distance t from where
    its ray lands, along the normal n, that multiplies the light which the rim throws by
    sinc^2(t n_1 / P_1) sinc^2(t n_2 / P_2): P is the period after which the sampled pupil's image
    repeats. Copies that fold in from there are left out, 0.4 % of the rim's light at P / 4.

    Parameters
    ----------
    wave : Wave
    wavelength_um : float
    size, pitch_um : int, float
        The window's; its rows lie along alpha.
    period_um : (float, float)
        Along alpha and beta.
    """
    landing, normals, strength = throws(wave, wave.slope, wavelength_um)
    radius_um = size / 2 * pitch_um
    edges = np.arange(np.log(radius_um / LOST_FROM), np.log(2 * radius_um), LOST_LOG_STEP)
    ends = np.exp(np.arange(edges[0] - 1.0, edges[-1] + LOST_LOG_STEP / 2, LOST_LOG_STEP))
    t = np.sqrt(ends[:-1] * ends[1:])
    along = [np.sinc(t * way[:, None] / side) for way, side in zip(normals, period_um, strict=True)]
    light = strength[:, None] * (1 / ends[:-1] - 1 / ends[1:]) * (1 - (along[0] * along[1]) ** 2)
    polar = _binned(landing, normals, light, t, edges)[1:-1]
    even = even_density(_both(polar) if wave.mirrored else polar, edges)
    line = (np.arange(size) - size // 2) * pitch_um
    # The rows beyond the middle of a mirrored pupil's image repeat those before it.
    rows = line[: size // 2 + 1] if wave.mirrored else line
    x, y = np.broadcast_arrays(rows[:, None], line)
    r = np.maximum(np.hypot(x, y), 0.5 * pitch_um)
    turn = np.arctan2(x, y) % (2 * np.pi) * ((even.shape[1] - 1) / (2 * np.pi))
    at = [(np.log(r) - edges[0]) / LOST_LOG_STEP - 0.5, turn]
    found = pitch_um**2 / r**3 * map_coordinates(even, at, order=1, mode="nearest")
    lost = np.where(r > radius_um / LOST_FROM, found, 0.0)
    return np.concatenate([lost, lost[size // 2 - 1 : 0 : -1]]) if wave.mirrored else lost


def throws(
    wave: Wave, slope: list[np.ndarray], wavelength_um: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where rays of rim elements land (2, M), normals (2, M) and strengths (M,), um.

    Elements of a mirrored pupil are those of the half where alpha is positive.
    """
    cell = (wave.alpha[1] - wave.alpha[0]) * (wave.beta[1] - wave.beta[0])
    area = float(wave.light.sum()) * cell
    points, normals, lengths = _rim(wave)
    if wave.mirrored:
        middle = np.abs(points[0]) < 1e-9 * (wave.alpha[1] - wave.alpha[0])
        half = (points[0] > 0) | middle
        lengths = np.where(middle, lengths / 2, lengths)[half]
        points, normals = points[:, half], normals[:, half]
    at = [
        (point - axis[0]) / (axis[1] - axis[0])
        for point, axis in zip(points, (wave.alpha, wave.beta), strict=True)
    ]
    landing = np.stack([-map_coordinates(one, at, order=1) for one in slope])
    strength = lengths * wavelength_um / (4 * np.pi**2 * area)
    if np.ndim(wave.passed):
        strength = strength * map_coordinates(wave.passed, at, order=1)
    return landing, normals, strength


def even_density(polar: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return density times r^3, which is nearly even, of polar bins; the first column twice."""
    middle = np.exp((edges[:-1] + edges[1:]) / 2)
    area = np.diff(edges)[:, None] * (2 * np.pi / polar.shape[1])
    even = polar * middle[:, None] / area
    return np.concatenate([even, even[:, :1]], axis=1)


def _both(polar: np.ndarray) -> np.ndarray:
    """Return the polar bins (R, A) of a half and of its mirror image, where alpha is negative."""
    return polar + polar[:, -np.arange(polar.shape[1])]


def diffracted(
    wave: Wave, landing: np.ndarray, normals: np.ndarray, strength: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    """Return the light that rim elements throw: in polar bins, beyond them, and what each throws.

    Parameters
    ----------
    wave : Wave
    landing, normals : ndarray (2, M)
        Where the ray of each element lands, um; along alpha and beta.
    strength : ndarray (M,)
        lambda dl / (4 pi^2 S), um.
    edges : ndarray (R + 1,)
        Edges of the bins, in ln r.

    Returns
    -------
    polar : ndarray (R, AROUND)
    beyond : float
    taken : ndarray (M,)
        What is thrown farther than some um is missing where the rays land: the transform of |nu n|
        is 0 in sum.
    """
    # Distances t along the normals, from well within the first bin on.
    ends = np.exp(np.arange(edges[0] - 1.0, edges[-1] + LOG_STEP / 2, LOG_STEP))
    t = np.sqrt(ends[:-1] * ends[1:])
    share = 1 / ends[:-1] - 1 / ends[1:]
    polar = _binned(landing, normals, strength[:, None] * share, t, edges)
    beyond = float(polar[-1].sum() + 2 * strength.sum() / ends[-1])
    if wave.mirrored:
        polar, beyond = _both(polar), 2 * beyond
    return polar[1:-1], beyond, 2 * strength / ends[0]


def _binned(
    landing: np.ndarray, normals: np.ndarray, light: np.ndarray, t: np.ndarray, edges: np.ndarray
) -> np.ndarray:
    """Return light (M, T) at distances t both ways along normals, in polar bins (R + 2, AROUND).

    The first row holds what lies nearer than all edges, the last what lies beyond.
    """
    count, step = len(edges) - 1, edges[1] - edges[0]
    polar = np.zeros((count + 2) * AROUND)
    # In float32, which places light to 1e-4 of a bin, and in parts that the caches hold: a third
    # of the time.
    both = np.concatenate([t, -t]).astype(np.float32)
    for first in range(0, len(light), ELEMENTS):
        part = slice(first, first + ELEMENTS)
        x, y = (
            (start[part, None] + way[part, None] * both).astype(np.float32)
            for start, way in zip(landing, normals, strict=True)
        )
        thrown = np.concatenate([light[part], light[part]], axis=1).astype(np.float32)
        far = np.maximum(x * x + y * y, np.float32(1e-18))
        place = np.log(far) * np.float32(0.5 / step) - np.float32(edges[0] / step + 0.5)
        turn = np.arctan2(x, y) * np.float32(AROUND / (2 * np.pi))
        row, col = np.floor(place), np.floor(turn)
        lower, right = place - row, turn - col
        rows, cols = row.astype(np.intp), col.astype(np.intp)
        for down in (0, 1):
            bins = (np.clip(rows + down, -1, count) + 1) * AROUND
            kept = thrown * (lower if down else 1 - lower)
            for across in (0, 1):
                weight = kept * (right if across else 1 - right)
                number = bins + (cols + across) % AROUND
                polar += np.bincount(number.ravel(), weight.ravel(), len(polar))
    return polar.reshape(count + 2, AROUND)


def _rim(wave: Wave) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return middles (2, M), unit normals (2, M) and lengths (M,) of the rim's elements."""
    from contourpy import contour_generator

    lines = contour_generator(wave.beta, wave.alpha, wave.reach).lines(1.0)
    middles, normals, lengths = [], [], []
    for line in lines:
        steps = np.diff(line[:, ::-1], axis=0)
        size = np.hypot(*steps.T)
        there = size > 1e-3 * size.max(initial=0.0)
        starts, steps, size = line[:-1, ::-1][there], steps[there], size[there]
        if len(size) < 3:
            continue
        angle = np.arctan2(steps[:, 0], steps[:, 1])
        closed = np.allclose(line[0], line[-1])
        before, after = (_turned(angle, way, closed) for way in (1, -1))
        # Within a segment the normal turns evenly, from half of one bend to half of the next.
        low, high = angle - before / 2, angle + after / 2
        parts = np.maximum(np.ceil(np.abs(high - low) / TURN).astype(int), 1)
        of = np.repeat(np.arange(len(parts)), parts)
        at = (np.arange(len(of)) - (np.cumsum(parts) - parts)[of] + 0.5) / parts[of]
        turned = low[of] + (high - low)[of] * at
        middles.append(starts[of] + steps[of] * at[:, None])
        normals.append(np.stack([np.cos(turned), -np.sin(turned)], axis=-1))
        lengths.append((size / parts)[of])
    if not middles:
        return np.zeros((2, 0)), np.zeros((2, 0)), np.zeros(0)
    return np.concatenate(middles).T, np.concatenate(normals).T, np.concatenate(lengths)


def _turned(angle: np.ndarray, way: int, closed: bool) -> np.ndarray:
    """Return by how much a line bends between each segment and the one before or after it.

    0 at a corner, and at the end of an open line.
    """
    bend = (way * (angle - np.roll(angle, way)) + np.pi) % (2 * np.pi) - np.pi
    bend[np.abs(bend) > CORNER] = 0.0
    if not closed:
        bend[0 if way == 1 else -1] = 0.0
    return bend

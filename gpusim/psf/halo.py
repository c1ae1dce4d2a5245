"""The light that lands far from its chief ray: beyond the window of a bank's PSFs.

Two kinds of light go there. The pupil's rim diffracts: each element of it, of length dl with the
normal n, throws light both ways along n. To first order in the shear of the pupil against itself
the OTF is (Goodman, Introduction to Fourier Optics, sec. 6.3, for small frequencies nu)

    H(nu) = 1/S integral exp(-2 pi i nu x(p)) dp - lambda/(2 S) contour |nu n| exp(-2 pi i nu x) dl,

p the direction cosines, S the pupil's area, x(p) = -grad W where the ray of p lands. The first term
is the spot diagram. The transform of the second, -|nu n| -> 1/(2 pi^2 t^2) along n, is

    lambda / (4 pi^2 S t^2) dl dt    at the distance t from x, on both sides:

the boundary diffraction wave (Rubinowicz 1917; Born and Wolf, sec. 8.9) without its fringes, which
go as fast as lambda N. A round pupil at f-number N so has 2 lambda N / (pi^2 r) of its light
beyond r. The share of H that is left out goes with the shear cubed: it changes the core.

The light is put on levels of coarser and coarser samples, each wider than the one before; between
two levels it passes from one to the other over half the inner one's radius.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np
from scipy.ndimage import map_coordinates, maximum_filter

from gpusim.lens.wavefront import Pupil
from gpusim.parallel import each

AnyBank = TypeVar("AnyBank")  # Bank or PlaneBank

# The levels: samples across each, and its pitch over that of the level within it. Three of them
# reach 16 mm from the chief ray where the core's pitch is 0.5 um; at f/2.8 they miss 2e-5.
SIZE = 128
STEP = 8
LEVELS = 3
# A level's weight falls, as a raised cosine, from this fraction of its radius to its end. No other
# level takes over from the last one: it holds what it can.
FALLS_FROM = 0.5
LAST_FALLS_FROM = 0.875
# Diffracted light is summed up in polar bins, so many around and of this width in ln r: against
# twice as many each way the levels change by 1e-3 of their light.
AROUND = 256
LOG_STEP = 0.04
ELEMENTS = 64  # rim elements whose light is binned at once
# Rim elements turn by at most so much, and a corner is where the rim turns by more than CORNER from
# one node of the pupil's grid to the next: no light is thrown into the angle between its sides.
TURN = 2 * np.pi / 512
CORNER = np.radians(20)
MOST_SCALED = 5.0  # 1.5 is met in windows of 64 samples at f/2.8, 1.1 in those of 256
# What sampling the rim loses is worked out from this part of the window's radius on, in bins of
# this width in ln r: nearer it is less than 1e-3 of the rim's light.
LOST_FROM, LOST_LOG_STEP = 16.0, 0.1
FEW_RAYS = 1e-6  # of the light: fewer are not looked for


@dataclass(frozen=True)
class Wave:
    """A vignetted pupil and its wavefront on a grid of direction cosines, both halves.

    Attributes
    ----------
    alpha, beta : ndarray, shapes (A,) and (B,)
        Evenly spaced.
    opd_um : ndarray, shape (A, B)
        W.
    reach : ndarray, shape (A, B)
        Less than 1 within the pupil, 1 at its rim.
    light : ndarray, shape (A, B)
        What each cell passes: its share within the rim, times `passed`.
    passed : ndarray, shape (A, B), or float
        Light that enters and passes there, over that about the chief ray; 1 where it is even.
    mirrored : bool
        Whether alpha and -alpha are alike: one half is then worked out for both.
    rays_per_node : int
        Rays for each node of the grid, each way, where they land beyond a core.
    """

    alpha: np.ndarray
    beta: np.ndarray
    opd_um: np.ndarray
    reach: np.ndarray
    light: np.ndarray
    passed: np.ndarray | float = 1.0
    mirrored: bool = False
    rays_per_node: int = 6

    @property
    def slope(self) -> list[np.ndarray]:
        """The gradient of W, um, along alpha and beta: rays land at its negative."""
        return np.gradient(self.opd_um, self.alpha, self.beta, edge_order=2)

    def lands_beyond(self, radius_um: float) -> bool:
        """Return whether rays land farther from the chief ray than a radius."""
        far = self.light * (np.hypot(*self.slope) > radius_um)
        return bool(far.sum() > FEW_RAYS * self.light.sum())


def wave_of(pupil: Pupil, step: int = 1) -> Wave:
    """Return the wave in a pupil, of every `step`-th node each way, both halves."""
    thin = slice(None, None, step)

    def whole(values: np.ndarray) -> np.ndarray:
        both = np.concatenate([values[::-1], values]) if pupil.half else values
        return both[thin, thin]

    alpha = np.concatenate([-pupil.alpha[::-1], pupil.alpha]) if pupil.half else pupil.alpha
    return Wave(
        alpha=alpha[thin],
        beta=pupil.beta[thin],
        opd_um=whole(1e3 * pupil.opd_mm),
        reach=whole(pupil.reach),
        light=whole(pupil.light),
        passed=whole((pupil.apodised * pupil.entering) ** 2),
        mirrored=pupil.half,
    )


def pitches_um(core_pitch_um: float) -> np.ndarray:
    """Return the pitches (K,) of the levels around a core."""
    return core_pitch_um * float(STEP) ** np.arange(1, LEVELS + 1)


def fall(distance_um: np.ndarray, radius_um: float, start: float = FALLS_FROM) -> np.ndarray:
    """Return the weight of what lies within a level: 1, from a share of it on less, at the end 0.

    ``start``: that share of the radius.
    """
    share = np.clip((distance_um / radius_um - start) / (1 - start), 0, 1)
    return 0.5 * (1 + np.cos(np.pi * share))


def split(bank: AnyBank) -> tuple[AnyBank, ...]:
    """Return a bank as banks that add up to it, from the core outwards; without halo it alone.

    The core's PSFs fall to 0 towards the window's rim, where the first level takes over.
    """
    if bank.halo is None:
        return (bank,)
    alone = dict.fromkeys(("halo", "halo_pitch_um", "beyond_energy", "halo_misfit"))
    size = bank.psf.shape[-1]
    within = fall(distances_um(size, bank.pitch_um), size / 2 * bank.pitch_um)
    core = replace(bank, psf=bank.psf * within.astype(np.float32), **alone)
    return core, *(
        replace(bank, psf=psf, pitch_um=float(pitch), **alone)
        for psf, pitch in zip(bank.halo, bank.halo_pitch_um, strict=True)
    )


def distances_um(size: int, pitch_um: float) -> np.ndarray:
    """Return the distance of each sample of a window (size, size) from the chief ray."""
    line = (np.arange(size) - size // 2) * pitch_um
    return np.hypot(line, line[:, None])


def field_halo(
    wave: Callable[[int], Wave],
    wavelengths_nm: np.ndarray,
    core_pitch_um: float,
    core_radius_um: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the halo of one field.

    Where no ray lands beyond the core, it is diffracted light, nearly proportional to the
    wavelength: three lines are worked out, and a parabola leads through them.

    Parameters
    ----------
    wave : callable
        Returns the wavefront of a line.
    wavelengths_nm : ndarray (L,)
    core_pitch_um, core_radius_um : float

    Returns
    -------
    levels : ndarray of float32 (K, L, SIZE, SIZE)
    beyond : ndarray (L,)
        Share of the light beyond them.
    """
    lines, pitch = len(wavelengths_nm), pitches_um(core_pitch_um)
    used, basis = through_few(wavelengths_nm)
    waves = {line: wave(line) for line in used}
    if any(one.lands_beyond(FALLS_FROM * core_radius_um) for one in waves.values()):
        used, basis = range(lines), np.eye(lines)
        waves |= {line: wave(line) for line in used if line not in waves}
    found = {
        line: halo(one, 1e-3 * wavelengths_nm[line], core_radius_um, pitch)
        for line, one in waves.items()
    }
    levels = np.einsum("lf,fkyx->klyx", basis, np.stack([found[line][0] for line in used]))
    return levels.astype(np.float32), basis @ [found[line][1] for line in used]


def through_few(wavelengths_nm: np.ndarray) -> tuple[list[int], np.ndarray]:
    """Return lines (up to 3) to work diffracted light out at, and the parabola through them.

    It is nearly proportional to the wavelength.

    Returns
    -------
    few : list of int
    basis : ndarray (L, len(few))
        Lagrange's polynomials.
    """
    lines = len(wavelengths_nm)
    few = sorted({0, lines // 2, lines - 1})
    basis = np.ones((lines, len(few)))
    for place, line in enumerate(few):
        for other in few:
            if other != line:
                step = wavelengths_nm[line] - wavelengths_nm[other]
                basis[:, place] *= (wavelengths_nm - wavelengths_nm[other]) / step
    return few, basis


def whole_halo(
    fields: Sequence[tuple[np.ndarray, np.ndarray]], core_pitch_um: float, core: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the halo of a bank, by the names of its variables, scaled to what the core lacks.

    Parameters
    ----------
    fields : sequence of (levels, beyond)
        As `field_halo` returns them, F of them.
    core_pitch_um : float
    core : ndarray (F, L)
        Share of the light in the window that `fall` leaves to it.

    Returns
    -------
    dict
        ``halo`` (K, F, L, SIZE, SIZE), ``halo_pitch_um``, ``beyond_energy`` and ``halo_misfit``.
    """
    levels = np.stack([one for one, _ in fields], axis=1)
    beyond = np.stack([one for _, one in fields])
    held = levels.sum(axis=(0, 3, 4), dtype=float)
    wanted = 1 - beyond - core
    # Where the two disagree by more, the window is too small for its lens: what they lack is not
    # made up, but counts as light that is lost.
    factor = np.clip(wanted / np.maximum(held, FEW_RAYS), 1 / MOST_SCALED, MOST_SCALED)
    levels *= factor.astype(np.float32)[:, :, None, None]
    return {
        "halo": levels,
        "halo_pitch_um": pitches_um(core_pitch_um),
        "beyond_energy": beyond + np.abs(wanted - factor * held),
        "halo_misfit": held - wanted,
    }


def halo_of(
    wave: Callable[[int, int], Wave],
    wavelengths_nm: np.ndarray,
    core_pitch_um: float,
    core_radius_um: float,
    core: np.ndarray,
) -> dict[str, np.ndarray]:
    """Return what `whole_halo` does; ``wave`` returns the wavefront of a field and a line."""

    def one(field: int) -> tuple[np.ndarray, np.ndarray]:
        given = wavelengths_nm, core_pitch_um, core_radius_um
        return field_halo(lambda line: wave(field, line), *given)

    return whole_halo(each(one, range(len(core))), core_pitch_um, core)


def halo(
    wave: Wave, wavelength_um: float, core_radius_um: float, level_pitch_um: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the light beyond the core of one field and wavelength.

    Parameters
    ----------
    wave : Wave
    wavelength_um : float
    core_radius_um : float
        Radius at which the core's weight, `fall`, is 0.
    level_pitch_um : ndarray (K,)
        As `pitches_um` returns them.

    Returns
    -------
    levels : ndarray (K, SIZE, SIZE)
        Share of the light per sample; rows alpha, columns beta, sample j at (j - SIZE / 2) pitch
        from the chief ray's point.
    outside : float
        Share of the light beyond the last level.
    """
    radii = [core_radius_um, *(SIZE / 2 * level_pitch_um)]
    slope = wave.slope
    first = FALLS_FROM * core_radius_um / 2
    edges = np.log(first) + LOG_STEP * np.arange(
        int(np.ceil((np.log(1.5 * radii[-1]) - np.log(first)) / LOG_STEP)) + 1
    )
    landing, normals, strength = _throws(wave, slope, wavelength_um)
    polar, beyond, taken = _diffracted(wave, landing, normals, strength, edges)
    middle = np.exp(edges[:-1] + LOG_STEP / 2)
    rays, places = _far_rays(wave, slope, FALLS_FROM * core_radius_um)
    if len(rays):
        rays, places = np.append(rays, -taken), np.append(places, landing, axis=1)
        far = np.hypot(*places)
    even = _even(polar, edges)
    levels = np.zeros((len(level_pitch_um), SIZE, SIZE))
    ends = [FALLS_FROM] * (len(levels) - 1) + [LAST_FALLS_FROM]
    for level, pitch, inner, outer, end in zip(
        levels, level_pitch_um, radii[:-1], radii[1:], ends, strict=True
    ):
        used, at, weight = _places(float(pitch), float(inner), float(outer), end, float(edges[0]))
        level[used] = weight * map_coordinates(even, at, order=1, mode="nearest")
        if len(rays):
            # By their own distance: no ray is lost or counted twice between two levels.
            own = rays * (1 - fall(far, inner)) * fall(far, outer, end)
            there = own != 0
            at = places[:, there] / pitch + SIZE // 2
            level += _deposited(own[there], at, wave.mirrored)
    outside = beyond + float(polar.sum(axis=1) @ (1 - fall(middle, radii[-1], LAST_FALLS_FROM)))
    if len(rays):
        far_out = float(rays @ (1 - fall(far, radii[-1], LAST_FALLS_FROM)))
        outside += 2 * far_out if wave.mirrored else far_out
    return levels, outside


@lru_cache(maxsize=2 * LEVELS)
def _places(
    pitch_um: float, inner_um: float, outer_um: float, end: float, first: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where a level is lit, and how: all fields and lines of a bank ask for the same.

    Returns
    -------
    used : ndarray of bool (SIZE, SIZE)
    at : ndarray (2, U)
        Row and column among the polar bins, the first of which begins at ``first``, in ln r.
    weight : ndarray (U,)
        The level's own weight times what leads from density times r^3 to light.
    """
    line = (np.arange(SIZE) - SIZE // 2) * pitch_um
    distance = distances_um(SIZE, pitch_um)
    used = (distance > FALLS_FROM * inner_um) & (distance < outer_um)
    r = distance[used]
    turn = np.arctan2(*np.broadcast_arrays(line[:, None], line))[used] % (2 * np.pi)
    at = np.stack([(np.log(r) - first) / LOG_STEP - 0.5, turn / (2 * np.pi) * AROUND])
    weight = pitch_um**2 / r**3 * (1 - fall(r, inner_um)) * fall(r, outer_um, end)
    return used, at, weight


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
    landing, normals, strength = _throws(wave, wave.slope, wavelength_um)
    radius_um = size / 2 * pitch_um
    edges = np.arange(np.log(radius_um / LOST_FROM), np.log(2 * radius_um), LOST_LOG_STEP)
    ends = np.exp(np.arange(edges[0] - 1.0, edges[-1] + LOST_LOG_STEP / 2, LOST_LOG_STEP))
    t = np.sqrt(ends[:-1] * ends[1:])
    along = [np.sinc(t * way[:, None] / side) for way, side in zip(normals, period_um, strict=True)]
    light = strength[:, None] * (1 / ends[:-1] - 1 / ends[1:]) * (1 - (along[0] * along[1]) ** 2)
    polar = _binned(landing, normals, light, t, edges)[1:-1]
    even = _even(_both(polar) if wave.mirrored else polar, edges)
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


def _throws(
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


def _even(polar: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return density times r^3, which is nearly even, of polar bins; the first column twice."""
    middle = np.exp((edges[:-1] + edges[1:]) / 2)
    area = np.diff(edges)[:, None] * (2 * np.pi / polar.shape[1])
    even = polar * middle[:, None] / area
    return np.concatenate([even, even[:, :1]], axis=1)


def _both(polar: np.ndarray) -> np.ndarray:
    """Return the polar bins (R, A) of a half and of its mirror image, where alpha is negative."""
    return polar + polar[:, -np.arange(polar.shape[1])]


def _diffracted(
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


def _far_rays(
    wave: Wave, slope: list[np.ndarray], radius_um: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return shares (M,) of the light and landing points (2, M) of rays beyond a radius."""
    if not wave.lands_beyond(radius_um):
        return np.zeros(0), np.zeros((2, 0))
    first = wave.alpha.size // 2 if wave.mirrored else 0
    # A ray lies between nodes and lands between where these do: it is far where one of them is.
    near = [maximum_filter(one, 3, mode="constant") for one in (np.hypot(*slope), wave.light)]
    far = (near[0] > 0.8 * radius_um) & (near[1] > 0)
    rows, cols = np.nonzero(far[first:])
    rows += first
    # Straight lines: beyond the rim slopes run wild, and a spline of them all would ring inside.
    # Beyond the outer nodes there is no light.
    rays = wave.rays_per_node
    away = (np.arange(rays) + 0.5) / rays - 0.5
    nodes = np.stack([np.maximum(-away, 0), 1 - np.abs(away), np.maximum(away, 0)], axis=1)
    own = rows[:, None, None] + np.arange(3)[:, None], cols[:, None, None] + np.arange(3)
    light, *landing = (
        (nodes @ np.pad(one, 1)[own] @ nodes.T).ravel() for one in (wave.light, *slope)
    )
    landing = -np.stack(landing)
    there = (light > 0) & (np.hypot(*landing) > 0.8 * radius_um)
    return light[there] / (rays**2 * wave.light.sum()), landing[:, there]


def _deposited(light: np.ndarray, place: np.ndarray, mirrored: bool) -> np.ndarray:
    """Return light (M,) at places (2, M), in samples, shared out between the nearest four.

    ``mirrored``: as much lies at the mirror images, about the row SIZE / 2.
    """
    low = np.floor(place).astype(int)
    part = place - low
    rows = SIZE + 1  # the mirror image of the first row lies beyond the last
    grid = np.zeros(rows * SIZE)
    for down in (0, 1):
        for across in (0, 1):
            row, col = low[0] + down, low[1] + across
            inside = (row >= 0) & (row < rows) & (col >= 0) & (col < SIZE)
            weight = np.abs(1 - down - part[0]) * np.abs(1 - across - part[1]) * light
            grid += np.bincount((row * SIZE + col)[inside], weight[inside], rows * SIZE)
    found = grid.reshape(rows, SIZE)
    return (found + found[::-1] if mirrored else found)[:SIZE]

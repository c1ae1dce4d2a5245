"""A photograph's highlights on the image plane: squares, small enough for one PSF each."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from gpusim.psf.field_bank import FieldBank
from gpusim.psf.places import Heights
from gpusim.scene.highlights import Highlights
from gpusim.sensor.sensor import Sensor

STEP_UM = 1e-3  # of differences of the chief-ray map, which is known to 1e-9 um
NEWTON_STEPS = 30
FOUND_UM = 1e-4  # how near to an ideal point its real one leads
# Steps of the grid whose cells are bundles: one square each at the least, and what a float holds.
SMALLEST_STEP_UM, LARGEST_STEP_UM = 1e-3, 1e9


def real_points(bank: FieldBank, ideal_um: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where ideal points (N, 2) land, the map's slopes there, and which do, by Newton steps.

    Returns
    -------
    real_um : ndarray (N, 2)
    slopes : ndarray (N, 2, 2)
        d(real)/d(ideal).
    lit : ndarray (N,) of bool
    """

    def to_ideal(real: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u, v, inside = bank.ideal_points(*real.T)
        return np.stack([u, v], axis=1), inside

    def slopes_at(real: np.ndarray) -> np.ndarray:
        columns = [
            (to_ideal(real + d)[0] - to_ideal(real - d)[0]) / (2 * STEP_UM)
            for d in STEP_UM * np.eye(2)
        ]
        return np.linalg.pinv(np.stack(columns, axis=2))

    centre = np.array(bank.centre_um)
    off = ideal_um - centre
    # From the inner side of the circle's rim, beyond which the map of some banks has no slope.
    rim = 0.99 * bank.rectilinear_circle_um / np.maximum(np.hypot(*off.T), 1e-9)
    real = centre + off * np.minimum(rim, 1.0)[:, None]
    for _ in range(NEWTON_STEPS):
        lack = ideal_um - to_ideal(real)[0]
        if np.abs(lack).max(initial=0.0) < FOUND_UM**2:
            break
        real = real + np.einsum("nij,nj->ni", slopes_at(real), lack)
    found, inside = to_ideal(real)
    lit = inside & (np.abs(found - ideal_um).max(axis=1) < FOUND_UM)
    return real, slopes_at(real), lit


@dataclass(frozen=True, eq=False)
class Squares:
    """Highlights on the real image plane, cut up into squares that share one PSF each.

    Attributes
    ----------
    real_um : ndarray (N, 2)
        Centres; x, y from the axis.
    size_um : ndarray (N,)
        Sides on the ideal plane.
    slopes : ndarray (N, 2, 2)
        d(real)/d(ideal).
    light : ndarray (N, M)
        Coefficients of the scene's spectra times the area on the real plane, um^2.
    """

    real_um: np.ndarray
    size_um: np.ndarray
    slopes: np.ndarray
    light: np.ndarray


def largest_um(
    bank: FieldBank, change: float, real_um: np.ndarray, turns: bool = True
) -> np.ndarray:
    """Return the sides (N,) of squares across which so much of a PSF changes, at points (N, 2).

    By the PSFs of the fields around each, at the reference wavelength: half of the sum of their
    differences' sizes over how far they are apart; and of each PSF turned by a quarter of a turn,
    over the quarter of a circle. In a halo it changes twenty times as fast near the rim as half-way
    to it. For a lens without an axis the answer is that of the place where it changes fastest.
    ``turns``: False for PSFs that are seen each in its own frame.
    """

    def psf(number: int) -> np.ndarray:
        found = bank.field(number).psf[bank.reference].astype(np.float64)
        return found / found.sum()

    fields, places = bank.places(bank.image_circle_um)
    steps = {
        (one, other): np.abs(psf(fields[one]) - psf(fields[other])).sum() / 2 / apart_um
        for one, other, apart_um in places.neighbours
    }
    most = np.full(len(real_um), max(steps.values(), default=0.0))
    if isinstance(places, Heights):
        # At a field: its own turn, and the change to the fields next to it.
        rates = np.zeros(len(places.radius_um))
        for number, radius_um in enumerate(places.radius_um[1:] if turns else (), start=1):
            found = psf(fields[number])[1:, 1:]  # about the middle
            rates[number] = np.abs(found - np.rot90(found)).sum() / 2 / (np.pi / 2 * radius_um)
        for pair, step in steps.items():
            rates[list(pair)] = np.maximum(rates[list(pair)], step)
        before = np.searchsorted(places.radius_um, np.hypot(*real_um.T), "right") - 1
        after = np.minimum(before + 1, len(rates) - 1)
        most = np.maximum(rates[before], rates[after])
    return change / np.maximum(most, np.finfo(float).tiny)


def squares_on_sensor(
    bank: FieldBank,
    sensor: Sensor,
    highlights: Highlights,
    reach_um: float,
    *,
    change: float = math.inf,
    most_um: float = math.inf,
) -> Squares:
    """Place highlights on the real plane; those that no pixel sees are left out.

    They are cut up into squares across which at most the share `change` of a PSF changes, and that
    are `most_um` wide at most.
    """
    pitch = sensor.pixel_pitch_um
    cuts = np.ones(len(highlights), int)
    if change < math.inf:
        of_psf = largest_um(bank, change, real_points(bank, highlights.centre_um)[0])
        most = np.minimum(of_psf, most_um)
        cuts = np.maximum(np.ceil(highlights.size_um / most), 1).astype(int)
    ideal, size, excess = [], [], []
    for count in np.unique(cuts):
        own = np.flatnonzero(cuts == count)
        side = highlights.size_um / count
        line = (np.arange(count) - (count - 1) / 2) * side
        inner = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        ideal.append((highlights.centre_um[own, None] + inner).reshape(-1, 2))
        size.append(np.full(len(ideal[-1]), side))
        excess.append(np.repeat(highlights.excess[own], len(inner), axis=0))
    sizes = np.concatenate(size)
    real, slopes, lit = real_points(bank, np.concatenate(ideal))
    half = np.array([sensor.cols, sensor.rows]) * pitch / 2
    seen = lit & np.all(np.abs(real) < half + reach_um, axis=1)
    light = np.concatenate(excess) * (sizes**2 * np.abs(np.linalg.det(slopes)))[:, None]
    return Squares(real[seen], sizes[seen], slopes[seen], light[seen])


def bundled(
    bank: FieldBank, squares: Squares, change: float, turn: float
) -> tuple[np.ndarray, Squares]:
    """Gather squares that one kernel serves: of one size, and near to each other.

    Across a bundle at most the share `change` of a PSF changes. Behind a lens with an axis that is
    a PSF in its own frame, which depends on the height alone: a bundle is part of a ring, `turn`
    radians long, for aperture and square do not turn with the PSFs. The kernel is that of the
    middle of the light: what is too much on one side is too little on the other.

    Returns
    -------
    owner : ndarray (N,) of int
        Number of each square's bundle.
    bundles : Squares
        Place, size, slopes and light of each.
    """
    alike_um = largest_um(bank, change, squares.real_um, turns=False)
    # Squares reach beyond their centres. Steps of powers of two: neighbours have the same.
    room_um = np.clip(alike_um - squares.size_um, SMALLEST_STEP_UM, LARGEST_STEP_UM)
    step_um = np.exp2(np.floor(np.log2(room_um)))
    places = bank.places(bank.image_circle_um)[1]
    if isinstance(places, Heights):
        x, y = squares.real_um.T
        cells = [np.hypot(x, y) / step_um, np.arctan2(y, x) / turn]
    else:
        cells = [*(squares.real_um / step_um[:, None]).T]
    keys = np.column_stack([squares.size_um, step_um, *map(np.floor, cells)])
    _, first, owner = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    owner = owner.reshape(-1)  # NumPy 2.0 alone keeps an axis

    def total(values: np.ndarray) -> np.ndarray:
        found = np.zeros((len(first), *values.shape[1:]))
        np.add.at(found, owner, values)
        return found

    share = np.maximum(squares.light.sum(axis=1), np.finfo(float).tiny)
    share /= total(share)[owner]
    return owner, Squares(
        total(share[:, None] * squares.real_um),
        squares.size_um[first],
        total(share[:, None, None] * squares.slopes),
        total(squares.light),
    )


def of_few_spectra(light: np.ndarray, alike: float) -> tuple[np.ndarray, np.ndarray]:
    """Return spectra (R, M) of some highlights, and all light (N, M) as sums of them, (N, R).

    Lamps of a scene of 16 bands may have three colours: then there are tables of three spectra and
    not of sixteen. The spectra are those that differ most from the ones before them (a QR
    decomposition with column pivoting; Golub and Van Loan 2013, algorithm 5.4.1), so that tables
    hold no negative light. All of them come back as they are where no fewer will do.
    """
    total = light.sum(axis=1, keepdims=True)
    lit = np.flatnonzero(total[:, 0] > 0)
    if not len(lit):
        return np.eye(light.shape[1]), light
    colours = light[lit] / total[lit]
    lengths = np.linalg.norm(colours, axis=1)
    _, triangle, order = scipy.linalg.qr(colours.T, mode="economic", pivoting=True)
    rank = int(np.sum(np.abs(np.diag(triangle)) > alike * lengths.min()))
    if rank >= light.shape[1]:
        return np.eye(light.shape[1]), light
    few = colours[np.sort(order[:rank])]
    return few, np.linalg.lstsq(few.T, light.T, rcond=None)[0].T

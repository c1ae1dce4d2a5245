"""A bank over both directions of the field, for lenses that are not symmetric about an axis.

Elements may be decentred and tilted. Computed in float64 from the whole pupil, stored as NetCDF-4.
The chain renders with banks that are symmetric (``bank.py``); this one shows what tolerances do.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from gpusim.errors import UserError
from gpusim.lens.bank import (
    PITCH_UM,
    REFERENCE_NM,
    WAVELENGTHS_NM,
    load_dataset,
    pupil_amplitude,
    save_dataset,
)
from gpusim.lens.prescription import Prescription
from gpusim.lens.psf import folded_share, intensity
from gpusim.lens.system import System, build, first_order, transmission
from gpusim.lens.wavefront import OVERSIZE, pupils, sample_field

if TYPE_CHECKING:
    import xarray

SIDE = 7  # fields each way
SIZE = 128
# Nodes across the pupil grid. Against 1024 nodes, the double Gauss at f/2.8 over 14 deg changes by
# 1.9e-3 of the PSF's peak with 256 nodes.
PUPIL_NODES = 256

_FIELD = ("field_y", "field_x")
_LINES = (*_FIELD, "wavelength")
_VARIABLES = {
    "wavelengths_nm": (("wavelength",), "nm", "wavelength"),
    "field_x_deg": (("field_x",), "degree", "field angle along x"),
    "field_y_deg": (("field_y",), "degree", "field angle along y"),
    "chief_x_um": (_LINES, "um", "where the chief ray lands, x"),
    "chief_y_um": (_LINES, "um", "where the chief ray lands, y"),
    "psf": (
        (*_LINES, "y", "x"),
        "1",
        "share of the light per sample, sum 1; centred on the chief ray of its own wavelength; "
        "upright image",
    ),
    "relative_illumination": (
        _LINES,
        "1",
        "what the vignetted pupil passes, over that of field 0, 0: see projected_solid_angle_sr",
    ),
    "projected_solid_angle_sr": (
        ("wavelength",),
        "sr",
        "integral of d alpha d beta over the pupil of field 0, 0, times what an apodised stop "
        "passes",
    ),
    "transmission": (("wavelength",), "1", "product of the surfaces' transmittances on axis"),
    "outside_energy": (_LINES, "1", "share of the light outside the PSF window"),
    "folded_energy": (
        _LINES,
        "1",
        "share of rays so far out that the sampled pupil folds them back into the window",
    ),
    "fit_residual_waves": (
        _LINES,
        "1",
        "RMS difference of the fitted wavefront from the traced rays, in waves",
    ),
    "failed_rays": (_LINES, "1", "rays aimed within the stop that did not reach the image"),
}
_SCALARS = {
    "reference_nm": ("nm", "reference wavelength"),
    "efl_mm": ("mm", "paraxial focal length of the centred lens at the reference wavelength"),
    "f_number": ("1", "focal length over entrance pupil diameter, of the centred lens"),
    "pitch_um": ("um", "spacing of the PSF samples"),
}


@dataclass(frozen=True, eq=False)
class PlaneBank:
    """PSFs and chief rays of a lens over its field: Y by X fields, L wavelengths, n x n samples.

    A field (x, y) in degrees lies hypot(x, y) off the axis of the lens, in the direction of
    (x, y): that holds beyond 90 deg too.

    Attributes
    ----------
    wavelengths_nm : ndarray, shape (L,)
    field_x_deg, field_y_deg : ndarray, shapes (X,) and (Y,)
        Rising; each holds 0.
    chief_x_um, chief_y_um : ndarray, shape (Y, X, L)
    psf : ndarray of float32, shape (Y, X, L, n, n)
        Sum 1; rows y, columns x, sample j at (j - n / 2) pitch from its own chief ray.
    relative_illumination : ndarray, shape (Y, X, L)
        Projected solid angle over that of field (0, 0).
    projected_solid_angle_sr, transmission : ndarray, shape (L,)
        At field (0, 0), and on the axis.
    outside_energy, folded_energy, fit_residual_waves, failed_rays : ndarray, shape (Y, X, L)
    reference_nm, efl_mm, f_number, pitch_um : float
    provenance : dict of str to str
    """

    wavelengths_nm: np.ndarray
    field_x_deg: np.ndarray
    field_y_deg: np.ndarray
    chief_x_um: np.ndarray
    chief_y_um: np.ndarray
    psf: np.ndarray
    relative_illumination: np.ndarray
    projected_solid_angle_sr: np.ndarray
    transmission: np.ndarray
    outside_energy: np.ndarray
    folded_energy: np.ndarray
    fit_residual_waves: np.ndarray
    failed_rays: np.ndarray
    reference_nm: float
    efl_mm: float
    f_number: float
    pitch_um: float
    provenance: dict[str, str]

    @property
    def reference(self) -> int:
        """Index of the wavelength nearest to the reference."""
        return int(np.abs(self.wavelengths_nm - self.reference_nm).argmin())

    @property
    def middle(self) -> tuple[int, int]:
        """Row and column of the field on the axis."""
        return int(np.abs(self.field_y_deg).argmin()), int(np.abs(self.field_x_deg).argmin())

    def to_xarray(self) -> xarray.Dataset:
        """Return the bank as a dataset with units and meaning on every variable."""
        import xarray

        lens = f"{self.provenance['title']}; {self.provenance['history']}"
        texts = {"provenance": lens}
        data = {
            name: (dims, getattr(self, name), {"units": units, "long_name": meaning} | texts)
            for name, (dims, units, meaning) in _VARIABLES.items()
        } | {
            name: ((), getattr(self, name), {"units": units, "long_name": meaning} | texts)
            for name, (units, meaning) in _SCALARS.items()
        }
        size = self.psf.shape[-1]
        at = (np.arange(size) - size // 2) * self.pitch_um
        axes = {name: (name, at, {"units": "um"} | texts) for name in ("y", "x")}
        return xarray.Dataset(data, coords=axes, attrs=self.provenance)

    def save(self, path: str | Path) -> None:
        """Write the bank as NetCDF: under a temporary name first, so never half a file."""
        save_dataset(self.to_xarray(), path)

    @classmethod
    def load(cls, path: str | Path) -> PlaneBank:
        """Read a bank that ``save`` wrote.

        Raises
        ------
        OSError, ValueError, KeyError
            Where the file is not a whole bank.
        """
        return cls(**load_dataset(path, _VARIABLES, _SCALARS))


def holds_plane_bank(path: Path) -> bool:
    """Tell a bank over both directions of the field from one with an axis."""
    import h5py

    if path.suffix.lower() != ".nc":
        return False
    try:
        with h5py.File(path, "r") as file:
            return "field_x_deg" in file
    except OSError:
        return False


def load_plane_bank(path: Path) -> PlaneBank:
    """Read a saved bank over both directions of the field.

    Raises
    ------
    UserError
        Where the file is not a whole bank.
    """
    try:
        return PlaneBank.load(path)
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError) as error:
        raise UserError(
            f"not a whole bank: {' '.join(str(error).split())}",
            file=path,
            allowed="a NetCDF file as gpusim lens LENS --out bank.nc writes it",
        ) from error


def default_sides_deg(prescription: Prescription, count: int = SIDE) -> np.ndarray:
    """Return an odd number of angles, evenly spaced, so that the corners see the largest field."""
    half = np.linspace(0, prescription.max_field_deg / np.sqrt(2), (count + 1) // 2)
    return np.concatenate([-half[:0:-1], half])


def compute_plane_bank(
    prescription: Prescription,
    wavelengths_nm: np.ndarray | None = None,
    field_x_deg: np.ndarray | None = None,
    field_y_deg: np.ndarray | None = None,
    *,
    reference_nm: float = REFERENCE_NM,
    pitch_um: float = PITCH_UM,
    size: int = SIZE,
    progress: Callable[[int, int], None] | None = None,
) -> PlaneBank:
    """Compute the bank of a lens, symmetric or not, over both directions of the field.

    Parameters
    ----------
    prescription : Prescription
    wavelengths_nm : array_like, shape (L,), optional
        400 to 700 nm in steps of 25.
    field_x_deg, field_y_deg : array_like, optional
        Rising and holding 0; 7 each way within the lens's largest field.
    reference_nm : float
        Of the paraxial data.
    pitch_um, size : float, int
        PSF sampling: spacing, and samples across (even).
    progress : callable, optional
        Called with (fields done, fields in all).

    Raises
    ------
    UserError
        Where a glass has no data at a wavelength, a field lies beyond the lens or the pitch does
        not sample the PSF.
    """
    wavelengths = np.array(WAVELENGTHS_NM if wavelengths_nm is None else wavelengths_nm, float)
    x_deg, y_deg = (
        default_sides_deg(prescription) if one is None else np.array(one, float)
        for one in (field_x_deg, field_y_deg)
    )
    _check(prescription, x_deg, y_deg, size)
    system = build(prescription)
    fields = [(x, y) for y in y_deg for x in x_deg]
    rows = []
    # Fields in parallel, each on one BLAS thread: OpenBLAS's own threads wait by spinning.
    with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
        for row in pool.map(lambda f: _one_field(system, wavelengths, f, size, pitch_um), fields):
            rows.append(row)
            if progress is not None:
                progress(len(rows), len(fields))
    shape = (len(y_deg), len(x_deg))
    stacked = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    stacked = {name: array.reshape(*shape, *array.shape[1:]) for name, array in stacked.items()}
    solid_angle = stacked.pop("solid_angle")
    centre = solid_angle[np.flatnonzero(y_deg == 0)[0], np.flatnonzero(x_deg == 0)[0]]
    order = first_order(system.prescription, reference_nm)
    return PlaneBank(
        wavelengths_nm=wavelengths,
        field_x_deg=x_deg,
        field_y_deg=y_deg,
        relative_illumination=solid_angle / centre,
        projected_solid_angle_sr=centre,
        transmission=transmission(system.prescription, wavelengths),
        reference_nm=float(reference_nm),
        efl_mm=order.efl_mm,
        f_number=order.f_number,
        pitch_um=float(pitch_um),
        provenance={
            "title": prescription.title,
            "source": prescription.source,
            "history": "; ".join(system.prescription.history) or "as published",
            "focus": f"image plane {system.image_z_mm - system.geometry.vertex_z[-1]:.6f} mm "
            "behind the last vertex, found with every surface on the axis",
            "pupil": f"{pupil_amplitude(prescription)}, scalar Debye integral",
        },
        **stacked,
    )


def _one_field(
    system: System,
    wavelengths: np.ndarray,
    field_deg: tuple[float, float],
    size: int,
    pitch_um: float,
) -> dict[str, np.ndarray]:
    """All wavelengths of one field, by the names of the bank's variables."""
    theta, azimuth = np.radians(np.hypot(*field_deg)), np.arctan2(*field_deg)
    samples = sample_field(system, system.index(wavelengths), theta, azimuth)
    grids = pupils(samples, wavelengths, size * pitch_um, PUPIL_NODES)
    psf = np.empty((len(wavelengths), size, size), dtype=np.float32)
    outside, folded = np.zeros((2, len(wavelengths)))
    for w, (pupil, wavelength) in enumerate(zip(grids, wavelengths, strict=True)):
        width = max((2 if pupil.half else 1) * np.ptp(pupil.alpha), np.ptp(pupil.beta))
        if pitch_um > wavelength * 1e-3 / (2 * width) * OVERSIZE:
            raise UserError(
                f"the PSF pitch is too coarse for this aperture at {wavelength:g} nm",
                file=system.prescription.file,
                field="pitch_um",
                value=pitch_um,
                allowed=f"<= {wavelength * 1e-3 / (2 * width) * OVERSIZE:.3g}",
            )
        window, outside[w] = intensity(pupil, wavelength, size, pitch_um)
        folded[w] = folded_share(pupil, wavelength, size, pitch_um)
        psf[w] = window.T / window.sum()
    in_stop = samples.margin[-1] < 0
    return {
        "chief_x_um": 1e3 * samples.chief_x_mm,
        "chief_y_um": 1e3 * samples.chief_y_mm,
        "psf": psf,
        "solid_angle": np.array([g.projected_solid_angle_sr for g in grids]),
        "outside_energy": outside,
        "folded_energy": folded,
        "fit_residual_waves": np.array([g.fit_residual_mm for g in grids]) / (wavelengths * 1e-6),
        "failed_rays": (~samples.ok & in_stop).sum(axis=1).astype(np.int32),
    }


def _check(prescription: Prescription, x_deg: np.ndarray, y_deg: np.ndarray, size: int) -> None:
    """Refuse settings that make no bank."""
    for name, angles in (("field_x_deg", x_deg), ("field_y_deg", y_deg)):
        if not (0 in angles and (np.diff(angles) > 0).all()):
            raise UserError(
                "field angles must rise and hold 0",
                field=name,
                value=str(angles),
                allowed="rising, with 0",
            )
    farthest = max(np.hypot(x, y) for x in x_deg[[0, -1]] for y in y_deg[[0, -1]])
    if farthest > prescription.max_field_deg * (1 + 1e-12):
        raise UserError(
            "the field lies beyond the lens",
            file=prescription.file,
            field="field_x_deg, field_y_deg",
            value=f"{farthest:g}",
            allowed=f"0 to {prescription.max_field_deg:g} from the axis",
        )
    if size % 2:
        raise UserError("the PSF window must be even", field="size", value=size, allowed="even")

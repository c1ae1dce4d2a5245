"""Computing the bank of a lens without an axis, from the whole pupil."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu import default_device
from gpusim.lens.prescription import Prescription
from gpusim.lens.projection import RECTILINEAR
from gpusim.lens.system import System, build
from gpusim.parallel import each
from gpusim.psf.chief_rays import rays_on_rings
from gpusim.psf.halo import whole_halo
from gpusim.psf.plane_bank import PlaneBank
from gpusim.psf.plane_generator import PlaneGenerator, Pupils
from gpusim.psf.provenance import of_lens
from gpusim.psf.sampling import (
    REFERENCE_NM,
    WAVELENGTHS_NM,
    check_reference,
    default_pitch_um,
    default_sides_deg,
)
from gpusim.psf.store import from_cache
from gpusim.psf.transform import TRANSFORM

SIZE = 128
TOGETHER = 16  # fields whose pupils wait for the device: 7 MB each


def compute_plane_bank(
    prescription: Prescription,
    wavelengths_nm: np.ndarray | None = None,
    field_x_deg: np.ndarray | None = None,
    field_y_deg: np.ndarray | None = None,
    *,
    reference_nm: float = REFERENCE_NM,
    pitch_um: float | None = None,
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
        Rising and holding 0; 9 each way, from the lens's largest field to the other.
    reference_nm : float
        One of the wavelengths.
    pitch_um : float, optional
        Spacing of the PSF's samples (``sampling.default_pitch_um``).
    size : int
        Samples across, even, up to half of the transform.
    progress : callable, optional
        Called with (fields done, fields in all).

    Raises
    ------
    UserError
        Where a glass has no data at a wavelength, a field lies beyond the lens or does not pass
        it, the pitch does not sample the PSF, or distortion folds the image over.
    """
    wavelengths = np.array(WAVELENGTHS_NM if wavelengths_nm is None else wavelengths_nm, float)
    x_deg, y_deg = (
        default_sides_deg(prescription) if one is None else np.array(one, float)
        for one in (field_x_deg, field_y_deg)
    )
    _check(prescription, wavelengths, (x_deg, y_deg), reference_nm, size)
    if pitch_um is None:
        pitch_um = default_pitch_um(prescription, wavelengths)
    system = build(prescription)
    reach_deg = min(RECTILINEAR.end_deg, -x_deg[0], x_deg[-1], -y_deg[0], y_deg[-1])
    rays = rays_on_rings(system, reference_nm, min(reach_deg, prescription.max_field_deg))
    fields = [(x, y) for y in y_deg for x in x_deg]
    given = {"size": size, "pitch_um": pitch_um, "reference_nm": reference_nm}
    rows = _rows(PlaneGenerator(default_device(), system, wavelengths, **given), fields, progress)
    return plane_bank_of(
        system,
        wavelengths,
        (x_deg, y_deg),
        rows,
        rays,
        reference_nm=reference_nm,
        pitch_um=pitch_um,
    )


def _rows(
    generator: PlaneGenerator,
    fields: list[tuple[float, float]],
    progress: Callable[[int, int], None] | None,
) -> list[dict[str, np.ndarray]]:
    """Return what a generator makes of each field, in their order."""

    def on_host(field: tuple[float, float]) -> tuple[Pupils, dict[str, np.ndarray]]:
        pupils = generator.pupils(field)
        return pupils, generator.beside(pupils)

    rows = []
    try:
        for first in range(0, len(fields), TOGETHER):
            for laid in each(on_host, fields[first : first + TOGETHER]):
                rows.append(generator.row(*laid))
                if progress is not None:
                    progress(len(rows), len(fields))
    finally:
        generator.release()
    return rows


def plane_bank_of(
    system: System,
    wavelengths: np.ndarray,
    sides_deg: tuple[np.ndarray, np.ndarray],
    rows: list[dict[str, np.ndarray]],
    rays: dict[str, np.ndarray],
    *,
    reference_nm: float,
    pitch_um: float,
) -> PlaneBank:
    """Return the bank of fields that were traced.

    Parameters
    ----------
    system : System
    wavelengths : ndarray (L,)
    sides_deg : (ndarray (X,), ndarray (Y,))
        The grid's field angles. The illumination is relative to the field nearest to the axis.
    rows : list of dict
        What `gpusim.psf.plane_generator.PlaneGenerator.row` returns of each field, row after row.
    rays : dict
        Chief rays of the map, by the names of the bank's variables.
    reference_nm, pitch_um : float
    """
    x_deg, y_deg = sides_deg
    shape = (len(y_deg), len(x_deg))
    of_halo = whole_halo(
        [(row.pop("levels"), row.pop("beyond")) for row in rows],
        pitch_um,
        rows[0]["psf"].shape[-1] / 2 * pitch_um,
        np.stack([row.pop("core") for row in rows]),
    )
    pitches = of_halo.pop("halo_pitch_um")
    halo = of_halo.pop("halo")
    halo = halo.reshape(len(halo), *shape, *halo.shape[2:])
    of_halo = {name: one.reshape(*shape, -1) for name, one in of_halo.items()}
    stacked = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    stacked = {name: array.reshape(*shape, *array.shape[1:]) for name, array in stacked.items()}
    light_sr = stacked.pop("light_sr")
    centre = light_sr[np.abs(y_deg).argmin(), np.abs(x_deg).argmin()]
    facts = of_lens(system, wavelengths, reference_nm)
    facts["provenance"]["focus"] += ", found with every surface on the axis"
    return PlaneBank(
        field_x_deg=x_deg,
        field_y_deg=y_deg,
        relative_illumination=light_sr / centre,
        projected_solid_angle_sr=centre,
        pitch_um=float(pitch_um),
        halo=halo,
        halo_pitch_um=pitches,
        **facts,
        **of_halo,
        **rays,
        **stacked,
    )


def cached_plane_bank(prescription: Prescription, **settings: object) -> PlaneBank:
    """Return the plane bank of a lens from the disk cache, or compute and store it.

    Parameters
    ----------
    prescription : Prescription
    **settings
        As for ``compute_plane_bank``.
    """
    return from_cache(PlaneBank, compute_plane_bank, prescription, settings)


def _check(
    prescription: Prescription,
    wavelengths: np.ndarray,
    sides_deg: tuple[np.ndarray, np.ndarray],
    reference_nm: float,
    size: int,
) -> None:
    """Refuse settings that make no bank."""
    check_reference(reference_nm, wavelengths)
    for name, angles in zip(("field_x_deg", "field_y_deg"), sides_deg, strict=True):
        if len(angles) < 2 or not (0 in angles and (np.diff(angles) > 0).all()):
            raise UserError(
                "field angles must rise and hold 0",
                field=name,
                value=str(angles),
                allowed="at least two, rising, with 0",
            )
        farthest = np.abs(angles).max()
        if farthest > prescription.max_field_deg * (1 + 1e-12):
            raise UserError(
                "the field lies beyond the lens",
                file=prescription.file,
                field=name,
                value=f"{farthest:g}",
                allowed=f"0 to {prescription.max_field_deg:g} from the axis",
            )
    if size % 2 or not 0 < size <= TRANSFORM // 2:
        raise UserError(
            "the PSF window has a size that is not computed",
            field="size",
            value=size,
            allowed=f"even, up to {TRANSFORM // 2}",
        )

"""Computing the bank of a lens without an axis, in float64 from the whole pupil."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.entering import stretch
from gpusim.lens.prescription import Prescription
from gpusim.lens.projection import RECTILINEAR
from gpusim.lens.samples import sample_field
from gpusim.lens.system import System, build
from gpusim.lens.wavefront import OVERSIZE, Pupil
from gpusim.parallel import each
from gpusim.psf.chief_rays import rays_on_rings
from gpusim.psf.cone import cone_of
from gpusim.psf.halo import distances_um, fall, field_halo, wave_of, whole_halo
from gpusim.psf.plane_bank import PlaneBank
from gpusim.psf.provenance import of_lens
from gpusim.psf.psf import intensity, losses_of, unfolded_pupil
from gpusim.psf.sampling import (
    REFERENCE_NM,
    WAVELENGTHS_NM,
    check_reference,
    default_pitch_um,
    default_sides_deg,
)
from gpusim.psf.store import from_cache

SIZE = 128
# Nodes across the pupil grid. Against 1024 nodes, the double Gauss at f/2.8 over 14 deg changes by
# 1.9e-3 of the PSF's peak with 256 nodes.
PUPIL_NODES = 256


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
        Samples across, even.
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
    _check(prescription, wavelengths, x_deg, y_deg, reference_nm, size)
    if pitch_um is None:
        pitch_um = default_pitch_um(prescription, wavelengths)
    system = build(prescription)
    reach_deg = min(RECTILINEAR.end_deg, -x_deg[0], x_deg[-1], -y_deg[0], y_deg[-1])
    rays = rays_on_rings(system, reference_nm, min(reach_deg, prescription.max_field_deg))
    fields = [(x, y) for y in y_deg for x in x_deg]
    rows = each(
        lambda one: plane_field_of(
            system, wavelengths, one, size=size, pitch_um=pitch_um, reference_nm=reference_nm
        ),
        fields,
        progress,
    )
    return plane_bank_of(
        system,
        wavelengths,
        (x_deg, y_deg),
        rows,
        rays,
        reference_nm=reference_nm,
        pitch_um=pitch_um,
    )


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
        What `plane_field_of` returns for each field, row after row.
    rays : dict
        Chief rays of the map, by the names of the bank's variables.
    reference_nm, pitch_um : float
    """
    x_deg, y_deg = sides_deg
    shape = (len(y_deg), len(x_deg))
    of_halo = whole_halo(
        [(row.pop("levels"), row.pop("beyond")) for row in rows],
        pitch_um,
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


def plane_field_of(
    system: System,
    wavelengths: np.ndarray,
    field_deg: tuple[float, float],
    *,
    size: int,
    pitch_um: float,
    reference_nm: float,
    nodes: int = PUPIL_NODES,
) -> dict[str, np.ndarray]:
    """Return all wavelengths of one field, by the names of the bank's variables.

    `nodes`: across the pupil's grid.
    """
    largest_deg = system.prescription.max_field_deg
    theta, azimuth = np.radians(min(np.hypot(*field_deg), largest_deg)), np.arctan2(*field_deg)
    samples = sample_field(system, system.index(wavelengths), theta, azimuth)
    # As of a symmetric bank, whose PSFs are turned: so that a lens has the same light in both.
    radius_um = size / 2 * pitch_um
    distance_um = distances_um(size, pitch_um)
    inside, within = distance_um < radius_um, fall(distance_um, radius_um)
    lines, waves = [], []
    for line, wavelength in enumerate(wavelengths):
        pupil = unfolded_pupil(samples, line, wavelength, size, pitch_um, nodes)
        _check_pitch(system, pupil, wavelength, pitch_um)
        window = intensity(pupil, wavelength, size, pitch_um)[0] * inside
        waves.append(wave_of(pupil, 2 * len(pupil.beta) // nodes))
        lines.append(
            {
                "outside_energy": 1 - window.sum(),
                "core": (window * within).sum(),
                # Rows are x in the pupil, and y in the image.
                "psf": window.T.astype(np.float32),
                "cone": cone_of(pupil.alpha, pupil.beta, pupil.arriving, pupil.half),
                "light_sr": pupil.entered,
                **losses_of(samples, line, pupil, wavelength, size, pitch_um),
            }
        )
    levels, beyond = field_halo(waves.__getitem__, wavelengths, pitch_um, radius_um)
    stacked = {name: np.stack([one[name] for one in lines]) for name in lines[0]}
    stacked["light_sr"] /= stretch(system, reference_nm, theta, azimuth).area()
    return stacked | {
        "levels": levels.swapaxes(-1, -2),
        "beyond": beyond,
        "chief_x_um": 1e3 * samples.chief_x_mm,
        "chief_y_um": 1e3 * samples.chief_y_mm,
        "chief": samples.chief_direction,
    }


def _check_pitch(system: System, pupil: Pupil, wavelength_nm: float, pitch_um: float) -> None:
    """Refuse a pitch above the Nyquist limit of the PSF, lambda / (2 pupil width)."""
    width = max((2 if pupil.half else 1) * np.ptp(pupil.alpha), np.ptp(pupil.beta))
    limit = wavelength_nm * 1e-3 / (2 * width) * OVERSIZE
    if pitch_um > limit:
        raise UserError(
            f"the PSF pitch is too coarse for this aperture at {wavelength_nm:g} nm",
            file=system.prescription.file,
            field="pitch_um",
            value=pitch_um,
            allowed=f"<= {limit:.3g}",
        )


def _check(
    prescription: Prescription,
    wavelengths: np.ndarray,
    x_deg: np.ndarray,
    y_deg: np.ndarray,
    reference_nm: float,
    size: int,
) -> None:
    """Refuse settings that make no bank."""
    check_reference(reference_nm, wavelengths)
    for name, angles in (("field_x_deg", x_deg), ("field_y_deg", y_deg)):
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
    if size % 2:
        raise UserError("the PSF window must be even", field="size", value=size, allowed="even")

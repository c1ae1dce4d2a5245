"""Computing the bank of a lens with an axis, on the device: PSFs, chief rays, illumination."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu import default_device
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import System, build
from gpusim.psf.bank import Bank
from gpusim.psf.chief_rays import between_fields
from gpusim.psf.field_map import FieldMap, ideal_height_um
from gpusim.psf.generator import RAYS, Generator
from gpusim.psf.halo import distances_um, fall, halo_of
from gpusim.psf.provenance import of_lens
from gpusim.psf.sampling import (
    REFERENCE_NM,
    WAVELENGTHS_NM,
    check_reference,
    default_fields_deg,
    window,
)
from gpusim.psf.scatter import shown_by
from gpusim.psf.store import from_cache
from gpusim.psf.transform import TRANSFORM


def compute_bank(
    prescription: Prescription,
    wavelengths_nm: np.ndarray | None = None,
    field_deg: np.ndarray | None = None,
    *,
    reference_nm: float = REFERENCE_NM,
    pitch_um: float | None = None,
    size: int | None = None,
    rays: int = RAYS,
    focus_um: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> Bank:
    """Compute the bank of a lens on the default device.

    Parameters
    ----------
    prescription : Prescription
    wavelengths_nm : array_like, shape (L,), optional
        400 to 700 nm in steps of 25.
    field_deg : array_like, shape (F,), optional
        15 fields from 0 to the lens's largest (``default_fields_deg``).
    reference_nm : float
        One of the wavelengths.
    pitch_um : float, optional
        Spacing of the PSF's samples (as the lens needs it: ``gpusim.psf.sampling.window``).
    size : int, optional
        Samples across, even (the same).
    rays : int
        Rays across the pupil, each way.
    focus_um : float
        How far the image plane is moved away from the lens.
    progress : callable, optional
        Called with (fields done, fields in all).

    Returns
    -------
    Bank

    Raises
    ------
    UserError
        Where a glass has no data at a wavelength, a field lies beyond the lens, the pitch does not
        sample the PSF, distortion folds the image over, or an element is decentred or tilted.
    """
    wavelengths = np.array(WAVELENGTHS_NM if wavelengths_nm is None else wavelengths_nm, float)
    angles = default_fields_deg(prescription) if field_deg is None else np.array(field_deg, float)
    _check_settings(prescription, wavelengths, angles, reference_nm, size)
    system = build(prescription)
    if size is None or pitch_um is None:
        needed = window(system, wavelengths)
        size, pitch_um = (
            own if given is None else given
            for given, own in zip((size, pitch_um), needed, strict=True)
        )
    generator = Generator(
        default_device(),
        system,
        wavelengths,
        angles,
        pitch_um=pitch_um,
        size=size,
        rays=rays,
        progress=progress,
    )
    try:
        return bank_of(generator, reference_nm, focus_um)
    finally:
        generator.release()


def bank_of(
    generator: Generator,
    reference_nm: float = REFERENCE_NM,
    focus_um: float = 0.0,
    *,
    wide: bool = True,
) -> Bank:
    """Return the bank of a lens that is traced already, at any focus.

    Parameters
    ----------
    generator : Generator
    reference_nm : float
        One of its wavelengths.
    focus_um : float
        How far the image plane is moved away from the lens.
    wide : bool
        Whether to work out what lands beyond the window; else the PSFs hold all of the light: for
        drafts.

    Raises
    ------
    UserError
        Where distortion folds the image over.
    """
    system, wavelengths = generator.system, generator.wavelengths_nm
    spread, core = _spreads(generator, focus_um, wide)
    entered = spread.pop("entered")
    angles, radial = generator.field_deg, generator.chief_beta
    real = 1e3 * generator.chief_y_mm + focus_um * radial / np.sqrt(1 - radial**2)
    facts = of_lens(system, wavelengths, reference_nm)
    scale_mm = facts["efl_mm"] if facts["principal_mm"] is None else facts["principal_mm"]
    rays_deg, rays_um = between_fields(generator.between, angles, real, 1e3 * scale_mm, focus_um)
    _refuse_folds(system, rays_deg, rays_um, 1e3 * scale_mm)
    halo = {}
    if wide:
        halo = halo_of(
            lambda field, line: generator.wave(field, line, focus_um),
            wavelengths,
            float(generator.pitch_um),
            generator.size / 2 * generator.pitch_um,
            core,
        )
    if focus_um:
        facts["provenance"]["focus"] += f"; moved by {focus_um:g} um away from the lens"
    areas = [
        generator.stretch(field, float(reference_nm)).area(1e-3 * focus_um)
        for field in range(len(angles))
    ]
    light_sr = entered / np.array(areas)[:, None]
    made = Bank(
        field_deg=angles,
        ideal_height_um=ideal_height_um(scale_mm, angles),
        real_height_um=real,
        relative_illumination=light_sr,
        projected_solid_angle_sr=np.ones(len(wavelengths)),
        fit_residual_waves=generator.residual_waves,
        failed_rays=generator.failed_rays,
        pitch_um=float(generator.pitch_um),
        chief=np.stack([radial, np.zeros_like(radial)], axis=-1),
        cone=np.stack([generator.cones(field) for field in range(len(angles))]),
        ray_deg=rays_deg,
        ray_um=rays_um,
        **facts,
        **spread,
        **halo,
    )
    shown_sr = shown_by(made, light_sr)
    return replace(
        made,
        relative_illumination=shown_sr / shown_sr[0],
        projected_solid_angle_sr=shown_sr[0],
        field_light=light_sr / shown_sr[0],
    )


def _spreads(
    generator: Generator, focus_um: float, wide: bool
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the PSFs of all fields and what was lost, and the light (F, L) of their cores.

    The first by the names of the bank's variables; and ``entered``, the light that goes in.
    """
    size = generator.size
    # The circle in the window: a PSF is turned to every azimuth and must not gain corners by it.
    distance_um = distances_um(size, generator.pitch_um)
    radius_um = size / 2 * generator.pitch_um
    inside = distance_um < radius_um
    within = fall(distance_um, radius_um)
    shape = (len(generator.field_deg), len(generator.wavelengths_nm))
    psfs = np.empty((*shape, size, size), np.float32)
    outside, folded, entered, core = np.zeros((4, *shape))
    for field in range(len(psfs)):
        spread = generator.spread(field, 1e-3 * focus_um, rim=wide)
        psf = np.multiply(spread.psf, inside, out=psfs[field])
        outside[field] = 1.0 - psf.sum(axis=(1, 2), dtype=float)
        core[field] = np.einsum("lyx,yx->l", psf, within, dtype=float)
        folded[field] = spread.folded_energy
        entered[field] = spread.entered
    if not wide:
        psfs /= psfs.sum(axis=(2, 3), keepdims=True)
    found = {"psf": psfs, "outside_energy": outside, "folded_energy": folded, "entered": entered}
    return found, core


def _refuse_folds(
    system: System, rays_deg: np.ndarray, rays_um: np.ndarray, scale_um: float
) -> None:
    """Refuse chief rays (M,), (M, L) whose heights do not rise with the field."""
    theta = np.radians(rays_deg)
    folds = [f for h in rays_um.T if (f := FieldMap(theta, h, scale_um).folds_at) is not None]
    if folds:
        raise UserError(
            "distortion folds the image over: image height does not rise with field angle",
            file=system.prescription.file,
            field="max_field_deg",
            value=f"{rays_deg[-1]:g}",
            allowed=f"up to {np.degrees(min(folds)):.4g} deg",
        )


def _check_settings(prescription, wavelengths, angles, reference_nm, size) -> None:
    """Refuse settings that make no bank."""
    file = prescription.file
    for number, surface in enumerate(prescription.surfaces, start=1):
        if not surface.is_centred:
            raise UserError(
                "a bank to render with is symmetric about the axis, and this lens is not",
                file=file,
                field=f"surfaces.{number}",
                value=f"decentre_mm {list(surface.decentre_mm)}, tilt_deg {list(surface.tilt_deg)}",
                allowed="no decentre_mm, no tilt_deg (gpusim.psf.compute_plane takes such lenses)",
            )
    check_reference(reference_nm, wavelengths)
    if len(angles) < 2 or angles[0] != 0 or not (np.diff(angles) > 0).all():
        raise UserError(
            "field angles must rise from 0",
            file=file,
            field="field_deg",
            value=str(angles),
            allowed="0 and at least one more",
        )
    if not (np.diff(wavelengths) > 0).all():
        raise UserError(
            "wavelengths must rise",
            field="wavelengths_nm",
            value=str(wavelengths),
            allowed="rising",
        )
    if angles[-1] > prescription.max_field_deg:
        raise UserError(
            "the field lies beyond the lens",
            file=file,
            field="field_deg",
            value=f"{angles[-1]:g}",
            allowed=f"0 to {prescription.max_field_deg:g}",
        )
    if size is not None and (size % 2 or not 0 < size <= TRANSFORM // 2):
        raise UserError(
            "the PSF window has a size that is not computed",
            field="size",
            value=size,
            allowed=f"even, up to {TRANSFORM // 2}",
        )


def cached_bank(prescription: Prescription, **settings: object) -> Bank:
    """Return the bank of a lens from the disk cache, or compute and store it.

    Parameters
    ----------
    prescription : Prescription
    **settings
        As for ``compute_bank``.
    """
    return from_cache(Bank, compute_bank, prescription, settings)

"""PSFs traced anew in float64, to judge a bank by: what the certificate calls the lens itself.

The float64 tracer, the fitted wavefront and the matrix Fourier transform on the host, at fields and
wavelengths of the caller's choice: no node, no line and no shader of a bank has a part in it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

from gpusim.lens.entering import stretch
from gpusim.lens.prescription import Prescription
from gpusim.lens.samples import sample_field
from gpusim.lens.system import System, build
from gpusim.parallel import each
from gpusim.psf.bank import Bank
from gpusim.psf.compute_plane import plane_bank_of
from gpusim.psf.cone import cone_of
from gpusim.psf.field_map import ideal_height_um
from gpusim.psf.halo import distances_um, fall, field_halo, halo_of
from gpusim.psf.plane_bank import PlaneBank
from gpusim.psf.provenance import of_lens
from gpusim.psf.psf import intensity, losses_of, unfolded_pupil
from gpusim.psf.store import from_cache
from gpusim.psf.wave import wave_of

# Nodes across the pupil. With 512, PSFs of the double Gauss at f/2.8 differ from those of 1024 by
# 5e-4 of the peak, and their edge responses by 5e-5.
NODES = 512
# Across what the halo is made of: with 170, light is misplaced by 1.4e-4 (the lens of `validate
# kodak`) to 4e-3 of all (Tessar, f/2.8, 20 deg).
WAVE_NODES = 512


def traced_bank(
    prescription: Prescription,
    wavelengths_nm: np.ndarray,
    field_deg: np.ndarray,
    *,
    reference_nm: float,
    map_nm: float,
    pitch_um: float,
    size: int,
    progress: Callable[[int, int], None] | None = None,
) -> Bank:
    """Trace a lens at some fields and wavelengths.

    Parameters
    ----------
    prescription : Prescription
        A lens with an axis.
    wavelengths_nm : ndarray (L,)
        Rising.
    field_deg : ndarray (F,)
        Rising from 0.
    reference_nm : float
        One of the wavelengths.
    map_nm : float
        Wavelength whose chief rays map the scene on the image: light counts per area of that.
    pitch_um, size : float, int
        Pitch and size of the PSFs.
    progress : callable, optional
        Called with (fields done, fields in all).

    Raises
    ------
    UserError
        Where a field does not pass the lens.
    """
    system = build(prescription)
    lines = np.asarray(wavelengths_nm, float)
    rows = each(
        lambda theta: field_of(system, lines, theta, size=size, pitch_um=pitch_um, map_nm=map_nm),
        field_deg,
        progress,
    )
    stacked = {name: np.stack([row[name] for row in rows]) for name in rows[0] if name != "waves"}
    light_sr = stacked.pop("light_sr")
    radius_um = size / 2 * pitch_um
    within = fall(distances_um(size, pitch_um), radius_um)
    core = np.einsum("flyx,yx->fl", stacked["psf"], within, dtype=float)
    facts = of_lens(system, lines, reference_nm)
    facts["provenance"]["traced"] = "in float64, to judge a bank by"
    scale_mm = facts["efl_mm"] if facts["principal_mm"] is None else facts["principal_mm"]
    return Bank(
        field_deg=np.asarray(field_deg, float),
        ideal_height_um=ideal_height_um(scale_mm, np.asarray(field_deg, float)),
        # What fields send: what they show follows from those around, which were not traced.
        relative_illumination=light_sr / light_sr[0],
        projected_solid_angle_sr=light_sr[0],
        field_light=light_sr / light_sr[0],
        pitch_um=float(pitch_um),
        **facts,
        **stacked,
        **halo_of(lambda field, line: rows[field]["waves"][line], lines, pitch_um, radius_um, core),
    )


def cached_traced_bank(prescription: Prescription, **settings: object) -> Bank:
    """Return the same from the disk cache, or trace and store it."""
    return from_cache(Bank, traced_bank, prescription, settings, "traced")


def traced_plane_field(
    prescription: Prescription,
    wavelengths_nm: np.ndarray,
    field_deg: tuple[float, float],
    *,
    reference_nm: float,
    map_nm: float,
    pitch_um: float,
    size: int,
    progress: Callable[[int, int], None] | None = None,
) -> PlaneBank:
    """Trace a lens without an axis at one field: a bank of it alone, with its own solid angle.

    Parameters
    ----------
    prescription : Prescription
    wavelengths_nm : ndarray (L,)
        Rising.
    field_deg : (float, float)
        Angles x and y.
    reference_nm : float
        One of the wavelengths.
    map_nm : float
        As of `traced_bank`.
    pitch_um, size : float, int
        Pitch and size of the PSFs.
    progress : callable, optional
        Called with (1, 1) in the end.

    Raises
    ------
    UserError
        Where the field does not pass the lens.
    """
    system = build(prescription)
    lines = np.asarray(wavelengths_nm, float)
    x_deg, y_deg = (np.array([angle], float) for angle in field_deg)
    with threadpool_limits(1):
        row = plane_field_of(
            system,
            lines,
            (x_deg[0], y_deg[0]),
            size=size,
            pitch_um=pitch_um,
            map_nm=map_nm,
        )
    at = int(np.flatnonzero(lines == reference_nm)[0])
    rays = {"ray_x_deg": x_deg, "ray_y_deg": y_deg}
    rays |= {f"ray_{axis}_um": row[f"chief_{axis}_um"][[at]] for axis in "xy"}
    if progress is not None:
        progress(1, 1)
    return plane_bank_of(
        system, lines, (x_deg, y_deg), [row], rays, reference_nm=reference_nm, pitch_um=pitch_um
    )


def cached_traced_plane_field(prescription: Prescription, **settings: object) -> PlaneBank:
    """Return the same from the disk cache, or trace and store it."""
    return from_cache(PlaneBank, traced_plane_field, prescription, settings, "traced")


def field_of(
    system: System,
    lines: np.ndarray,
    theta_deg: float,
    *,
    size: int,
    pitch_um: float,
    map_nm: float,
) -> dict[str, object]:
    """Return all wavelengths of one field, by the names of the bank's variables."""
    theta = float(np.radians(theta_deg))
    samples = sample_field(system, system.index(lines), theta)
    inside = distances_um(size, pitch_um) < size / 2 * pitch_um
    given = {"size": size, "pitch_um": pitch_um}
    rows = []
    for line, wavelength in enumerate(lines):
        # One after the other, because finely sampled pupils are large.
        pupil = unfolded_pupil(samples, line, wavelength, **given, nodes=NODES)
        psf = intensity(pupil, wavelength, **given)[0] * inside
        rows.append(
            {
                "psf": psf.astype(np.float32),
                "outside_energy": 1 - psf.sum(),
                "light_sr": pupil.entered,
                "cone": cone_of(pupil.alpha, pupil.beta, pupil.arriving, pupil.half)[:, [1, 0, 2]],
                "waves": wave_of(pupil, len(pupil.beta) // WAVE_NODES),
                **losses_of(samples, line, pupil, wavelength, **given),
            }
        )
    waves = [row.pop("waves") for row in rows]
    stacked = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    stacked["light_sr"] /= stretch(system, map_nm, theta).area()
    return stacked | {
        "waves": waves,
        "real_height_um": 1e3 * samples.chief_y_mm,
        "chief": samples.chief_direction[:, ::-1],
    }


def plane_field_of(
    system: System,
    wavelengths: np.ndarray,
    field_deg: tuple[float, float],
    *,
    size: int,
    pitch_um: float,
    map_nm: float,
    nodes: int = NODES,
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
    given = {"size": size, "pitch_um": pitch_um}
    lines, waves = [], []
    for line, wavelength in enumerate(wavelengths):
        pupil = unfolded_pupil(samples, line, wavelength, **given, nodes=nodes)
        window = intensity(pupil, wavelength, **given)[0] * inside
        waves.append(wave_of(pupil, len(pupil.beta) // WAVE_NODES))
        lines.append(
            {
                "outside_energy": 1 - window.sum(),
                "core": (window * within).sum(),
                # Rows are x in the pupil, and y in the image.
                "psf": window.T.astype(np.float32),
                "cone": cone_of(pupil.alpha, pupil.beta, pupil.arriving, pupil.half),
                "light_sr": pupil.entered,
                **losses_of(samples, line, pupil, wavelength, **given),
            }
        )
    levels, beyond = field_halo(waves.__getitem__, wavelengths, pitch_um, radius_um)
    stacked = {name: np.stack([one[name] for one in lines]) for name in lines[0]}
    stacked["light_sr"] /= stretch(system, map_nm, theta, azimuth).area()
    return stacked | {
        "levels": levels.swapaxes(-1, -2),
        "beyond": beyond,
        "chief_x_um": 1e3 * samples.chief_x_mm,
        "chief_y_um": 1e3 * samples.chief_y_mm,
        "chief": samples.chief_direction,
    }

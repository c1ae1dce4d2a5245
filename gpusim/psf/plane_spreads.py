"""Line spreads of a lens without an axis at fields and wavelengths of choice: as `spreads`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.gpu import default_device
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build, first_order, transmission
from gpusim.parallel import each
from gpusim.psf.compute_plane import SIZE, TOGETHER
from gpusim.psf.plane_generator import PlaneGenerator, Pupils
from gpusim.psf.sampling import REFERENCE_NM, default_pitch_um
from gpusim.psf.spreads import LINE_SPREADS, PITCH, LineSpreads, Progress, line_sums
from gpusim.psf.store import Table, from_cache
from gpusim.psf.traced import plane_field_of
from gpusim.psf.transform import TRANSFORM


@dataclass(frozen=True, eq=False, kw_only=True)
class PlaneSpreads(LineSpreads):
    """Line spreads of a lens at fields of the plane; its PSFs' axes are x and y.

    Attributes
    ----------
    field_x_deg, field_y_deg : ndarray (F,)
    chief_um : ndarray (F, L, 2)
    """

    field_x_deg: np.ndarray
    field_y_deg: np.ndarray
    chief_um: np.ndarray
    table = Table(
        {
            "field_x_deg": (("field",), "degree", "field angle in object space, along x"),
            "field_y_deg": (("field",), "degree", "field angle in object space, along y"),
            "chief_um": (("field", "wavelength", "axis"), "um", "x and y of chief rays"),
            **LINE_SPREADS,
        },
        PITCH,
    )


def plane_spreads(
    prescription: Prescription,
    wavelengths_nm: np.ndarray,
    field_x_deg: np.ndarray,
    field_y_deg: np.ndarray,
    *,
    transform: int = TRANSFORM,
    traced: bool = False,
    progress: Progress | None = None,
) -> PlaneSpreads:
    """Trace a lens and return the line spreads of its PSFs.

    Parameters
    ----------
    prescription : Prescription
    wavelengths_nm, field_x_deg, field_y_deg : ndarray (L,), (F,), (F,)
        See `PlaneSpreads`.
    transform : int
        Cells of the pupil each way.
    traced : bool
        In float64 on the host: see `gpusim.psf.traced`.
    progress : callable, optional
        Called with (fields done, fields in all).

    Raises
    ------
    UserError
        Where a field does not pass the lens.
    """
    system, lines = build(prescription), np.asarray(wavelengths_nm, float)
    pitch_um = default_pitch_um(prescription, lines)
    given = {"size": SIZE, "pitch_um": pitch_um}
    fields = list(zip(np.asarray(field_x_deg, float), np.asarray(field_y_deg, float), strict=True))
    if traced:
        rows = [
            plane_field_of(system, lines, field, map_nm=REFERENCE_NM, **given) for field in fields
        ]
        psfs = [row["psf"] for row in rows]
        light = [row["light_sr"] for row in rows]
        chief = [np.stack([row["chief_x_um"], row["chief_y_um"]], axis=-1) for row in rows]
        spread = [line_sums(psf, pitch_um) for psf in psfs]
    else:
        generator = PlaneGenerator(
            default_device(), system, lines, reference_nm=REFERENCE_NM, **given, transform=transform
        )
        spread, light, chief = _generated(generator, fields, progress)
    return PlaneSpreads(
        field_x_deg=np.asarray(field_x_deg, float),
        field_y_deg=np.asarray(field_y_deg, float),
        wavelengths_nm=lines,
        chief_um=np.array(chief),
        light_sr=np.array(light),
        transmission=transmission(prescription, lines),
        spread=np.array(spread, np.float32),
        pitch_um=float(pitch_um),
        provenance={
            "title": prescription.title,
            "history": "; ".join(prescription.history) or "as published",
            "efl": f"{first_order(prescription, REFERENCE_NM).efl_mm:.6g} mm",
            "holds": "line spreads of PSFs",
        },
    )


def _generated(
    generator: PlaneGenerator,
    fields: list[tuple[float, float]],
    progress: Progress | None,
) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Return line spreads, light and chief rays of fields by the generator."""

    def on_host(field: tuple[float, float]) -> tuple[Pupils, float]:
        pupils = generator.pupils(field)
        return pupils, generator.area(pupils)

    spread, light, chief = [], [], []
    try:
        for first in range(0, len(fields), TOGETHER):
            for pupils, area in each(on_host, fields[first : first + TOGETHER]):
                psf, entered, _ = generator.spread(pupils)
                spread.append(line_sums(psf.swapaxes(1, 2), generator.pitch_um))
                light.append(entered / area)
                chief.append(pupils.chief_um)
                if progress is not None:
                    progress(len(spread), len(fields))
    finally:
        generator.release()
    return spread, light, chief


def cached_plane_spreads(prescription: Prescription, **settings: object) -> PlaneSpreads:
    """Return `plane_spreads` from the disk cache, or store them there."""
    return from_cache(PlaneSpreads, plane_spreads, prescription, settings)

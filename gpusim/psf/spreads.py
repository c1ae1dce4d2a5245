"""Line spreads of a lens's PSFs at fields and wavelengths of choice: what a survey measures.

A bank is sampled as densely as it must be to be interpolated. How densely that is, is told by what
PSFs do between fields and lines; their sums along x and along y tell it as well as they themselves,
take a hundredth of the room, and need no halo. They come from the generator, as the bank does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from gpusim.gpu import default_device
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build, first_order, transmission
from gpusim.psf.field_map import WIDE_DEG
from gpusim.psf.generator import Generator
from gpusim.psf.halo import distances_um, fall
from gpusim.psf.sampling import REFERENCE_NM, window
from gpusim.psf.store import Table, Variables, dataset_of, from_cache, load_dataset, save_dataset
from gpusim.psf.traced import field_of as traced_field
from gpusim.psf.transform import TRANSFORM

Progress = Callable[[int, int], None]
# Glass disperses nearly evenly in 1 / lambda, and so lie the lines: 12 of them err by a third of
# what 13 lines in even steps of 25 nm do. In elevenths of 1/700 to 1/400, 550 nm is one of them.
SHORTEST_NM, LONGEST_NM, ELEVENTHS = 400.0, 700.0, 11
LINE_SPREADS: Variables = {
    "wavelengths_nm": (("wavelength",), "nm", "wavelength"),
    "light_sr": (
        ("field", "wavelength"),
        "sr",
        "what an even scene of unit radiance sends through, per area of the image",
    ),
    "transmission": (("wavelength",), "1", "product of the surfaces' transmittances on axis"),
    "spread": (
        ("field", "wavelength", "along", "at"),
        "1",
        "share of the light per sample, along the first and second axis; centred on the chief ray",
    ),
}
PITCH = {"pitch_um": ("um", "spacing of the samples")}


def added_intervals(first_nm: float, last_nm: float) -> tuple[int, int]:
    """Return how many intervals, none wider than an eleventh, lie below 400 and beyond 700 nm."""
    eleventh = (1 / SHORTEST_NM - 1 / LONGEST_NM) / ELEVENTHS
    gaps = 1 / first_nm - 1 / SHORTEST_NM, 1 / LONGEST_NM - 1 / last_nm
    below, beyond = (max(0, math.ceil(gap / eleventh - 1e-9)) for gap in gaps)
    return below, beyond


def even_lines_nm(
    steps: int, first_nm: float = SHORTEST_NM, last_nm: float = LONGEST_NM
) -> np.ndarray:
    """Return lines that are evenly spaced in 1 / lambda, `steps` of them in each eleventh.

    Those from 400 to 700 nm are always the same; below and beyond there are as many as it takes,
    evenly spaced as far as the ends.
    """
    ends = (first_nm, SHORTEST_NM), (SHORTEST_NM, LONGEST_NM), (LONGEST_NM, last_nm)
    below, beyond = added_intervals(first_nm, last_nm)
    parts = [
        np.linspace(1 / start, 1 / end, count * steps + 1)
        for (start, end), count in zip(ends, (below, ELEVENTHS, beyond), strict=True)
        if count
    ]
    inverse = np.concatenate([parts[0], *(part[1:] for part in parts[1:])])
    return np.round(1 / inverse, 6)


def middles_deg(prescription: Prescription, field_deg: np.ndarray) -> np.ndarray:
    """Return the fields half-way between fields, in image height nearly."""
    if prescription.max_field_deg > WIDE_DEG:
        return (field_deg[1:] + field_deg[:-1]) / 2
    height = np.tan(np.radians(field_deg))
    return np.degrees(np.arctan((height[1:] + height[:-1]) / 2))


@dataclass(frozen=True, eq=False, kw_only=True)
class LineSpreads:
    """Line spreads of a lens at F fields and L wavelengths.

    Attributes
    ----------
    wavelengths_nm : ndarray (L,)
        Rising; the reference wavelength is among these.
    light_sr : ndarray (F, L)
    transmission : ndarray (L,)
    spread : ndarray of float32 (F, L, 2, n)
        The PSF, as far as a bank's first level holds it, summed along its second and its first
        axis; the chief ray is at sample n / 2.
    pitch_um : float
    provenance : dict
    """

    wavelengths_nm: np.ndarray
    light_sr: np.ndarray
    transmission: np.ndarray
    spread: np.ndarray
    pitch_um: float
    provenance: dict[str, str]
    table: ClassVar[Table]  # what a file holds

    @property
    def reference(self) -> int:
        """Index of the reference wavelength."""
        return int(np.abs(self.wavelengths_nm - REFERENCE_NM).argmin())

    def save(self, path: str | Path) -> None:
        """Write them as NetCDF, never half a file."""
        save_dataset(dataset_of(self, self.table), path)

    @classmethod
    def load(cls, path: str | Path, *, sealed: bool = False) -> Self:
        """Read what ``save`` wrote; raises where the file is not whole, as ``Bank.load`` does."""
        return cls(**load_dataset(path, cls.table, sealed))


@dataclass(frozen=True, eq=False, kw_only=True)
class Spreads(LineSpreads):
    """Line spreads of a lens with an axis; its PSFs' axes are xi and eta.

    Attributes
    ----------
    field_deg : ndarray (F,)
        Rising.
    height_um : ndarray (F, L)
    efl_mm : float
    """

    field_deg: np.ndarray
    height_um: np.ndarray
    efl_mm: float
    table = Table(
        {
            "field_deg": (("field",), "degree", "field angle in object space"),
            "height_um": (("field", "wavelength"), "um", "height where the chief ray lands"),
            **LINE_SPREADS,
        },
        PITCH | {"efl_mm": ("mm", "paraxial focal length at the reference wavelength")},
    )


def spreads(
    prescription: Prescription,
    wavelengths_nm: np.ndarray,
    field_deg: np.ndarray,
    *,
    transform: int = TRANSFORM,
    rim: bool = True,
    progress: Progress | None = None,
) -> Spreads:
    """Trace a lens and return the line spreads of its PSFs.

    Parameters
    ----------
    prescription : Prescription
        A lens with an axis.
    wavelengths_nm, field_deg : ndarray (L,), (F,)
        See `Spreads`.
    transform : int
        Cells of the pupil each way, at least: twice the samples of a PSF where these are more.
    rim : bool
        Whether to add what these cells take from a rim. It changes evenly over field and
        wavelength: where spreads are compared with one another alone it is of no account.
    progress : callable, optional
        Called with (fields done, fields in all).

    Raises
    ------
    UserError
        Where a field does not pass the lens.
    """
    system = build(prescription)
    lines, angles = np.asarray(wavelengths_nm, float), np.asarray(field_deg, float)
    size, pitch_um = window(system, lines)
    given = {"pitch_um": pitch_um, "size": size, "progress": progress}
    given["transform"] = transform if 2 * size <= transform else TRANSFORM
    generator = Generator(default_device(), system, lines, angles, **given)
    try:
        found = [generator.spread(field, rim=rim) for field in range(len(angles))]
        areas = [generator.stretch(field, REFERENCE_NM).area() for field in range(len(angles))]
        return _of(
            prescription,
            lines,
            angles,
            pitch_um,
            height_um=1e3 * generator.chief_y_mm,
            spread=[line_sums(one.psf, pitch_um) for one in found],
            light_sr=np.array([one.entered for one in found]) / np.array(areas)[:, None],
        )
    finally:
        generator.release()


def traced_spreads(
    prescription: Prescription,
    wavelengths_nm: np.ndarray,
    field_deg: np.ndarray,
    *,
    progress: Progress | None = None,
) -> Spreads:
    """Return what `spreads` does, in float64 on the host: see `gpusim.psf.traced`."""
    system = build(prescription)
    lines, angles = np.asarray(wavelengths_nm, float), np.asarray(field_deg, float)
    size, pitch_um = window(system, lines)
    given = {"size": size, "pitch_um": pitch_um, "map_nm": REFERENCE_NM}
    found = [traced_field(system, lines, theta, **given) for theta in angles]
    return _of(
        prescription,
        lines,
        angles,
        pitch_um,
        height_um=[one["real_height_um"] for one in found],
        spread=[line_sums(one["psf"], pitch_um) for one in found],
        light_sr=[one["light_sr"] for one in found],
    )


def line_sums(psf: np.ndarray, pitch_um: float) -> np.ndarray:
    """Return the sums (L, 2, n) of PSFs (L, n, n) along rows and columns, as far as cores go."""
    size = psf.shape[-1]
    core = psf * fall(distances_um(size, pitch_um), size / 2 * pitch_um)
    return np.stack([core.sum(axis=1), core.sum(axis=2)], axis=1)


def _of(
    prescription: Prescription,
    lines: np.ndarray,
    angles: np.ndarray,
    pitch_um: float,
    *,
    height_um: ArrayLike,
    spread: ArrayLike,
    light_sr: ArrayLike,
) -> Spreads:
    """Return what was found, fields first."""
    return Spreads(
        field_deg=angles,
        wavelengths_nm=lines,
        height_um=np.array(height_um),
        light_sr=np.array(light_sr),
        transmission=transmission(prescription, lines),
        spread=np.array(spread, np.float32),
        pitch_um=float(pitch_um),
        efl_mm=first_order(prescription, REFERENCE_NM).efl_mm,
        provenance={
            "title": prescription.title,
            "history": "; ".join(prescription.history) or "as published",
            "holds": "line spreads of PSFs",
        },
    )


def cached_spreads(
    prescription: Prescription,
    wavelengths_nm: np.ndarray,
    field_deg: np.ndarray,
    progress: Progress | None = None,
    *,
    transform: int = TRANSFORM,
    rim: bool = True,
) -> Spreads:
    """Return `spreads` from the disk cache, or store them there."""
    settings = {"wavelengths_nm": wavelengths_nm, "field_deg": field_deg, "transform": transform}
    given = settings | {"rim": rim, "progress": progress}
    return from_cache(Spreads, spreads, prescription, given)


def cached_traced_spreads(
    prescription: Prescription,
    wavelengths_nm: np.ndarray,
    field_deg: np.ndarray,
    progress: Progress | None = None,
) -> Spreads:
    """Return `traced_spreads` from the disk cache, or store them there."""
    settings = {"wavelengths_nm": wavelengths_nm, "field_deg": field_deg, "progress": progress}
    return from_cache(Spreads, traced_spreads, prescription, settings, "traced")

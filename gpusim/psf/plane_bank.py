"""A bank over both directions of the field, for lenses that are not symmetric about an axis.

Elements may be decentred and tilted. Computed in float64 from the whole pupil, stored as NetCDF-4.
The chain renders with it as with a symmetric one (``bank.py``): PSFs are bicubic between the fields
of the grid, as they lie, and nothing is turned. x and y are those of the prescription; on
the sensor x points right and y down.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from gpusim.errors import UserError
from gpusim.lens.entering import stretch
from gpusim.lens.prescription import Prescription
from gpusim.lens.projection import RECTILINEAR, Projection
from gpusim.lens.system import System, build, first_order, transmission
from gpusim.lens.wavefront import OVERSIZE, pupils, sample_field, sample_rays
from gpusim.psf.bank import (
    REFERENCE_NM,
    WAVELENGTHS_NM,
    no_rays,
    principal_mm,
    provenance_of,
)
from gpusim.psf.chief_rays import MIDDLE
from gpusim.psf.cone import FieldRays, cone_of
from gpusim.psf.halo import distances_um, fall, field_halo, split, wave_of, whole_halo
from gpusim.psf.lines import CUBIC
from gpusim.psf.places import FieldGrid, FieldPsfs
from gpusim.psf.plane_map import MAP_ERROR_UM, PlaneMap, Rings
from gpusim.psf.psf import folded_share, intensity
from gpusim.psf.sampling import default_pitch_um
from gpusim.psf.store import from_cache, load_dataset, save_dataset

if TYPE_CHECKING:
    import xarray

SIDE = 9  # fields each way
SIZE = 128
# Chief rays of the map: on rings of field angle, denser towards the rim, where splines are least
# sure; twice as many as long as they leave more open than `gpusim.psf.plane_map` allows. A phone's
# lens takes 20.
RINGS, MOST_RINGS = 10, 80
SPOKES = 20
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
        "share of the light per sample; centred on the chief ray of its own wavelength; "
        "upright image",
    ),
    "relative_illumination": (
        _LINES,
        "1",
        "what an even scene sends through the lens about a field, per area of its image, over that "
        "of field 0, 0",
    ),
    "projected_solid_angle_sr": (
        ("wavelength",),
        "sr",
        "what an even scene of unit radiance sends through about field 0, 0, per area of its image",
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
    "ray_x_deg": (("ray",), "degree", "field angle along x of the chief rays of the map"),
    "ray_y_deg": (("ray",), "degree", "field angle along y of the chief rays of the map"),
    "ray_x_um": (("ray",), "um", "where they land at the reference wavelength, x"),
    "ray_y_um": (("ray",), "um", "where they land at the reference wavelength, y"),
}
# Where the rays are known: see gpusim.psf.bank.
_RAYS = {
    "chief": (
        (*_LINES, "direction"),
        "1",
        "direction cosines of the chief ray at the image, along x and y",
    ),
    "cone": (
        (*_LINES, "cell", "part"),
        "1",
        "rays that arrive: direction cosines along x and y, and share of the projected solid angle",
    ),
}
# Where the light beyond the window is known.
_HALO = {
    "halo": (
        ("level", *_LINES, "halo_y", "halo_x"),
        "1",
        "share of the light per sample on coarser levels, beyond what the psf and the levels "
        "before hold: see gpusim.psf.halo",
    ),
    "halo_pitch_um": (("level",), "um", "spacing of a level's samples"),
    "beyond_energy": (_LINES, "1", "share of the light beyond the last level"),
    "halo_misfit": (
        _LINES,
        "1",
        "light that window and levels together had too much of, before the levels were scaled",
    ),
}
# Where lens or object are not set to infinity: else the focal length.
_FINITE = {
    "principal_mm": (
        (),
        "mm",
        "principal distance: paraxial image height over tan(theta), at the reference wavelength",
    ),
}
_SCALARS = {
    "reference_nm": ("nm", "wavelength whose chief ray defines the real plane"),
    "efl_mm": ("mm", "paraxial focal length of the centred lens at the reference wavelength"),
    "f_number": ("1", "focal length over entrance pupil diameter, of the centred lens"),
    "pitch_um": ("um", "spacing of the PSF samples"),
}


@dataclass(frozen=True, eq=False)
class PlaneBank:
    """PSFs and chief rays of a lens over its field: Y by X fields, L wavelengths, n x n samples.

    A field (x, y) in degrees lies hypot(x, y) off the axis of the lens, in the direction of
    (x, y): that holds beyond 90 deg too. In the corners of the grid, beyond the lens's largest
    field, is what the largest field in the same direction shows.

    Light lands within a circle about the chief ray of field (0, 0), the largest that the fields
    fill; beyond it the image is black.

    Attributes
    ----------
    wavelengths_nm : ndarray, shape (L,)
    field_x_deg, field_y_deg : ndarray, shapes (X,) and (Y,)
        Rising; each holds 0.
    chief_x_um, chief_y_um : ndarray, shape (Y, X, L)
    psf : ndarray of float32, shape (Y, X, L, n, n)
        Sum 1 less ``outside_energy``; rows y, columns x, sample j at (j - n / 2) pitch from its own
        chief ray; 0 outside the circle in the window.
    relative_illumination : ndarray, shape (Y, X, L)
        What an even scene sends through the lens about a field, per area of its image, over that
        of field (0, 0): see ``gpusim.lens.entering``.
    projected_solid_angle_sr, transmission : ndarray, shape (L,)
        At field (0, 0), and on the axis.
    outside_energy, folded_energy, fit_residual_waves, failed_rays : ndarray, shape (Y, X, L)
    ray_x_deg, ray_y_deg, ray_x_um, ray_y_um : ndarray, shape (M,)
        Chief rays of the map from field to image; the first is that of field (0, 0), the last
        lie on the rim of the field.
    reference_nm, efl_mm, f_number, pitch_um : float
    provenance : dict of str to str
    chief : ndarray, shape (Y, X, L, 2), or None
        Direction cosines of the chief ray at the image, along x and y.
    cone : ndarray of float32, shape (Y, X, L, R, 3), or None
        Rays that arrive, with their share: see ``gpusim.psf.cone``.
    halo, halo_pitch_um : ndarray of float32, shape (K, Y, X, L, m, m), and ndarray (K,), or None
    beyond_energy, halo_misfit : ndarray, shape (Y, X, L), or None
        As of ``gpusim.psf.bank.Bank``.
    principal_mm : float, or None
    projection : Projection
        As of ``gpusim.psf.bank.Bank``.
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
    ray_x_deg: np.ndarray
    ray_y_deg: np.ndarray
    ray_x_um: np.ndarray
    ray_y_um: np.ndarray
    reference_nm: float
    efl_mm: float
    f_number: float
    pitch_um: float
    provenance: dict[str, str]
    chief: np.ndarray | None = None
    cone: np.ndarray | None = None

    halo: np.ndarray | None = None
    halo_pitch_um: np.ndarray | None = None
    beyond_energy: np.ndarray | None = None
    halo_misfit: np.ndarray | None = None
    principal_mm: float | None = None
    projection: Projection = RECTILINEAR  # how the scene lies on the ideal plane
    spectral_degree = CUBIC  # what the chain asks of a bank: see gpusim.psf.field_bank

    @property
    def principal_distance_mm(self) -> float:
        """Ideal image height over tan(theta): the focal length where all is set to infinity."""
        return self.efl_mm if self.principal_mm is None else float(self.principal_mm)

    @property
    def reference(self) -> int:
        """Index of the reference wavelength."""
        return int(np.flatnonzero(self.wavelengths_nm == self.reference_nm)[0])

    @property
    def middle(self) -> tuple[int, int]:
        """Row and column of the field on the axis."""
        return int(np.abs(self.field_y_deg).argmin()), int(np.abs(self.field_x_deg).argmin())

    # What the chain asks of a bank: see gpusim.psf.field_bank.

    @functools.cached_property
    def levels(self) -> tuple[PlaneBank, ...]:
        """The bank as banks that add up, from the core outwards; without halo it alone."""
        return split(self)

    @property
    def centre_um(self) -> tuple[float, float]:
        """x, y of the image circle's centre: the chief ray of field (0, 0)."""
        return float(self.ray_x_um[0]), float(self.ray_y_um[0])

    @property
    def image_circle_um(self) -> float:
        """Radius of the largest circle about ``centre_um`` that the fields fill."""
        field = np.hypot(self.ray_x_deg, self.ray_y_deg)
        rim = field >= field.max() * (1 - 1e-9)
        x, y = self.centre_um
        return float(np.hypot(self.ray_x_um[rim] - x, self.ray_y_um[rim] - y).min())

    @property
    def rectilinear_circle_um(self) -> float:
        """The same: the map's rays end where the ideal plane does."""
        return self.image_circle_um

    @property
    def lateral_um(self) -> float:
        """Largest distance between the chief rays of two wavelengths at a field, x and y apart."""
        return float(np.hypot(np.ptp(self.chief_x_um, axis=-1), np.ptp(self.chief_y_um, -1)).max())

    @property
    def probes(self) -> tuple[int, ...]:
        """Fields that stand for all: the axis, the ends of the axes and, half-way, the corners."""
        across = len(self.field_x_deg)
        x0, y0 = (int(np.flatnonzero(a == 0)[0]) for a in (self.field_x_deg, self.field_y_deg))
        x1, y1 = across - 1, len(self.field_y_deg) - 1
        ends = [(x0, y0), (0, y0), (x1, y0), (x0, 0), (x0, y1)]
        half_x, half_y = ((a // 2, (a + b + 1) // 2) for a, b in ((x0, x1), (y0, y1)))
        half = [(x, y) for y in half_y for x in half_x]
        return tuple(y * across + x for x, y in ends + half)

    def field(self, number: int) -> FieldPsfs:
        """Return the PSFs of a field, counted row after row."""
        at = divmod(number, len(self.field_x_deg))
        chief = np.stack([self.chief_x_um[at], self.chief_y_um[at]], axis=-1)
        return FieldPsfs(
            self.psf[at], chief - chief[self.reference], self.relative_illumination[at]
        )

    def rays(self, number: int) -> FieldRays:
        """Return the rays of a field, counted row after row."""
        if self.chief is None or self.cone is None:
            raise no_rays(self.provenance)
        at = divmod(number, len(self.field_x_deg))
        place = np.stack([self.chief_x_um[at], self.chief_y_um[at]], axis=-1)[self.reference]
        return FieldRays(place, self.chief[at], self.cone[at])

    def places(self, reach_um: float) -> tuple[tuple[int, ...], FieldGrid]:
        """Return the fields as far as image points up to `reach_um` from the middle need them.

        And a PSF's half width farther, as light from there still reaches them.
        """
        turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
        reach_um += self.psf.shape[-1] / 2 * self.pitch_um
        rim = self.field_deg(reach_um * np.cos(turn), reach_um * np.sin(turn))
        x, y = (
            np.arange(
                # Two on either side of a point are of the nearest four.
                max(int(np.searchsorted(axis, angle.min(), "right")) - 2, 0),
                min(int(np.searchsorted(axis, angle.max())) + 2, len(axis)),
            )
            for axis, angle in zip((self.field_x_deg, self.field_y_deg), rim, strict=True)
        )
        numbers = (y[:, None] * len(self.field_x_deg) + x).ravel()
        grid = FieldGrid(self.field_x_deg[x], self.field_y_deg[y], self.field_deg)
        return tuple(int(number) for number in numbers), grid

    @functools.cached_property
    def plane_map(self) -> PlaneMap:
        """The map from the real to the ideal plane at the reference wavelength.

        Raises
        ------
        UserError
            Where the chief rays do not tell the map, or it folds over.
        """
        return PlaneMap(
            np.stack([self.ray_x_deg, self.ray_y_deg], axis=1),
            np.stack([self.ray_x_um, self.ray_y_um], axis=1),
            lambda theta: 1e3 * self.principal_distance_mm * self.projection.height(theta),
            self.centre_um,
            self.image_circle_um,
        )

    def ideal_points(
        self, x_um: np.ndarray, y_um: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x and y on the ideal plane of real image points, and which are in the circle.

        Beyond the circle they are those of the nearest point of its rim.
        """
        return self.plane_map.ideal_points(x_um, y_um)

    def field_deg(self, x_um: np.ndarray, y_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the field angles x and y of real image points; beyond the circle its rim's."""
        u, v, _ = self.plane_map.ideal_points(x_um, y_um)
        height = np.hypot(u, v)
        theta = self.projection.angle(height / (1e3 * self.principal_distance_mm))
        scale = np.degrees(theta) / np.maximum(height, 1e-9)
        return u * scale, v * scale

    def illumination_at(self, x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
        """Return the relative illumination at real image points, by wavelength first."""
        grid = FieldGrid(self.field_x_deg, self.field_y_deg, self.field_deg)
        table = self.relative_illumination.reshape(-1, len(self.wavelengths_nm))
        numbers, weights = grid.blended(x_um, y_um)
        # One after the other, because maps are large.
        light = sum(
            weights[..., one, None] * table[numbers[..., one]] for one in range(weights.shape[-1])
        )
        return np.moveaxis(light, -1, 0)

    def to_xarray(self) -> xarray.Dataset:
        """Return the bank as a dataset with units and meaning on every variable."""
        import xarray

        lens = f"{self.provenance['title']}; {self.provenance['history']}"
        texts = {"provenance": lens}
        variables = _VARIABLES | ({} if self.cone is None else _RAYS)
        variables |= {} if self.halo is None else _HALO
        variables |= {} if self.principal_mm is None else _FINITE
        data = {
            name: (dims, getattr(self, name), {"units": units, "long_name": meaning} | texts)
            for name, (dims, units, meaning) in variables.items()
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
    def load(cls, path: str | Path, *, sealed: bool = False) -> PlaneBank:
        """Read a bank that ``save`` wrote; where it must be ``sealed``, its checksum is there.

        Raises
        ------
        OSError, ValueError, KeyError
            Where the file is not a whole bank.
        """
        return cls(**load_dataset(path, _VARIABLES, _SCALARS, _RAYS | _HALO | _FINITE, sealed))


def holds_plane_bank(path: Path) -> bool:
    """Tell a bank over both directions of the field from one with an axis."""
    import h5py

    if path.suffix.lower() != ".nc":
        return False
    try:
        with h5py.File(path, "r") as file:
            return "field_x_deg" in file
    except (OSError, RuntimeError):  # the reader of banks says what is wrong with it
        return False


def load_plane_bank(path: Path) -> PlaneBank:
    """Read a saved bank over both directions of the field.

    Raises
    ------
    UserError
        Where the file is not a whole bank.
    """
    try:
        bank = PlaneBank.load(path)
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError) as error:
        raise UserError(
            f"not a whole bank: {' '.join(str(error).split())}",
            file=path,
            allowed="a NetCDF file as gpusim lens LENS --out bank.nc writes it",
        ) from error
    for name in _VARIABLES:
        if not np.isfinite(getattr(bank, name)).all():
            raise UserError(
                "the bank holds values that are no numbers",
                file=path,
                field=name,
                allowed="finite numbers",
            )
    rising = (bank.wavelengths_nm, bank.field_x_deg, bank.field_y_deg)
    if bank.reference_nm not in bank.wavelengths_nm or any((np.diff(a) <= 0).any() for a in rising):
        raise UserError(
            "the axes of the bank are in disorder",
            file=path,
            field="wavelengths_nm, field_x_deg, field_y_deg, reference_nm",
            allowed="rising, the reference among the wavelengths",
        )
    return bank


def default_sides_deg(prescription: Prescription, count: int = SIDE) -> np.ndarray:
    """Return an odd number of angles, evenly spaced, from the largest field to the other."""
    half = np.linspace(0, prescription.max_field_deg, (count + 1) // 2)
    return np.concatenate([-half[:0:-1], half])


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
    rays = _chief_rays(system, reference_nm, min(reach_deg, prescription.max_field_deg))
    fields = [(x, y) for y in y_deg for x in x_deg]
    rows = []
    # Fields in parallel, each on one BLAS thread: OpenBLAS's own threads wait by spinning.
    with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
        for row in pool.map(
            lambda f: field_of(system, wavelengths, f, size, pitch_um, reference_nm), fields
        ):
            rows.append(row)
            if progress is not None:
                progress(len(rows), len(fields))
    return bank_of(system, wavelengths, (x_deg, y_deg), rows, rays, reference_nm, pitch_um)


def bank_of(
    system: System,
    wavelengths: np.ndarray,
    sides_deg: tuple[np.ndarray, np.ndarray],
    rows: list[dict[str, np.ndarray]],
    rays: dict[str, np.ndarray],
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
        What `field_of` returns for each field, row after row.
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
    order = first_order(system.prescription, reference_nm)
    provenance = provenance_of(system)
    provenance["focus"] += ", found with every surface on the axis"
    return PlaneBank(
        wavelengths_nm=wavelengths,
        field_x_deg=x_deg,
        field_y_deg=y_deg,
        relative_illumination=light_sr / centre,
        projected_solid_angle_sr=centre,
        transmission=transmission(system.prescription, wavelengths),
        reference_nm=float(reference_nm),
        efl_mm=order.efl_mm,
        principal_mm=principal_mm(system.prescription, reference_nm),
        f_number=order.f_number,
        pitch_um=float(pitch_um),
        provenance=provenance,
        halo=halo,
        halo_pitch_um=pitches,
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


def _chief_rays(system: System, reference_nm: float, largest_deg: float) -> dict[str, np.ndarray]:
    """Trace as many chief rays as the map takes, by the names of the bank's variables."""
    count = RINGS
    while True:
        rays = _on_rings(system, reference_nm, largest_deg, count)
        if largest_deg == 0 or count == MOST_RINGS:
            return rays
        fields, landed = (
            np.stack([rays[f"ray_x_{unit}"], rays[f"ray_y_{unit}"]], axis=1)
            for unit in ("deg", "um")
        )
        if Rings(fields, landed).error_um <= MAP_ERROR_UM:
            return rays
        count *= 2


def _on_rings(
    system: System, reference_nm: float, largest_deg: float, count: int
) -> dict[str, np.ndarray]:
    """Trace the chief rays of the axis and of so many rings."""
    index = system.index(np.array([reference_nm]))
    rings_deg = largest_deg * np.sin(np.pi / 2 * np.arange(1, count + 1) / count)
    spokes = 2 * np.pi * np.arange(SPOKES) / SPOKES

    def land(field: tuple[float, float]) -> tuple[float, float]:
        found = sample_rays(system, index, np.radians(field[0]), MIDDLE, MIDDLE, field[1])
        return 1e3 * found.chief_x_mm[0], 1e3 * found.chief_y_mm[0]

    fields = [(0.0, 0.0)]
    if largest_deg > 0:
        fields += [(ring, spoke) for ring in rings_deg for spoke in spokes]
    with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
        landed = np.array(list(pool.map(land, fields)))
    if largest_deg > 0:
        grid = landed[1:].reshape(count, SPOKES, 2)
        inner = np.concatenate([np.broadcast_to(landed[0], (1, SPOKES, 2)), grid[:-1]])
        outwards, around = grid - inner, np.roll(grid, -1, axis=1) - grid
        # Azimuth runs from y towards x: outwards and around, in that order, turn clockwise.
        turns = outwards[..., 1] * around[..., 0] - outwards[..., 0] * around[..., 1]
        if turns.min() <= 0:
            ring = int(np.flatnonzero((turns <= 0).any(axis=1))[0])
            raise UserError(
                "distortion folds the image over: image height does not rise with field angle",
                file=system.prescription.file,
                field="max_field_deg",
                value=f"{largest_deg:g}",
                # The turn lies within the two rings before the one that has turned back.
                allowed=f"up to {rings_deg[ring - 2] if ring > 1 else 0:.4g} deg",
            )
    theta, azimuth = np.transpose(fields)
    return {
        "ray_x_deg": theta * np.sin(azimuth),
        "ray_y_deg": theta * np.cos(azimuth),
        "ray_x_um": landed[:, 0],
        "ray_y_um": landed[:, 1],
    }


def field_of(
    system: System,
    wavelengths: np.ndarray,
    field_deg: tuple[float, float],
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
    index = system.index(wavelengths)
    samples = sample_field(system, index, theta, azimuth)
    grids = pupils(samples, wavelengths, size * pitch_um, nodes)
    psf = np.empty((len(wavelengths), size, size), dtype=np.float32)
    outside, folded, core = np.zeros((3, len(wavelengths)))
    # As of a symmetric bank, whose PSFs are turned: so that a lens has the same light in both.
    radius_um = size / 2 * pitch_um
    distance_um = distances_um(size, pitch_um)
    inside, within = distance_um < radius_um, fall(distance_um, radius_um)
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
        window = intensity(pupil, wavelength, size, pitch_um)[0] * inside
        outside[w], core[w] = 1 - window.sum(), (window * within).sum()
        folded[w] = folded_share(pupil, wavelength, size, pitch_um)
        psf[w] = window.T
    in_stop = samples.margin[-1] < 0
    levels, beyond = field_halo(
        lambda line: wave_of(grids[line], 2), wavelengths, pitch_um, radius_um
    )
    return {
        "core": core,
        # Rows are x in the pupil, and y in the image.
        "levels": levels.swapaxes(-1, -2),
        "beyond": beyond,
        "chief_x_um": 1e3 * samples.chief_x_mm,
        "chief_y_um": 1e3 * samples.chief_y_mm,
        "chief": samples.chief_direction,
        "cone": np.stack([cone_of(g.alpha, g.beta, g.arriving, g.half) for g in grids]),
        "psf": psf,
        "light_sr": np.array([g.entered for g in grids])
        / stretch(system, reference_nm, theta, azimuth).area(),
        "outside_energy": outside,
        "folded_energy": folded,
        "fit_residual_waves": np.array([g.fit_residual_mm for g in grids]) / (wavelengths * 1e-6),
        "failed_rays": (~samples.ok & in_stop).sum(axis=1).astype(np.int32),
    }


def _check(
    prescription: Prescription,
    wavelengths: np.ndarray,
    x_deg: np.ndarray,
    y_deg: np.ndarray,
    reference_nm: float,
    size: int,
) -> None:
    """Refuse settings that make no bank."""
    if reference_nm not in wavelengths:
        raise UserError(
            "the reference wavelength is not one of the bank's",
            field="reference_nm",
            value=reference_nm,
            allowed=", ".join(f"{w:g}" for w in wavelengths),
        )
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

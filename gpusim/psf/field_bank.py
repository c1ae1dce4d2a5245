"""A bank: PSFs over field and wavelength with everything else that the chain needs of a lens.

The same of lenses that have an axis (`gpusim.psf.bank.Bank`) and of those that have none
(`gpusim.psf.plane_bank.PlaneBank`): fields have numbers, and what lies between them is the kind's
own. Stored as NetCDF-4 (readable from xarray, MATLAB, Julia), each variable with units and meaning,
and cached on disk under a hash of all that determines it.
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self, TypeVar

import numpy as np

from gpusim.lens.projection import RECTILINEAR, Projection
from gpusim.psf.cone import FieldRays, no_rays
from gpusim.psf.halo import split
from gpusim.psf.lines import CUBIC
from gpusim.psf.places import FieldPsfs, Places
from gpusim.psf.store import Table, dataset_of, load_dataset, save_dataset

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False, kw_only=True)
class FieldBank(ABC):
    """PSFs at fields that have numbers, and what lies between them.

    Fields lie along the first axes of an array, written F here: one axis of a lens with an axis,
    two of any other. L wavelengths, n x n samples.

    Attributes
    ----------
    wavelengths_nm : ndarray, shape (L,)
    reference_nm : float
        One of the wavelengths: its chief ray defines the real plane.
    psf : ndarray of float32, shape (F, L, n, n)
        Share of the light per sample: the sum is 1 less ``outside_energy``, and 1 where the light
        outside is not known. Sample j at (j - n / 2) pitch, centred on the chief ray of its own
        wavelength; 0 outside the circle in the window.
    relative_illumination : ndarray, shape (F, L)
    projected_solid_angle_sr, transmission : ndarray, shape (L,)
        In the middle of the field.
    outside_energy, folded_energy, fit_residual_waves, failed_rays : ndarray, shape (F, L)
        How good the PSFs are.
    efl_mm, f_number, pitch_um : float
    provenance : dict of str to str
        Lens, source, settings and choices in words.
    chief : ndarray, shape (F, L, 2), or None
        Direction cosines of the chief ray at the image, along the columns and the rows of the
        PSFs; None where a ready-made bank does not say.
    cone : ndarray of float32, shape (F, L, R, 3), or None
        Rays that arrive, with their share: see ``gpusim.psf.cone``.
    halo, halo_pitch_um : ndarray of float32, shape (K, F, L, m, m), and ndarray, shape (K,), or
        None
        Levels of coarser samples that hold what lands farther out: see ``gpusim.psf.halo``. They
        take over where the window's light is let out softly: see ``levels``.
    beyond_energy, halo_misfit : ndarray, shape (F, L), or None
    principal_mm : float, or None
        See ``principal_distance_mm``.
    spectral_degree : int
        Degree of the spline for what lies between the wavelengths: see ``gpusim.psf.lines``.
    projection : Projection
        How the scene lies on the ideal plane. It is no part of a file.
    """

    wavelengths_nm: np.ndarray
    reference_nm: float
    psf: np.ndarray
    relative_illumination: np.ndarray
    projected_solid_angle_sr: np.ndarray
    transmission: np.ndarray
    outside_energy: np.ndarray
    folded_energy: np.ndarray
    fit_residual_waves: np.ndarray
    failed_rays: np.ndarray
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
    spectral_degree: int = CUBIC
    projection: Projection = RECTILINEAR

    table: ClassVar[Table]  # what a file of the kind holds

    @property
    def principal_distance_mm(self) -> float:
        """Ideal image height over tan(theta): the focal length where all is set to infinity."""
        return self.efl_mm if self.principal_mm is None else float(self.principal_mm)

    @property
    def reference(self) -> int:
        """Index of the reference wavelength."""
        return int(np.flatnonzero(self.wavelengths_nm == self.reference_nm)[0])

    @functools.cached_property
    def levels(self) -> tuple[Self, ...]:
        """The bank as banks that add up, from the core outwards; without halo one.

        The core's PSFs fall to 0 towards the window's rim, where the first level takes over.
        """
        return split(self)

    @property
    @abstractmethod
    def landing_um(self) -> np.ndarray:
        """Where chief rays land (F, L, 2), along the columns and the rows of the PSFs."""

    @property
    def lateral_um(self) -> float:
        """Largest distance between the chief rays of two wavelengths at a field, x and y apart."""
        apart = np.ptp(self.landing_um, axis=-2)
        return float(np.hypot(apart[..., 0], apart[..., 1]).max())

    @property
    @abstractmethod
    def centre_um(self) -> tuple[float, float]:
        """x, y of the image circle's centre, from the middle of the sensor."""

    @property
    @abstractmethod
    def image_circle_um(self) -> float:
        """Radius of the image circle."""

    @property
    @abstractmethod
    def rectilinear_circle_um(self) -> float:
        """Radius of the part of the image circle that has a place on the ideal plane."""

    @property
    @abstractmethod
    def probes(self) -> tuple[int, ...]:
        """Fields that stand for all, the middle first."""

    @abstractmethod
    def at(self, number: int) -> tuple[int, ...]:
        """Return where the field of a number lies along the axes of the field."""

    def field(self, number: int) -> FieldPsfs:
        """Return the PSFs of a field."""
        at = self.at(number)
        landing = self.landing_um[at]
        shift = landing - landing[self.reference]
        return FieldPsfs(self.psf[at], shift, self.relative_illumination[at])

    def rays(self, number: int) -> FieldRays:
        """Return the rays of a field, in the frame of its PSFs.

        Raises
        ------
        UserError
            Where nobody said at which angles the light arrives.
        """
        if self.chief is None or self.cone is None:
            raise no_rays(self.provenance)
        at = self.at(number)
        return FieldRays(self.landing_um[at][self.reference], self.chief[at], self.cone[at])

    @abstractmethod
    def places(self, reach_um: float) -> tuple[tuple[int, ...], Places]:
        """Return the numbers of the fields that image points so far out need, and their places.

        The list that the places go with: a number occurs again where its field does, turned.
        """

    @abstractmethod
    def ideal_points(
        self, x_um: np.ndarray, y_um: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x and y on the ideal plane of real image points, and which are in the circle."""

    @abstractmethod
    def illumination_at(self, x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
        """Return the relative illumination at real image points, by wavelength first."""

    def to_xarray(self) -> xarray.Dataset:
        """Return the bank as a dataset with units and meaning on every variable."""
        size = self.psf.shape[-1]
        samples = (np.arange(size) - size // 2) * self.pitch_um
        axes = dict.fromkeys(self.table.variables["psf"][0][-2:], samples)
        lens = f"{self.provenance['title']}; {self.provenance['history']}"
        return dataset_of(self, self.table, axes, lens)

    def save(self, path: str | Path) -> None:
        """Write the bank as NetCDF: under a temporary name first, so never half a file."""
        save_dataset(self.to_xarray(), path)

    @classmethod
    def load(cls, path: str | Path, *, sealed: bool = False) -> Self:
        """Read a bank that ``save`` wrote; where it must be ``sealed``, its checksum is there.

        Raises
        ------
        OSError, ValueError, KeyError
            Where the file is not a whole bank.
        """
        return cls(**load_dataset(path, cls.table, sealed))


AnyBank = TypeVar("AnyBank", bound=FieldBank)


def seen_as(bank: AnyBank, projection: Projection) -> AnyBank:
    """Return a bank before a scene of another projection; as it is where it has that already."""
    return bank if bank.projection == projection else replace(bank, projection=projection)

"""What the chain asks of a bank: the same of lenses that have an axis and of those that have none.

`gpusim.psf.bank.Bank` and `gpusim.psf.plane_bank.PlaneBank` give it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np

from gpusim.lens.projection import Projection
from gpusim.psf.cone import FieldRays
from gpusim.psf.places import FieldPsfs, Places


class FieldBank(Protocol):
    """PSFs at fields that have numbers, and what lies between them.

    Attributes
    ----------
    wavelengths_nm : ndarray (L,)
    reference_nm, reference : float, int
        The wavelength whose chief ray defines the real plane, and its index.
    efl_mm, f_number : float
        As the lens is known.
    psf : ndarray (..., L, n, n)
    pitch_um : float
        Pitch of the PSFs' samples.
    projected_solid_angle_sr, transmission : ndarray (L,)
        On the axis.
    centre_um : (float, float)
        x, y of the image circle's centre, from the middle of the sensor.
    image_circle_um, rectilinear_circle_um : float
        Its radius, and that of the part that has a place on the ideal plane.
    lateral_um : float
        Largest distance between the chief rays of two wavelengths at a field.
    probes : tuple of int
        Fields that stand for all, the middle first.
    spectral_degree : int
        Degree of the spline for what lies between the wavelengths: see `gpusim.psf.lines`.
    projection : Projection
        How the scene lies on the ideal plane.
    """

    wavelengths_nm: np.ndarray
    reference_nm: float
    efl_mm: float
    f_number: float
    psf: np.ndarray
    pitch_um: float
    projected_solid_angle_sr: np.ndarray
    transmission: np.ndarray
    centre_um: tuple[float, float]
    spectral_degree: int
    projection: Projection

    @property
    def levels(self) -> tuple[FieldBank, ...]:
        """Banks that add up to this one: the core, and coarser ones of the light far from it."""

    @property
    def reference(self) -> int:
        """See above."""

    @property
    def image_circle_um(self) -> float:
        """See above."""

    @property
    def rectilinear_circle_um(self) -> float:
        """See above."""

    @property
    def lateral_um(self) -> float:
        """See above."""

    @property
    def probes(self) -> tuple[int, ...]:
        """See above."""

    def field(self, number: int) -> FieldPsfs:
        """Return the PSFs of a field."""

    def rays(self, number: int) -> FieldRays:
        """Return the rays of a field.

        Raises
        ------
        UserError
            Where nobody said at which angles the light arrives.
        """

    def places(self, reach_um: float) -> tuple[tuple[int, ...], Places]:
        """Return the numbers of the fields that image points so far out need, and their places.

        The list that the places go with: a number occurs again where its field does, turned.
        """

    def ideal_points(
        self, x_um: np.ndarray, y_um: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x and y on the ideal plane of real image points, and which are in the circle."""

    def illumination_at(self, x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
        """Return the relative illumination at real image points, by wavelength first."""


AnyBank = TypeVar("AnyBank", bound=FieldBank)


def seen_as(bank: AnyBank, projection: Projection) -> AnyBank:
    """Return a bank before a scene of another projection; as it is where it has that already."""
    return bank if bank.projection == projection else replace(bank, projection=projection)

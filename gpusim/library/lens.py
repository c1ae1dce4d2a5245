"""Lenses that one asks by hand: presets, files of other programs, fields of one's own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self

from pydantic import ValidationError

from gpusim.config.mistakes import user_error
from gpusim.formats.lens_file import load_prescription
from gpusim.formats.ready import ReadyLens, is_ready, load_ready
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import FirstOrder, first_order
from gpusim.library.views import Views

if TYPE_CHECKING:
    from pathlib import Path


class Lens(Views):
    """A lens by its surfaces: a `Prescription` that shows its PSF, MTF and layout.

    Made by `Lens.load`, or of the fields of a lens file: ``Lens(title=..., surfaces=[...], ...)``.
    Its methods give changed lenses: `scaled` to a focal length, `stopped` to an f-number, `limited`
    to a field, `looking` at a distance, `defocused`, `with_element_moved`.

    Raises
    ------
    UserError
        A field is wrong, unknown or missing.

    Examples
    --------
    >>> from gpusim import Lens
    >>> Lens.load("double-gauss")
    Lens('Double Gauss f/2 (Tronnier, Voigtlaender), 44 deg full field', 11 surfaces)
    """

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise user_error(error, type(self)) from error

    @classmethod
    def load(cls, name_or_path: str | Path) -> Lens | ReadyLens:
        """Return a lens of the package by its name, or that of a file.

        Parameters
        ----------
        name_or_path : str or path
            ``gpusim lens`` lists the names; YAML, Zemax .zmx, CODE V .seq and pbrt .dat are
            prescriptions; a bank (.nc, .npz), an ISETCam folder, Zemax's exports or an MTF table
            are ready-made PSFs, which can be used and not be changed: a `ReadyLens`.

        Raises
        ------
        UserError
            No such lens, or a field of the file is wrong.

        Examples
        --------
        >>> from gpusim import Lens
        >>> Lens.load("double-gauss").scaled(12.0).stopped(2.8).history[0]
        'every length multiplied by 0.119444868'
        """
        if is_ready(name_or_path):
            return load_ready(name_or_path)
        return cls.of(load_prescription(name_or_path))

    @classmethod
    def of(cls, prescription: Prescription) -> Self:
        """Return a prescription as one that shows itself; file, history and import log stay."""
        lens = cls.model_construct(prescription.model_fields_set)
        for name in ("__dict__", "__pydantic_private__"):
            object.__setattr__(lens, name, dict(getattr(prescription, name)))
        return lens

    def first_order(self, wavelength_nm: float | None = None) -> FirstOrder:
        """Return the paraxial lens: focal length, f-number, and where its pupils lie, in mm.

        Parameters
        ----------
        wavelength_nm : float, optional
            By default the lens's reference wavelength.

        Raises
        ------
        UserError
            A glass is unknown there, or the lens has no focal length greater than 0.

        Examples
        --------
        >>> from gpusim import Lens
        >>> paraxial = Lens.load("double-gauss").scaled(12.0).stopped(2.8).first_order()
        >>> round(paraxial.efl_mm, 6), round(paraxial.f_number, 6)
        (12.0, 2.8)
        """
        return first_order(self, wavelength_nm)

    def __repr__(self) -> str:
        return f"Lens({self.title!r}, {len(self.surfaces)} surfaces)"

    __str__ = __repr__

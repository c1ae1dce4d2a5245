"""Where lenses come from: presets, files of other programs, ready-made PSFs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gpusim.lens.prescription import Prescription, load_prescription
from gpusim.lens.ready import ReadyLens, is_ready, load_ready

if TYPE_CHECKING:
    from pathlib import Path


class Lens:
    """Makes lenses: a `Prescription`, which can be changed and traced, or a `ReadyLens`."""

    @staticmethod
    def load(name_or_path: str | Path) -> Prescription | ReadyLens:
        """Return a lens of the package by its name, or that of a file.

        Parameters
        ----------
        name_or_path : str or path
            ``gpusim lens`` lists the names; YAML, Zemax .zmx, CODE V .seq and pbrt .dat are
            prescriptions; a bank (.nc, .npz), an ISETCam folder, Zemax's exports or an MTF table
            are ready-made.

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
        return (
            load_ready(name_or_path) if is_ready(name_or_path) else load_prescription(name_or_path)
        )

    @staticmethod
    def of(**fields: object) -> Prescription:
        """Return a lens of the fields of a lens file: see `Prescription`.

        Raises
        ------
        pydantic.ValidationError
            A field is wrong, unknown or missing.
        """
        return Prescription(**fields)

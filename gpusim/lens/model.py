"""What is stated of a lens: surfaces, glasses, stop, aperture and field, with their source.

Lengths are in mm, angles in degrees; surface numbers count from 1, as lens designers count; the
object, at infinity or on a plane, and the image lie in air. What is computed of it is in
`gpusim.lens.system`; the class that users have, which can be scaled, stopped down and refocused, is
`gpusim.lens.prescription.Prescription`.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from gpusim.config.model import Strict, wrong
from gpusim.errors import UserError
from gpusim.known import Known
from gpusim.lens.glass import surface_known
from gpusim.lens.import_log import ImportLog
from gpusim.lens.surface import Coating, Surface

# Fields that state the aperture, of which a lens has one, and those that are lengths.
APERTURES = ("f_number", "entrance_pupil_diameter_mm", "stop_semi_diameter_mm", "object_na")
LENGTHS = (*APERTURES[1:3], "object_distance_mm", "focus_distance_mm")

MOVED = "image plane moved"  # a step of a lens's history begins so

Positive = Annotated[float, Field(gt=0)]


class Check(Strict):
    """A figure that the source states, to the tolerance that its printed digits allow."""

    quantity: Literal["efl_mm", "bfl_mm", "f_number", "entrance_pupil_diameter_mm"]
    value: float
    tolerance: float = Field(gt=0)
    indices: Literal["catalogue", "printed"] = "catalogue"


class LensModel(Strict):
    """The fields of a lens, and the changes that need no ray."""

    title: str
    patent: str | None = None
    source: str
    notes: str = ""
    units: Literal["mm"]
    glass_catalogues: tuple[str, ...] = ()
    nearest_glasses: bool = False  # in place of model glasses, of which nd and Vd alone are known
    design_wavelengths_nm: tuple[Positive, ...] = Field(
        (486.1327, 587.5618, 656.2725), min_length=1
    )
    reference_nm: float = Field(587.5618, gt=0)
    f_number: float | None = Field(None, gt=0)
    entrance_pupil_diameter_mm: float | None = Field(None, gt=0)
    stop_semi_diameter_mm: float | None = Field(None, gt=0)
    max_field_deg: float = Field(ge=0, lt=120)
    focus: Literal["best", "paraxial", "as-given"]
    focus_shift_um: float = 0.0  # of the image plane from that focus, away from the lens
    # From the first vertex; None: infinity. Focused on the object, or on another distance (.inf).
    object_distance_mm: float | None = Field(None, gt=0)
    focus_distance_mm: float | None = Field(None, gt=0, allow_inf_nan=True)
    object_na: float | None = Field(None, gt=0, lt=1)  # sine of the axial beam's half angle
    stop: int
    # G: the stop passes the amplitude exp(-G rho^2), rho from 0 at its centre to 1 at its rim. With
    # 100, 1/e is at a tenth of the rim: such a beam needs no stop.
    gaussian_apodisation: float = Field(0.0, ge=0, le=100)
    surfaces: tuple[Surface, ...] = Field(min_length=1)
    coating: Coating | None = None
    internal_transmission: bool = False  # whether glasses absorb, as far as their catalogues say
    checks: tuple[Check, ...] = ()

    _file: Path | None = PrivateAttr(None)
    _history: tuple[str, ...] = PrivateAttr(())
    _import_log: ImportLog = PrivateAttr(default_factory=ImportLog)
    _states_axis_alone: bool = PrivateAttr(False)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if sum(getattr(self, name) is not None for name in APERTURES) != 1:
            given = [name for name in APERTURES if getattr(self, name) is not None]
            raise wrong(
                "a lens has one aperture",
                f"one of {', '.join(APERTURES)}",
                field=", ".join(given or APERTURES),
                value=", ".join(f"{getattr(self, name):g}" for name in given) or "none",
            )
        if self.object_na is not None and self.object_distance_mm is None:
            raise wrong(
                "object_na has no meaning for an object at infinity",
                "with object_distance_mm",
                field="object_na",
                value=self.object_na,
            )
        if not 1 <= self.stop <= len(self.surfaces):
            raise wrong(
                "the stop is none of the surfaces",
                f"a surface number from 1 to {len(self.surfaces)}",
                field="stop",
                value=self.stop,
            )
        for number, surface in enumerate(self.surfaces[:-1], start=1):
            if surface.thickness is None:
                raise wrong(
                    "a thickness is missing",
                    "mm; the last surface alone may lack it",
                    field=f"surfaces.{number}.thickness",
                    value="none",
                )
        if self.surfaces[-1].glass is not None:
            raise wrong(
                "the image lies in air",
                "no glass behind the last surface",
                field=f"surfaces.{len(self.surfaces)}.glass",
                value=self.surfaces[-1].glass,
            )
        last = self.surfaces[-1].thickness
        if self.focus == "as-given" and (last is None or last <= 0):
            raise wrong(
                "focus: as-given takes the image plane from the last surface's thickness",
                "greater than 0 (mm), or focus: best or paraxial",
                field=f"surfaces.{len(self.surfaces)}.thickness",
                value="none" if last is None else last,
            )
        return self

    @property
    def file(self) -> Path | None:
        """The file that it was read from."""
        return self._file

    @property
    def focused_mm(self) -> float | None:
        """Distance that it is focused on, from the first vertex; None for infinity."""
        if self.focus_distance_mm is None:
            return self.object_distance_mm
        return self.focus_distance_mm if math.isfinite(self.focus_distance_mm) else None

    @property
    def import_log(self) -> ImportLog:
        """What the reader made of the file: rows of surface number or "file", what, how."""
        return self._import_log

    @property
    def states_axis_alone(self) -> bool:
        """Whether its file states no field but the axis, so that a use may choose one."""
        return self._states_axis_alone

    @property
    def history(self) -> tuple[str, ...]:
        """What was done since the file was read: one sentence for each step."""
        return self._history

    @property
    def is_centred(self) -> bool:
        """Whether no surface is decentred or tilted."""
        return all(surface.is_centred for surface in self.surfaces)

    @property
    def known(self) -> tuple[Known, ...]:
        """Over which wavelengths its glasses and coatings are known: those that end first."""
        found = [
            surface_known(surface, number, self.glass_catalogues, file=self.file)
            for number, surface in enumerate(self.surfaces, start=1)
        ]
        coatings = {"the lens's coating": self.coating} | {
            f"the coating of surface {number}": surface.coating
            for number, surface in enumerate(self.surfaces, start=1)
        }
        found += [
            Known(what, one.wavelength_nm[0], one.wavelength_nm[-1])
            for what, one in coatings.items()
            if isinstance(one, Coating)
        ]
        some = [one for one in found if one is not None]
        if not some:
            return ()
        ends = max(some, key=lambda one: one.first_nm), min(some, key=lambda one: one.last_nm)
        return tuple(dict.fromkeys(ends))

    def derived(self, step: str, **changes: object) -> Self:
        """Return a changed copy that remembers the step."""
        copy = self.model_copy(update=changes)
        copy._history = (*self._history, step)
        return copy

    def resized(self, factor: float) -> Self:
        """Return the lens with every length multiplied by a factor."""
        lengths = {
            name: None if getattr(self, name) is None else getattr(self, name) * factor
            for name in LENGTHS
        }
        return self.derived(
            f"every length multiplied by {factor:.9g}",
            surfaces=tuple(surface.scaled(factor) for surface in self.surfaces),
            focus_shift_um=self.focus_shift_um * factor,
            checks=(),  # they hold at the published size
            **lengths,
        )

    def defocused(self, shift_um: float) -> Self:
        """Return the lens with its image plane moved by a distance, > 0 away from the lens.

        Raises
        ------
        UserError
            Where ``shift_um`` is not a finite number.

        Examples
        --------
        >>> import gpusim as gs
        >>> gs.Lens.load("double-gauss").defocused(20.0).focus_shift_um
        20.0
        """
        if not math.isfinite(shift_um):
            raise UserError(
                "the image plane cannot be moved there",
                file=self.file,
                field="focus_shift_um",
                value=shift_um,
                allowed="a finite number of um",
            )
        return self.derived(
            f"{MOVED} by {shift_um:g} um away from the lens",
            focus_shift_um=self.focus_shift_um + shift_um,
        )

    def focused(self) -> Self:
        """Return the lens with its image plane in its focus: as if nobody had moved it."""
        copy = self.model_copy(update={"focus_shift_um": 0.0})
        copy._history = tuple(step for step in self._history if not step.startswith(MOVED))
        return copy

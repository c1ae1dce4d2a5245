"""What a lens is: surfaces, glasses, stop, aperture and field, with their source.

A prescription is plain data. Everything computed from it (indices, stop radius, missing clear
apertures, focus) is in ``system.py``. Lengths are in mm, angles in degrees; surface numbers count
from 1, as lens designers count; the object, at infinity or on a plane, and the image lie in air.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr, field_validator, model_validator

from gpusim.config.mistakes import checked
from gpusim.config.model import Strict
from gpusim.config.names import perhaps
from gpusim.config.text import read_bytes, yaml_of
from gpusim.errors import UserError
from gpusim.known import Known
from gpusim.lens.account import Account
from gpusim.lens.glass import FORMULAS

if TYPE_CHECKING:
    from gpusim.psf.field_bank import FieldBank

# Fields that state the aperture, of which a lens has one, and those that are lengths.
APERTURES = ("f_number", "entrance_pupil_diameter_mm", "stop_semi_diameter_mm", "object_na")
LENGTHS = (*APERTURES[1:3], "object_distance_mm", "focus_distance_mm")
ASPHERE_POWERS = tuple(range(2, 31, 2))  # r^2 to r^30: extended aspheres of phone lenses need them


class Asphere(Strict):
    """Even polynomial that is added to the sag of the conic: sum of a_k r^k, in mm^(1-k)."""

    a2: float = 0.0
    a4: float = 0.0
    a6: float = 0.0
    a8: float = 0.0
    a10: float = 0.0
    a12: float = 0.0
    a14: float = 0.0
    a16: float = 0.0
    a18: float = 0.0
    a20: float = 0.0
    a22: float = 0.0
    a24: float = 0.0
    a26: float = 0.0
    a28: float = 0.0
    a30: float = 0.0

    @property
    def coefficients(self) -> tuple[float, ...]:
        """a2, a4 ... a30."""
        return tuple(getattr(self, f"a{power}") for power in ASPHERE_POWERS)


class Dispersion(Strict):
    """The dispersion formula of a glass that no offline catalogue has.

    ``formula`` and ``coefficients`` as in a Zemax catalogue (``glass.FORMULAS``), for wavelengths
    in um; ``range_um`` is where they hold. ``absorption``: rows of wavelength in nm and the
    coefficient of absorption per mm, from the internal transmission that a catalogue states.
    """

    formula: int
    coefficients: tuple[float, ...] = Field(min_length=1, max_length=10)
    range_um: tuple[float, float]
    absorption: tuple[tuple[float, NotNegative], ...] | None = Field(None, min_length=1)

    @field_validator("formula")
    @classmethod
    def _known(cls, formula: int) -> int:
        if formula not in FORMULAS:
            raise ValueError(f"one of {', '.join(f'{n} {t}' for n, t in FORMULAS.items())}")
        return formula

    @field_validator("range_um")
    @classmethod
    def _ordered(cls, range_um: tuple[float, float]) -> tuple[float, float]:
        if not 0 < range_um[0] < range_um[1]:
            raise ValueError("two wavelengths in um, the shorter first")
        return range_um

    @field_validator("absorption")
    @classmethod
    def _rising(cls, rows: tuple[tuple[float, float], ...] | None):
        if any(a[0] >= b[0] for a, b in itertools.pairwise(((0.0, 0.0), *(rows or ())))):
            raise ValueError("wavelengths greater than 0, rising")
        return rows


TiltDeg = Annotated[float, Field(gt=-90, lt=90)]
NotNegative = Annotated[float, Field(ge=0)]
Reflectance = Annotated[float, Field(ge=0, lt=1)]


class Coating(Strict):
    """Reflectance by wavelength, at all angles: of one surface, or of all between glass and air."""

    wavelength_nm: tuple[float, ...] = Field(min_length=1)
    reflectance: tuple[Reflectance, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.wavelength_nm) != len(self.reflectance):
            raise ValueError("as many reflectances as wavelengths")
        if any(a >= b for a, b in itertools.pairwise((0.0, *self.wavelength_nm))):
            raise ValueError("wavelengths greater than 0, rising")
        return self


class Layer(Strict):
    """One layer of magnesium fluoride, a quarter of ``mgf2_nm`` thick at normal incidence."""

    mgf2_nm: float = Field(gt=0)


class Surface(Strict):
    """One surface and the space behind it.

    ``radius`` (``.inf`` is a plane) or ``curvature``; ``thickness`` to the next surface (in air it
    may be a step back); ``glass`` behind it (absent: air; ``model``: nd and vd rule, with
    ``dpgf``, how far P_g,F lies above the normal line, by default as most glasses of that vd;
    ``constant``: nd at every wavelength, for sources without dispersion; else a glass of a
    catalogue, or one with its own ``dispersion``, beside which nd and vd record what the source
    printed).

    ``decentre_mm`` [x, y] moves the vertex off the axis, then ``tilt_deg`` [ax, ay] turns the
    surface about its own vertex: by ax about x, then by ay about the y axis that was turned with
    it (R = Rx(ax) Ry(ay); right-handed: ax > 0 turns y towards z, ay > 0 turns z towards x). Each
    surface states its own: the surfaces that follow stay where they are.

    ``coating``: a curve, one layer of MgF2, or ``bare``, in place of the lens's; where a surface
    has one, all losses of the lens are those of each ray, at its angles.
    """

    radius: float | None = Field(None, allow_inf_nan=True)
    curvature: float | None = None
    thickness: float | None = None
    glass: str | None = Field(None, min_length=1)
    nd: float | None = Field(None, gt=1, lt=5)
    vd: float | None = Field(None, gt=5, lt=150)
    dpgf: float | None = Field(None, ge=-0.2, le=0.2)
    dispersion: Dispersion | None = None
    conic: float = 0.0
    asphere: Asphere = Asphere()
    semi_diameter: float | None = Field(None, gt=0)
    decentre_mm: tuple[float, float] = (0.0, 0.0)
    tilt_deg: tuple[TiltDeg, TiltDeg] = (0.0, 0.0)
    coating: Coating | Layer | Literal["bare"] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.radius is None) == (self.curvature is None):
            raise ValueError("give either radius or curvature")
        if self.radius is not None and (self.radius == 0 or math.isnan(self.radius)):
            raise ValueError("radius must not be 0 (a plane is .inf)")
        if self.glass == "constant":
            if self.nd is None or self.vd is not None:
                raise ValueError("a constant glass needs nd and no vd: it does not disperse")
        elif (self.nd is None) != (self.vd is None):
            raise ValueError("nd and vd come together")
        if self.glass is None and self.nd is not None:
            raise ValueError("nd and vd need a glass (glass: model uses them as they are)")
        if self.glass == "model" and self.nd is None:
            raise ValueError("a model glass needs nd and vd")
        if self.glass != "model" and self.dpgf is not None:
            raise ValueError("dpgf needs a model glass")
        if self.dispersion is not None and self.glass in (None, "model", "constant"):
            raise ValueError("a dispersion needs the name of its glass")
        # In air a step back is a way to place a diaphragm beside the vertex of a lens.
        if self.glass is not None and self.thickness is not None and self.thickness <= 0:
            raise ValueError("a glass thickness must be greater than 0")
        return self

    @property
    def vertex_curvature(self) -> float:
        """Curvature of the base conic in 1/mm."""
        return 1.0 / self.radius if self.curvature is None else self.curvature

    @property
    def is_centred(self) -> bool:
        """Whether it is neither decentred nor tilted."""
        return not any((*self.decentre_mm, *self.tilt_deg))

    @property
    def rotation(self) -> np.ndarray:
        """Rotation from the surface's own frame to that of the lens, shape (3, 3)."""
        return tilt_matrix(self.tilt_deg)

    def scaled(self, factor: float) -> Surface:
        """Return the same shape, larger by a factor."""
        asphere = {
            f"a{power}": a * factor ** (1 - power)
            for power, a in zip(ASPHERE_POWERS, self.asphere.coefficients, strict=True)
        }
        return self.model_copy(
            update={
                "radius": None if self.radius is None else self.radius * factor,
                "curvature": None if self.curvature is None else self.curvature / factor,
                "thickness": None if self.thickness is None else self.thickness * factor,
                "semi_diameter": None
                if self.semi_diameter is None
                else self.semi_diameter * factor,
                "asphere": Asphere(**asphere),
                "decentre_mm": tuple(factor * d for d in self.decentre_mm),
            }
        )


class Check(Strict):
    """A figure that the source states, to the tolerance that its printed digits allow."""

    quantity: Literal["efl_mm", "bfl_mm", "f_number", "entrance_pupil_diameter_mm"]
    value: float
    tolerance: float = Field(gt=0)
    indices: Literal["catalogue", "printed"] = "catalogue"


class Prescription(Strict):
    """A lens as published. ``load_prescription`` makes one; the methods derive others."""

    title: str
    patent: str | None
    source: str
    notes: str = ""
    units: Literal["mm"]
    glass_catalogues: tuple[str, ...] = ()
    nearest_glasses: bool = False  # in place of model glasses, of which nd and Vd alone are known
    design_wavelengths_nm: tuple[float, ...] = Field((486.1327, 587.5618, 656.2725), min_length=1)
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
    _account: Account = PrivateAttr(default_factory=Account)
    _states_axis_alone: bool = PrivateAttr(False)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if sum(getattr(self, name) is not None for name in APERTURES) != 1:
            raise ValueError(f"give one of {', '.join(APERTURES)}")
        if self.object_na is not None and self.object_distance_mm is None:
            raise ValueError("object_na needs object_distance_mm: at infinity it has no meaning")
        if not 1 <= self.stop <= len(self.surfaces):
            raise ValueError(f"stop must be a surface number from 1 to {len(self.surfaces)}")
        if any(w <= 0 for w in self.design_wavelengths_nm):
            raise ValueError("design_wavelengths_nm must be greater than 0")
        for number, surface in enumerate(self.surfaces[:-1], start=1):
            if surface.thickness is None:
                raise ValueError(f"surface {number} needs a thickness (only the last may lack it)")
        if self.surfaces[-1].glass is not None:
            raise ValueError("the last surface must have air behind it: the image lies in air")
        last = self.surfaces[-1].thickness
        if self.focus == "as-given" and (last is None or last <= 0):
            raise ValueError("focus: as-given needs a thickness > 0 behind the last surface")
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
    def account(self) -> Account:
        """What the reader made of the file: rows of surface number or "file", what, how."""
        return self._account

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
        from gpusim.lens.glass import surface_known

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

    def bank(
        self, progress: Callable[[int, int], None] | None = None, **sampling: np.ndarray
    ) -> FieldBank:
        """Return its PSF bank, from the cache on disk where it is there.

        Over both directions of the field where a surface is decentred or tilted. ``sampling``:
        ``field_deg`` and ``wavelengths_nm``, in place of the default ones.
        """
        from gpusim.psf.bank import cached_bank
        from gpusim.psf.plane_bank import cached_plane_bank

        cached = cached_bank if self.is_centred else cached_plane_bank
        return cached(self, progress=progress, **sampling)

    def derived(self, step: str, **changes: object) -> Prescription:
        """Return a changed copy that remembers the step."""
        copy = self.model_copy(update=changes)
        copy._history = (*self._history, step)
        return copy

    def resized(self, factor: float) -> Prescription:
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

    def scaled(self, efl_mm: float) -> Prescription:
        """Return the lens scaled to a focal length at its reference wavelength.

        Raises
        ------
        UserError
            Where ``efl_mm`` is not greater than 0.
        """
        from gpusim.lens.system import first_order

        if not (math.isfinite(efl_mm) and efl_mm > 0):
            raise UserError(
                "a focal length must be greater than 0 mm",
                file=self.file,
                field="efl_mm",
                value=efl_mm,
                allowed="> 0",
            )
        return self.resized(efl_mm / first_order(self).efl_mm)

    def stopped(self, f_number: float) -> Prescription:
        """Return the lens with its stop closed to an f-number; the glass keeps its size.

        An apodising filter keeps its size too: the smaller stop passes its middle.

        Raises
        ------
        UserError
            Where the lens does not open so far.
        """
        from gpusim.lens.system import first_order, with_clear_apertures

        widest = first_order(self).f_number
        # The stop may be asked to be where it is already, to the digits that f-numbers have.
        if not (math.isfinite(f_number) and f_number >= widest * (1 - 1e-3)):
            raise UserError(
                "the lens does not open to this f-number",
                file=self.file,
                field="f_number",
                value=f_number,
                allowed=f">= {widest:.4g}",
            )
        return with_clear_apertures(self).derived(
            f"stop closed to f/{f_number:g}",
            gaussian_apodisation=self.gaussian_apodisation * min(1.0, widest / f_number) ** 2,
            **(dict.fromkeys(APERTURES) | {"f_number": float(f_number)}),
        )

    def defocused(self, shift_um: float) -> Prescription:
        """Return the lens with its image plane moved by a distance, > 0 away from the lens.

        Raises
        ------
        UserError
            Where ``shift_um`` is not a finite number.
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
            f"image plane moved by {shift_um:g} um away from the lens",
            focus_shift_um=self.focus_shift_um + shift_um,
        )

    def looking(
        self, object_distance_m: float | None = None, focus_distance_m: float | None = None
    ) -> Prescription:
        """Return the lens with its object and its focus at other distances from its first vertex.

        The lens, or the image plane, is moved until the focus lies there: the stop keeps its size,
        so that an f-number is that of an object at infinity, as cameras mark it.

        Parameters
        ----------
        object_distance_m : float, optional
            Distance of the object plane; infinity is allowed too. By default it stays as it is.
        focus_distance_m : float, optional
            Distance that the lens is focused on; infinity is allowed too. By default the lens
            focuses on the object, unless it has another distance.

        Raises
        ------
        UserError
            Where a distance is not greater than 0, or the lens forms no real image of what it is
            focused on.
        """
        from gpusim.lens.system import conjugates, first_order, with_clear_apertures

        changes, steps = {}, []
        for name, given in (("object", object_distance_m), ("focus", focus_distance_m)):
            if given is None:
                continue
            if not given > 0:
                raise UserError(
                    f"the distance of the {name} is not greater than 0",
                    file=self.file,
                    field=f"{name}_distance_m",
                    value=given,
                    allowed="> 0 m from the first surface, infinity too",
                )
            changes[f"{name}_distance_mm"] = 1e3 * given
            steps.append(f"{'focused' if name == 'focus' else 'object'} at {given:g} m")
        if changes.get("object_distance_mm") == math.inf:
            changes["object_distance_mm"] = None
        aperture = {}
        if self.f_number is None and self.stop_semi_diameter_mm is None:
            aperture = dict.fromkeys(APERTURES) | {"f_number": first_order(self).f_number}
        lens = with_clear_apertures(self).derived(", ".join(steps), **aperture, **changes)
        moved = conjugates(lens).image_mm
        if lens.focus != "as-given":
            return lens
        # The plane keeps its distance from the paraxial focus.
        *others, last = lens.surfaces
        thickness = last.thickness + moved - conjugates(self).image_mm
        surfaces = (*others, last.model_copy(update={"thickness": thickness}))
        return lens.model_copy(update={"surfaces": surfaces})

    def absorbing(self) -> Prescription:
        """Return the lens with glasses that absorb; the account names those without data."""
        from gpusim.lens.throughput import without_data

        for number, name in without_data(self).items():
            what = f"glass {name}: its internal transmission, of which there are no data, by 1"
            self.account.substituted(number, what)
        return self.derived("glasses absorb", internal_transmission=True)

    def with_nearest_glasses(self) -> Prescription:
        """Return the lens with each model glass by the nearest one of the glass catalogues.

        See ``gpusim.lens.model_glass``; a model glass that has none near it stays.
        """
        from gpusim.lens.model_glass import with_nearest

        return with_nearest(self)

    def limited(self, max_field_deg: float) -> Prescription:
        """Return the lens used over a smaller field; the glass keeps its size.

        A lens whose file states the axis alone takes any field that it passes.

        Raises
        ------
        UserError
            Where the field is beyond the published one.
        """
        from gpusim.lens.system import with_clear_apertures

        if self.states_axis_alone and 0 < max_field_deg < 90:
            return self.derived(
                f"field of {max_field_deg:g} deg chosen", max_field_deg=float(max_field_deg)
            )
        if not 0 <= max_field_deg <= self.max_field_deg:
            raise UserError(
                "the field lies beyond the lens",
                file=self.file,
                field="max_field_deg",
                value=max_field_deg,
                allowed=f"0 to {self.max_field_deg:g}",
            )
        return with_clear_apertures(self).derived(
            f"field limited to {max_field_deg:g} deg", max_field_deg=float(max_field_deg)
        )

    def with_element_moved(
        self,
        first: int,
        last: int,
        decentre_mm: tuple[float, float] = (0.0, 0.0),
        tilt_deg: tuple[float, float] = (0.0, 0.0),
    ) -> Prescription:
        """Return the lens with an element decentred and tilted as one rigid body.

        Parameters
        ----------
        first, last : int
            Numbers of its first and last surface, from 1.
        decentre_mm, tilt_deg : tuple of float
            As for a ``Surface``, about the vertex of the first one. The vertices behind it move
            along the axis too: the spaces there take up the difference, so that everything else,
            the image plane with it, stays where it is.

        Raises
        ------
        UserError
            Where there are no such surfaces, or a surface would be turned by 90 deg or more.
        """
        from gpusim.lens.system import with_clear_apertures

        count = len(self.surfaces)
        if not 1 <= first <= last <= count:
            raise UserError(
                "no such element",
                file=self.file,
                field="surfaces",
                value=f"{first} to {last}",
                allowed=f"surface numbers from 1 to {count}, the first not after the last",
            )
        lens = with_clear_apertures(self)  # the glass keeps its size
        surfaces, turn = list(lens.surfaces), tilt_matrix(tilt_deg)
        pivot = np.array([*surfaces[first - 1].decentre_mm, 0.0])
        z, moved_by = 0.0, np.zeros(count + 1)  # along the axis; the image plane is last
        for i in range(first - 1, last):
            arm = np.array([*surfaces[i].decentre_mm, z]) - pivot
            place = pivot + turn @ arm + np.array([*decentre_mm, 0.0])
            moved_by[i] = place[2] - z
            # A surface of revolution is turned by where its axis points.
            ax, ay, az = turn @ surfaces[i].rotation[:, 2]
            tilt = (math.degrees(math.atan2(-ay, az)), math.degrees(math.asin(ax)))
            if not max(abs(a) for a in tilt) < 90:
                raise UserError(
                    "the element is turned too far",
                    file=self.file,
                    field=f"surfaces.{i + 1}.tilt_deg",
                    value=f"{tilt[0]:g}, {tilt[1]:g}",
                    allowed="less than 90",
                )
            z += surfaces[i].thickness or 0.0
            surfaces[i] = surfaces[i].model_copy(
                update={"decentre_mm": (float(place[0]), float(place[1])), "tilt_deg": tilt}
            )
        for i in range(count):
            if surfaces[i].thickness is not None:
                longer = float(moved_by[i + 1] - moved_by[i])
                thickness = surfaces[i].thickness + longer
                surfaces[i] = surfaces[i].model_copy(update={"thickness": thickness})
        x, y = decentre_mm
        return lens.derived(
            f"surfaces {first} to {last} decentred by {x:g}, {y:g} mm and tilted by "
            f"{tilt_deg[0]:g}, {tilt_deg[1]:g} deg about the vertex of surface {first}",
            surfaces=tuple(surfaces),
        )


def tilt_matrix(tilt_deg: tuple[float, float]) -> np.ndarray:
    """Return Rx(ax) Ry(ay), shape (3, 3): by ax about x, then by ay about the turned y axis."""
    (sx, sy), (cx, cy) = np.sin(np.radians(tilt_deg)), np.cos(np.radians(tilt_deg))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return about_x @ about_y


def presets() -> dict[str, Path]:
    """Return the lenses that come with the package: name to file."""
    folder = Path(str(resources.files("gpusim") / "data" / "lenses"))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_prescription(name_or_path: str | Path) -> Prescription:
    """Read a lens: a preset's name, or a file.

    Files are the project's own ``.yaml``, Zemax ``.zmx``, CODE V ``.seq`` and pbrt ``.dat``.

    Raises
    ------
    UserError
        Where there is no such lens, or the file is not a complete prescription: names the file,
        the field, its value and what is allowed.
    """
    known = presets()
    path = known.get(str(name_or_path), Path(name_or_path))
    reader = _reader(path.suffix.lower())
    if reader is None:
        raise UserError(
            f"no such lens{perhaps(name_or_path, known)}",
            field="lens",
            value=name_or_path,
            allowed=f"a {KINDS} file, or a preset: {', '.join(known)}",
        )
    content = read_bytes(
        path, "the lens file", allowed=f"a readable {KINDS} file, or a preset: {', '.join(known)}"
    )
    lens = reader(content, path)
    if lens.nearest_glasses:
        lens = lens.with_nearest_glasses()
    if lens.internal_transmission:
        lens = lens.absorbing()
    if lens.max_field_deg == 0:
        from gpusim.formats.imported import with_small_field

        lens = with_small_field(lens)
    return lens


KINDS = ".yaml, .zmx, .seq or .dat"


def _reader(suffix: str) -> Callable[[bytes, Path], Prescription] | None:
    """Return the reader of a kind of lens file."""
    if suffix in (".yaml", ".yml"):
        return _parse_yaml
    if suffix == ".zmx":
        from gpusim.formats.zmx import parse_zmx

        return parse_zmx
    if suffix == ".seq":
        from gpusim.formats.seq import parse_seq

        return parse_seq
    if suffix == ".dat":
        from gpusim.formats.pbrt import parse_pbrt

        return parse_pbrt
    return None


def _parse_yaml(content: bytes, path: Path) -> Prescription:
    data = yaml_of(content, path, "the lens file")
    from gpusim.formats.agf import with_file_catalogues

    lens = with_file_catalogues(validated(data, path))
    given = [name for name in data if name not in ("surfaces", "checks")]
    lens.account.read("file", ", ".join(given))
    for number, (row, surface) in enumerate(
        zip(data["surfaces"], lens.surfaces, strict=True), start=1
    ):
        printed = surface.glass not in (None, "model", "constant") and surface.nd is not None
        lens.account.read(
            number, ", ".join(key for key in row if not (printed and key in ("nd", "vd")))
        )
        if printed:
            lens.account.ignored(number, f"nd, vd: the index is that of glass {surface.glass}")
    return lens


def validated(data: object, file: Path) -> Prescription:
    """Return the prescription in ``data``, or one UserError that names the first wrong field."""
    prescription = checked(Prescription, data, file)
    prescription._file = file
    return prescription

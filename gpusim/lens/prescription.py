"""What a lens is: surfaces, glasses, stop, aperture and field, with their source.

A prescription is plain data. Everything computed from it (indices, stop radius, missing clear
apertures, focus) is in ``system.py``. Lengths are in mm, angles in degrees; surface numbers count
from 1, as lens designers count; the object is at infinity in air and the image lies in air.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

import yaml
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    field_validator,
    model_validator,
)

from gpusim.errors import UserError
from gpusim.lens.account import Account
from gpusim.lens.glass import FORMULAS

if TYPE_CHECKING:
    from gpusim.lens.bank import Bank

ASPHERE_POWERS = tuple(range(2, 31, 2))  # r^2 to r^30: extended aspheres of phone lenses need them


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Asphere(_Strict):
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


class Dispersion(_Strict):
    """The dispersion formula of a glass that no offline catalogue has.

    ``formula`` and ``coefficients`` as in a Zemax catalogue (``glass.FORMULAS``), for wavelengths
    in um; ``range_um`` is where they hold.
    """

    formula: int
    coefficients: tuple[float, ...] = Field(min_length=1, max_length=10)
    range_um: tuple[float, float]

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


class Surface(_Strict):
    """One surface and the space behind it.

    ``radius`` (``.inf`` is a plane) or ``curvature``; ``thickness`` to the next surface (in air it
    may be a step back); ``glass`` behind it (absent: air; ``model``: nd and vd rule; ``constant``:
    nd at every wavelength, for sources without dispersion; else a glass of a catalogue, or one with
    its own ``dispersion``, beside which nd and vd record what the source printed).
    """

    radius: float | None = Field(None, allow_inf_nan=True)
    curvature: float | None = None
    thickness: float | None = None
    glass: str | None = Field(None, min_length=1)
    nd: float | None = Field(None, gt=1, lt=5)
    vd: float | None = Field(None, gt=5, lt=150)
    dispersion: Dispersion | None = None
    conic: float = 0.0
    asphere: Asphere = Asphere()
    semi_diameter: float | None = Field(None, gt=0)

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
            }
        )


class Check(_Strict):
    """A figure that the source states, to the tolerance that its printed digits allow."""

    quantity: Literal["efl_mm", "bfl_mm", "f_number", "entrance_pupil_diameter_mm"]
    value: float
    tolerance: float = Field(gt=0)
    indices: Literal["catalogue", "printed"] = "catalogue"


class Prescription(_Strict):
    """A lens as published. ``load_prescription`` makes one; the methods derive others."""

    title: str
    patent: str | None
    source: str
    notes: str = ""
    units: Literal["mm"]
    glass_catalogues: tuple[str, ...] = ()
    design_wavelengths_nm: tuple[float, ...] = Field((486.1327, 587.5618, 656.2725), min_length=1)
    reference_nm: float = Field(587.5618, gt=0)
    f_number: float | None = Field(None, gt=0)
    entrance_pupil_diameter_mm: float | None = Field(None, gt=0)
    stop_semi_diameter_mm: float | None = Field(None, gt=0)
    max_field_deg: float = Field(ge=0, lt=120)
    focus: Literal["best", "paraxial", "as-given"]
    stop: int
    surfaces: tuple[Surface, ...] = Field(min_length=1)
    checks: tuple[Check, ...] = ()

    _file: Path | None = PrivateAttr(None)
    _history: tuple[str, ...] = PrivateAttr(())
    _account: Account = PrivateAttr(default_factory=Account)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        apertures = (self.f_number, self.entrance_pupil_diameter_mm, self.stop_semi_diameter_mm)
        if sum(a is not None for a in apertures) != 1:
            raise ValueError(
                "give one of f_number, entrance_pupil_diameter_mm, stop_semi_diameter_mm"
            )
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
    def account(self) -> Account:
        """What the reader made of the file: rows of surface number or "file", what, how."""
        return self._account

    @property
    def history(self) -> tuple[str, ...]:
        """What was done since the file was read: one sentence for each step."""
        return self._history

    def bank(self, progress: Callable[[int, int], None] | None = None) -> Bank:
        """Return its PSF bank, from the cache on disk where it is there."""
        from gpusim.lens.bank import cached_bank

        return cached_bank(self, progress=progress)

    def derived(self, step: str, **changes: object) -> Prescription:
        """Return a changed copy that remembers the step."""
        copy = self.model_copy(update=changes)
        copy._history = (*self._history, step)
        return copy

    def resized(self, factor: float) -> Prescription:
        """Return the lens with every length multiplied by a factor."""
        lengths = {
            name: None if getattr(self, name) is None else getattr(self, name) * factor
            for name in ("entrance_pupil_diameter_mm", "stop_semi_diameter_mm")
        }
        return self.derived(
            f"every length multiplied by {factor:.9g}",
            surfaces=tuple(surface.scaled(factor) for surface in self.surfaces),
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
            f_number=float(f_number),
            entrance_pupil_diameter_mm=None,
            stop_semi_diameter_mm=None,
        )

    def limited(self, max_field_deg: float) -> Prescription:
        """Return the lens used over a smaller field; the glass keeps its size.

        Raises
        ------
        UserError
            Where the field is beyond the published one.
        """
        from gpusim.lens.system import with_clear_apertures

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
            "no such lens",
            field="lens",
            value=name_or_path,
            allowed=f"a {KINDS} file, or a preset: {', '.join(known)}",
        )
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UserError(
            f"the lens file cannot be read: {error.strerror}",
            file=path,
            allowed=f"a readable {KINDS} file, or a preset: {', '.join(known)}",
        ) from error
    return reader(content, path)


KINDS = ".yaml, .zmx, .seq or .dat"


def _reader(suffix: str) -> Callable[[bytes, Path], Prescription] | None:
    """Return the reader of a kind of lens file."""
    if suffix in (".yaml", ".yml"):
        return _parse_yaml
    if suffix == ".zmx":
        from gpusim.lens.zmx import parse_zmx

        return parse_zmx
    if suffix == ".seq":
        from gpusim.lens.seq import parse_seq

        return parse_seq
    if suffix == ".dat":
        from gpusim.lens.pbrt import parse_pbrt

        return parse_pbrt
    return None


def _parse_yaml(content: bytes, path: Path) -> Prescription:
    try:
        data = yaml.safe_load(content.decode("utf-8"))
    # ValueError: wrong bytes, and dates and numbers that look like such and are none.
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        problem = " ".join(str(error).split())
        raise UserError(
            f"not a YAML file: {problem}", file=path, allowed="a prescription"
        ) from error
    from gpusim.lens.agf import with_file_catalogues

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
    if not isinstance(data, dict):
        raise UserError(
            "the file holds no prescription",
            file=file,
            value=type(data).__name__,
            allowed=f"a mapping with the fields {', '.join(Prescription.model_fields)}",
        )
    try:
        prescription = Prescription.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = _numbered(first["loc"])
        model = {"surfaces": Surface, "checks": Check}.get(place.split(".")[0], Prescription)
        if first["type"] == "extra_forbidden":
            problem = "this field is not known"
            allowed = ", ".join(model.model_fields)
        elif first["type"] == "missing":
            problem = "a field is missing"
            allowed = f"{place} must be given"
        else:
            problem = "a field is wrong"
            allowed = first["msg"].removeprefix("Value error, ")
        value = first["input"]
        raise UserError(
            problem,
            file=file,
            field=place or None,
            value=value if isinstance(value, str | int | float) else None,
            allowed=allowed,
        ) from error
    prescription._file = file
    return prescription


def _numbered(location: tuple[str | int, ...]) -> str:
    """Dotted place of a field, list entries counted from 1 as surfaces are."""
    return ".".join(str(part + 1) if isinstance(part, int) else part for part in location)

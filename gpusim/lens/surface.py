"""What a surface of a lens is: its shape, the glass behind it, its coating and its place.

Lengths are in mm, angles in degrees.
"""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from gpusim.config.model import Strict, wrong
from gpusim.lens.dispersion import FORMULAS

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

    ``formula`` and ``coefficients`` as in a Zemax catalogue (``dispersion.FORMULAS``), for
    wavelengths in um; ``range_um`` is where they hold. ``absorption``: rows of wavelength in nm and
    the coefficient of absorption per mm, from the internal transmission that a catalogue states.
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
            given = "none" if self.radius is None else f"{self.radius:g}, {self.curvature:g}"
            allowed = "one of the two: radius in mm, or curvature in 1/mm"
            raise wrong("a shape is given once", allowed, field="radius, curvature", value=given)
        if self.radius is not None and (self.radius == 0 or math.isnan(self.radius)):
            allowed = "mm, not 0; a plane is .inf"
            raise wrong("no surface has this radius", allowed, field="radius", value=self.radius)
        self._check_glass()
        # In air a step back is a way to place a diaphragm beside the vertex of a lens.
        if self.glass is not None and self.thickness is not None and self.thickness <= 0:
            raise wrong(
                "a glass has a thickness",
                "greater than 0 (mm)",
                field="thickness",
                value=self.thickness,
            )
        return self

    def _check_glass(self) -> None:
        given = {name: getattr(self, name) for name in ("nd", "vd", "dpgf")}
        values = ", ".join(f"{name}: {v:g}" for name, v in given.items() if v is not None)
        numbers = values or "no nd, no vd"
        if self.glass == "constant":
            if self.nd is None or self.vd is not None:
                allowed = "nd alone: it does not disperse"
                raise wrong("a constant glass has one index", allowed, field="nd", value=numbers)
        elif (self.nd is None) != (self.vd is None):
            raise wrong("half of a glass is given", "both nd and vd", field="nd, vd", value=numbers)
        if self.glass is None and self.nd is not None:
            allowed = "a glass's name, or model, which takes nd and vd as they are"
            raise wrong("nd and vd are of no glass", allowed, field="glass", value="none")
        if self.glass == "model" and self.nd is None:
            raise wrong("a model glass lacks its numbers", "nd and vd", field="nd", value="none")
        if self.glass != "model" and self.dpgf is not None:
            raise wrong(
                "dpgf is a model glass's", "glass: model", field="glass", value=self.glass or "none"
            )
        if self.dispersion is not None and self.glass in (None, "model", "constant"):
            raise wrong(
                "a dispersion is of no glass",
                "the name of its glass",
                field="glass",
                value=self.glass or "none",
            )

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


def tilt_matrix(tilt_deg: tuple[float, float]) -> np.ndarray:
    """Return Rx(ax) Ry(ay), shape (3, 3): by ax about x, then by ay about the turned y axis."""
    (sx, sy), (cx, cy) = np.sin(np.radians(tilt_deg)), np.cos(np.radians(tilt_deg))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return about_x @ about_y

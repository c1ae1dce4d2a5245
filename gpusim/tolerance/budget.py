"""A tolerance budget: which numbers of a lens vary, how, and what the camera must still do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gpusim.batch.axes import Axis, combined
from gpusim.camera import Camera
from gpusim.config.mistakes import checked
from gpusim.config.model import Strict, Table
from gpusim.config.text import read_yaml
from gpusim.errors import UserError
from gpusim.lens.perturb import OF_ELEMENT, OF_SURFACE, names_part, parts
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build

# Shares of a normal law one standard deviation from its middle.
ONE_SIGMA = (0.15865525, 0.84134475)


class Budget(Strict):
    """What varies.

    Attributes
    ----------
    tolerances : dict of str to Axis
        By number of the lens (`gpusim.lens.perturb`), its change as a distribution.
    samples : int
        Lenses that are drawn.
    sampler, random_seed
        As of a sweep.
    compensator : "focus" or None
        Whether each camera is focused after it was put together.
    field : float
        Where the eight outer places lie, on the way from the middle to the sensor's edges.
    traced_percent : float
        Samples whose wavefront is traced too, to say how well the differentials agree.
    required_cy_px : float, optional
        Least MTF50 of a camera's worst edge that passes.
    raws : bool
        Whether the design and the camera below which five in a hundred lie are rendered.
    """

    tolerances: Table[Axis] = Field(min_length=1)
    samples: Annotated[int, Field(ge=1, le=100_000)] = 200
    sampler: Literal["random", "sobol"] = "sobol"
    random_seed: Annotated[int, Field(ge=0)] = 0
    compensator: Literal["focus"] | None = "focus"
    field: Annotated[float, Field(gt=0, le=1)] = 0.8
    traced_percent: Annotated[float, Field(ge=0, le=100)] = 5.0
    required_cy_px: Annotated[float, Field(gt=0, lt=1)] | None = None
    raws: bool = True

    @model_validator(mode="after")
    def _known(self) -> Self:
        for name, axis in self.tolerances.items():
            if not names_part(name, several=True):
                raise ValueError(
                    f"tolerances.{name}: NUMBER.WHAT or all.WHAT with {', '.join(OF_SURFACE)}; "
                    f"element.FIRST-LAST.WHAT or element.all.WHAT with {', '.join(OF_ELEMENT)}"
                )
            if not axis.is_drawn or axis.log_uniform is not None:
                raise ValueError(f"tolerances.{name}: uniform or normal, about a change of 0")
        return self

    @classmethod
    def load(cls, path: Path) -> Budget:
        """Read a budget from a YAML file.

        Raises
        ------
        UserError
            No such file, or a field that is wrong.
        """
        return checked(cls, read_yaml(path, "the tolerance budget"), path)

    def axes(self, lens: Prescription) -> dict[str, Axis]:
        """Return the distribution of each number of a lens, ``all`` spelled out.

        Raises
        ------
        UserError
            A name that stands for no number of the lens.
        """
        found: dict[str, Axis] = {}
        for name, axis in self.tolerances.items():
            own = parts(lens, name)
            if not own:
                raise UserError("the lens has none", field=f"tolerances.{name}", allowed="a number")
            # What is named by itself counts before what "all" stands for.
            found |= {one: axis for one in own if own == [name] or one not in self.tolerances}
        return found

    def draws(self, lens: Prescription) -> list[dict[str, float]]:
        """Return the change of each number, for each sample."""
        rows = combined(self.axes(lens), "sample", self.samples, self.sampler, self.random_seed)
        return [{name: float(value) for name, value in row.items()} for row in rows]

    @property
    def traced(self) -> range:
        """Samples that are traced, spread evenly."""
        count = min(self.samples, round(self.samples * self.traced_percent / 100 + 0.499))
        return range(0, self.samples, max(1, self.samples // count)) if count else range(0)


def step_of(axis: Axis) -> float:
    """Return the change that differentials are taken at: one standard deviation or so of its law.

    Raises
    ------
    UserError
        A law that has no width.
    """
    step = max(abs(float(axis.at(share))) for share in ONE_SIGMA)
    if step == 0:
        raise UserError("a tolerance without width", field="tolerances", allowed="a spread above 0")
    return step


@dataclass(frozen=True)
class Mounted:
    """A camera's lens with stop, apertures and image plane fixed, as they are once it is made."""

    lens: Prescription

    @classmethod
    def of(cls, camera: Camera) -> Self:
        """Return the lens of a camera as its design is made: later changes move no focus.

        Raises
        ------
        UserError
            A ready-made lens, which has no surfaces.
        """
        if not isinstance(camera.lens, Prescription):
            raise UserError(
                "a ready-made lens has no surfaces to perturb",
                field="CAMERA",
                allowed="a camera whose lens is a prescription",
            )
        system = build(camera.lens)
        lens = system.prescription
        *others, last = lens.surfaces
        behind = system.image_z_mm - float(system.geometry.vertex_z[-1])
        fixed = dict.fromkeys(("f_number", "entrance_pupil_diameter_mm", "object_na"))
        return cls(
            lens.derived(
                "stop and image plane fixed",
                **fixed,
                stop_semi_diameter_mm=system.stop_radius_mm,
                focus="as-given",
                focus_shift_um=0.0,
                surfaces=(*others, last.model_copy(update={"thickness": behind})),
            )
        )

"""A camera: a lens in front of a sensor or a part of one.

The lens is a prescription at a focal length and f-number, or ready-made: a bank of PSFs that
somebody else computed, or a table of its MTF (`gpusim.lens.ready`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gpusim.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Callable

    from gpusim.lens.field_bank import FieldBank
    from gpusim.sensor.sensor import Sensor

PRESETS = Path(__file__).parent / "data" / "cameras"


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Lens(Protocol):
    """What a camera asks of its lens: `Prescription` and `ReadyLens` give it."""

    title: str
    source: str

    @property
    def history(self) -> tuple[str, ...]:
        """What was done since the file was read: one sentence for each step."""

    def bank(self, progress: Callable[[int, int], None] | None = None) -> FieldBank:
        """Return its PSFs with everything else that the chain needs of it."""

    def model_dump(self) -> dict[str, object]:
        """Return what is known of it, for the report."""


class LensChoice(_Strict):
    """Which lens: a prescription, a ready-made bank or an MTF table, exactly one of them.

    A prescription is brought to a focal length by scaling, to an f-number by stopping down, to a
    field, and out of focus; the others are what they are.
    """

    prescription: str | None = None
    bank: str | None = None
    mtf: str | None = None
    focal_length_mm: float | None = Field(default=None, gt=0)
    f_number: float | None = Field(default=None, gt=0)
    max_field_deg: float | None = Field(default=None, gt=0)
    focus_shift_um: float | None = Field(default=None, allow_inf_nan=False)

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = [name for name in ("prescription", "bank", "mtf") if getattr(self, name)]
        if len(given) != 1:
            raise ValueError(
                "give exactly one of prescription, bank (ready-made PSFs) and mtf (an MTF table)"
            )
        for name in ("focal_length_mm", "f_number", "max_field_deg", "focus_shift_um"):
            if given != ["prescription"] and getattr(self, name) is not None:
                raise ValueError(
                    f"{name} goes with a prescription: the PSFs of lens.{given[0]} hold for one "
                    "focal length, stop, field and focus, and cannot be traced again"
                )
        return self


class SensorChoice(_Strict):
    """Which sensor, and how many of its pixels, about its centre."""

    preset: str
    rows: int | None = Field(default=None, gt=0)
    cols: int | None = Field(default=None, gt=0)


class CameraFile(_Strict):
    """Fields of a camera file; its filters stand in front of the lens."""

    title: str
    lens: LensChoice
    sensor: SensorChoice
    filters: list[dict[str, object]] = []


@dataclass(frozen=True)
class Camera:
    """A lens in front of a sensor.

    Attributes
    ----------
    title : str
    lens : Lens
    sensor : Sensor
    """

    title: str
    lens: Lens
    sensor: Sensor

    def bank(self, progress: Callable[[int, int], None] | None = None) -> FieldBank:
        """Return the lens's PSF bank.

        Raises
        ------
        UserError
            When the image circle does not reach the corners of the sensor.
        """
        bank = self.lens.bank(progress)
        # The corner that is farthest from the image circle's centre.
        sides = zip((self.sensor.cols, self.sensor.rows), bank.centre_um, strict=True)
        corner_um = math.hypot(*(n * self.sensor.pixel_pitch_um / 2 + abs(c) for n, c in sides))
        if bank.image_circle_um < corner_um:
            raise UserError(
                f"The image circle of {self.lens.title} misses the corners of the sensor.",
                field="lens",
                value=f"image circle radius {bank.image_circle_um / 1e3:.3f} mm",
                allowed=f"at least {corner_um / 1e3:.3f} mm: fewer pixels, another "
                "lens, or a larger focal_length_mm of a prescription",
            )
        if bank.rectilinear_circle_um < corner_um:
            from gpusim.lens.bank import RECTILINEAR_DEG

            # Scenes lie on the ideal plane, which has no place for light from the side.
            raise UserError(
                f"The corners of the sensor see more than {RECTILINEAR_DEG:g} deg off the axis of "
                f"{self.lens.title}: no scene reaches so far, for scenes are flat.",
                field="sensor",
                value=f"corner at {corner_um / 1e3:.3f} mm",
                allowed=f"at most {bank.rectilinear_circle_um / 1e3:.3f} mm: a longer focal "
                "length or fewer pixels",
            )
        return bank


def presets() -> list[str]:
    """Return the names of the cameras that come with the package."""
    return sorted(path.stem for path in PRESETS.glob("*.yaml"))


def load_camera(name_or_path: str | Path) -> Camera:
    """Load a camera file, or a preset by its name.

    Raises
    ------
    UserError
        Unknown preset, missing or malformed file, or a field that is wrong.
    """
    from gpusim.sensor.filters_model import load_filters
    from gpusim.sensor.load import load_sensor

    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = PRESETS / f"{name_or_path}.yaml"
        if not path.exists():
            raise UserError(
                "There is no camera of that name.",
                field="CAMERA",
                value=name_or_path,
                allowed=f"a .yaml file, or one of: {', '.join(presets())}",
            )
    try:
        fields = CameraFile.model_validate(yaml.safe_load(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"The camera file cannot be read: {error}", file=path) from error
    except yaml.YAMLError as error:
        raise UserError(f"The camera file is not YAML: {error}", file=path) from error
    except ValidationError as error:
        first = error.errors()[0]
        raise UserError(
            f"The camera file is wrong: {first['msg'].removeprefix('Value error, ')}",
            file=path,
            field=".".join(str(part) for part in first["loc"]) or "(top level)",
            value=first["input"],
            allowed="title, lens {prescription, focal_length_mm, f_number, max_field_deg, "
            "focus_shift_um} or "
            "lens {bank} or lens {mtf}, sensor {preset, rows, cols}, filters",
        ) from error
    lens = _lens(path, fields.lens)
    sensor = load_sensor(_beside(path, fields.sensor.preset))
    if fields.sensor.rows is not None or fields.sensor.cols is not None:
        sensor = sensor.roi(fields.sensor.rows or sensor.rows, fields.sensor.cols or sensor.cols)
    # Light passes those in front of the lens first: the product is the same.
    filters = [*sensor.filters, *load_filters(fields.filters, path)]
    return Camera(fields.title, lens, sensor.model_copy(update={"filters": filters}))


def _lens(camera_file: Path, choice: LensChoice) -> Lens:
    """Load the lens that a camera file chose."""
    from gpusim.lens.prescription import load_prescription
    from gpusim.lens.ready import MTF_TABLE, load_ready

    if choice.prescription is None:
        name = choice.bank or choice.mtf
        # A folder has no suffix, and only MTF tables come with the package.
        lens = load_ready(_beside(camera_file, name) if choice.mtf else camera_file.parent / name)
        if (lens.kind == MTF_TABLE) != (choice.mtf is not None):
            raise UserError(
                f"The file is {'a table of the' if choice.bank else 'no table of an'} MTF.",
                file=camera_file,
                field="lens.bank" if choice.bank else "lens.mtf",
                value=name,
                allowed=f"lens.{'mtf' if choice.bank else 'bank'} for this file",
            )
        return lens
    lens = load_prescription(_beside(camera_file, choice.prescription))
    if choice.focal_length_mm is not None:
        lens = lens.scaled(choice.focal_length_mm)
    if choice.f_number is not None:
        lens = lens.stopped(choice.f_number)
    if choice.max_field_deg is not None:
        lens = lens.limited(choice.max_field_deg)
    if choice.focus_shift_um is not None:
        lens = lens.defocused(choice.focus_shift_um)
    return lens


def _beside(camera_file: Path, name: str) -> str:
    """Return a file's name as seen from the camera file, a preset's as it is."""
    return str(camera_file.parent / name) if Path(name).suffix else name

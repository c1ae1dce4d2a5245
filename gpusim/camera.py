"""A camera: a lens prescription at a focal length and f-number, and a sensor or a part of one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gpusim.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Callable

    from gpusim.lens.bank import Bank
    from gpusim.lens.prescription import Prescription
    from gpusim.sensor.sensor import Sensor

PRESETS = Path(__file__).parent / "data" / "cameras"


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class LensChoice(_Strict):
    """Which lens, its focal length by scaling, its f-number by stopping down, and its field."""

    prescription: str
    focal_length_mm: float | None = Field(default=None, gt=0)
    f_number: float | None = Field(default=None, gt=0)
    max_field_deg: float | None = Field(default=None, gt=0)


class SensorChoice(_Strict):
    """Which sensor, and how many of its pixels, about its centre."""

    preset: str
    rows: int | None = Field(default=None, gt=0)
    cols: int | None = Field(default=None, gt=0)


class CameraFile(_Strict):
    """Fields of a camera file."""

    title: str
    lens: LensChoice
    sensor: SensorChoice


@dataclass(frozen=True)
class Camera:
    """A lens in front of a sensor.

    Attributes
    ----------
    title : str
    lens : Prescription
    sensor : Sensor
    """

    title: str
    lens: Prescription
    sensor: Sensor

    def bank(self, progress: Callable[[int, int], None] | None = None) -> Bank:
        """Return the lens's PSF bank, from the cache on disk where it is there.

        Raises
        ------
        UserError
            When the image circle does not reach the corners of the sensor.
        """
        from gpusim.lens.bank import cached_bank

        bank = cached_bank(self.lens, progress=progress)
        corner_um = (
            self.sensor.pixel_pitch_um * (self.sensor.rows**2 + self.sensor.cols**2) ** 0.5 / 2
        )
        if bank.image_circle_um < corner_um:
            raise UserError(
                f"The image circle of {self.lens.title} misses the corners of the sensor.",
                field="lens.focal_length_mm",
                value=f"image circle radius {bank.image_circle_um / 1e3:.3f} mm",
                allowed=f"at least {corner_um / 1e3:.3f} mm: a longer focal length or fewer pixels",
            )
        if bank.rectilinear_circle_um < corner_um:
            # Scenes lie on the ideal plane, which has no place for light from the side.
            corner_deg = float(bank.angle_from_height(corner_um)[0])
            raise UserError(
                f"The corners of the sensor see {corner_deg:.4g} deg through {self.lens.title}: "
                "no scene reaches so far, for scenes are flat.",
                field="sensor",
                value=f"half diagonal {corner_um / 1e3:.3f} mm",
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
    from gpusim.lens.prescription import load_prescription
    from gpusim.sensor.sensor import load_sensor

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
            f"The camera file is wrong: {first['msg']}",
            file=path,
            field=".".join(str(part) for part in first["loc"]) or "(top level)",
            value=first["input"],
            allowed="title, lens {prescription, focal_length_mm, f_number, max_field_deg}, "
            "sensor {preset, rows, cols}",
        ) from error
    lens = load_prescription(_beside(path, fields.lens.prescription))
    if fields.lens.focal_length_mm is not None:
        lens = lens.scaled(fields.lens.focal_length_mm)
    if fields.lens.f_number is not None:
        lens = lens.stopped(fields.lens.f_number)
    if fields.lens.max_field_deg is not None:
        lens = lens.limited(fields.lens.max_field_deg)
    sensor = load_sensor(_beside(path, fields.sensor.preset))
    if fields.sensor.rows is not None or fields.sensor.cols is not None:
        sensor = sensor.roi(fields.sensor.rows or sensor.rows, fields.sensor.cols or sensor.cols)
    return Camera(fields.title, lens, sensor)


def _beside(camera_file: Path, name: str) -> str:
    """Return a file's name as seen from the camera file, a preset's as it is."""
    return str(camera_file.parent / name) if Path(name).suffix else name

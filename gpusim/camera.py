"""A camera: a lens in front of a sensor or a part of one.

The lens is a prescription at a focal length and f-number, or ready-made: a bank of PSFs that
somebody else computed, or a table of its MTF (`gpusim.formats.ready`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

from pydantic import Field, model_validator

from gpusim.config.mistakes import checked
from gpusim.config.model import Strict
from gpusim.config.names import perhaps
from gpusim.config.text import read_yaml
from gpusim.errors import UserError
from gpusim.formats.imported import with_field_to
from gpusim.formats.lens_file import load_prescription
from gpusim.formats.lens_file import presets as lenses
from gpusim.formats.ready import MTF_TABLE, is_ready, load_ready, mtf_presets
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import conjugates, first_order
from gpusim.psf.lens_bank import lens_bank
from gpusim.scene.patterns import Frame
from gpusim.sensor.filters_model import load_filters
from gpusim.sensor.load import load_sensor
from gpusim.sensor.load import presets as sensors

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np

    from gpusim.known import Known
    from gpusim.psf.field_bank import FieldBank
    from gpusim.sensor.sensor import Sensor

# Where a camera chooses the field of its lens, it goes beyond the sensor's corners by this: the
# chief ray lands elsewhere at the bank's wavelengths than at the lens's own.
CORNER_SPARE = 1.02
PRESETS = Path(__file__).parent / "data" / "cameras"


class Lens(Protocol):
    """What a camera asks of its lens, whether a `Prescription` or a `ReadyLens`."""

    title: str
    source: str

    @property
    def history(self) -> tuple[str, ...]:
        """What was done since the file was read: one sentence for each step."""

    @property
    def known(self) -> tuple[Known, ...]:
        """Over which wavelengths it is known."""

    def model_dump(self) -> dict[str, object]:
        """Return what is known of it, for the report."""


# What of a camera's choice of a lens holds for another lens in its place.
LASTING = ("focal_length_mm", "object_distance_m", "focus_distance_m")


class LensChoice(Strict):
    """Which lens: a prescription, a ready-made bank or an MTF table, exactly one of them.

    A prescription is brought to a focal length by scaling, to an f-number by stopping down, to a
    field, and out of focus, and may get catalogue glasses for its model glasses, and glasses that
    absorb as their catalogues say (``internal_transmission``); the others are what they are.
    ``object_distance_m`` is where its objects lie, on a plane, and ``focus_distance_m`` what it is
    focused on, from its first surface: without the first, infinity; without the second, the
    objects.
    """

    prescription: str | None = None
    bank: str | None = None
    mtf: str | None = None
    focal_length_mm: float | None = Field(default=None, gt=0)
    f_number: float | None = Field(default=None, gt=0)
    max_field_deg: float | None = Field(default=None, gt=0)
    object_distance_m: float | None = Field(default=None, gt=0, allow_inf_nan=True)
    focus_distance_m: float | None = Field(default=None, gt=0, allow_inf_nan=True)
    focus_shift_um: float | None = Field(default=None, allow_inf_nan=False)
    nearest_glasses: bool | None = None
    internal_transmission: bool | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = [name for name in ("prescription", "bank", "mtf") if getattr(self, name)]
        if len(given) != 1:
            raise ValueError(
                "give exactly one of prescription, bank (ready-made PSFs) and mtf (an MTF table)"
            )
        changes = set(type(self).model_fields) - {"prescription", "bank", "mtf"}
        for name in sorted(changes):
            if given != ["prescription"] and getattr(self, name) is not None:
                raise ValueError(
                    f"{name} goes with a prescription: the PSFs of lens.{given[0]} hold for one "
                    "focal length, stop, field and focus, and cannot be traced again"
                )
        return self


class SensorChoice(Strict):
    """Which sensor, and how many of its pixels, about its centre."""

    preset: str
    rows: int | None = Field(default=None, gt=0)
    cols: int | None = Field(default=None, gt=0)


class CameraFile(Strict):
    """Fields of a camera file; its filters stand in front of the lens.

    ``lens`` and ``sensor`` may each be a name or a file alone, too: see ``load_camera``.
    """

    title: str
    lens: LensChoice
    sensor: SensorChoice
    filters: tuple[dict[str, object], ...] = ()


@dataclass(frozen=True)
class Camera:
    """A lens in front of a sensor.

    Attributes
    ----------
    lens : Lens
    sensor : Sensor
    title : str
        By default made of their names.
    """

    lens: Lens
    sensor: Sensor
    title: str = ""

    def __post_init__(self) -> None:
        """Name a camera that has no title after its parts."""
        if not self.title:
            object.__setattr__(self, "title", f"{self.lens.title}, {self.sensor.name}")

    def bank(
        self, progress: Callable[[int, int], None] | None = None, **sampling: np.ndarray
    ) -> FieldBank:
        """Return the lens's PSF bank, traced or ready-made.

        ``sampling`` is for lenses that are traced: see `gpusim.psf.lens_bank.lens_bank`.
        """
        if isinstance(self.lens, Prescription):
            return lens_bank(self.lens, progress, **sampling)
        return self.lens.bank(progress, **sampling)

    @cached_property
    def frame(self) -> Frame:
        """What a chart is laid out for: the sensor, and how large the lens shows things."""
        lens = self.lens
        if not isinstance(lens, Prescription):
            return Frame.of(self.sensor, lens.bank().principal_distance_mm)
        found = Frame.of(self.sensor, conjugates(lens).principal_distance_mm)
        if lens.object_distance_mm is None:
            return found
        pupil_mm = first_order(lens).entrance_pupil_z_mm
        return replace(found, object_mm=lens.object_distance_mm + pupil_mm)


def presets() -> list[str]:
    """Return the names of the cameras that come with the package."""
    return sorted(path.stem for path in PRESETS.glob("*.yaml"))


def load_camera(
    name_or_path: str | Path,
    lens: Mapping[str, float] | None = None,
    sensor: str | None = None,
) -> Camera:
    """Load a camera file, or a preset by its name.

    ``lens`` holds fields of a `LensChoice` (see `changed_lens`) and ``sensor`` names another
    sensor, both in place of the file's own; of another sensor all pixels are used.

    A file's ``lens`` is a mapping (``LensChoice``) or the name or file of a lens, whose kind is
    recognised; its ``sensor`` a mapping (``SensorChoice``) or the name or file of a sensor.

    Raises
    ------
    UserError
        Unknown preset, missing or malformed file, or a field that is wrong.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = PRESETS / f"{name_or_path}.yaml"
        if str(name_or_path) not in presets():
            raise UserError(
                _no_camera(str(name_or_path)),
                field="CAMERA",
                value=name_or_path,
                allowed=f"a .yaml file, or one of: {', '.join(presets())}",
            )
    data = read_yaml(path, "the camera file")
    _check_kind(data, path)
    named = data.get("lens") if isinstance(data, dict) else None
    fields = checked(CameraFile, _spelled_out(data), path)
    ready = _ready_place(path, named) if isinstance(named, str) else None
    if lens and "prescription" not in lens and ready is not None:
        raise UserError(
            "a ready-made lens is used as it is: it has no surfaces to trace again",
            file=path,
            field=f"lens.{next(iter(lens))}",
            allowed="a camera whose lens is a prescription",
        )
    if lens:
        chosen = changed_lens(fields.lens.model_dump(exclude_none=True), lens)
        data = _spelled_out(data) | {"lens": chosen}
        fields, ready = checked(CameraFile, data, path), None
    if sensor is not None:
        fields = fields.model_copy(update={"sensor": SensorChoice(preset=sensor)})
    sensor = load_sensor(sensor or _beside(path, fields.sensor.preset))
    if fields.sensor.rows is not None or fields.sensor.cols is not None:
        sensor = sensor.roi(fields.sensor.rows or sensor.rows, fields.sensor.cols or sensor.cols)
    lens = load_ready(ready) if ready is not None else _lens(path, fields.lens, sensor)
    # Light passes those in front of the lens first: the product is the same.
    filters = [*sensor.filters, *load_filters(fields.filters, path)]
    return Camera(lens, sensor.model_copy(update={"filters": filters}), fields.title)


def changed_lens(chosen: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a `LensChoice` with some changed.

    Another prescription is another lens: it has the focal length and the distances of the one
    before it, and is wide open over its whole field.
    """
    if "prescription" in changes:
        chosen = {name: value for name, value in chosen.items() if name in LASTING}
    return {**chosen, **changes}


def _no_camera(name: str) -> str:
    """Say that there is no camera of a name: of which kind it is, or which may be meant."""
    kinds = {"lens": {*lenses(), *mtf_presets()}, "sensor": set(sensors())}
    for kind, names in kinds.items():
        if name in names:
            having = []
            for camera in presets():
                said = read_yaml(PRESETS / f"{camera}.yaml", "the camera file")[kind]
                if name in (said.values() if isinstance(said, dict) else [said]):
                    having.append(camera)
            found = f"cameras with it: {', '.join(having)}" if having else "no camera has it"
            return f"{name} is a {kind}; {found}"
    return f"there is no camera of that name{perhaps(name, presets())}"


def _check_kind(data: object, path: Path) -> None:
    """Refuse a file of a lens or a sensor alone, and say what a camera of it looks like."""
    own = {"surfaces": ("lens", "sensor: imx477"), "pixel_pitch_um": ("sensor", "lens: tessar")}
    for field, (kind, other) in own.items():
        if isinstance(data, dict) and field in data:
            raise UserError(
                f"this is the file of a {kind}, not of a camera",
                file=path,
                field=field,
                allowed=f"a camera file of three lines: title: NAME; {kind}: {path.name}; {other}",
            )


def _spelled_out(data: object) -> object:
    """Return a camera file's data with a lens or sensor that is a name alone as a mapping."""
    if not isinstance(data, dict):
        return data
    names = {"lens": "prescription", "sensor": "preset"}
    named = {
        key: {name: data[key]} for key, name in names.items() if isinstance(data.get(key), str)
    }
    return data | named


def _ready_place(camera_file: Path, name: str) -> str | None:
    """Return where a ready-made lens is that goes by a name alone; None for a prescription."""
    places = (str(camera_file.parent / name), _beside(camera_file, name))
    return next((place for place in places if is_ready(place)), None)


def _lens(camera_file: Path, choice: LensChoice, sensor: Sensor) -> Lens:
    """Load the lens that a camera file chose.

    A lens whose file states the axis alone is used to the corners of the sensor.
    """
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
    if choice.nearest_glasses:
        lens = lens.with_nearest_glasses()
    if choice.internal_transmission:
        lens = lens.absorbing()
    if choice.focal_length_mm is not None:
        lens = lens.scaled(choice.focal_length_mm)
    if lens.states_axis_alone and choice.max_field_deg is None:
        corner_px = math.hypot(sensor.rows, sensor.cols) / 2
        lens = with_field_to(lens, CORNER_SPARE * 1e-3 * sensor.pixel_pitch_um * corner_px)
    elif lens.states_axis_alone:
        lens = lens.limited(choice.max_field_deg)
    if choice.f_number is not None:
        lens = lens.stopped(choice.f_number)
    if choice.max_field_deg is not None and not lens.states_axis_alone:
        lens = lens.limited(choice.max_field_deg)
    if choice.object_distance_m is not None or choice.focus_distance_m is not None:
        lens = lens.looking(choice.object_distance_m, choice.focus_distance_m)
    if choice.focus_shift_um is not None:
        lens = lens.defocused(choice.focus_shift_um)
    return lens


def _beside(camera_file: Path, name: str) -> str:
    """Return a file's name as seen from the camera file, a preset's as it is."""
    return str(camera_file.parent / name) if Path(name).suffix else name

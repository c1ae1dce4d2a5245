"""A camera whose lens shows itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING

from gpusim import camera
from gpusim.errors import UserError
from gpusim.lens.prescription import Prescription
from gpusim.library.lens import Lens

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class Camera(camera.Camera):
    """A lens in front of a sensor.

    Attributes
    ----------
    lens : Lens or ReadyLens
    sensor : Sensor
    title : str
        By default made of their names.

    Raises
    ------
    UserError
        A name in place of a lens or a sensor.
    """

    def __post_init__(self) -> None:
        for field in ("lens", "sensor"):
            given = getattr(self, field)
            if isinstance(given, str | PurePath):
                raise UserError(
                    f"a name is no {field}",
                    field=field,
                    value=given,
                    allowed=f"gs.{field.capitalize()}.load({str(given)!r})",
                )
        super().__post_init__()

    @classmethod
    def load(cls, name_or_path: str | Path, *, sensor: str | None = None, **lens: float) -> Camera:
        """Return a camera of the package by its name, or that of a file.

        Parameters
        ----------
        name_or_path : str or path
        sensor : str, optional
            Name or file of another sensor, in place of the file's.
        lens : float
            Fields of its lens in place of the file's: ``f_number``, ``focal_length_mm``,
            ``focus_distance_m`` ...

        Raises
        ------
        UserError
            Unknown preset, missing or malformed file, or a field that is wrong.

        Examples
        --------
        >>> import gpusim as gs
        >>> camera = gs.Camera.load("demo", f_number=4.0)
        >>> camera.sensor.cols, camera.lens.f_number
        (2028, 4.0)
        """
        found = camera.load_camera(name_or_path, lens or None, sensor)
        own = Lens.of(found.lens) if isinstance(found.lens, Prescription) else found.lens
        return cls(own, found.sensor, found.title)

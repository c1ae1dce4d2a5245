"""A camera whose lens shows itself."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING

from PIL import Image

from gpusim import camera
from gpusim.errors import UserError
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import first_order
from gpusim.library.lens import Lens
from gpusim.library.notebook import facts, figure, picture
from gpusim.library.sensor import Sensor

if TYPE_CHECKING:
    from pathlib import Path

LENS_PX = 480  # longest side of its lens's section in a notebook


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

    Examples
    --------
    >>> import gpusim as gs
    >>> lens = gs.Lens.load("double-gauss").scaled(12.0).stopped(2.8)
    >>> gs.Camera(lens, gs.Sensor.load("imx477").roi(480, 640), "mine").sensor.cols
    640
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

    def _repr_html_(self) -> str:
        """Return the lens's section, where it has surfaces, and the sensor, for notebooks."""
        lens, told, drawn = self.lens, {"lens": self.lens.title}, ""
        if isinstance(lens, Lens):
            order = first_order(lens)
            drawn = picture(Image.open(io.BytesIO(lens._repr_png_())), LENS_PX)
            told["focal length"] = f"{order.efl_mm:.4g} mm"
            told["f-number"] = f"{order.f_number:.3g}"
        return figure(facts(self.title, told), drawn, Sensor.of(self.sensor)._repr_html_())

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
        return cls(own, Sensor.of(found.sensor), found.title)

"""How large a chart is before a lens: by its size at the object's distance, or by an angle."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Self

from gpusim.errors import UserError
from gpusim.lens.projection import ANGULAR, RECTILINEAR, Projection
from gpusim.scene.patterns import Frame

_SIZE = re.compile(r"(\d{1,7}(?:\.\d{0,6})?) ?(mm|deg)", re.ASCII)
ALLOWED = "850mm, at the distance of the object, or 40deg"


@dataclass(frozen=True)
class Height:
    """The height of a chart in the scene.

    Attributes
    ----------
    value : float
    unit : str
        "mm", of a plane across the axis at the object's distance; or "deg", the angle between its
        upper and lower ends, seen from the middle of the entrance pupil.
    """

    value: float
    unit: str

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the height that a text says: "850mm" or "40deg".

        Raises
        ------
        UserError
        """
        found = _SIZE.fullmatch(text)
        if found is None or not 0 < float(found[1]) < {"mm": 1e7, "deg": 360}[found[2]]:
            raise UserError(
                "that is no height of a chart", field="chart-height", value=text, allowed=ALLOWED
            )
        return cls(float(found[1]), found[2])

    def half_heights(self, frame: Frame, projection: Projection = RECTILINEAR) -> float:
        """Return half of it on the ideal image plane, over half of the sensor's height.

        On that plane a field angle theta lies at the principal distance times tan(theta), or times
        theta where the scene is laid by angle.

        Raises
        ------
        UserError
            The lens is not known, nor where the object lies; or the angle has no end there.
        """
        if frame.principal_mm is None or frame.half_height_um is None:
            raise self._refused("with a camera: its lens says how large it is")
        if self.unit == "mm":
            if frame.object_mm is None:
                raise self._refused("an angle (40deg), or a camera with an object distance")
            if projection is ANGULAR:
                raise self._refused("an angle (40deg): a scene laid by angle is no flat chart")
            theta = math.atan(self.value / 2 / frame.object_mm)
        else:
            theta = math.radians(self.value / 2)
            if math.degrees(theta) > projection.end_deg:
                raise self._refused(f"up to {2 * projection.end_deg:g} degrees")
        half_mm = frame.principal_mm * float(projection.height(theta))
        return 1e3 * half_mm / frame.half_height_um

    def _refused(self, allowed: str) -> UserError:
        return UserError(
            "a chart cannot be laid out by this height",
            field="chart-height",
            value=f"{self.value:g}{self.unit}",
            allowed=allowed,
        )

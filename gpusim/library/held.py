"""What of a light lies on the device, until nobody holds the light any more."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Resident, default_device
from gpusim.plan.tiles import Rect


class Held:
    """The glare and a part of the photosites' light, brought to the device when they are needed."""

    def __init__(self) -> None:
        self._arrays: dict[str, Resident] = {}

    def __del__(self) -> None:
        self.release()

    def release(self) -> None:
        """Give the device's memory back; what needs it again brings it there again."""
        for one in self._arrays.values():
            one.destroy()
        self._arrays.clear()

    def glare(self, glare: np.ndarray) -> Resident:
        """Return the glare of each site, on the device."""
        if "glare" not in self._arrays:
            self._arrays["glare"] = default_device().resident("glare", glare)
        return self._arrays["glare"]

    def rates(self, rates: np.ndarray, area: Rect, whole: Rect, period: int) -> Resident:
        """Return the light of a rectangle of whole periods, on the device; the last one stays.

        Parameters
        ----------
        rates : ndarray (S, rows / period, cols / period)
            All pixels of the area.
        area, whole : (row, col, rows, cols)
        period : int
        """
        name = f"rates {whole}"
        if name not in self._arrays:
            for other in [other for other in self._arrays if other.startswith("rates")]:
                self._arrays.pop(other).destroy()
            top, left = (whole[0] - area[0]) // period, (whole[1] - area[1]) // period
            rows, cols = whole[2] // period, whole[3] // period
            part = rates[:, top : top + rows, left : left + cols]
            self._arrays[name] = default_device().resident("rates", np.ascontiguousarray(part))
        return self._arrays[name]

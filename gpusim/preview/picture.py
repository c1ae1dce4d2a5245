"""Frames as pictures: developed, or photosite by photosite in the colours of their filters."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from gpusim.gpu import default_device
from gpusim.isp.pipeline import develop_source
from gpusim.isp.settings import Settings
from gpusim.isp.source import Source, read_source
from gpusim.library.frame import Frame
from gpusim.sensor.sensor import Sensor

COLOURS = {
    "R": (1, 0, 0),
    "G": (0, 1, 0),
    "B": (0, 0, 1),
    "C": (0, 1, 1),
    "M": (1, 0, 1),
    "Y": (1, 1, 0),
}
GREY = (1, 1, 1)


class Developer:
    """Develops the frames of one light; what a file says of the sensor is worked out once."""

    def __init__(self) -> None:
        self._sensor: Sensor | None = None
        self._shape: tuple[int, int] = (0, 0)
        self._source: Source | None = None

    def develop(self, frame: Frame, ev: float) -> np.ndarray:
        """Return the picture (rows, cols, 3), uint8: as shot, and `ev` stops brighter.

        Bayer frames by Malvar, He and Cutler's interpolation, the others as `gpusim develop` does.
        """
        if (
            self._source is None
            or self._sensor is not frame.light.sensor
            or self._shape != frame.raw.shape
        ):
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "raw.dng"
                frame.write_raw(path, 0.0)
                self._source = read_source(path)
            self._sensor, self._shape = frame.light.sensor, frame.raw.shape
        row, col, rows, cols = frame.areas.active
        source = replace(self._source, codes=frame.raw[row : row + rows, col : col + cols])
        bayer = len(source.pattern) == 2 and set("".join(source.pattern)) == set("RGB")
        settings = Settings(ev=ev, demosaic="malvar" if bayer else None)
        return np.ascontiguousarray(develop_source(source, settings, default_device()).picture)


def mosaic(frame: Frame) -> np.ndarray:
    """Return each photosite in the colour of its filter: (rows, cols, 3), uint8."""
    sensor = frame.light.sensor
    row, col, rows, cols = frame.areas.active
    codes = frame.raw[row : row + rows, col : col + cols].astype(np.float32)
    black = float(np.mean(sensor.site_black_dn))
    light = np.clip((codes - black) / (sensor.raw_max_dn - black), 0, 1) ** (1 / 2.2)
    letters = np.array([list(line) for line in sensor.cfa.letters])
    first = frame.areas.lit
    letters = np.roll(letters, (-first[0] % letters.shape[0], -first[1] % letters.shape[1]), (0, 1))
    if len(set(letters.ravel())) == 1:
        shown = np.broadcast_to(GREY, (*letters.shape, 3))
    else:
        shown = np.array([[COLOURS.get(letter, GREY) for letter in line] for line in letters])
    times = [-(-size // period) for size, period in zip(codes.shape, letters.shape, strict=True)]
    tiled = np.tile(shown, (*times, 1))[:rows, :cols]
    return np.round(255 * light[..., None] * tiled).astype(np.uint8)

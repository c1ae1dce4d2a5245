"""Distortion and lateral colour undone. Stage ``shaders/isp/rectify.wgsl``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.gpu import Array, Kernel, Recording

SAMPLES = 33  # along each side, at which a map is asked how far it reaches
IDENTITY = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # the map that moves nothing
TAPS = 2  # rows beyond a place that its interpolation takes


@dataclass(frozen=True)
class Rectification:
    """The maps that undo a lens's distortion, as DNG's WarpRectilinear gives them.

    Attributes
    ----------
    maps : tuple of (k0, k1, k2, k3, t0, t1)
        One for all planes, or one for each.
    axis : (float, float)
        x, y of the optical axis, 0 to 1 over the picture.
    """

    maps: tuple[tuple[float, ...], ...]
    axis: tuple[float, float]

    def unit(self, frame: tuple[int, int]) -> float:
        """Return the distance from the axis to the farthest corner of a frame, pixels."""
        (x, y), (rows, cols) = self.axis, frame
        return float(np.hypot(max(x, 1 - x) * cols, max(y, 1 - y) * rows))

    def sources(
        self, frame: tuple[int, int], row: np.ndarray, col: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return where the light of places fell, rows and columns (maps, ...)."""
        unit = self.unit(frame)
        across, down = self.axis[0] * frame[1] - 0.5, self.axis[1] * frame[0] - 0.5
        x, y = (np.asarray(col) - across) / unit, (np.asarray(row) - down) / unit
        s = x * x + y * y
        rows, cols = [], []
        for k0, k1, k2, k3, t0, t1 in self.maps:
            f = k0 + s * (k1 + s * (k2 + s * k3))
            rows.append(down + unit * (f * y + 2 * t1 * x * y + t0 * (s + 2 * y * y)))
            cols.append(across + unit * (f * x + 2 * t0 * x * y + t1 * (s + 2 * x * x)))
        return np.stack(rows), np.stack(cols)

    def rows_for(self, frame: tuple[int, int], start: int, stop: int) -> tuple[int, int]:
        """Return the first row of a frame, and behind the last, that some rows are made from."""
        row = np.linspace(start, stop - 1, SAMPLES)[:, None]
        col = np.linspace(0, frame[1] - 1, SAMPLES)[None]
        found, across = self.sources(frame, row, col)
        inside = (np.abs(found - (frame[0] - 1) / 2) <= frame[0] / 2) & (
            np.abs(across - (frame[1] - 1) / 2) <= frame[1] / 2
        )
        if not inside.any():
            return start, stop
        # Between samples the map is bent by less than its largest step.
        spare = TAPS + sum(np.abs(np.diff(found, 2, axis=axis)).max() for axis in (1, 2))
        first, last = found[inside].min() - spare, found[inside].max() + spare
        return max(int(np.floor(first)), 0), min(int(np.ceil(last)) + 1, frame[0])


def record_rectify(
    rec: Recording,
    planes: Array,
    given: Rectification,
    frame: tuple[int, int],
    *,
    first: tuple[int, int],
    rows: tuple[int, int],
    label: str = "rectified",
) -> Array:
    """Record the picture without distortion.

    Parameters
    ----------
    rec : Recording
    planes : Array (colours, rows, cols), f32; or (rows, cols), of one colour
    given : Rectification
        With one map, or as many as there are colours.
    frame : (int, int)
        Rows and columns of the whole picture.
    first : (int, int)
        Row and column of the picture, of the first pixel in `planes`; may be negative.
    rows : (int, int)
        The first row of the picture that is made, and how many.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (colours, rows, cols), f32
    """
    colours, high, cols = (1, *planes.shape)[-3:]
    begin, made = rows
    rectified = rec.buffer(label, (colours, made, cols), "f4")
    table = np.zeros((colours, 8), np.float32)
    table[:, :6] = np.resize(given.maps, (colours, 6))
    maps = rec.buffer(f"{label} maps", (colours, 2, 4), "f4")
    rec.upload(maps, table.reshape(colours, 2, 4))
    kernel = Kernel("isp/rectify", COLOURS=colours)
    params = {
        "rows": high,
        "cols": cols,
        "made": made,
        "first": first[0],
        "left": first[1],
        "begin": begin,
        "axis": (given.axis[0] * frame[1] - 0.5, given.axis[1] * frame[0] - 0.5),
        "frame": (frame[1], frame[0]),
        "unit": given.unit(frame),
    }
    groups = kernel.cover(cols, made)
    kernel.record(rec, groups, params, planes=planes, maps=maps, rectified=rectified)
    return rectified

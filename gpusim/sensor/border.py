"""Border: pixels without light or charge around others. Stage ``shaders/sensor/border.wgsl``."""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.frame import Rect


def record_border(
    rec: Recording, inner: Array | None, at: Rect, rect: Rect, *, label: str = "framed"
) -> Array:
    """Record a rectangle of pixels, 0 where nothing is known of them.

    Parameters
    ----------
    rec : Recording
    inner : Array (rows, cols) or (1, rows, cols), f32, or None
        What is known; None where ``at`` has no pixels.
    at, rect : (row, col, rows, cols)
        Where that lies, within ``rect``; and what is wanted.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (rows, cols), f32
        Values of ``rect``, in the units of ``inner``.
    """
    framed = rec.buffer(label, rect[2:], "f4")
    if inner is None:
        rec.clear(framed)
        return framed
    kernel = Kernel("sensor/border")
    params = {
        "rows": rect[2],
        "cols": rect[3],
        "row0": at[0] - rect[0],
        "col0": at[1] - rect[1],
        "inner_rows": at[2],
        "inner_cols": at[3],
    }
    kernel.record(rec, kernel.cover(rect[3], rect[2]), params, inner=inner, framed=framed)
    return framed

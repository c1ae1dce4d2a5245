"""Demosaicing of Bayer arrays along edges.

Stages ``differences``, ``direction``, ``refine`` and ``colours`` of ``shaders/isp``.
"""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording


def record_directional(rec: Recording, light: Array, *, label: str = "planes") -> Array:
    """Record the interpolation of all colours (Menon, Andriani and Calvagno 2007).

    Parameters
    ----------
    rec : Recording
    light : Array (rows, cols), f32
        Red at even rows and columns; rows and columns even.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (3, rows, cols), f32
        Red, green, blue; undefined in the eight rows and columns at each rim.
    """
    rows, cols = light.shape
    cells = rows // 2, cols // 2
    size = {"rows": cells[0], "cols": cells[1]}
    planes = rec.buffer(label, (3, rows, cols), "f4")
    differences = rec.buffer(f"{label} differences", (*cells, 4), "f4")
    chosen = rec.buffer(f"{label} chosen", (*cells, 4), "f4")
    refined = rec.buffer(f"{label} refined", (*cells, 2), "f4")

    def record(name: str, params: dict[str, int], **buffers: Array) -> None:
        kernel = Kernel(f"isp/{name}")
        groups = kernel.cover(max(cells[1] - 2, 0), max(cells[0] - 2, 0))
        kernel.record(rec, groups, params, **buffers)

    record("differences", {"rows": rows, "pairs": cells[1]}, light=light, differences=differences)
    record("direction", size, differences=differences, chosen=chosen)
    record("refine", size, chosen=chosen, refined=refined)
    record("colours", size, light=light, chosen=chosen, refined=refined, planes=planes)
    return planes

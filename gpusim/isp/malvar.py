"""Demosaicing of Bayer arrays by linear filters. Stage ``shaders/isp/malvar.wgsl``."""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording


def record_malvar(rec: Recording, light: Array, *, label: str = "planes") -> Array:
    """Record the interpolation of all colours (Malvar, He and Cutler 2004).

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
        Red, green, blue; undefined in the two rows and columns at each rim.
    """
    rows, cols = light.shape
    planes = rec.buffer(label, (3, rows, cols), "f4")
    kernel = Kernel("isp/malvar")
    params = {"rows": rows, "pairs": cols // 2}
    groups = kernel.cover(max(cols // 2 - 2, 0), max(rows // 2 - 2, 0))
    kernel.record(rec, groups, params, light=light, planes=planes)
    return planes

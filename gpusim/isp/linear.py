"""Black level and linearisation of a raw file's codes. Stage ``shaders/isp/linear.wgsl``."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Array, Kernel, Recording


def record_linear(
    rec: Recording,
    codes: np.ndarray,
    black: np.ndarray,
    span: float,
    *,
    table: np.ndarray | None = None,
    label: str = "light",
) -> Array:
    """Record what makes light of codes.

    Parameters
    ----------
    rec : Recording
    codes : ndarray (rows, cols), uint16
        The columns a multiple of 4.
    black : ndarray (PY, PX)
        Level of black by site of its pattern, from the first pixel: in the units of the table, or
        in codes without one.
    span : float
        From black to saturation, in the same units.
    table : ndarray (codes,), optional
        What a linear converter would have given in place of each code.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (rows, cols), f32
        0 is black, 1 saturation.
    """
    rows, cols = codes.shape
    light = rec.buffer(label, (rows, cols), "f4")
    words = rec.buffer(f"{label} codes", (rows, cols // 2), "u4")
    rec.upload(words, np.ascontiguousarray(codes, "<u2").view(np.uint32))
    levels = rec.buffer(f"{label} black", black.shape, "f4")
    rec.upload(levels, np.asarray(black, np.float32))
    overrides = {"PY": black.shape[0], "PX": black.shape[1]}
    linear = levels  # what the shader does not read still wants an array
    if table is not None:
        overrides["TABLE"] = True
        linear = rec.buffer(f"{label} table", table.shape, "f4")
        rec.upload(linear, np.asarray(table, np.float32))
    kernel = Kernel("isp/linear", **overrides)
    params = {
        "rows": rows,
        "fours": cols // 4,
        "scale": 1 / span,
    }
    groups = kernel.cover(cols // 4, rows)
    kernel.record(rec, groups, params, codes=words, table=linear, black=levels, light=light)
    return light

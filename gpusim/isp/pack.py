"""Packing of a picture into whole numbers. Stage ``shaders/isp/pack.wgsl``."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Array, Kernel, Recording
from gpusim.isp.line import line


def record_pack(rec: Recording, values: Array, bits: int, *, label: str = "picture") -> str:
    """Record packing and download; return the label, for `unpacked`.

    Parameters
    ----------
    rec : Recording
    values : Array (3, rows, cols), f32
        1 is white; rows times columns a multiple of 4.
    bits : int
        8 or 16.
    label : str
    """
    _, rows, cols = values.shape
    words = bits // 8
    codes = rec.buffer(label, (rows, cols, words), "u4")
    kernel = Kernel("isp/pack", **({"WIDE": True} if words == 2 else {}))
    groups, params = line(kernel, rows * cols)
    kernel.record(rec, groups, params, values=values, codes=codes)
    return rec.download(codes)


def unpacked(codes: np.ndarray) -> np.ndarray:
    """Return the picture (rows, cols, 3), uint8 or uint16, of what was downloaded."""
    kind = "<u1" if codes.shape[2] == 1 else "<u2"
    return codes.view(kind)[..., :3]

"""The colour matrix of a picture. Stage ``shaders/isp/matrix.wgsl``."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Array, Kernel, Recording
from gpusim.isp.line import line


def record_matrix(
    rec: Recording, planes: Array, matrix: np.ndarray, *, label: str = "colours"
) -> Array:
    """Record the conversion of the camera's balanced colours to those of the picture.

    Parameters
    ----------
    rec : Recording
    planes : Array (colours, rows, cols), f32; or (rows, cols), of one colour
        Rows times columns a multiple of 4.
    matrix : ndarray (3, colours)
        Up to eight colours.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (3, rows, cols), f32
    """
    number, rows, cols = (1, *planes.shape)[-3:]
    colours = rec.buffer(label, (3, rows, cols), "f4")
    kernel = Kernel("isp/matrix", COLOURS=number)
    groups, params = line(kernel, rows * cols)
    wide = np.zeros((3, 8))
    wide[:, :number] = matrix
    wide = wide.reshape(3, 2, 4)
    params |= dict(zip(("red", "green", "blue"), wide, strict=True))
    kernel.record(rec, groups, params, planes=planes, colours=colours)
    return colours

"""White balance of a filter array's light. Stage ``shaders/isp/balance.wgsl``."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Array, Kernel, Recording


def record_balance(rec: Recording, light: Array, gain: np.ndarray) -> None:
    """Record the white balance, in place; what is more than white becomes white.

    Parameters
    ----------
    rec : Recording
    light : Array (rows, cols), f32
        The columns a multiple of 4.
    gain : ndarray (PY, PX)
        By site of the filter pattern, from the first pixel.
    """
    rows, cols = light.shape
    gains = rec.buffer(f"{light.label} gains", gain.shape, "f4")
    rec.upload(gains, np.asarray(gain, np.float32))
    kernel = Kernel("isp/balance", PY=gain.shape[0], PX=gain.shape[1])
    params = {"rows": rows, "fours": cols // 4}
    kernel.record(rec, kernel.cover(cols // 4, rows), params, gain=gains, light=light)

"""Smear: light during the transfer of the charge. Stage ``shaders/sensor/smear.wgsl``."""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording, double_float
from gpusim.sensor.smear_model import Smear

PIECE_ROWS = 32  # as in the shader


def record_smear(
    rec: Recording,
    rate: Array,
    mean: Array,
    smear: Smear,
    *,
    limit_e: float = 1e30,
    label: str = "smeared",
) -> Array:
    """Record what light adds to the packets of whole columns on their way to the read-out.

    Parameters
    ----------
    rec : Recording
    rate : Array (rows, cols), f32
        Electrons/s of every row that is shifted: the lit ones, and 0 for those without light.
    mean : Array (rows, cols), f32
        Mean electrons of each packet, before the shot noise.
    smear : Smear
    limit_e : float
        Most that a pixel keeps, electrons: the full well where no noise is drawn after it.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (rows, cols), f32
        Mean electrons.
    """
    rows, cols = mean.shape
    smeared = rec.buffer(label, mean.shape, "f4")
    pieces = -(-rows // PIECE_ROWS)
    sums = rec.buffer(f"{label} sums", (pieces + 1, cols, 2), "f4")
    rec.clear(sums)
    exact = double_float(rec.device)
    passed = 0 if smear.kind == "interline" else 1 + smear.cleared_by_shift
    params = {
        "rows": rows,
        "cols": cols,
        "weight": smear.weight_s,
        "limit_e": limit_e,
        "zero": 0,
    }
    buffers = {"rate": rate, "mean": mean, "sums": sums, "smeared": smeared}
    for step, height in enumerate((pieces, 1, pieces)):
        kernel = Kernel("sensor/smear", PASSED=passed, STEP=step, **exact)
        kernel.record(rec, kernel.cover(cols, height), params, **buffers)
    return smeared

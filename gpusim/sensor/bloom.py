"""Bloom: charge above the full well flows along the column. Stage ``shaders/sensor/bloom.wgsl``."""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording, double_float


def record_bloom(
    rec: Recording,
    charge: Array,
    full_well_e: float,
    *,
    photosites: tuple[int, int] | None = None,
    label: str = "bloomed",
) -> tuple[Array, Array]:
    """Record the blooming of whole columns.

    Parameters
    ----------
    rec : Recording
    charge : Array (rows, cols), f32
        Electrons that each photosite would hold without a limit; whole numbers up to 1e7 stay so.
    full_well_e : float
    photosites : (int, int), optional
        First row of the photosites, and the first after them; by default all rows.
    label : str
        Label of the buffer that is returned first.

    Returns
    -------
    kept : Array (rows, cols), f32
        Electrons.
    spilled : Array (2, cols, 2), f32
        Electrons that left each column at the read-out (row 0) and at its other end, as sums of a
        high and a low part. With ``kept`` they are all that came in.
    """
    rows, cols = charge.shape
    first, last = photosites or (0, rows)
    kept = rec.buffer(label, charge.shape, "f4")
    spilled = rec.buffer(f"{label} spilled", (2, cols, 2), "f4")
    kernel = Kernel("sensor/bloom", **double_float(rec.device))
    params = {
        "rows": rows,
        "cols": cols,
        "first_row": first,
        "last_row": last,
        "full_well_e": full_well_e,
        "zero": 0,
    }
    kernel.record(rec, kernel.cover(cols), params, charge=charge, kept=kept, spilled=spilled)
    return kept, spilled

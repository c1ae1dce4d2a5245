"""Correction of defective pixels. Stage ``shaders/isp/repair.wgsl``."""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording

# Beyond what noise does to one pixel of 12 million beside the extremes of eight others: a pixel of
# Gaussian noise leaves their range by 6 sigma once in 1e10.
SIGMAS = 6.0


def record_repair(
    rec: Recording,
    light: Array,
    step: int,
    noise: tuple[float, float],
    *,
    label: str = "repaired",
) -> Array:
    """Record the correction of pixels that stand out from the eight of their colour around.

    A point of light on a single pixel stands out as well, and goes.

    Parameters
    ----------
    rec : Recording
    light : Array (rows, cols), f32
        Relative to saturation.
    step : int
        Pixels between sites of one colour: 2 of a Bayer array, 1 without filters.
    noise : (float, float)
        Variance of light x: noise[0] x + noise[1], as DNG's NoiseProfile has it.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (rows, cols), f32
        Undefined less than `step` pixels from the rim.
    """
    rows, cols = light.shape
    repaired = rec.buffer(label, light.shape, "f4")
    kernel = Kernel("isp/repair", STEP=step)
    slope, floor = noise
    params = {"rows": rows, "cols": cols, "sigmas": SIGMAS, "slope": slope, "floor": floor}
    groups = kernel.cover(max(cols - 2 * step, 0), max(rows - 2 * step, 0))
    kernel.record(rec, groups, params, light=light, repaired=repaired)
    return repaired

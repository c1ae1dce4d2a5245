"""Charge-transfer inefficiency by traps, and its removal. Stage ``shaders/sensor/traps.wgsl``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording
from gpusim.sensor.cti_model import MAX_SPECIES, Cti

LEVELS = 32  # of what is filled, that are told apart
PACKETS = 4096  # in a dispatch: see the shader


def record_traps(
    rec: Recording,
    charge: Array,
    cti: Cti,
    *,
    well_e: float,
    serial: bool = False,
    before: int = 0,
    overscan: int = 0,
    label: str = "arrived",
) -> tuple[Array, Array]:
    """Record what arrives at the read-out of whole columns, or of whole rows.

    All traps are empty when the first packet of a line comes.

    Parameters
    ----------
    rec : Recording
    charge : Array (rows, cols), f32
        Electrons, with 0 for the overscan, where the last trails are read.
    cti : Cti
        With traps.
    well_e : float
        Full well of the elements, electrons, where ``cti`` does not give it.
    serial : bool
        Along rows, towards column 0; else along columns, towards row 0.
    before : int
        Elements between the first packet and the read-out.
    overscan : int
        How many of the last packets have no element of their own; below 0, how many elements lie
        beyond the last packet.
    label : str
        Label of the buffer that is returned first.

    Returns
    -------
    arrived : Array (rows, cols), f32
        Electrons.
    trapped : Array (cols,) or (rows,), f32
        Electrons that are still trapped behind each line. With ``arrived`` they are all that came
        in, but for roundings.
    """
    rows, cols = charge.shape
    lines, elements = (rows, cols) if serial else (cols, rows)
    sites = before + elements - overscan
    arrived = rec.buffer(label, charge.shape, "f4")
    trapped = rec.buffer(f"{label} trapped", lines, "f4")
    species = len(cti.traps)
    size = 4 * lines * (LEVELS * (2 if species > 2 else 1) + 3)
    levels = rec.buffer(f"{label} levels", size, "f4")
    kernel = Kernel("sensor/traps", SPECIES=species, DEPTH=LEVELS)
    spare = [0.0] * (MAX_SPECIES - species)
    params = {
        "lines": lines,
        "line_stride": cols if serial else 1,
        "element_stride": 1 if serial else cols,
        "before": before,
        "packets": elements,
        "well_fill_power": cti.well_fill_power,
        "notch_e": cti.notch_e,
        "depth_e": (cti.well_e or well_e) - cti.notch_e,
        "density": [*(one.density for one in cti.traps), *spare],
        "rate": [*(np.log2(np.e) / one.release_transfers for one in cti.traps), *spare],
    }
    buffers = {"charge": charge, "arrived": arrived, "trapped": trapped, "levels": levels}
    rec.clear(levels)
    rec.clear(trapped)
    groups = min(cti.groups, sites)
    for group in reversed(range(groups)):
        first, end = (number * sites // groups for number in (group, group + 1))
        start = max(first - before, 0)
        params |= {"first_site": first, "end_site": end, "first_packet": start}
        params["farthest"] = int(group == groups - 1)
        for begin in range(start, elements, PACKETS):
            params |= {"begin": begin, "end": min(begin + PACKETS, elements)}
            kernel.record(rec, kernel.cover(lines), params, **buffers)
    return arrived, trapped


def restored(
    device: Device,
    arrived: np.ndarray,
    add: Callable[[Recording, Array], Array],
    iterations: int = 4,
) -> np.ndarray:
    """Return the charge before it was shifted, as far as what arrived tells.

    Massey et al. 2010 (MNRAS 401, 371, section 3): there is no inverse of the transfer, but its
    effect is small, so that the frame itself is a first guess of the charge, and what the transfer
    does to a guess corrects the next: charge += arrived - add(charge). Each step leaves of the
    error about what the transfer changes of a signal.

    Parameters
    ----------
    device : Device
    arrived : ndarray (rows, cols)
        Electrons, with the overscan.
    add : callable
        Records the transfer of a frame, and returns what arrives: of `record_traps` the first.
    iterations : int
    """
    charge = arrived.astype(np.float32)
    for _ in range(iterations):
        rec = Recording(device)
        buffer = rec.buffer("charge", charge.shape, "f4")
        rec.upload(buffer, charge)
        label = rec.download(add(rec, buffer))
        charge = charge + (arrived - rec.run()[label])
    return charge

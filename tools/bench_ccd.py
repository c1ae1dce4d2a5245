"""Jobs of tools/bench.py for what a CCD does to its charge: smear and transfer inefficiency."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gpusim.gpu import Array, Device, Recording
from gpusim.reference.cti import cti
from gpusim.reference.smear import smear
from gpusim.reference.traps import traps
from gpusim.sensor.cti import record_cti
from gpusim.sensor.cti_model import Cti, Species
from gpusim.sensor.smear import record_smear
from gpusim.sensor.smear_model import Smear
from gpusim.sensor.traps import record_traps

SIDE = 2048  # of the frames whose charge is shifted
PART = 8  # columns of which the reference is found
WELL_E = 84_700.0
DENSITY, RELEASE, POWER = 10.0, 5.0, 0.58  # of the traps
# arcticpy needs a NumPy of its own, so that it runs beside: where GPUSIM_ARCTIC_PYTHON names a
# Python that has it, it is started once, and shifts the frame for each line that it is sent.
ARCTIC = """
import sys
import numpy as np
import arcticpy as arctic
frame = np.load(sys.argv[1]).astype(float)
well, density, release, power = map(float, sys.argv[2:])
traps = [arctic.TrapInstantCapture(density=density, release_timescale=release)]
ccd = arctic.CCD(full_well_depth=well, well_notch_depth=0.0, well_fill_power=power)
for line in sys.stdin:
    arctic.add_cti(
        frame, parallel_roe=arctic.ROE(), parallel_ccd=ccd, parallel_traps=traps,
        parallel_express=int(line), verbosity=0,
    )
    print("done", flush=True)
"""


def sky(rows: int, cols: int) -> np.ndarray:
    """Return a frame of electrons: noise on a background, with brighter places."""
    rng = np.random.default_rng(1)
    return rng.poisson(200 + 2000 * rng.random((rows, cols)) ** 4).astype(np.float32)


def _found(
    device: Device, record: Callable[[Recording], Array], expected: np.ndarray
) -> dict[str, object]:
    """Return the largest difference from the reference over its largest value."""
    rec = Recording(device)
    label = rec.download(record(rec))
    found = rec.run()[label][: len(expected), : expected.shape[1]]
    worst = np.abs(found - expected).max() / np.abs(expected).max()
    return {"measure": "largest difference over largest value", "worst": float(worst)}


def smear_job(device: Device, frame: tuple[int, int], job: type) -> object:
    """Time the smear of a frame-transfer sensor that is cleared by shifting."""
    rate, mean = 1e5 * sky(*frame), sky(*frame)
    model = Smear(kind="frame_transfer", row_s=1e-6)
    buffers = [device.resident(name, plane) for name, plane in (("rate", rate), ("mean", mean))]

    def record(rec: Recording) -> Array:
        return record_smear(rec, *buffers, model)

    expected = smear(rate[:, :PART], mean[:, :PART].astype(float), "cleared", model.weight_s)
    rec = Recording(device)
    record(rec)
    return job(rec.run, rate.size, _found(device, record, expected), 3 * rate.nbytes, rate.size, {})


def linear_job(device: Device, frame: tuple[int, int], job: type) -> object:
    """Time the linear model along columns and then along rows, at most 2048 x 2048."""
    charge = sky(*(min(side, SIDE) for side in frame))
    source = device.resident("charge", charge)

    def record(rec: Recording) -> Array:
        parallel = record_cti(rec, source, 1e-5, label="parallel")
        return record_cti(rec, parallel, 2e-5, serial=True)

    # Along rows what arrives depends on the columns before alone.
    expected = cti(cti(charge[:, :PART], 1e-5).T, 2e-5).T
    rec = Recording(device)
    record(rec)
    found = _found(device, record, expected)
    return job(rec.run, charge.size, found, 4 * charge.nbytes, charge.size, {})


def trap_job(device: Device, frame: tuple[int, int], job: type) -> object:
    """Time traps of one species along columns, at most 2048 x 2048; arcticpy is a peer."""
    charge = sky(*(min(side, SIDE) for side in frame))
    source = device.resident("charge", charge)
    model = Cti(traps=(Species(density=DENSITY, release_transfers=RELEASE),), well_fill_power=POWER)

    def record(rec: Recording) -> Array:
        return record_traps(rec, source, model, well_e=WELL_E)[0]

    law = {"well_fill_power": POWER, "well_e": WELL_E, "groups": model.groups}
    expected, _ = traps(charge[:, :1], [(DENSITY, RELEASE)], **law)
    rec = Recording(device)
    record(rec)
    found = _found(device, record, expected)
    return job(rec.run, charge.size, found, 2 * charge.nbytes, charge.size, _arctic_peers(charge))


def _arctic_peers(charge: np.ndarray) -> dict[str, tuple[Callable[[], object], float]]:
    """Return arcticpy's runs of the same frame, where there is a Python that has it."""
    python = os.environ.get("GPUSIM_ARCTIC_PYTHON")
    if not python:
        return {}
    folder = tempfile.TemporaryDirectory()
    file = Path(folder.name) / "charge.npy"
    np.save(file, charge)
    figures = (WELL_E, DENSITY, RELEASE, POWER)
    worker = subprocess.Popen(
        [python, "-c", ARCTIC, file, *map(str, figures)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )

    def run(express: int) -> None:
        worker.stdin.write(f"{express}\n")
        worker.stdin.flush()
        if worker.stdout.readline() != "done\n":
            raise RuntimeError(f"{python} could not run arcticpy")
        folder.cleanup()  # it has read the frame

    return {
        f"arcticpy, express {express}": (lambda express=express: run(express), 1.0)
        for express in (5, 1)
    }

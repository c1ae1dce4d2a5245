"""Cases of a CCD's charge on its way: transfers without number, traps, the sun, full columns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.gpu import Array, Recording, default_device
from gpusim.sensor.bloom import record_bloom
from gpusim.sensor.cti import record_cti
from gpusim.sensor.cti_model import Cti, Species
from gpusim.sensor.smear import record_smear
from gpusim.sensor.smear_model import Smear
from gpusim.sensor.traps import record_traps, restored
from gpusim.stress.table import Case

WELL_E = 84_700.0


def _shifted(plane: np.ndarray, record: Callable[[Recording, Array], tuple[Array, ...]]) -> list:
    """Return what a stage makes of a frame, in float64."""
    rec = Recording(default_device())
    buffer = rec.buffer("frame", plane.shape, "f4")
    rec.upload(buffer, plane)
    labels = [rec.download(array) for array in record(rec, buffer)]
    result = rec.run()
    return [result[label].astype(np.float64) for label in labels]


def ten_thousand_transfers() -> tuple:
    """Shift a packet 1e4 times, with inefficiencies from 1e-8 to 1e-2."""
    charge = np.zeros((400, 1), np.float32)
    charge[0] = 1e7
    worst = lost = 0.0
    for inefficiency in 10.0 ** np.arange(-8, -1):
        [found] = _shifted(
            charge,
            lambda rec, plane, e=inefficiency: (record_cti(rec, plane, e, before=9_999),),
        )
        kept = np.exp(1e4 * np.log1p(-inefficiency))
        worst = max(worst, abs(found[0, 0] / 1e7 - kept))
        lost = max(lost, abs(found.sum() / 1e7 - 1))
    got = f"off by {worst:.1e} of the packet at most; with all trails {lost:.1e} short"
    return "(1 - e)^n of the packet, and the rest behind it", got, worst < 1e-7 and lost < 1e-6


def traps_conserve() -> tuple:
    """Shift a frame with packets smaller than what the traps could take, and one sun."""
    rng = np.random.default_rng(8)
    charge = rng.poisson(0.3, (1000, 64)).astype(np.float32)
    charge[400:410, 10:20] = 5e4
    kinds = ((20.0, 0.5), (5.0, 10.0), (5.0, 300.0))
    cti = Cti(traps=tuple(Species(density=d, release_transfers=r) for d, r in kinds), groups=5)
    found, left = _shifted(charge, lambda rec, plane: record_traps(rec, plane, cti, well_e=WELL_E))
    short = (found.sum() + left.sum()) / charge.astype(float).sum() - 1
    right = abs(short) < 1e-6 and found.min() >= 0
    return "read and trapped are all there was, to 1e-6", f"{short:+.1e} of it", right


def traps_removed() -> tuple:
    """Remove from a frame what traps did to it."""
    charge = np.random.default_rng(9).poisson(300, (800, 16)).astype(np.float32)
    charge[200:204] = 3e4
    charge[-60:] = 0
    cti = Cti(traps=(Species(density=3.0, release_transfers=5.0),))

    def add(rec: Recording, plane: Array) -> Array:
        return record_traps(rec, plane, cti, well_e=WELL_E, overscan=60)[0]

    [found] = _shifted(charge, lambda rec, plane: (add(rec, plane),))
    left = restored(default_device(), found.astype(np.float32), add) - charge
    share = np.sqrt(np.mean(left**2) / np.mean((found - charge) ** 2))
    return "less than 0.5 % of what was added is left", f"{share:.2%}", share < 0.005


def smear_of_the_sun() -> tuple:
    """Smear dark rows, and rows of one electron per second, with the sun in their column."""
    rate = np.ones((500, 2), np.float32)
    rate[240:260, 0] = 1e12
    smear = Smear(kind="frame_transfer", row_s=1e-6)

    def record(rec: Recording, plane: Array) -> tuple[Array]:
        none = rec.buffer("none", plane.shape, "f4")
        rec.clear(none)
        return (record_smear(rec, plane, none, smear),)

    [found] = _shifted(rate, record)
    expected = (rate.astype(float).sum(axis=0) - rate) * 1e-6
    off = np.abs(found / expected - 1).max()
    return "t (sum of the column less the row), to f32", f"off by {off:.1e}", off < 2.0**-22


def blooming_columns() -> tuple:
    """Let every photosite of a column but a few hold more than it can."""
    charge = np.full((2000, 8), 1e7, np.float32)
    charge[::50] = 3
    charge[1000] = 16_777_215
    kept, spilled = _shifted(charge, lambda rec, plane: record_bloom(rec, plane, 20_000.0))
    total = kept.sum(axis=0) + spilled.sum(axis=(0, 2))
    lost = np.abs(total - charge.astype(float).sum(axis=0)).max()
    got = f"{lost:g} electrons lost of 2e10, at most {kept.max():g} in a photosite"
    return "no electron lost, none above the full well", got, lost == 0 and kept.max() == 20_000


CASES: tuple[Case, ...] = (
    ("1e4 transfers", ten_thousand_transfers, None),
    ("charge in traps", traps_conserve, None),
    ("traps undone", traps_removed, None),
    ("the sun smears", smear_of_the_sun, None),
    ("columns bloom", blooming_columns, None),
)

"""The rates of the sensor's stages, and of a dispatch."""

from __future__ import annotations

import time

import numpy as np

from gpusim.calibrate import timing
from gpusim.gpu import Device, Kernel, Recording
from gpusim.sensor.adc import record_adc
from gpusim.sensor.adc_model import DualGain
from gpusim.sensor.bloom import record_bloom
from gpusim.sensor.border import record_border
from gpusim.sensor.crosstalk import record_crosstalk
from gpusim.sensor.crosstalk_model import Kernels
from gpusim.sensor.cti import record_cti
from gpusim.sensor.cti_model import Cti, Species
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.load import load_sensor
from gpusim.sensor.merge import record_merge
from gpusim.sensor.mosaic import record_mosaic
from gpusim.sensor.noise import record_noise
from gpusim.sensor.smear import record_smear
from gpusim.sensor.smear_model import Smear
from gpusim.sensor.traps import record_traps

SIDE = 512  # of the frame for the sensor's stages, pixels
NOTHING = """
struct Params { number: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> found: array<u32>;
@compute @workgroup_size(1, 1, 1)
fn main() { found[0] = params.number; }
"""


def sensor_rates(device: Device) -> dict[str | int, float]:
    """Time mosaic, border, cross-talk of 3 x 3, exposure, noise, adc, merge at a mid-grey."""
    sensor = load_sensor("imx477").roi(SIDE, SIDE)
    rec = Recording(device)
    planes = rec.buffer("planes", (4, SIDE // 2, SIDE // 2), np.float32)
    glare = rec.buffer("glare", 4, np.float32)
    rec.upload(planes, np.full(planes.shape, 1e5, np.float32))
    rec.clear(glare)
    rate = record_mosaic(rec, planes, glare, sensor, (SIDE, SIDE))
    whole, even = (0, 0, SIDE, SIDE), Kernels({"*": [[1 / 9] * 3] * 3})
    rate = record_border(rec, rate, whole, whole)
    rate = record_crosstalk(rec, rate, even, sensor, given=whole, wanted=whole)
    mean = record_exposure(rec, rate, sensor, 0.01)
    dn = record_adc(rec, record_noise(rec, mean, sensor, seed=1), sensor)
    low = {"temporal_dark_noise_e": 12, "black_level_dn": 256, "switch_dn": 3800}
    dual = DualGain(system_gain_dn_per_e=sensor.system_gain_dn_per_e / 8, **low)
    record_merge(
        rec,
        dn,
        dn,
        sensor.model_copy(update={"dual_gain": dual, "analogue_gains": ()}),
        label="merged",
    )
    found = {stage: 1e9 * seconds / SIDE**2 for stage, seconds in timing.fastest(rec).items()}
    return found | {"crosstalk": found["crosstalk"] / 9}


def ccd_rates(device: Device) -> dict[str | int, float]:
    """Time what CCDs do to their charge, at a mid-grey."""
    rec = Recording(device)
    rate = rec.buffer("rate", (SIDE, SIDE), np.float32)
    rec.upload(rate, np.full(rate.shape, 1e3, np.float32))
    charge = record_smear(rec, rate, rate, Smear(kind="frame_transfer", row_s=1e-6))
    charge, _ = record_bloom(rec, charge, 1e5)
    charge = record_cti(rec, charge, 1e-5, label="shifted")
    traps = Cti(traps=(Species(density=1.0, release_transfers=5.0),), groups=1)
    record_traps(rec, charge, traps, well_e=1e5)
    return {stage: 1e9 * seconds / SIDE**2 for stage, seconds in timing.fastest(rec).items()}


def dispatch_rates(device: Device) -> dict[str | int, float]:
    """Time what a dispatch of next to nothing costs, in a pass of its own, host and device."""
    kernels = [Kernel.from_text(f"calibration/{name}", NOTHING) for name in ("this", "that")]
    spans = []
    for _ in range(timing.RUNS + 1):
        started = time.perf_counter()
        rec = Recording(device)
        found = rec.buffer("found", 1, np.uint32)
        for number in range(64):
            kernels[number % 2].record(rec, (1, 1, 1), {"number": number}, found=found)
        rec.run()
        spans.append((time.perf_counter() - started) / 64)
    return {"dispatch": 1e9 * min(spans)}

"""A capture made by hand, for the tests of what is shown and written without rendering."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from gpusim.camera import load_camera
from gpusim.certify import Certificate, Probe
from gpusim.isp.lens_tags import Optics
from gpusim.optics.grid import SimGrid
from gpusim.plan import Accuracy, PlanStage
from gpusim.plan.band import Band, Unknown
from gpusim.plan.candidates import RunnerUp
from gpusim.psf.local import LocalPsfs
from gpusim.render import Capture
from gpusim.scene import make_scene
from gpusim.scene.spectra import WAVELENGTHS_NM


class Fake(Capture):
    """A capture without a bank."""

    psfs = LocalPsfs(np.zeros((1, 2)), True, np.full((1, 4, 4, 3), 1 / 16), 12.0)


ROWS, COLS = 48, 64
MISSING = Unknown(700.0, 1200.0, ("the <filter>",), 0.234, "R")
STAGES = (
    PlanStage("paint", True, "drawn on the sim grid", 1e-5, 0.3),
    PlanStage("warp", False, "the scene is a <chart> & needs none"),
    PlanStage("fft rows", True, "2 blocks", 2e-4, 1.0),
    PlanStage("adc", True, "12 bit", None, 0.01),
)
RUNNERS_UP = (
    RunnerUp("fft, <4> samples", 1e-5, 3.25, "too dear: 3.25 s against 1.75 s"),
    RunnerUp("fft, 2 samples, cut", 4e-3, None, "error of its cut 4.0e-03 above 1.0e-03"),
)
# A lens that distorts by 5 % and shades by 30 % at the rim.
HEIGHT_UM = np.linspace(0, 4000, 65)
OPTICS = Optics(
    "a lens",
    8.3,
    2.8,
    HEIGHT_UM,
    HEIGHT_UM * (1 + 0.05 * (HEIGHT_UM / 4000) ** 2),
    1 - 0.3 * (HEIGHT_UM / 4000) ** 2,
)
POINTS = (
    Probe(row=3, col=5, truth=100.0, render=100.01, relative=1e-4, sigma=1e-3),
    Probe(row=40, col=60, truth=50.0, render=50.1, relative=2e-3, sigma=1.4e-2),
)


def fake_capture(
    certified: bool = True, keep: tuple[str, ...] = (), tolerance: float = 1e-3
) -> Capture:
    """Return a capture of 48 x 64 pixels with numbers that are easy to find again.

    Its total RMS is 1.5e-3.
    """
    rng = np.random.default_rng(1)
    # A 2 x 2 filter pattern of a grey scene between black level and white level, 12 bit.
    raw = rng.integers(300, 4000, (ROWS, COLS)).astype(np.uint16)
    plane = raw.astype(np.float32)
    certificate = Certificate(
        probes=len(POINTS),
        rms_relative=1.42e-3,
        worst_relative=2e-3,
        rms_sigma=1e-2,
        worst_sigma=1.4e-2,
        worst_position=(40, 60),
        unit="relative",
        engine_rms=1.42e-3,
        engine_worst=2e-3,
        bank_rms=3e-4,
        bank_worst=9e-4,
        sensor_rms=1e-7,
        sensor_worst=3e-7,
        window=5e-5,
        total_rms=1.5e-3,
        total_worst=2.2e-3,
        notes=("a word on how the bank was measured",),
        met=tolerance >= 1.5e-3,
        confidence="a word on confidence",
        seconds=0.5,
        points=POINTS,
    )
    scale = SimpleNamespace(
        name="whole",
        grid=SimGrid(ROWS, COLS, 4, 2, 256, 16, (3, 3)),
        pitch_um=0.775,
        sigma=0.8,
    )
    basis = SimpleNamespace(coefficients=np.eye(3))
    return Fake(
        raw=raw,
        rate=plane if "rate" in keep else None,
        electrons=plane if "electrons" in keep else None,
        white_e={"R": 900.0, "G": 1800.0, "B": 1000.0},
        transmission=np.full(61, 0.6),
        optics=OPTICS,
        notes=("a note of the scene",),
        plan=SimpleNamespace(
            basis=basis,
            scales=(scale,),
            stages=STAGES,
            name="fft & <whole> PSFs",
            predicted_s=1.75,
            rates="rates of a test",
            runners_up=RUNNERS_UP,
            tolerance=tolerance,
            shortfall="",
        ),
        times_s={"paint": 0.25, "fft rows": 1.5, "adc": 0.004},
        wall_s=2.25,
        prepare_s={"lens": 0.125},
        memory={"budget_bytes": 1 << 30, "peak_bytes": 123 << 20},
        work={"tiles": 1, "blocks": 9, "nodes": 16},
        rect=(0, 0, ROWS, COLS),
        device={"adapter": "a GPU", "driver": "a driver", "backend": "Vulkan"},
        certificate=certificate if certified else None,
        camera=load_camera("demo"),
        scene=make_scene("demo"),
        seed=7,
        frame=3,
        exposure_s=1 / 60,
        temperature_c=25.0,
        accuracy=Accuracy(tolerance=tolerance, probes=2),
        band=Band(WAVELENGTHS_NM, (MISSING,)),
        recipe={"camera": {"sensor": {}}, "noise": True},
        bank=None,
    )

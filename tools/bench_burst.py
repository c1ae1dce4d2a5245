"""The job of tools/bench.py for bursts: one light, read many times."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.gpu import Device
from gpusim.isp.lens_tags import Optics
from gpusim.library.light import Light
from gpusim.sensor.load import load_sensor
from gpusim.sensor.planes import planes_of

FRAMES, SIDE = 20, 512
EXPOSURES_S = (1 / 240, 1 / 60)
SIGNAL_E_PER_S = 120_000.0  # a quarter of the full well in the longer exposure


def burst_job(device: Device, frame: tuple[int, int], job: Callable) -> object:
    """Time a burst of 20 frames; the error is that of the raws, taken one by one."""
    side = min(SIDE, *frame)
    sensor = load_sensor("imx477").roi(side, side)
    period = planes_of(sensor).period
    size = (period**2, side // period, side // period)
    rates = SIGNAL_E_PER_S * np.random.default_rng(1).random(size, np.float32)
    none = np.zeros(0)
    light = Light(
        title="bench",
        scene="random",
        sensor=sensor,
        rect=(0, 0, side, side),
        area=(0, 0, side, side),
        rates=rates,
        glare=np.zeros(len(sensor.site_channels()), np.float32),
        white_e_per_s=dict.fromkeys(sensor.channels, SIGNAL_E_PER_S),
        transmission=np.ones(61),
        optics=Optics("bench", 8.0, 2.8, none, none, none),
        tolerance="none",
        recipe={},
    )

    def run() -> object:
        return light.burst(FRAMES, EXPOSURES_S, seed=1)

    burst = run()
    alone = [light.capture(at, seed=1, frame=k).raw for k, at in enumerate(EXPOSURES_S)]
    differing = sum(int((burst.raw[k] != one).sum()) for k, one in enumerate(alone))
    return job(run, burst.raw.size, {"pixels that differ": differing})

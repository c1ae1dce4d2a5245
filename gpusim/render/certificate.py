"""What a renderer made of a rectangle, judged at probe pixels: see `gpusim.certify`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gpusim.certify import (
    Certificate,
    ExactModel,
    Measure,
    Placed,
    Share,
    bank_share,
    certify,
    sensor_share,
)
from gpusim.plan.tiles import Rect
from gpusim.render.on_device import Progress
from gpusim.render.reading import Reading
from gpusim.sensor.frame import overlap
from gpusim.sensor.readout import Shot

if TYPE_CHECKING:
    from gpusim.render.renderer import Renderer


def certified(
    renderer: Renderer, reading: Reading, rect: Rect, shot: Shot, report: Progress
) -> Certificate:
    """Judge a rectangle that was read.

    Parameters
    ----------
    renderer : Renderer
        What rendered its light.
    reading : Reading
        With the planes ``rate`` and ``mean``.
    rect : (row, col, rows, cols)
        What was read.
    shot : Shot
        What it was read with.
    report : callable
        Called with (what, done, total).
    """
    sensor = renderer.camera.sensor
    seen = overlap(rect, sensor.frame.lit)
    top, left = seen[0] - rect[0], seen[1] - rect[1]
    light = reading.on_rect("rate")[top : top + seen[2], left : left + seen[3]]
    rate = Placed(light, seen)
    exact = ExactModel(renderer.bank, sensor, renderer.scene, renderer.placed)
    by = Measure(sensor, shot.exposure_s, renderer.accuracy)
    warm_c = sensor.reference_temperature_c if shot.temperature_c is None else shot.temperature_c

    def readout(pixels: np.ndarray) -> tuple[Share, str]:
        with renderer.device.pool.within(renderer.memory_bytes):
            made = reading.mean_signal()
        noise = renderer.plan.runs("noise")
        return sensor_share(by, made, pixels, temperature_c=warm_c, noise=noise)

    return certify(
        exact,
        rate,
        renderer.glare,
        by,
        progress=lambda done, total: report("certify", done, total),
        readout=readout,
        judged=lambda: (
            renderer.judged
            or bank_share(
                exact,
                renderer.camera.lens,
                rate,
                by,
                progress=lambda done, total: report("trace anew", done, total),
                dropped=renderer.band.dropped,
            )
        ),
    )

"""Several frames of one light, read in as few recordings as the memory allows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from gpusim.gpu import default_device
from gpusim.library.shot import checked
from gpusim.plan.stages import sensor_runs
from gpusim.plan.tiles import aligned, strips, tiles_of
from gpusim.render.reading import lit_for, read_together
from gpusim.sensor.planes import planes_of

if TYPE_CHECKING:
    from gpusim.library.light import Light
    from gpusim.sensor.readout import Shot
    from gpusim.sensor.sensor import Sensor


def read_raws(light: Light, sensors: Sequence[Sensor], shots: Sequence[Shot]) -> list[np.ndarray]:
    """Return the raws of several frames, as `Light.read` makes them one by one.

    Parameters
    ----------
    light : Light
    sensors : sequence of Sensor
        That read each frame: steps of one sensor's gain.
    shots : sequence of Shot

    Returns
    -------
    list of ndarray (rows, cols), uint16
    """
    budget, planes = default_device().pool.budget, planes_of(light.sensor)
    tiles = tiles_of(light.rect, planes.period, budget, None, planes.layers)

    def fits(count: int) -> bool:
        # What the frames share, half of what one needs, is there once.
        return len(strips(light.rect, 2 * budget // (count + 1))) == 1

    fit = max(filter(fits, range(1, len(shots) + 1)), default=1)
    fit = -(-len(shots) // -(-len(shots) // fit))  # the same in each recording
    if light.sensor.is_ccd or len(tiles) > 1 or fit == 1:
        return [
            light.at(sensor=sensor).read({"dn": np.uint16}, shot)["dn"]
            for sensor, shot in zip(sensors, shots, strict=True)
        ]
    whole = aligned(lit_for(light.rect, light.sensor, sensor_runs(light.sensor)), planes.period)
    raws: list[np.ndarray] = []
    for first in range(0, len(shots), fit):
        own = slice(first, first + fit)
        readers = [light.reader(sensor, sensor_runs(sensor)) for sensor in sensors[own]]
        known = [checked(*one) for one in zip(shots[own], sensors[own], strict=True)]
        raws += read_together(readers, known, light.rect, light.on_device(whole), whole)
    return raws

"""The halo of a render: light that lands beyond the window of the PSFs, on coarser grids."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from gpusim.psf.field_bank import FieldBank
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor


@dataclass(frozen=True)
class CoarseCamera:
    """A level of a halo before a coarse sensor."""

    level: FieldBank
    sensor: Sensor

    def bank(self, progress: Callable[[int, int], None] | None = None) -> FieldBank:
        """Return the level."""
        return self.level


def seen_by(scene: Scene, sensor: Sensor, coarse: Sensor, level_um: float) -> Scene:
    """Return the scene as a coarse sensor of another size sees it: where the real one does.

    Bright outliers of a photograph are samples like others where these are at most half as large as
    the level's own samples, `level_um` apart: it has no detail that would tell them apart.
    """
    half = tuple(side * sensor.pixel_pitch_um / 2 for side in (sensor.cols, sensor.rows))
    if isinstance(scene.source, Chart):
        scale = half[1] / (coarse.rows * coarse.pixel_pitch_um / 2)
        return replace(scene, source=scene.source.placed(scale))
    source = scene.source
    covered = half if source.half_um is None else source.half_um
    whole = source.whole or 2 * source.pitch_um(*half) <= level_um
    return replace(scene, source=replace(source, half_um=covered, whole=whole))

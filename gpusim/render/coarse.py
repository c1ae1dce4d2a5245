"""The halo of a render: light that lands beyond the window of the PSFs, on coarser grids."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gpusim.optics.halo import Halo, coarse_grid
from gpusim.optics.halo import needed as coarse_rects
from gpusim.parallel import each
from gpusim.plan import Accuracy, Plan
from gpusim.plan.costs import Costs
from gpusim.plan.fringes import lone_points
from gpusim.plan.tiles import Rect
from gpusim.plan.ways import WHOLE
from gpusim.psf.field_bank import FieldBank
from gpusim.render.on_device import Progress
from gpusim.render.planning import planning
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor

if TYPE_CHECKING:
    from gpusim.render.renderer import Renderer


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


def coarse_plan(camera: CoarseCamera, scene: Scene, accuracy: Accuracy, costs: Costs) -> Plan:
    """Return the plan of a level before a coarse sensor."""
    # A level is a tail itself: to plan where it might be cut took 2 s before a sinusoid.
    return planning(camera, scene, accuracy, costs, noise=False).plan("fft", (WHOLE,))


def coarse_halo(
    renderer: Renderer,
    rect: Rect,
    lit: Callable[[CoarseCamera, Scene, Accuracy, Rect], np.ndarray],
    report: Progress,
) -> Halo:
    """Return the halo of a rectangle of lit pixels, each of its levels from a coarse grid.

    Parameters
    ----------
    renderer : Renderer
    rect : (row, col, rows, cols)
    lit : callable
        Returns the light (S, rows, cols) of a level before a coarse sensor, on a rectangle of it.
    report : callable
        Called with (what, done, total).
    """
    sensor = renderer.camera.sensor
    banks = [renderer.bank.levels[level.number] for level in renderer.plan.halo]
    edges, lone = isinstance(renderer.scene.source, Chart), lone_points(renderer.scene)
    # Around points that stand alone all light is the first level's: on its own samples their chart
    # before the demonstration camera errs by 1.1e-2, on samples twice as wide by 1.8e-2.
    grids = [
        coarse_grid(bank, sensor, edges, first=level.number == 1 and not lone)
        for level, bank in zip(renderer.plan.halo, banks, strict=True)
    ]
    levels = [
        (
            CoarseCamera(bank, grid.sensor),
            seen_by(renderer.scene, sensor, grid.sensor, bank.pitch_um),
            level.accuracy,
        )
        for level, bank, grid in zip(renderer.plan.halo, banks, grids, strict=True)
    ]
    report("halo", 0, len(levels))
    # Rectangles share the plans.
    new = [one for one in levels if one[0].level.pitch_um not in renderer.coarse_plans]
    plans = each(lambda one: coarse_plan(*one, renderer.costs), new)
    for (camera, *_), plan in zip(new, plans, strict=True):
        renderer.coarse_plans[camera.level.pitch_um] = plan
    light = []
    for done, (level, part) in enumerate(zip(levels, coarse_rects(grids, rect), strict=True)):
        report("halo", done, len(levels))
        light.append(lit(*level, part))
    report("halo", len(levels), len(levels))
    return Halo(renderer.device, sensor, grids, light, rect)

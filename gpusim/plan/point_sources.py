"""What a photograph's highlights take: their tables on the host, and their sums."""

from __future__ import annotations

from gpusim.optics.point_sources import PointSources
from gpusim.plan.costs import Costs
from gpusim.plan.stage import PlanStage
from gpusim.psf.field_bank import FieldBank
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor


def describe_point_sources(
    bank: FieldBank,
    sensor: Sensor,
    scene: Scene,
    placed: Chart | PlacedRaster,
    tolerance: float,
    costs: Costs,
) -> PlanStage:
    """Describe the stage; its cost is that of the whole frame, and no further frame has it."""
    count = 0 if isinstance(placed, Chart) else len(placed.highlights)
    if not count:
        return PlanStage("point sources", False, "no part of the scene outshines the rest")
    given = placed.highlights, scene.spectra, tolerance, scene.wavelengths_nm
    work = PointSources(None, bank, sensor, *given).work()
    cost_s = sum(costs.seconds(name, amount) for name, amount in work.items())
    text = f"{count} highlights, each with the PSF of its own place, once a scene"
    return PlanStage("point sources", True, text, None, cost_s)

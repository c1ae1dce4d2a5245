"""A capture made by hand, for the tests of what is shown and written without rendering."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from gpusim.camera import load_camera
from gpusim.optics.grid import SimGrid
from gpusim.plan import PlanStage
from gpusim.scene import make_scene

ROWS, COLS = 48, 64
STAGES = (
    PlanStage("paint", True, "drawn on the sim grid", 1e-5, 0.3),
    PlanStage("warp", False, "the scene is a <chart> & needs none"),
    PlanStage("rows", True, "2 blocks", 2e-4, 1.0),
    PlanStage("adc", True, "12 bit", None, 0.01),
)
TIMES_S = {"paint": 0.25, "rows": 1.5, "adc": 0.004, "download": 0.1}

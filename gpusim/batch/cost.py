"""What a sweep takes by the planner's word, before a frame of it is rendered."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from gpusim.calibrate.rates import adapter_costs
from gpusim.gpu import default_device
from gpusim.plan import Accuracy
from gpusim.plan.deadline import first_frame_s
from gpusim.render.planning import planning
from gpusim.scene import make_scene
from gpusim.sensor.effects import EFFECTS

if TYPE_CHECKING:
    from gpusim.batch.sweep import Sweep

Progress = Callable[[str, int, int], None]
_READ_OUT = {effect.name for effect in EFFECTS}


class Cost(NamedTuple):
    """Predicted seconds on this adapter, of one worker.

    Attributes
    ----------
    light_s : float
        The optics of the sweep's first light, on the whole sensor; others count alike.
    frame_s : float
        Reading a frame out.
    all_s : float
        All lights and frames. Tracing lenses, certificates, the light beyond the PSFs' window and
        the writing of files come on top.
    """

    light_s: float
    frame_s: float
    all_s: float


def cost_of(sweep: Sweep, progress: Progress | None = None) -> Cost:
    """Plan the first light of a sweep, for which its lens is traced where it is not known yet.

    Parameters
    ----------
    sweep : Sweep
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    UserError
        The tolerance cannot be met, or a setting is none.
    """
    report = progress or (lambda what, done, total: None)
    frames = sweep.frames
    camera = frames[0].camera()
    scene = make_scene(frames[0].scene, **frames[0].scene_options, frame=camera.frame)
    accuracy = Accuracy.parse(str(sweep.tolerance), best_effort=sweep.best_effort)
    costs = adapter_costs(
        default_device(), progress=lambda done, total: report("calibrate", done, total)
    )
    plan = planning(
        camera,
        scene,
        accuracy,
        costs,
        progress=lambda done, total: report("lens", done, total),
    ).plan()
    frame_s = sum(
        stage.predicted_cost_s or 0.0
        for stage in plan.stages
        if stage.runs and stage.name in _READ_OUT
    )
    light_s = first_frame_s(plan) - frame_s
    lights = len({frame.light_key for frame in frames})
    return Cost(light_s, frame_s, lights * light_s + len(frames) * frame_s)

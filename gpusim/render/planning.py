"""The plan of a render: renders, dry runs and sweeps have it from here."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

from gpusim.camera import Camera
from gpusim.plan import Accuracy, Plan, plans_optics
from gpusim.plan.band import with_band
from gpusim.plan.costs import Costs
from gpusim.render.deadline import resolved
from gpusim.render.look import Look, look
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor


@dataclass(frozen=True, eq=False)
class Planning:
    """What plans are made of; `planning` makes it.

    Attributes
    ----------
    sensor : Sensor
    seen : Look
        What the camera sees of the scene.
    accuracy : Accuracy
        With a tolerance in place of a time.
    afforded : str
        What a time affords, in words; empty where none was given.
    costs : Costs
    noise : bool
    exposure_s : float
        Longest that will be captured.
    """

    sensor: Sensor
    seen: Look
    accuracy: Accuracy
    afforded: str
    costs: Costs
    noise: bool
    exposure_s: float

    def plan(self, method: str | None = None, force: Collection[str] = ()) -> Plan:
        """Return the plan for a method, or for the cheapest: see `gpusim.plan.plan_optics`."""
        return self.plans(1, method, force)[0]

    def plans(
        self, count: int, method: str | None = None, force: Collection[str] = ()
    ) -> list[Plan]:
        """Return the plan and what the planner takes for the next cheapest ways, `count` in all."""
        found = plans_optics(
            self.seen.bank,
            self.sensor,
            self.seen.scene,
            self.accuracy.planned,
            self.costs,
            count=count,
            noise=self.noise,
            method=method,
            force=force,
            exposure_s=self.exposure_s,
            density=self.seen.density,
        )
        return [with_band(plan, self.seen.band) for plan in found]


def planning(
    camera: Camera,
    scene: Scene,
    accuracy: Accuracy,
    costs: Costs,
    *,
    noise: bool = True,
    method: str | None = None,
    force: Collection[str] = (),
    exposure_s: float = math.inf,
    seen: Look | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Planning:
    """Choose what a render samples, and trace the lens where it is not known yet.

    Parameters
    ----------
    camera, scene, accuracy
    costs : Costs
        Rates of the adapter that is to render.
    noise, exposure_s
        As of `gpusim.plan.plan_optics`.
    method, force
        Of the plans by which a time is made a tolerance.
    seen : Look, optional
        What the camera sees of the scene, where that is known.
    progress : callable, optional
        Called with (done, total) while the lens is traced.

    Raises
    ------
    UserError
        When the tolerance cannot be met, or no plan is as fast as was asked for.
    """
    if seen is not None:
        return Planning(camera.sensor, seen, accuracy, "", costs, noise, exposure_s)
    given = {"noise": noise, "method": method, "force": force, "exposure_s": exposure_s}
    accuracy, afforded = resolved(camera, scene, accuracy, costs, **given, progress=progress)
    seen = look(camera, scene, accuracy.planned, exposure_s, progress)
    return Planning(camera.sensor, seen, accuracy, afforded, costs, noise, exposure_s)

"""The accuracy that a time allows, for a camera before a scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import replace

from gpusim.camera import Camera
from gpusim.plan import Accuracy, Plan, plan_optics
from gpusim.plan.accuracy import LARGEST
from gpusim.plan.costs import Costs
from gpusim.plan.deadline import first_frame_s, predicted_error, tightest
from gpusim.plan.density import Density
from gpusim.render.look import Look, look
from gpusim.scene.scene import Scene


def resolved(
    camera: Camera,
    scene: Scene,
    accuracy: Accuracy,
    costs: Costs,
    *,
    noise: bool = True,
    method: str | None = None,
    force: Collection[str] = (),
    exposure_s: float = math.inf,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Accuracy, str]:
    """Return an accuracy with a tolerance in place of a time, and in words what was found.

    Parameters
    ----------
    camera, scene
    accuracy : Accuracy
        One without ``within_s`` is returned as it is.
    costs : Costs
        Rates of the adapter that is to render: another adapter affords another tolerance.
    noise, method, force, exposure_s
        As of `gpusim.plan.plan_optics`.
    progress : callable, optional
        Called with (done, total) while the lens is traced.

    Raises
    ------
    UserError
        No plan is so fast and no best effort is asked for; or the loosest cannot be met.
    """
    if accuracy.within_s is None:
        return accuracy, ""

    def seen_for(tolerance: float) -> tuple[Look, Accuracy]:
        asked = replace(accuracy, tolerance=tolerance, within_s=None, best_effort=False)
        return look(camera, scene, asked, exposure_s, progress), asked

    def planned(seen: Look, asked: Accuracy, density: Density | None) -> Plan:
        given = {"noise": noise, "method": method, "force": force, "exposure_s": exposure_s}
        return plan_optics(
            seen.bank, camera.sensor, seen.scene, asked, costs, density=density, **given
        )

    def plan_for(tolerance: float) -> Plan:
        seen, asked = seen_for(tolerance)
        return planned(seen, asked, seen.density)

    coarse, loosest = seen_for(LARGEST)

    def guess(tolerance: float) -> Plan:
        # On the coarsest bank: a denser one takes minutes to trace and changes little of the time.
        return planned(coarse, replace(loosest, tolerance=tolerance), None)

    tolerance, plan = tightest(plan_for, guess, accuracy)
    spent = first_frame_s(plan)
    words = (
        f"{accuracy.text}: planned for {tolerance:g} of the local signal, predicted to err by "
        f"{predicted_error(plan):.1e} and to take {spent:.2g} s"
    )
    if spent > accuracy.within_s:
        words += ", for no plan is faster"
    return replace(accuracy, tolerance=tolerance, within_s=None), words

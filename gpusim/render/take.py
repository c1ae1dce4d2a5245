"""One frame of a camera and a scene, from preparation to release."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from gpusim.camera import Camera
from gpusim.plan import Accuracy
from gpusim.plan.costs import Costs
from gpusim.render.anew import planned_anew
from gpusim.render.capture import Capture
from gpusim.render.checks import rectangle
from gpusim.render.on_device import Progress
from gpusim.render.renderer import Renderer
from gpusim.scene.scene import Scene


def capture(
    camera: Camera,
    scene: Scene,
    *,
    exposure_s: float,
    seed: int = 0,
    frame: int = 0,
    temperature_c: float | None = None,
    accuracy: Accuracy | None = None,
    memory_bytes: int | None = None,
    tile: tuple[int, int, int, int] | None = None,
    tile_px: int | None = None,
    keep: tuple[str, ...] = (),
    folder: Path | None = None,
    noise: bool = True,
    method: str | None = None,
    gain: float | None = None,
    costs: Costs | None = None,
    progress: Progress | None = None,
) -> Capture:
    """Prepare a camera and a scene, and render one frame: see `Renderer` and `Renderer.capture`.

    Where the certificate misses the tolerance, the frame is made again: see `gpusim.render.anew`.
    ``gain``: a step of the sensor's analogue gain, see `Sensor.at_gain`. ``costs``: the rates that
    the plan is made from, those of the adapter if not given.
    """
    if gain is not None:
        camera = replace(camera, sensor=camera.sensor.at_gain(gain))
    rectangle(tile, camera.sensor)  # before the long work
    camera.sensor.dark_current_at(temperature_c)  # as well

    def attempt(asked: Accuracy) -> Capture:
        # A frame that is not bettered keeps its files.
        own = None if folder is None else Path(tempfile.mkdtemp(dir=folder))
        renderer = Renderer(
            camera,
            scene,
            asked,
            progress=progress,
            memory_bytes=memory_bytes,
            exposure_s=exposure_s,
            noise=noise,
            method=method,
            costs=costs,
        )
        try:
            return renderer.capture(
                exposure_s,
                seed=seed,
                frame=frame,
                temperature_c=temperature_c,
                tile=tile,
                tile_px=tile_px,
                keep=keep,
                folder=own,
                progress=progress,
            )
        finally:
            renderer.release()

    return planned_anew(accuracy or Accuracy(), attempt)

"""Bringing the light of a scene onto the photosites of a camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.errors import UserError
from gpusim.library.light import Light
from gpusim.plan import Accuracy
from gpusim.plan.stages import sensor_runs
from gpusim.plan.tiles import Rect, aligned
from gpusim.render.anew import planned_anew
from gpusim.render.certificate import certified
from gpusim.render.checks import rectangle
from gpusim.render.lighting import planes_on
from gpusim.render.reading import lit_for, taken_for
from gpusim.render.renderer import Renderer
from gpusim.sensor.readout import Shot

if TYPE_CHECKING:
    from gpusim.camera import Camera
    from gpusim.scene.scene import Scene


def expose(
    camera: Camera,
    scene: Scene,
    tolerance: float | str = 1e-3,
    *,
    probes: int | None = None,
    tile: tuple[int, int, int, int] | None = None,
    exposure_s: float | None = None,
    best_effort: bool = False,
    memory_bytes: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Light:
    """Bring the light of a scene through a camera's lens onto its photosites.

    Where the certificate misses the tolerance, the light is made again by a plan for less error.

    Parameters
    ----------
    camera : Camera
    scene : Scene
    tolerance : float or str
        Root mean square error of the mean signal, relative to it; ``"0.1sigma"``: of its noise;
        ``"as good as 0.4 s allows"``: the least whose kernels, light and read-out are predicted to
        take no longer on this adapter, for a whole frame. The light's notes say what that is.
    probes : int, optional
        Pixels at which the result is held against the exact model; 0: no certificate. By default as
        many as settle whether the tolerance is met, from 64 to 256.
    tile : (x, y, width, height), optional
        The rectangle of lit pixels to make; by default all that is read out.
    exposure_s : float, optional
        The longest that will be captured; a tolerance in sigmas is planned for it.
    best_effort : bool
        Whether to go on where the tolerance cannot be met.
    memory_bytes : int, optional
        Budget of device memory, by default the device's.
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    UserError
        The tolerance cannot be met, the memory does not suffice, a value is out of range, or
        what is given is no camera and no scene.

    Examples
    --------
    >>> import gpusim as gs
    >>> small = gs.Camera.load("mtf-only")
    >>> small = gs.Camera(small.lens, small.sensor.roi(48, 64), "small")
    >>> gs.expose(small, gs.Scene.load("colorchecker"), 1e-2, probes=0)
    Light('small', 'colorchecker', 64 x 48 pixels)
    """
    _check_given(camera, scene, probes, tile, exposure_s)
    accuracy = Accuracy.parse(str(tolerance), probes, best_effort=best_effort)
    rect = rectangle(tile, camera.sensor)
    # Only a tolerance in sigmas asks for the exposure.
    longest: dict[str, Any] = {} if exposure_s is None else {"exposure_s": exposure_s}

    def attempt(asked: Accuracy) -> Light:
        renderer = Renderer(
            camera, scene, asked, progress=progress, memory_bytes=memory_bytes, **longest
        )
        try:
            return lit(renderer, rect, progress)
        finally:
            renderer.release()

    return planned_anew(accuracy, attempt)


def _check_given(
    camera: object,
    scene: object,
    probes: object,
    tile: Sequence[int] | None,
    exposure_s: float | None,
) -> None:
    """Refuse a name in place of a camera or a scene, the two in each other's place, and the like.

    What has a lens and a sensor is a camera, what has spectra and a source is a scene.
    """
    if not (hasattr(camera, "lens") and hasattr(camera, "sensor")):
        raise UserError(
            "not a camera",
            field="camera",
            value=camera,
            allowed="gs.Camera(lens, sensor), or gs.Camera.load of a name or file",
        )
    if not (hasattr(scene, "spectra") and hasattr(scene, "source")):
        raise UserError(
            "not a scene",
            field="scene",
            value=scene,
            allowed="gs.Scene.from_rgb, gs.Scene.from_spectra, or gs.Scene.load of a name or file",
        )
    if probes is not None and not isinstance(probes, Integral):
        raise UserError(
            "not a number of probes", field="probes", value=probes, allowed="whole, 0 or more"
        )
    if tile is not None and len(tile) != 4:
        raise UserError("not a tile", field="tile", value=tile, allowed="x, y, width, height")
    if exposure_s is not None and not 0 < exposure_s:
        raise UserError(
            "no such exposure", field="exposure_s", value=exposure_s, allowed="seconds above 0"
        )


def lit(
    renderer: Renderer,
    rect: Rect,
    progress: Callable[[str, int, int], None] | None = None,
) -> Light:
    """Return the light of a renderer on a rectangle of what is read, certified if it says so."""
    sensor, report = renderer.camera.sensor, progress or (lambda what, done, total: None)
    runs = sensor_runs(sensor)
    wanted = lit_for(taken_for(rect, sensor, runs), sensor, runs)
    area = aligned(wanted, renderer.period)
    light = Light(
        title=renderer.camera.title,
        scene=renderer.scene.name,
        sensor=sensor,
        rect=rect,
        area=area,
        rates=planes_on(renderer, area, progress),
        glare=renderer.glare,
        white_e_per_s=renderer.white_e_per_s,
        transmission=renderer.transmission,
        optics=renderer.optics,
        tolerance=renderer.accuracy.text,
        recipe=renderer.recipe,
        notes=renderer.notes,
    )
    if not renderer.accuracy.certified:
        return light
    exposure_s = min(light.white_exposure_s, renderer.longest_s)
    planes = {"dn": np.uint16, "rate": np.float32, "mean": np.float32}
    shot = Shot(exposure_s, 0, 0)
    try:
        reading = light.reading(planes, shot)
        certificate = certified(renderer, reading, rect, shot, report)
    finally:
        light.release()
    return replace(light, certificate=certificate)

"""A camera before a scene whose settings change: each change redoes what it touches, and no more.

| what changes | what is done again |
|---|---|
| exposure, ISO, gain, seed, frame, temperature, noise, figures of the read-out | read-out |
| the part of the sensor that is looked at | light, read-out |
| lens, focus, f-number, pixels, filters, scene, tolerance | plan, light, read-out |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from gpusim.camera import Camera
from gpusim.errors import UserError
from gpusim.library.expose import lit
from gpusim.library.light import Light
from gpusim.plan import Accuracy
from gpusim.render.anew import planned_anew
from gpusim.render.checks import rectangle
from gpusim.render.renderer import Renderer
from gpusim.sensor.optical import optical_differences

if TYPE_CHECKING:
    from gpusim.library.frame import Frame
    from gpusim.plan.stages import Plan
    from gpusim.scene.scene import Scene

# How each setting of a lens is made, from the lens that the session was given; in this order.
LENS_SETTINGS: dict[str, Callable[[Any, float], Any]] = {
    "focal_length_mm": lambda lens, value: lens.scaled(value),
    "f_number": lambda lens, value: lens.stopped(value),
    "max_field_deg": lambda lens, value: lens.limited(value),
    "focus_distance_m": lambda lens, value: lens.looking(None, value),
    "focus_shift_um": lambda lens, value: lens.defocused(value),
}
READ_OUT = ("exposure_s", "iso", "gain", "seed", "frame", "temperature_c", "noise")
PARTS = ("lens", "sensor", "scene", "tolerance", "probes", "tile")


class Session:
    """A camera before a scene.

    Parameters
    ----------
    camera : Camera
    scene : Scene
    tolerance : float or str
        As of `gpusim.expose`.
    probes : int
        Number of the certificate's probe pixels; 0: none, which suits a preview.
    progress : callable, optional
        Called with (what, done, total).

    Examples
    --------
    >>> import gpusim as gs
    >>> small = gs.Camera.load("mtf-only")
    >>> small = gs.Camera(small.lens, small.sensor.roi(48, 64), "small")
    >>> session = gs.Session(small, gs.Scene.load("colorchecker"), tolerance=1e-2)
    >>> session.frame().raw.shape, session.redone
    ((48, 64), ('plan', 'light', 'read-out'))
    >>> session.change(exposure_s=1/30).frame().exposure_s, session.redone
    (0.03333333333333333, ('read-out',))
    >>> session.release()
    """

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        tolerance: float | str = 1e-3,
        *,
        probes: int = 0,
        progress: Callable[[str, int, int], None] | None = None,
    ) -> None:
        self.redone: tuple[str, ...] = ()  # by the last frame: of "plan", "light", "read-out"
        self.progress, self._title = progress, camera.title
        self._parts: dict[str, Any] = {
            "lens": camera.lens,
            "sensor": camera.sensor,
            "scene": scene,
            "tolerance": tolerance,
            "probes": probes,
            "tile": None,
        }
        self._lens_settings: dict[str, float] = {}
        self._read_out: dict[str, Any] = {}
        self._renderer: Renderer | None = None
        self._light: Light | None = None
        self._shown: Frame | None = None

    def __repr__(self) -> str:
        settings = {**self._lens_settings, **self._read_out}
        said = "".join(f", {name} {value}" for name, value in settings.items())
        return f"Session({self.camera.title!r}, {self._parts['scene'].name!r}{said})"

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *given: object) -> None:
        self.release()

    @property
    def camera(self) -> Camera:
        """The camera as it is set now."""
        lens = self._parts["lens"]
        for name, make in LENS_SETTINGS.items():
            if name in self._lens_settings:
                lens = make(lens, self._lens_settings[name])
        return Camera(lens, self._parts["sensor"], self._title)

    def change(self, **settings: Any) -> Session:
        """Change settings; the next frame does again what they touch.

        Parameters
        ----------
        **settings
            ``exposure_s``, ``iso``, ``gain``, ``seed``, ``frame``, ``temperature_c``, ``noise``;
            ``lens``, ``sensor``, ``scene``, ``tolerance``, ``probes``, ``tile`` (x, y, width,
            height); ``focal_length_mm``, ``f_number``, ``max_field_deg``, ``focus_distance_m``,
            ``focus_shift_um``. None takes a setting back.

        Raises
        ------
        UserError
            No such setting, or a value that it cannot have; nothing is changed then.

        Examples
        --------
        >>> import gpusim as gs
        >>> with gs.Session(gs.Camera.load("demo"), gs.Scene.load("colorchecker")) as session:
        ...     session.change(f_number=4.0, exposure_s=1/30).camera.lens.f_number
        4.0
        """
        known = (*READ_OUT, *PARTS, *LENS_SETTINGS)
        for name in settings:
            if name not in known:
                raise UserError(
                    "there is no such setting", field=name, allowed=", ".join(sorted(known))
                )
        before = dict(self._parts), dict(self._lens_settings), dict(self._read_out)
        try:
            for name, value in settings.items():
                self._set(name, value)
            rectangle(self._parts["tile"], self._parts["sensor"])
            made = self.camera  # a lens that cannot be so refuses here
            self._accuracy()
        except BaseException:
            self._parts, self._lens_settings, self._read_out = before
            raise
        self._forget(before, made)
        return self

    def _set(self, name: str, value: Any) -> None:
        if name in self._parts:
            self._parts[name] = value
            return
        group = self._lens_settings if name in LENS_SETTINGS else self._read_out
        if value is None:
            group.pop(name, None)
        else:
            group[name] = value

    def _forget(self, before: tuple[dict, dict, dict], made: Camera) -> None:
        """Drop what the change of the settings made stale."""
        parts, lens_settings, _ = before
        self._shown = None
        stale = [name for name in PARTS if name != "tile" and parts[name] is not self._parts[name]]
        if "sensor" in stale and self._light is not None:
            old = self._light.sensor
            if not optical_differences(made.sensor, old):
                self._light = self._light.at(sensor=made.sensor)
                stale.remove("sensor")
        if stale or lens_settings != self._lens_settings:
            self.release()
        elif parts["tile"] != self._parts["tile"]:
            self._drop_light()

    def _accuracy(self) -> Accuracy:
        return Accuracy.parse(str(self._parts["tolerance"]), self._parts["probes"])

    @property
    def plan(self) -> Plan | None:
        """How the light of the last frame was made; None before the first."""
        return None if self._renderer is None else self._renderer.plan

    def light(self) -> Light:
        """Return the light of the settings of now, made if it is not there.

        Examples
        --------
        >>> import gpusim as gs
        >>> small = gs.Camera.load("mtf-only")
        >>> small = gs.Camera(small.lens, small.sensor.roi(48, 64), "small")
        >>> with gs.Session(small, gs.Scene.load("colorchecker"), 1e-2) as session:
        ...     session.light().rect, session.redone, session.plan.tolerance
        ((0, 0, 48, 64), ('plan', 'light'), 0.01)
        """
        light, done = self._light, []
        if light is None:
            if self._renderer is None:
                done.append("plan")
            # A tighter plan that is there already stays: another rectangle begins with it.
            aim = None if self._renderer is None else self._renderer.accuracy.aim
            light = self._light = planned_anew(replace(self._accuracy(), aim=aim), self._lit)
            done.append("light")
        self.redone = tuple(done)
        return light

    def _lit(self, asked: Accuracy) -> Light:
        """Return the light by the renderer that is there, or by one for an accuracy."""
        if self._renderer is None or self._renderer.accuracy.aim != asked.aim:
            # Where this is refused, the renderer that is there stays.
            other = Renderer(self.camera, self._parts["scene"], asked, progress=self.progress)
            if self._renderer is not None:
                self._renderer.release()
            self._renderer = other
        rect = rectangle(self._parts["tile"], self._parts["sensor"])
        return lit(self._renderer, rect, self.progress)

    def frame(self) -> Frame:
        """Return a frame with the settings of now; the last one where nothing was changed.

        Raises
        ------
        UserError
            A setting has a value that it cannot have, or the tolerance cannot be met.
        """
        if self._shown is not None:
            self.redone = ()
            return self._shown
        self._shown = self.light().capture(**self._read_out)
        self.redone = (*self.redone, "read-out")
        return self._shown

    def release(self) -> None:
        """Give the device's memory back; the next frame makes all anew."""
        self._drop_light()
        if self._renderer is not None:
            self._renderer.release()
            self._renderer = None

    def _drop_light(self) -> None:
        if self._light is not None:
            self._light.release()
            self._light = None

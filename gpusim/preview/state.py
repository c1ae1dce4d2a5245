"""What is looked at: the camera's knobs, the scene, and the part of the sensor on screen."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

from gpusim.camera import Camera, load_camera
from gpusim.errors import UserError
from gpusim.scene.make import make_scene
from gpusim.scene.patterns import Frame
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor

LENS_KNOBS = ("focal_length_mm", "f_number", "focus_distance_m", "focus_shift_um")
SCENE_KNOBS = ("scene", "luminance_cd_m2", "illuminant")
# Effects of a sensor that can be switched off: the fields of its file that are left out then.
EFFECTS: dict[str, tuple[str, ...]] = {
    "dark current": ("dark_current_e_per_s", "dcnu_percent"),
    "read noise": ("temporal_dark_noise_e", "read_noise_law", "reset_noise", "lines"),
    "DSNU": ("dsnu_e", "column_offset"),
    "PRNU": ("prnu_percent",),
    "masks": ("masks",),
    "defects": ("defects",),
    "cross-talk": ("crosstalk",),
    "non-linearity": ("linearity", "full_well_knee"),
    "veiling glare": ("veiling_glare",),
    "smear, bloom": ("smear", "bloom"),
    "CTI": ("parallel_cti", "serial_cti"),
}
# What these fields are where their effect is off, if that is not their default.
OFF = {
    "temporal_dark_noise_e": 0.0,
    "dark_current_e_per_s": 0.0,
    "dsnu_e": 0.0,
    "prnu_percent": 0.0,
    "veiling_glare": 0.0,
}


@dataclass(frozen=True)
class Knobs:
    """Everything that can be turned. None: what the camera, the scene or the sensor has itself.

    Attributes
    ----------
    camera, scene : str
        As for ``gpusim render``.
    lens, sensor : str, optional
        Other parts in place of the camera's own.
    focal_length_mm, f_number, focus_distance_m, focus_shift_um : float, optional
        The lens's.
    luminance_cd_m2, illuminant : float, str, optional
        The scene's.
    exposure_s, iso, temperature_c, seed, noise
        Settings of the read-out.
    off : frozenset of str
        Effects of `EFFECTS` that are switched off.
    ev : float
        Stops by which the picture is shown brighter.
    tolerance : str
        Error allowed in the picture that is made at rest.
    """

    camera: str
    scene: str
    lens: str | None = None
    sensor: str | None = None
    focal_length_mm: float | None = None
    f_number: float | None = None
    focus_distance_m: float | None = None
    focus_shift_um: float | None = None
    luminance_cd_m2: float | None = None
    illuminant: str | None = None
    exposure_s: float | None = None
    iso: int | None = None
    temperature_c: float | None = None
    seed: int = 0
    noise: bool = True
    off: frozenset[str] = frozenset()
    ev: float = 0.0
    tolerance: str = "1e-2"

    def turned(self, **changes: Any) -> Knobs:
        """Return the knobs with others.

        Raises
        ------
        UserError
            There is no such knob, or no such effect.
        """
        known = [one.name for one in fields(self)]
        for name in changes:
            if name not in known:
                raise UserError("there is no such knob", field=name, allowed=", ".join(known))
        if "off" in changes:
            changes["off"] = frozenset(changes["off"])
            for effect in changes["off"] - EFFECTS.keys():
                raise UserError(
                    "there is no such effect", field="off", value=effect, allowed=", ".join(EFFECTS)
                )
        return replace(self, **changes)

    @property
    def optics(self) -> tuple[Any, ...]:
        """What the light depends on beside the part that is looked at."""
        names = ("camera", "lens", "sensor", *LENS_KNOBS, *SCENE_KNOBS)
        return (*(getattr(self, name) for name in names), "veiling glare" in self.off)

    @property
    def lens_key(self) -> tuple[Any, ...]:
        """What the lens depends on."""
        # The sensor's corners are as far as a lens is traced whose file states the axis alone.
        names = ("camera", "lens", "sensor", *LENS_KNOBS)
        return tuple(getattr(self, name) for name in names)

    @property
    def lens_changes(self) -> tuple[tuple[str, Any], ...]:
        """The fields of the camera file's lens that are turned, with their values."""
        given = ((name, getattr(self, name)) for name in LENS_KNOBS)
        other = () if self.lens is None else (("prescription", self.lens),)
        return (*other, *((name, value) for name, value in given if value is not None))

    def made_camera(self) -> Camera:
        """Return the camera, its sensor at its gain and without the effects that are off.

        Raises
        ------
        UserError
            A part is missing or a value is one that it cannot have.
        """
        made = _camera(self.camera, self.lens_changes, self.sensor)
        sensor = made.sensor if self.iso is None else made.sensor.at_iso(self.iso)
        return Camera(made.lens, without(sensor, self.off), made.title)

    def made_scene(self) -> Scene:
        """Return the scene, laid out for the sensor.

        Raises
        ------
        UserError
            There is none of that name, or a value is one that it cannot have.
        """
        frame = self.bare.made_camera().frame
        return _scene(self.scene, self.luminance_cd_m2, self.illuminant, frame)

    @property
    def bare(self) -> Knobs:
        """The same camera with its lens as it is and all effects on."""
        return Knobs(self.camera, self.scene, self.lens, self.sensor)

    def command(self, tile: tuple[int, int, int, int] | None, exposure_s: float) -> str:
        """Return the command line that makes the raw, beside the camera file that was saved."""
        words = ["gpusim", "render", "camera.yaml", self.scene, "--exposure", repr(exposure_s)]
        given = {
            "--luminance": self.luminance_cd_m2,
            "--illuminant": self.illuminant,
            "--iso": self.iso,
            "--temperature": self.temperature_c,
            "--ev": self.ev or None,
            "--seed": self.seed,
            "--tolerance": self.tolerance,
            "--tile": None if tile is None else ",".join(map(str, tile)),
        }
        for option, value in given.items():
            if value is not None:
                words += [option, str(value)]
        if not self.noise:
            words.append("--no-noise")
        return " ".join([*words, "--out", "out"])


def without(sensor: Sensor, off: frozenset[str]) -> Sensor:
    """Return a sensor without the effects that are switched off."""
    update = {}
    for effect in off:
        for name in EFFECTS[effect]:
            update[name] = OFF.get(
                name, Sensor.model_fields[name].get_default(call_default_factory=True)
            )
    return sensor.model_copy(update=update) if update else sensor


def having(sensor: Sensor) -> list[str]:
    """Return the effects of `EFFECTS` that a sensor has."""
    return [name for name in EFFECTS if without(sensor, frozenset((name,))) != sensor]


@lru_cache(maxsize=8)
def _camera(name: str, lens: tuple[tuple[str, Any], ...], sensor: str | None) -> Camera:
    return load_camera(name, dict(lens), sensor)


@lru_cache(maxsize=4)
def _scene(name: str, luminance: float | None, illuminant: str | None, frame: Frame) -> Scene:
    return make_scene(name, luminance, illuminant, frame=frame)


@dataclass(frozen=True)
class View:
    """The part of the sensor on screen.

    Attributes
    ----------
    x, y : float
        The photosite in the middle of the view, columns and rows.
    scale : float
        Points of the screen to a photosite.
    width, height : int
        Size of the view, points.
    """

    x: float
    y: float
    scale: float
    width: int
    height: int

    @classmethod
    def whole(cls, rows: int, cols: int, width: int, height: int) -> View:
        """Return the view of a whole sensor."""
        return cls(cols / 2, rows / 2, min(width / cols, height / rows), width, height)

    def panned(self, dx: float, dy: float) -> View:
        """Return the view moved with a pointer, points."""
        return replace(self, x=self.x - dx / self.scale, y=self.y - dy / self.scale)

    def zoomed(self, factor: float, px: float, py: float) -> View:
        """Return the view scaled about a point of it, which stays where it is."""
        scale = min(max(self.scale * factor, 0.01), 64.0)
        x, y = self.at(px, py)
        return replace(
            self,
            x=x - (px - self.width / 2) / scale,
            y=y - (py - self.height / 2) / scale,
            scale=scale,
        )

    def at(self, px: float, py: float) -> tuple[float, float]:
        """Return the photosite at a point of the view."""
        return (
            self.x + (px - self.width / 2) / self.scale,
            self.y + (py - self.height / 2) / self.scale,
        )

    def seen(self, rows: int, cols: int, period: int) -> tuple[int, int, int, int]:
        """Return the pixels (x, y, width, height) on screen, out to whole filter patterns.

        At least one pattern, where the view lies beside the sensor.
        """
        sides = []
        for middle, points, size in ((self.x, self.width, cols), (self.y, self.height, rows)):
            half = points / 2 / self.scale
            first = min(max(math.floor((middle - half) / period) * period, 0), size - period)
            last = max(math.ceil((middle + half) / period) * period, first + period)
            sides.append((first, min(last, size) - first))
        (x, width), (y, height) = sides
        return x, y, width, height

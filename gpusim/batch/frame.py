"""One frame of a sweep: its camera, its scene, and what it shares with others."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from gpusim.camera import Camera
from gpusim.config.mistakes import checked
from gpusim.errors import UserError
from gpusim.lens.perturb import perturbed
from gpusim.library.session import LENS_SETTINGS, READ_OUT
from gpusim.sensor.optical import OPTICAL
from gpusim.sensor.sensor import Sensor

if TYPE_CHECKING:
    from gpusim.batch.sweep import Sweep

OF_SCENE = ("luminance_cd_m2", "illuminant")


@dataclass(frozen=True)
class Frame:
    """One frame of a sweep.

    Attributes
    ----------
    sweep : Sweep
    scene : str
        Chart or file.
    settings : dict of str to object
        The value of each axis.
    number : int
        In the sweep.
    """

    sweep: Sweep
    scene: str
    settings: dict[str, Any]
    number: int = 0

    @property
    def name(self) -> str:
        """What its files are called."""
        return f"frame-{self.number:06d}"

    @property
    def read_out(self) -> dict[str, Any]:
        """Settings of `Light.capture`."""
        given = {name: value for name, value in self.settings.items() if name in READ_OUT}
        whole = ("iso", "seed", "frame")
        return {name: int(v) if name in whole else v for name, v in given.items()}

    @property
    def _sensor_changes(self) -> dict[str, Any]:
        return {
            name.removeprefix("sensor."): value
            for name, value in self.settings.items()
            if name.startswith("sensor.") or name == "serial_number"
        }

    def sensor(self) -> Sensor:
        """Return the sensor with this frame's figures.

        Raises
        ------
        UserError
            A figure that it cannot have.
        """
        base, changes = self.sweep.base.sensor, self._sensor_changes
        if not changes:
            return base
        fields = base.model_dump() | changes
        return checked(Sensor, fields, Path(self.sweep.camera))

    def camera(self) -> Camera:
        """Return the camera of this frame.

        Raises
        ------
        UserError
            A setting that it cannot have.
        """
        base, lens = self.sweep.base, self.sweep.base.lens
        for name, make in LENS_SETTINGS.items():
            if name in self.settings:
                if not hasattr(lens, "scaled"):
                    raise UserError(
                        "a ready-made lens is used as it is",
                        field=f"axes.{name}",
                        allowed="a camera whose lens is a prescription",
                    )
                lens = make(lens, self.settings[name])
        for name, value in self.settings.items():
            if name.startswith("lens."):
                lens = perturbed(lens, name.removeprefix("lens."), value, f"axes.{name}")
        return Camera(lens, self.sensor(), base.title)

    @property
    def scene_options(self) -> dict[str, Any]:
        """Options of `gpusim.scene.make_scene`."""
        return {name: self.settings[name] for name in OF_SCENE if name in self.settings}

    @cached_property
    def light_key(self) -> str:
        """What frames that share a light have in common."""
        optics = {
            name: value
            for name, value in self.settings.items()
            if name in LENS_SETTINGS or name in OF_SCENE or name.startswith("lens.")
        }
        optical = {n: v for n, v in self._sensor_changes.items() if n in OPTICAL}
        sweep = self.sweep
        own = [sweep.camera, sweep.rows, sweep.cols, sweep.tile, sweep.tolerance, sweep.probes]
        text = json.dumps([own, self.scene, optics, optical, sweep.best_effort], default=_plain)
        return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


def _plain(value: object) -> object:
    return value.model_dump() if isinstance(value, BaseModel) else str(value)

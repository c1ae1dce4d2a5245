"""Sensors that one asks by hand: presets, files, fields of one's own."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Any, Self

from pydantic import ValidationError

from gpusim.config.mistakes import user_error
from gpusim.library.notebook import curves, facts, figure
from gpusim.sensor import sensor
from gpusim.sensor.load import load_sensor

if TYPE_CHECKING:
    from pathlib import Path


class Sensor(sensor.Sensor):
    """A sensor, or a region of one: the figures of its data sheet, and what follows from them.

    Made by `Sensor.load`, or of the fields of a sensor file. The figures are listed with
    `gpusim.sensor.datasheet.DataSheet`. Nothing in it can be changed in place;
    ``sensor.model_copy(update={"full_well_e": 2e4})`` gives a changed one, which is checked.

    Raises
    ------
    UserError
        A field is wrong, unknown or missing, or contradicts another.

    Examples
    --------
    >>> from gpusim import Sensor
    >>> quiet = Sensor.load("imx477").model_copy(update={"temporal_dark_noise_e": 1.0})
    >>> quiet.temporal_dark_noise_e
    1.0
    >>> {quiet: "by what it holds"}[quiet.model_copy()]
    'by what it holds'
    """

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise user_error(error, type(self)) from error

    @classmethod
    def load(cls, name_or_path: str | Path) -> Self:
        """Return a sensor of the package by its name, or that of a file.

        Parameters
        ----------
        name_or_path : str or path
            ``gpusim sensor`` lists the names.

        Raises
        ------
        UserError
            Unknown preset; a file that cannot be read or is no YAML; a wrong field.

        Examples
        --------
        >>> from gpusim import Sensor
        >>> Sensor.load("imx477").roi(480, 640).rows
        480
        """
        return cls.of(load_sensor(name_or_path))

    @classmethod
    def of(cls, made: sensor.Sensor) -> Self:
        """Return a sensor as one that shows itself."""
        shown = cls.model_construct(made.model_fields_set)
        for name in ("__dict__", "__pydantic_private__"):
            object.__setattr__(shown, name, copy(getattr(made, name)))
        return shown

    def _repr_html_(self) -> str:
        """Return quantum efficiency from 400 to 700 nm and the main figures, for notebooks."""
        pattern = " / ".join(" ".join(row) for row in self.cfa.pattern)
        told = {
            "pixels": f"{self.cols} x {self.rows} of {self.pixel_pitch_um:g} um",
            "filters": pattern,
            "full well": f"{self.full_well_e:g} e-",
            "dark noise": f"{self.temporal_dark_noise_e:g} e-",
            "dark current": f"{self.dark_current_e_per_s:g} e-/s",
            "converter": f"{self.bit_depth} bit, {self.system_gain_dn_per_e:.3g} DN/e-",
            "quantum efficiency": f"up to {max(one.max() for one in self.qe.values()):.2f}, "
            "400 to 700 nm",
        }
        lines = ((name[0], self.qe[name]) for name in self.channels)
        return figure(curves(lines), facts(self.name, told))

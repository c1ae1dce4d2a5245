"""Sensors of other programs: what became of each thing that their files state.

A converter (`gpusim.formats.speos`, `gpusim.formats.isetcam_sensor`) turns a file into the fields
of a sensor file. Each field has its source: the key that it was read from with the equation, or
what is assumed because the file says nothing. What has no counterpart is listed; nothing is
dropped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from gpusim.config.mistakes import checked
from gpusim.errors import UserError
from gpusim.sensor.sensor import Sensor

GIVEN = "given by hand"


@dataclass
class Conversion:
    """Fields of a sensor file with their sources, and what found no place among them.

    Attributes
    ----------
    file : Path
        What was read.
    fields : dict
        Fields of a sensor file, without ``sources``.
    sources : dict of str to str
        Where each comes from; "assumed: ..." where the file says nothing.
    unused : list of str
        What the file states and no field takes, with the reason.
    """

    file: Path
    fields: dict[str, object] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)

    def put(self, name: str, value: object, source: str) -> None:
        """Set a field."""
        self.fields[name], self.sources[name] = value, source

    def assume(self, name: str, value: object, why: str) -> None:
        """Set a field that the file does not give, unless it is known already."""
        if name not in self.fields:
            self.put(name, value, f"assumed: {why}")

    def sensor(self, given: Mapping[str, object]) -> Sensor:
        """Return the sensor, in which some fields are given by hand.

        Raises
        ------
        UserError
            A field is wrong, missing or unknown.
        """
        fields = {**self.fields, **given}
        sources = {**self.sources, **dict.fromkeys(given, GIVEN)}
        own = ("name", "serial_number", "first_row", "first_col", "sources")
        missing = [
            name
            for name, info in Sensor.model_fields.items()
            if info.is_required() and name not in fields
        ]
        if missing:
            raise UserError(
                "the file does not say all that a sensor needs",
                file=self.file,
                field=missing[0],
                value="nothing",
                allowed=f"give it by hand: {' '.join(f'--set {one}=...' for one in missing)}",
            )
        fields["sources"] = {name: text for name, text in sources.items() if name not in own}
        return checked(Sensor, fields, self.file, folder=self.file.parent)


class _Dumper(yaml.SafeDumper):
    """Lists of numbers and rows of filters on lines of their own, fields in their order."""


def _sequence(dumper: yaml.SafeDumper, values: list) -> yaml.Node:
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=True)


_Dumper.add_representer(list, _sequence)


def sensor_text(sensor: Sensor, first: str) -> str:
    """Return a sensor file.

    Parameters
    ----------
    sensor : Sensor
    first : str
        What its first line, a comment, says.
    """
    fields = sensor.model_dump(mode="json", exclude_defaults=True)
    text = yaml.dump(fields, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
    return f"# {first}\n{text}"

"""Loading sensor files, and those that come with the package by their names."""

from __future__ import annotations

from pathlib import Path

from gpusim.config.mistakes import checked
from gpusim.config.names import perhaps
from gpusim.config.text import read_yaml
from gpusim.errors import UserError
from gpusim.sensor.sensor import Sensor

PRESETS = Path(__file__).resolve().parents[1] / "data" / "sensors"


def presets() -> list[str]:
    """Return the names of the sensors that come with the package."""
    return sorted(path.stem for path in PRESETS.glob("*.yaml"))


def load_sensor(name_or_path: str | Path) -> Sensor:
    """Load a sensor file, or a preset by its name.

    Raises
    ------
    UserError
        Unknown preset; a file that cannot be read or is no YAML; a wrong field.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = PRESETS / f"{name_or_path}.yaml"
        if str(name_or_path) not in presets():
            raise UserError(
                f"there is no sensor of that name{perhaps(name_or_path, presets())}",
                field="sensor",
                value=name_or_path,
                allowed=f"a .yaml file, or one of: {', '.join(presets())}",
            )
    return checked(Sensor, read_yaml(path, "the sensor file"), path, folder=path.parent)

"""What users may get wrong in a file: its content with some values replaced."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path

import yaml

from gpusim.sensor.load import PRESETS

Change = tuple[Sequence[str | int], object]


def changed(data: dict, *changes: Change) -> dict:
    """Return a copy of nested data with the value at each path replaced; ``...`` removes it."""
    found = copy.deepcopy(data)
    for (*parents, last), value in changes:
        place = found
        for key in parents:
            place = place[key]
        if value is ...:
            del place[last]
        else:
            place[last] = value
    return found


def sensor_file(folder: Path, *changes: Change, preset: str = "imx477", **fields: object) -> Path:
    """Write ``sensor.yaml``: a preset with whole fields, and then values at paths, replaced."""
    data = yaml.safe_load((PRESETS / f"{preset}.yaml").read_text(encoding="utf-8"))
    file = folder / "sensor.yaml"
    whole = (((name,), value) for name, value in fields.items())
    file.write_text(yaml.safe_dump(changed(data, *whole, *changes)))
    return file

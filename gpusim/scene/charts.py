"""The charts that ship with the project: YAML files in ``gpusim/data/charts``."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

from gpusim.scene.chart_file import Laid, read_chart
from gpusim.scene.patterns import Frame

HALF_WIDTH = 4 / 3  # half-heights: the field that charts are laid out for

FOLDER = Path(str(files("gpusim") / "data" / "charts"))
FIRST = ("demo", "colorchecker", "slanted-edge")  # of the list
_NAMES = sorted(file.stem for file in FOLDER.glob("*.yaml"))
CHARTS: tuple[str, ...] = (*FIRST, *(name for name in _NAMES if name not in FIRST))
"""Names of the charts."""
SUFFIXES = (".yaml", ".yml")


def is_chart(name_or_path: str | Path) -> bool:
    """Return whether a scene is a chart of the project or a file that describes one."""
    return str(name_or_path) in CHARTS or Path(name_or_path).suffix.lower() in SUFFIXES


def load_chart(name_or_path: str | Path, frame: Frame | None = None, **size: Any) -> Laid:
    """Return a chart by its name or from a YAML file; ``size`` as of `read_chart`."""
    name = str(name_or_path)
    path = FOLDER / f"{name}.yaml" if name in CHARTS else Path(name_or_path)
    return read_chart(path, frame, **size)

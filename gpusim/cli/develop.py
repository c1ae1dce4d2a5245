"""``gpusim develop``."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from gpusim.cli.files import whole_file
from gpusim.isp.develop import develop


def run(raw: Path, out: Path, ev: float, *, binned: bool) -> None:
    """Develop a raw file into a picture."""
    with whole_file(out, (".png",)) as file:
        Image.fromarray(develop(raw, ev, binned=binned)).save(file)
    print(out)

"""Targets of the Ansys and Meta validation: a checkerboard, waves, and the paper's eSFR chart.

The eSFR chart is the library's, of 50.3 x 33.5 in. The paper measures the square in the middle of
an older edition, where the library's has a star: here that square is in the star's place. The other
stars are left out; patches too, for colours' reflectances are known to 730 nm, where the scene
would end, and greys would lie beside ROI 1.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import yaml

from gpusim.scene import make_scene
from gpusim.scene.charts import FOLDER
from gpusim.scene.patterns import Frame
from gpusim.scene.scene import Scene
from gpusim.validate.edges import TILT_RAD

LUMINANCE_CD_M2, LAMP = 500.0, "D50"  # section 2.2
# Steps of 2:1 keep the certificate's errors, which are relative to the local signal, small: of 4:1
# they are 2.6e-3.
DARK, BRIGHT = 0.36, 0.72
HEIGHT_MM = 850.9  # 33.5 in
# The side of the square in the middle, half-heights: at 1.061 mm its edges are 85 px long, and
# regions of 64 px fit beside them.
SIDE = 0.45
# Steps of 2:1 in place of the chart's 4:1.
FILLS = {"grey": DARK, "dark": DARK**2 / BRIGHT, "bright": BRIGHT}


def drawn(text: str, frame: Frame, lamp: str = LAMP, height: str | None = None) -> Scene:
    """Return the scene of a chart's YAML before a camera, if need be of a height ("850mm")."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "chart.yaml"
        file.write_text(text, encoding="utf-8")
        return make_scene(file, LUMINANCE_CD_M2, lamp, frame=frame, chart_height=height)


def board(count: int, side: float) -> str:
    """Return the YAML of a checkerboard of so many squares along each side, half-heights."""
    return (
        f"title: a checkerboard\nfills: {{white: {BRIGHT}, black: {DARK}}}\nbackground: white\n"
        f"shapes:\n  - {{shape: checkerboard, squares: [{count}, {count}], side: {side:.9f}, "
        "fill: black}\n"
    )


def sinusoid(period_px: int) -> str:
    """Return the YAML of a vertical grating."""
    return (
        "title: a wave\nunit: pixels\nbackground: 0.5\n"
        f"pattern: {{pattern: sinusoid, period: {period_px}, fills: [{DARK}, {BRIGHT}]}}\n"
    )


@cache
def _chart() -> str:
    """Return the YAML of the library's eSFR chart with a square in the middle, without stars."""
    found = yaml.safe_load((FOLDER / "e-sfr.yaml").read_text(encoding="utf-8"))
    square = {"shape": "rectangle", "size": [SIDE, SIDE], "fill": "dark"}
    square["angle_deg"] = math.degrees(TILT_RAD)
    others = [one for one in found["shapes"] if one["shape"] == "rectangle"]
    return yaml.safe_dump(found | {"shapes": [square, *others], "fills": FILLS})


def chart(frame: Frame, lamp: str = LAMP) -> Scene:
    """Return the eSFR chart before a camera, as large as the paper's."""
    return drawn(_chart(), frame, lamp, f"{HEIGHT_MM}mm")


def half_um(frame: Frame) -> float:
    """Return half the side of the chart's square on the ideal plane of the camera before it."""
    return 1e3 * frame.principal_mm * SIDE / 4 * HEIGHT_MM / frame.object_mm

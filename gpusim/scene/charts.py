"""The charts that ship with the project, laid out over a 4:3 field.

Lengths are in half-heights of the sensor: the field is |x| <= 4/3, |y| <= 1. On 1520 rows 0.01 is
7.6 pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import numpy as np

from gpusim.known import Known
from gpusim.scene.chart import Chart, Disc, Primitive, Rect
from gpusim.scene.spectra import WAVELENGTHS_NM, colorchecker, colorchecker_known

HALF_WIDTH = 4 / 3
EDGE_ANGLE_RAD = math.radians(5.0)  # ISO 12233:2017 asks for about 5 degrees

# A background that an averaging light meter is calibrated for, and a dark 4:1 below it: the low
# edge contrast of ISO 12233:2014, which keeps clear of clipping and of sharpening's overshoot. Both
# are flat spectra.
GREY, DARK = 0.18, 0.045
# The wider contrast, 16:1, for charts without colour.
WHITE, BLACK = 0.80, 0.05

# Density steps of half a stop for tone curve and noise, 85 % to 1.9 %; the carrier lies midway
# between two.
WEDGE_DENSITIES = tuple(0.07 + 0.15 * step for step in range(12))

# ColorChecker Classic: patches of 40 mm with gaps of 6 mm between them.
PATCH_TO_PITCH = 40 / 46

DOT_PITCH = 2 / 23  # 66 pixels on 1520 rows; the field ends between two rows of dots
DOT_RADIUS = 0.0105  # 8 pixels on 1520 rows
CLEAR = 0.02  # least distance between a dot and anything else
# Dots go on beyond the field, which a barrel-distorting lens looks past.
OVERSCAN = 1.06


class _Sheet:
    """A chart in the making: named reflectances and the primitives painted so far."""

    def __init__(self, background: float) -> None:
        self.reflectances: dict[str, np.ndarray] = {}
        self.primitives: list[Primitive] = []
        self.neutral(background)

    def material(self, name: str, reflectance: np.ndarray) -> int:
        self.reflectances.setdefault(name, reflectance)
        return list(self.reflectances).index(name)

    def neutral(self, reflectance: float) -> int:
        """Return the material of spectrally flat reflectance."""
        return self.material(
            f"neutral {100 * reflectance:.3g} %", np.full(WAVELENGTHS_NM.size, reflectance)
        )

    def slanted_square(self, cx: float, cy: float, half: float, reflectance: float) -> None:
        """Paint a square whose sides are near-vertical and near-horizontal edges."""
        self.primitives.append(Rect(cx, cy, half, half, EDGE_ANGLE_RAD, self.neutral(reflectance)))

    def patches(self, cx: float, cy: float, pitch: float, rows: list[list[int]]) -> None:
        """Paint rows of square patches on a dark carrier."""
        gap = pitch * (1 - PATCH_TO_PITCH)
        half_w, half_h = len(rows[0]) * pitch / 2, len(rows) * pitch / 2
        self.primitives.append(
            Rect(cx, cy, half_w + gap / 2, half_h + gap / 2, 0.0, self.neutral(DARK))
        )
        half = pitch * PATCH_TO_PITCH / 2
        for r, row in enumerate(rows):
            for c, material in enumerate(row):
                x, y = cx - half_w + (c + 0.5) * pitch, cy - half_h + (r + 0.5) * pitch
                self.primitives.append(Rect(x, y, half, half, 0.0, material))

    def colorchecker(self, cx: float, cy: float, pitch: float) -> None:
        """Paint the ColorChecker upright: dark skin at the top left, the greys at the bottom."""
        patches = [self.material(name, spectrum) for name, spectrum in colorchecker().items()]
        self.patches(cx, cy, pitch, [patches[6 * row : 6 * row + 6] for row in range(4)])

    def dots(self, reflectance: float) -> None:
        """Fill what is free with a square grid of dots, one of them on the axis if that is free."""
        material = self.neutral(reflectance)
        across, down = (int(extent * OVERSCAN / DOT_PITCH) for extent in (HALF_WIDTH, 1.0))
        columns = DOT_PITCH * np.arange(-across, across + 1)
        rows = DOT_PITCH * np.arange(-down, down + 1)
        x, y = np.meshgrid(columns, rows)
        distance = np.full(x.shape, np.inf)
        for primitive in self.primitives:
            distance = np.minimum(distance, primitive.distance(x, y))
        free = distance >= DOT_RADIUS + CLEAR
        self.primitives += [
            Disc(float(cx), float(cy), DOT_RADIUS, material)
            for cx, cy in zip(x[free], y[free], strict=True)
        ]

    def done(self) -> tuple[Chart, np.ndarray]:
        chart = Chart(tuple(self.reflectances), 0, tuple(self.primitives))
        return chart, np.stack(list(self.reflectances.values()))


# Besides the axis: half the field's diagonal; and as near to the corners as leaves 45 pixels of
# 1520 rows around the squares for the region of interest.
HALF_FIELD = [(sx * HALF_WIDTH / 2, sy / 2) for sx, sy in product((-1, 1), repeat=2)]
CORNERS = [(sx * 1.17, sy * 0.835) for sx, sy in product((-1, 1), repeat=2)]


def demo() -> tuple[Chart, np.ndarray]:
    """Lay out slanted edges, ColorChecker, density wedge and distortion dots in one field."""
    sheet = _Sheet(GREY)
    for cx, cy in [(0.0, 0.0), *HALF_FIELD, *CORNERS]:
        sheet.slanted_square(cx, cy, 0.1, DARK)
    sheet.colorchecker(0.0, 0.53, 0.155)
    steps = [sheet.neutral(10**-density) for density in WEDGE_DENSITIES]
    sheet.patches(0.0, -0.83, 0.155, [steps])
    sheet.dots(DARK)
    return sheet.done()


def color_checker() -> tuple[Chart, np.ndarray]:
    """Lay out the ColorChecker alone, as large as the field takes it."""
    sheet = _Sheet(GREY)
    sheet.colorchecker(0.0, 0.0, 0.42)
    return sheet.done()


def slanted_edge() -> tuple[Chart, np.ndarray]:
    """Lay out black squares on white, 16:1, one spectrum: axis, half field, corners."""
    sheet = _Sheet(WHITE)
    for cx, cy in [(0.0, 0.0), *HALF_FIELD, *CORNERS]:
        sheet.slanted_square(cx, cy, 0.1, BLACK)
    return sheet.done()


def dots() -> tuple[Chart, np.ndarray]:
    """Lay out black dots on white, one spectrum, over the whole field and one on the axis."""
    sheet = _Sheet(WHITE)
    sheet.dots(BLACK)
    return sheet.done()


def grey() -> tuple[Chart, np.ndarray]:
    """Lay out a uniform 18 % grey, for flat fields."""
    return _Sheet(GREY).done()


CHARTS: dict[str, Callable[[], tuple[Chart, np.ndarray]]] = {
    "demo": demo,
    "colorchecker": color_checker,
    "slanted-edge": slanted_edge,
    "dots": dots,
    "grey": grey,
}
"""Chart and reflectances of its materials (M, 61), by name."""


def reflectances_at(
    chart: Chart, reflectances: np.ndarray, wavelengths_nm: np.ndarray
) -> np.ndarray:
    """Return the reflectances (M, K) of a chart's materials at other wavelengths.

    Patches of the ColorChecker beyond what is known of them as at its ends; greys are flat.
    """
    measured = colorchecker(wavelengths_nm)
    flat = (np.full(wavelengths_nm.size, row[0]) for row in reflectances)
    return np.stack(
        [measured.get(name, grey) for name, grey in zip(chart.materials, flat, strict=True)]
    )


def known_reflectances(chart: Chart) -> tuple[Known, ...]:
    """Return over which wavelengths the materials of a chart are known: greys over all."""
    measured = not set(colorchecker()).isdisjoint(chart.materials)
    return (colorchecker_known(),) if measured else ()
